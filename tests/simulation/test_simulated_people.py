"""Simulated people have the statistics of the estimator's model, at every frame rate."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from selection import others_slow

from graphtrack.geometry.angles import FloatArray, difference, direction, wrap
from graphtrack.model import GaitParameters, Model, Parameters
from graphtrack.model.model import default_parameters
from graphtrack.model.parameters import steady
from graphtrack.simulation import sampling
from graphtrack.simulation.motion import sample_modes
from graphtrack.simulation.sampling import sample_glances, sample_states, simulate
from graphtrack.smoothing import smooth
from graphtrack.tracks.track import TrackSet

COUPLED = ("joint-body", "joint", "joint-intentional")


def states_of(preset: str, fps: float, people: int = 20, seconds: float = 15.0) -> Mapping[str, FloatArray]:
    t = np.arange(round(seconds * fps)) / fps
    return sample_states(t, people, Model(preset), np.random.default_rng(1), pace=1.3)


def misaligned(preset: str, fps: float) -> float:
    """Degrees, root mean square, from the motion to the body of people who walk briskly."""
    states = states_of(preset, fps)
    brisk = np.linalg.norm(states["velocity"], axis=-1) > 1.0
    off = difference(states["body"], direction(states["velocity"]))[brisk]
    return float(np.degrees(np.sqrt(np.mean(off**2))))


@pytest.mark.parametrize("preset", others_slow(COUPLED, ["joint"]))
def test_bodies_face_the_motion_alike_at_every_rate(preset: str) -> None:
    # From 10 Hz on a frame is short against the correlation time, and the rate no longer matters.
    found = [misaligned(preset, fps) for fps in (10.0, 20.0, 60.0)]
    assert min(found) > 7.0 and max(found) < 10.5, found
    assert 5.5 < misaligned(preset, 2.5) < 9.5


@pytest.mark.slow
def test_people_walk_at_their_pace_all_the_time() -> None:
    for preset in ("position", "separate", "joint", "intentional", "full"):
        for fps in (2.5, 20.0):
            speed = np.linalg.norm(states_of(preset, fps, 60, 25.0)["velocity"], axis=-1)
            median = np.median(speed, axis=1)
            assert 1.1 < np.median(median) < 1.5 and 0.15 < median.std() < 0.45, (preset, fps)
            assert np.median(speed[:, -1]) < 1.7
    slow = sample_states(np.arange(50) / 5.0, 60, Model("joint"), np.random.default_rng(2), pace=0.7)
    assert 0.5 < np.median(np.linalg.norm(slow["velocity"], axis=-1)) < 0.9


def test_modes_have_their_shares_rates_and_offsets() -> None:
    gait = GaitParameters(
        body_aligned=0.3, body_switching=0.5, body_spread=0.1, body_drift=0.02, body_offset_kappa=2.0
    )
    t = np.arange(400) / 10.0
    modes = sample_modes(t, 400, gait, np.random.default_rng(4)).body
    # 400 people for 40 s, in which the mode is redrawn twenty times.
    assert modes.aligned.mean() == pytest.approx(0.3, abs=0.03)
    for k in (0, -1):
        assert modes.aligned[:, k].mean() == pytest.approx(0.3, abs=0.1)
    near = modes.offset[modes.aligned]
    assert near.std() == pytest.approx(0.1, rel=0.1)
    switched = modes.aligned[:, 1:] != modes.aligned[:, :-1]
    assert switched.mean() == pytest.approx((1.0 - np.exp(-0.05)) * 2.0 * 0.3 * 0.7, rel=0.1)
    stays = modes.offset[:, 1:] == modes.offset[:, :-1]
    assert stays[modes.aligned[:, 1:] & modes.aligned[:, :-1]].mean() > 0.9
    both_free = ~modes.aligned[:, 1:] & ~modes.aligned[:, :-1]
    turned = difference(modes.offset[:, 1:], modes.offset[:, :-1])[both_free]
    assert np.median(np.abs(turned)) == pytest.approx(0.6745 * np.sqrt(0.02 * 0.1), rel=0.1)
    assert np.array_equal(np.unique(modes.strength), np.sort([gait.body_free_strength, gait.body_strength]))


@pytest.mark.slow
def test_people_of_full_have_its_offsets_and_leads() -> None:
    gait = GaitParameters(
        body_aligned=1.0, body_lead=0.5, body_strength=20.0, body_spread=0.01, body_switching=0.0
    )
    t = np.arange(300) / 10.0
    states = sample_states(t, 60, Model("full", Parameters(gait=gait)), np.random.default_rng(5), pace=1.3)
    motion, body = direction(states["velocity"]), states["body"]
    off = [float(np.mean(np.abs(difference(body[:, :280], motion[:, s : 280 + s])))) for s in (0, 5)]
    assert off[1] < 0.8 * off[0], "the body faces where the motion will go"


def test_glances_come_and_go() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    aside = sample_glances(t, 200, 4.0, np.random.default_rng(6))
    away = np.abs(aside) > np.radians(10.0)
    begins = (away[:, 1:] & ~away[:, :-1]).sum(axis=1)
    assert begins.mean() == pytest.approx(4.0, abs=0.6)
    assert abs(np.degrees(aside.mean())) < 1.0 and np.degrees(np.abs(aside).max()) > 60.0
    # Two that overlap, each 80° in 0.3 s.
    assert np.abs(np.diff(aside, axis=1)).max() / 0.05 < 2.0 * np.radians(80.0) * 0.5 * np.pi / 0.3

    def people(glances: float) -> TrackSet:
        return simulate("joint", n_tracks=3, n_steps=100, rng=np.random.default_rng(7), glances=glances)

    for one, other in zip(people(0.0), people(30.0), strict=True):
        assert np.array_equal(one.true_body, other.true_body)
        assert np.abs(wrap(one.true_head - other.true_head)).max() > np.radians(20.0)


def consistency(preset: str, fps: float, people: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Squared errors over stated variances, a degree of freedom, of position, velocity, body and head."""
    kept: dict[str, FloatArray] = {}

    def keeping(*arguments: object, **options: object) -> dict[str, FloatArray]:
        kept.update(sample_states(*arguments, **options))  # type: ignore[arg-type]
        return dict(kept)

    monkeypatch.setattr(sampling, "sample_states", keeping)
    rng = np.random.default_rng(8)
    tracks = simulate(preset, n_tracks=people, n_steps=round(20.0 * fps), fps=fps, rng=rng)
    monkeypatch.undo()
    found: dict[str, list[float]] = {}
    columns = {"position": slice(0, 2), "velocity": slice(2, 4), "body": slice(4, 5), "head": slice(5, 6)}
    # Simulated people have no gait oscillation and no persistent turns, unlike the defaults.
    for i, track in enumerate(smooth(tracks, Model(preset, steady(default_parameters(preset))))):
        for name, column in columns.items():
            if name not in kept:
                continue
            error = getattr(track, name) - kept[name][i]
            error = error if error.ndim == 2 else wrap(error)[:, None]
            covariance = track.covariance[:, column, column]
            squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
            found.setdefault(name, []).append(float(squares.mean()) / error.shape[1])
    return {name: float(np.mean(values)) for name, values in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["position", "separate", "intentional", *COUPLED, "full"])
@pytest.mark.parametrize("fps", [2.5, 5.0, 10.0, 30.0, 60.0])
def test_estimates_of_simulated_people_know_their_errors(
    preset: str, fps: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = consistency(preset, fps, 60, monkeypatch)
    print("|", preset, fps, *(f"{name} {value:.2f}" for name, value in found.items()))
    # Body variances of `full` are slightly underestimated; those of the head are a tenth too wide at 2.5 Hz,
    # of 400 people too, where a glance can begin and end between two frames.
    least, most = ({"head": 0.85}, {"body": 1.2}) if preset == "full" else ({}, {})
    assert all(least.get(name, 0.9) < value < most.get(name, 1.1) for name, value in found.items()), found
