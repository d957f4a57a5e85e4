"""`graphtrack forecast`, `score` of its tables, `fit --forecast` and `track - --forecast`."""

import json

import numpy as np
import pandas as pd
import pytest
from command import run

import graphtrack as gt
from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.forecasting.forecaster import Forecaster, times_ahead
from graphtrack.forecasting.motion import ForecastParameters
from graphtrack.streaming.behaviour import EndedFrames
from graphtrack.tracking import OnlineTracker

KEYS = ["ahead", "x", "y", "x_std", "y_std", "xy_cov", "radius_50", "radius_90"]


def walkers(path, people=4, steps=20):
    rng = np.random.default_rng(0)
    rows = ["track_id,frame,t,x,y"]
    for k in range(people):
        start, speed = rng.uniform(0, 9, 2), rng.normal(0, 1, 2)
        for f in range(steps):
            x, y = start + 0.4 * f * speed + rng.normal(0, 0.02, 2)
            rows.append(f"{k},{f},{0.4 * f:.1f},{x:.4f},{y:.4f}")
    rows.append(f"{people},0,0.0,0,0")
    path.write_text("\n".join(rows) + "\n")


def graphtrack(line):
    return run(*line.split(), program="graphtrack")


@pytest.fixture
def here(cwd):
    walkers(cwd / "tracks.csv")
    return cwd


def test_forecasts_are_written_counted_and_scored(here):
    done = graphtrack("forecast tracks.csv -o forecast.csv --history 3.2 --samples 20")
    assert done.returncode == 0, done.stderr
    assert "no forecast of 1 track observed for less than 3.2 s" in done.stderr
    table = pd.read_csv("forecast.csv")
    assert list(table)[:11] == ["track_id", "frame", "t", *KEYS] and list(table)[11] == "sample_0_x"
    # Frames 7 to 19 of four people, twelve times ahead.
    assert len(table) == 4 * 13 * 12
    done = graphtrack("score forecast.csv --truth tracks.csv --json score.json")
    assert done.returncode == 0, done.stderr
    assert "4 forecasts judged, 48 left out" in done.stderr
    score = json.loads((here / "score.json").read_text())["forecast"]
    assert set(score["methods"]) == {"forecast", "constant velocity", "Kalman filter"}
    own, other = score["methods"]["forecast"], score["methods"]["constant velocity"]
    assert own["ade"] < other["ade"] and other["log_likelihood"] is None


def test_forecasts_do_not_go_with_options_of_tracks(here):
    graphtrack("forecast tracks.csv -o forecast.csv")
    for line in ("--metres 1", "--iou 0.5", "--report out.html"):
        done = graphtrack(f"score forecast.csv --truth tracks.csv {line}")
        assert done.returncode == 2 and "with forecasts" in done.stderr
    done = graphtrack("score forecast.csv tracks.csv --truth tracks.csv")
    assert done.returncode == 2


def test_what_is_learned_is_written_and_can_be_used(here, monkeypatch):
    one = {"place_distance": (1.0, 2.0)}
    monkeypatch.setattr("graphtrack.learning.forecasts.PLACE_STEPS", one)
    done = graphtrack("fit tracks.csv -o learned.toml --forecast --json learned.json")
    assert done.returncode == 0, done.stderr
    learned = ForecastParameters.load("learned.toml")
    assert learned.place_distance in one["place_distance"]
    found = json.loads((here / "learned.json").read_text())
    before, after = found["density"]["tracks.csv"]
    assert after > before
    line = "forecast tracks.csv -o forecast.csv --parameters learned.toml"
    assert graphtrack(line).returncode == 0


def test_a_late_row_changes_no_forecast():
    forecasts = EndedFrames(None, Forecaster(), times_ahead(0.8, 0.4))
    smoother = OnlineSmoother("position")
    seen = [gt.Observation(t=0.4 * k, frame=k, position=(0.5 * k, 0.0)) for k in (0, 1, 3, 2, 4)]
    told = [forecasts.take(1, one, smoother.update(one)) for one in seen]
    assert [row["frame"] for rows in told for row in rows] == [1, 3]


@pytest.mark.slow
def test_one_person_alone_is_forecast_and_can_be_learned_from(here, monkeypatch):
    monkeypatch.setattr("graphtrack.learning.forecasts.PLACE_STEPS", {"stop_speed": (0.0, 0.2)})
    walkers(here / "one.csv", people=1, steps=40)
    assert graphtrack("forecast one.csv -o forecast.csv").returncode == 0
    assert set(pd.read_csv("forecast.csv")["track_id"]) == {0}
    done = graphtrack("fit one.csv --forecast -o learned.toml")
    assert done.returncode == 0, done.stderr
    walkers(here / "short.csv", people=1, steps=2)
    done = graphtrack("fit short.csv --forecast -o learned.toml")
    assert done.returncode == 2 and "no person observed after a forecast" in done.stderr


def test_a_tracker_that_is_asked_late_says_what_one_says_that_was_always_asked():
    rng = np.random.default_rng(1)
    early, late = OnlineTracker("position"), OnlineTracker("position")
    with pytest.raises(InputError, match="update"):
        late.forecast(2.0)
    for k in range(12):
        where = np.array([(0.5 * k, 0.0), (9.0 - 0.4 * k, 4.0)]) + rng.normal(0, 0.03, (2, 2))
        early.update(0.4 * k, where)
        late.update(0.4 * k, where)
        first = early.forecast(2.0)
    second = late.forecast(2.0)
    assert first.track_id.tolist() == second.track_id.tolist() == [1, 2]
    np.testing.assert_allclose(first.position, second.position)
    np.testing.assert_allclose(first.radius_90, second.radius_90)
