"""Speeds that no pedestrian has are told of; single outliers and noise are not."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputWarning


def walkers(n: int = 12, steps: int = 40, hz: float = 10.0, noise: float = 0.1) -> pd.DataFrame:
    """People who walk at 1.3 m/s, seen with noise (metres, each axis)."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"track_id": np.repeat(np.arange(n), steps), "frame": np.tile(np.arange(steps), n)})
    table["t"] = table.frame / hz
    table["x"] = 1.3 * table.t + rng.normal(0.0, noise, len(table))
    table["y"] = table.track_id + rng.normal(0.0, noise, len(table))
    return table


def told(table: pd.DataFrame) -> list[str]:
    """The notes on speeds."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        notes = gt.TrackSet.from_table(table).summary.notes
    found = [note for note in notes if "faster than" in note]
    assert [str(one.message) for one in caught] == [f"table: {note}" for note in found]
    return found


def test_centimetres_and_a_wrong_rate_are_told_with_numbers() -> None:
    centimetres = walkers()
    centimetres[["x", "y"]] *= 100.0
    (note,) = told(centimetres)
    found = re.match(r"12 of 12 tracks move faster than 12 m/s \(median (\d+), greatest (\d+)\)", note)
    assert found is not None and 125 <= float(found[1]) <= float(found[2]) <= 140
    assert all(word in note for word in ("metres", "fps", "homography", "metres_per_pixel"))
    fast = walkers()
    fast["t"] /= 100.0
    assert len(told(fast)) == 1


def test_some_who_walk_among_many_who_stand_are_enough() -> None:
    table = walkers(noise=0.01)
    table.loc[table.track_id >= 2, "x"] = table.track_id
    table[["x", "y"]] *= 100.0
    assert told(table)[0].startswith("2 of 12 tracks")


def test_noise_from_frame_to_frame_outliers_and_one_odd_track_are_not() -> None:
    noisy = walkers(hz=30.0, noise=0.5)
    steps = np.hypot(noisy.x.diff(), noisy.y.diff()) * 30.0
    assert np.median(steps.dropna()) > 12.0
    assert not told(noisy)
    jumping = walkers()
    jumping.loc[jumping.frame % 10 == 0, "x"] += 500.0
    assert not told(jumping)
    odd = walkers()
    odd.loc[odd.track_id == 0, "x"] *= 100.0
    assert not told(odd)


def test_a_recording_at_a_wrong_rate_is_told_of(data_dir: Path) -> None:
    with pytest.warns(InputWarning, match="faster than"):
        io.read_identified(data_dir / "towncentre/frames_001_150/gt.txt")
