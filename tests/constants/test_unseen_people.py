"""Learned constants on real people, against a filter that learns its own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from innovation_filter import estimates

import graphtrack as gt
from graphtrack.experiments.harness import evenly, thinned
from graphtrack.geometry.angles import wrap
from graphtrack.tracks.track import Track, TrackSet

INPUTS = {"all": ("body", "head"), "heads alone": ("head",), "positions alone": ()}


def observed(tracks: TrackSet, hz: float, channels: tuple[str, ...], rng: np.random.Generator) -> list[Track]:
    """Noise of 0.1 m, 30° (body) and 20° (head), and 15 % of the frames empty."""
    found = []
    for track in tracks:
        track = thinned(track, max(1, round(1.0 / (hz * float(np.median(track.dt[1:]))))))
        if len(track) < 8:
            continue
        empty = rng.random(len(track)) < 0.15
        empty[0] = False
        truth = {f"true_{name}": getattr(track, name) for name in ("position", "body", "head")}
        position = track.position + rng.normal(0.0, 0.1, (len(track), 2))
        position[empty] = np.nan
        angles: dict[str, np.ndarray] = {}
        for name, degrees in (("body", 30.0), ("head", 20.0)):
            true, noise = getattr(track, name), rng.normal(0.0, np.radians(degrees), len(track))
            if true is not None and name in channels:
                angles[name] = np.where(empty, np.nan, wrap(true + noise))
                angles[f"{name}_kappa"] = np.full(len(track), np.radians(degrees) ** -2)
        std = np.full(len(track), 0.1)
        found.append(Track(len(found), track.frame, track.t, position, position_std=std, **truth, **angles))
    return found


def errors(track: Track, found: dict[str, np.ndarray]) -> dict[str, float]:
    away = found["position"] - track.true_position
    result = {"position": float(np.sqrt(np.mean(np.sum(away**2, axis=1))))}
    for name in ("body", "head"):
        truth = getattr(track, f"true_{name}")
        if truth is not None:
            result[name] = float(np.abs(wrap(found[name] - truth)).mean())
    return result


@pytest.mark.slow
@pytest.mark.parametrize("hz", [10.0, 2.5])
@pytest.mark.parametrize("channels", INPUTS.values(), ids=list(INPUTS))
def test_errors_are_those_of_a_filter_that_learns_its_constants_or_smaller(
    data_dir: Path, hz: float, channels: tuple[str, ...]
) -> None:
    rng, people, source = np.random.default_rng(7), list[Track](), list[str]()
    for name in ("lafan1", "citr", "vru"):
        tracks = gt.read(data_dir / name / "truth.csv.gz")
        if name == "lafan1":  # pieces of 20 seconds
            parts = [t[k : k + 600] for t in tracks for k in range(0, len(t) - 599, 600)]
            tracks = tracks.with_tracks(replace(one, track_id=k) for k, one in enumerate(parts))
        people += observed(evenly(tracks, 20, 3.0), hz, channels, rng)
        source += [name] * (len(people) - len(source))
    crowd = TrackSet(tuple(replace(track, track_id=k) for k, track in enumerate(people)))
    ratios = []
    smoothed = gt.smooth(crowd, constants="learn")
    pairs = [
        (errors(t, {n: getattr(s, n) for n in ("position", "body", "head")}), errors(t, estimates(t)))
        for t, s in zip(crowd, smoothed, strict=True)
    ]
    for name in ("lafan1", "citr", "vru"):
        own = [pair for pair, one in zip(pairs, source, strict=True) if one == name]
        for quantity in own[0][0]:
            ratios.append(
                np.mean([ours[quantity] for ours, _ in own]) / np.mean([its[quantity] for _, its in own])
            )
    assert max(ratios) < 1.1 and np.exp(np.mean(np.log(ratios))) < 1.0, ratios
