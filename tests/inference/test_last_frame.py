"""The last frame of a track has no later observations: offline and online agree on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.geometry.angles import difference
from graphtrack.inference.chain import batch
from graphtrack.simulation.degrade import add_noise


def differences(preset: str) -> np.ndarray:
    """Mean degrees between the last bodies and heads of whole tracks, and of the same online."""
    people = gt.simulate(preset, n_tracks=16, n_steps=45, fps=10.0, rng=np.random.default_rng(8))
    whole, online = gt.smooth(people, preset), gt.track_online(people, preset, lag=10.0)
    return mean_differences(whole, online)


def mean_differences(whole: gt.TrackSet, online: gt.TrackSet) -> np.ndarray:
    """Mean differences of the last bodies and the last heads, in degrees."""
    found = []
    for one, other in zip(whole, online, strict=True):
        found.append([difference(one.body[-1], other.body[-1]), difference(one.head[-1], other.head[-1])])
    return np.asarray(np.degrees(np.abs(found).mean(axis=0)))


@pytest.mark.parametrize("preset", ["separate", "joint"])
def test_the_last_frame_is_the_same_online(preset: str) -> None:
    assert differences(preset).max() < 0.01


def test_the_last_frame_is_nearly_the_same_online_with_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offline turns between modes and states are taken until nothing changes; online has one."""
    monkeypatch.setattr(batch, "PASSES", 8)
    assert differences("full").max() < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 3])
def test_the_last_frame_on_motion_capture(
    data_dir: Path, monkeypatch: pytest.MonkeyPatch, every: int
) -> None:
    """Mean degrees of 63 clips, with two turns between modes and states and with eight."""
    clips = gt.read(data_dir / "mocap" / "tracks_30hz.csv.gz")
    held = [track for track in clips.tracks[1::2] if len(track) >= 60]
    seen = []
    for seed in (0, 1):
        some, rng = clips.with_tracks(held[seed::6]), np.random.default_rng(seed)
        for track in add_noise(some, position_std=0.1, body_kappa=1.2, head_kappa=2.3, rng=rng):
            seen.append(replace(track[::every], track_id=len(seen)))
    scene = clips.with_tracks(seen)
    for preset, passes, body, head in (
        ("separate", 2, 0.01, 0.01),
        ("joint", 2, 0.02, 0.02),
        ("full", 2, 0.4, 0.8),
        ("full", 8, 0.15, 0.35),
    ):
        monkeypatch.setattr(batch, "PASSES", passes)
        found = mean_differences(gt.smooth(scene, preset), gt.track_online(scene, preset))
        print(every, preset, passes, found.round(4))
        assert (found < (body, head)).all()
