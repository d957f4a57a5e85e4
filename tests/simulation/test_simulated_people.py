"""Simulated people have the statistics of the estimator's model, at every frame rate."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from selection import others_slow

from graphtrack.geometry.angles import FloatArray, difference, direction, wrap
from graphtrack.model import Model
from graphtrack.simulation import sampling
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


@pytest.mark.slow
@pytest.mark.parametrize("preset", others_slow(COUPLED, ["joint"]))
def test_bodies_face_the_motion_alike_at_every_rate(preset: str) -> None:
    # From 10 Hz on a frame is short against the correlation time, and the rate no longer matters.
    found = [misaligned(preset, fps) for fps in (10.0, 20.0, 60.0)]
    assert min(found) > 7.0 and max(found) < 10.5, found
    assert 5.5 < misaligned(preset, 2.5) < 9.5


@pytest.mark.slow
def test_people_walk_at_their_pace_all_the_time() -> None:
    for preset in ("position", "separate", "joint", "intentional"):
        for fps in (2.5, 20.0):
            speed = np.linalg.norm(states_of(preset, fps, 60, 25.0)["velocity"], axis=-1)
            median = np.median(speed, axis=1)
            assert 1.1 < np.median(median) < 1.5 and 0.15 < median.std() < 0.45, (preset, fps)
            assert np.median(speed[:, -1]) < 1.7
    slow = sample_states(np.arange(50) / 5.0, 60, Model("joint"), np.random.default_rng(2), pace=0.7)
    assert 0.5 < np.median(np.linalg.norm(slow["velocity"], axis=-1)) < 0.9


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
    for i, track in enumerate(smooth(tracks, Model(preset), constants="default")):
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
@pytest.mark.parametrize("preset", ["position", "separate", "intentional", *COUPLED])
@pytest.mark.parametrize("fps", [2.5, 5.0, 10.0, 30.0, 60.0])
def test_estimates_of_simulated_people_know_their_errors(
    preset: str, fps: float, monkeypatch: pytest.MonkeyPatch, figures: Callable[..., None]
) -> None:
    found = consistency(preset, fps, 60, monkeypatch)
    for name, value in found.items():
        figures("NEES of the smoother", {"model": preset, "Hz": fps, "quantity": name, "NEES": value})
    # The variance of an angle is the inverse curvature at the mode; von Mises errors have wider tails.
    greatest = {"position": 1.1, "velocity": 1.1, "body": 1.2, "head": 1.2}
    assert all(0.9 < value < greatest[name] for name, value in found.items()), found
