"""Speed and heading in files: written with velocities, not read, with intervals on request."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from made_up import walker

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.streaming.protocol import estimate_row
from graphtrack.tracks.table import AsRead
from graphtrack.tracks.track import TrackSet


@pytest.fixture
def estimates():
    noisy = gt.simulate("joint", n_tracks=2, rng=np.random.default_rng(4))
    return gt.smooth(noisy)


def test_speed_and_heading_stand_in_the_file_and_are_not_read(estimates, tmp_path):
    path = tmp_path / "estimates.csv"
    gt.write(estimates, path)
    table = pd.read_csv(path)
    assert table["speed"].to_numpy() == pytest.approx(np.hypot(table["vx"], table["vy"]))
    assert table["heading_deg"].to_numpy() == pytest.approx(np.degrees(np.arctan2(table["vy"], table["vx"])))
    assert (table["speed_std"] > 0).all() and not any(name.endswith("_low") for name in table)
    again = gt.read(path)
    assert not again.summary.notes
    assert again.to_table()["speed"].to_numpy() == pytest.approx(table["speed"].to_numpy())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["with.csv", "with.parquet", "with.ndjson"])
def test_intervals_are_written_on_request_around_the_estimates(estimates, tmp_path, name):
    gt.write(estimates, tmp_path / name, intervals=0.9)
    again = gt.read(tmp_path / name)
    assert not again.summary.notes
    table = estimates.to_table(intervals=0.9)
    for column in ("speed", "heading_deg", "body_deg", "head_deg"):
        assert (table[f"{column}_low"] <= table[column]).all(), column
        assert (table[column] <= table[f"{column}_high"]).all(), column
    wider = estimates.to_table(intervals=0.99)
    assert (wider["speed_high"] > table["speed_high"]).all()
    low, high = estimates[0].interval("body", 0.6827)
    assert (high - low) / 2.0 == pytest.approx(estimates[0].std("body"), rel=1e-3)


def people_who_stand_and_walk(speed):
    rng, t = np.random.default_rng(8), 0.1 * np.arange(80)
    place = np.column_stack([speed * t, 0.0 * t]) + rng.normal(0.0, 0.03, (80, 2))
    return gt.Track(1, np.arange(80), t, place, position_std=np.full(80, 0.03), body=np.full(80, 0.2))


@pytest.mark.parametrize("angles", [None, "compass"])
def test_who_stands_has_no_heading(tmp_path, angles):
    """It is empty, with its interval, where 0 is in the 95 % ellipse of the velocity; all the rest stays."""
    found = gt.smooth(TrackSet((people_who_stand_and_walk(0.0),)))
    if angles is not None:
        found = replace(found, as_read=AsRead(angles=gt.AngleConvention.of(angles)))
    gt.write(found, tmp_path / "stands.csv", intervals=0.95)
    table = pd.read_csv(tmp_path / "stands.csv")
    cov, velocity = found[0].covariance[:, 2:4, 2:4], found[0].velocity
    inside = np.einsum("ni,nij,nj->n", velocity, np.linalg.inv(cov), velocity) <= 5.991
    assert inside.mean() > 0.5
    for name in ("heading_deg", "heading_deg_low", "heading_deg_high"):
        given = table[name].isna() if name in table else np.ones(len(table), bool)
        np.testing.assert_array_equal(given, inside)
    assert table["speed"].notna().all() and np.isfinite(found[0].heading).all()
    walks = gt.smooth(TrackSet((people_who_stand_and_walk(1.2),))).to_table()
    assert walks["heading_deg"].notna().all()
    online = gt.track_online(TrackSet((people_who_stand_and_walk(0.0),))).to_table()
    assert "heading_deg" not in online or online["heading_deg"].isna().mean() > 0.5


def test_an_online_estimate_and_its_row_have_a_speed():
    track, smoother = people_who_stand_and_walk(1.2), gt.OnlineSmoother(constants="default")
    table = gt.track_online(TrackSet((track,)), constants="default").to_table()
    for k in range(20):
        one = smoother.update(
            gt.Observation(track.t[k], k, tuple(track.position[k]), position_std=0.03, body=0.2)
        )
        assert one.speed == pytest.approx(table["speed"][k])
        assert one.speed_std == pytest.approx(table["speed_std"][k])
        assert estimate_row(1, one)["speed"] == one.speed
    waiting = gt.OnlineSmoother().update(gt.Observation(0.0))
    assert np.isnan(waiting.speed) and estimate_row(1, waiting)["speed"] is None


def test_a_speed_without_a_velocity_is_named():
    table = TrackSet((walker(1, velocity=None),)).to_table().assign(speed=1.0)
    assert "speed" not in TrackSet((walker(1, velocity=None),)).to_table()
    assert "speed" in gt.read(table).summary.notes[0]


def test_refusals(estimates, tmp_path):
    with pytest.raises(InputError, match="format mot"):
        gt.write(estimates, tmp_path / "boxes.txt", intervals=0.95)
    bare = TrackSet(tuple(replace(track, covariance=None) for track in estimates))
    with pytest.raises(InputError, match="without uncertainties"):
        gt.write(bare, tmp_path / "bare.csv", intervals=0.95)
    for wrong in (0.0, 1.0, 95.0, float("nan")):
        with pytest.raises(InputError, match="between 0 and 1"):
            gt.write(estimates, tmp_path / "wrong.csv", intervals=wrong)
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match="quantity"):
        estimates[0].interval("colour")
