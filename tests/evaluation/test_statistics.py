from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from walks import walk, without

from graphtrack import io
from graphtrack.experiments.baxter_statistics import (
    HISTOGRAM_EDGES,
    deviation_statistics,
    future_share,
    head_deviation,
    travel_velocity,
)
from graphtrack.geometry.angles import direction, unit, wrap
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour
from graphtrack.tracks.track import Track


def straight(head: np.ndarray, course: float = 1.0, speed: float = 1.2) -> Track:
    n = len(head)
    t = 0.04 * np.arange(n)
    return Track(1, np.arange(n), t, speed * t[:, None] * unit(course), head=wrap(head))


@pytest.mark.parametrize("course", [0.0, 1.0, 3.1, -3.1])
def test_mean_and_spread_are_those_that_were_put_in(course: float) -> None:
    rng = np.random.default_rng(0)
    offset = np.radians(rng.normal(-12.0, 25.0, 20_000))
    found = deviation_statistics([straight(course - offset, course)], "synthetic")
    assert np.degrees(found.mean) == pytest.approx(-12.0, abs=0.6)
    assert np.degrees(found.std) == pytest.approx(25.0, rel=0.02)
    assert found.density @ np.diff(HISTOGRAM_EDGES) == pytest.approx(1.0)
    peak = HISTOGRAM_EDGES[np.argmax(found.density)]
    assert peak <= np.radians(-12.0) < peak + np.radians(10.0) + 1e-9
    assert (found.people, found.frames) == (1, 20_000)


def test_the_velocity_is_the_mean_over_the_window() -> None:
    track = walk(80, uneven=True)
    rates = np.diff(track.position, axis=0) / np.diff(track.t)[:, None]
    found = travel_velocity(track, 24)
    np.testing.assert_allclose(found[40], rates[28:52].mean(axis=0))
    np.testing.assert_allclose(found[0], rates[:12].mean(axis=0))
    gappy = travel_velocity(without(track, "position", [40]), 24)
    np.testing.assert_allclose(gappy[40], np.delete(rates, [39, 40], axis=0)[28:50].mean(axis=0))


def test_who_stands_still_or_shows_no_head_does_not_count() -> None:
    assert np.isnan(head_deviation(straight(np.zeros(50), speed=0.1))).all()
    assert np.isnan(head_deviation(replace(straight(np.zeros(50)), head=None))).all()
    half = np.zeros(50)
    half[:25] = np.nan
    assert np.isfinite(head_deviation(straight(half))).sum() == 25
    assert deviation_statistics([straight(np.zeros(50), speed=0.1)], "synthetic") is None


@pytest.mark.parametrize("lag", [1, 5, 17])
def test_a_head_made_of_the_future_is_told(lag: int) -> None:
    track = walk(200, noise=0.1)
    head = np.full(200, np.nan)
    head[:-lag] = direction(track.position[lag:] - track.position[:-lag])
    track = replace(track, head=head)
    assert future_share([track]) > 0.95
    assert deviation_statistics([track], "synthetic").leaks_the_future


def test_an_honest_head_is_not_suspected() -> None:
    # The corpus looks ahead too, but with noise as a person does.
    corpus = simulate_behaviour(4, CorpusParameters(tracks=20), rng=np.random.default_rng(0))
    found = deviation_statistics(corpus.tracks(), "corpus")
    assert found.future < 0.05 and not found.leaks_the_future


def test_the_gaze_of_ucy_is_told(data_dir: Path) -> None:
    lines = (data_dir / "ucy/zara01/annotation.vsp").read_text().splitlines()
    place, tracks = 1, []
    for number in range(int(lines[0].split()[0])):
        count = int(lines[place].split()[0])
        rows = np.array([lines[k].split()[:4] for k in range(place + 1, place + 1 + count)], dtype=float)
        place += 1 + count
        _, first = np.unique(rows[:, 2], return_index=True)
        x, y, frame, gaze = rows[first].T
        # Gaze 0 points up the image and counts counter-clockwise; y points up.
        head = wrap(np.radians(gaze + 90.0))
        tracks.append(Track(number, frame.astype(int), frame / 25.0, 0.03 * np.stack([x, y], 1), head=head))
    assert future_share(tracks) > 0.4
    assert deviation_statistics(tracks, "ucy", window=2).leaks_the_future


@pytest.mark.parametrize("name", ["mocap/tracks_30hz.csv.gz", "caviar/xml/mws1gt.xml"])
def test_recorded_people_look_where_they_go(name: str, data_dir: Path) -> None:
    tracks = io.read_identified(data_dir / name)
    if "mocap" in name:
        tracks = tracks.select("*walk*")
    found = deviation_statistics(tracks, name)
    assert not found.leaks_the_future
    assert found.frames > 200
    assert np.abs(np.degrees(found.mean)) < 45.0
    assert np.argmax(found.density) in range(12, 24)
