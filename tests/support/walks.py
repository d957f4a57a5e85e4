"""Synthetic tracks for the tests: people who walk smoothly, observed with noise."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from graphtrack.geometry.angles import class_centres, mean_absolute_error, unit, wrap
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks.track import Track, TrackSet


def scores(angle: np.ndarray, n_classes: int, rng: np.random.Generator) -> np.ndarray:
    """Class likelihoods (n, k) as a classifier gives them: peaked at the angle, rough, not normalised."""
    peaked = np.exp(4.0 * (np.cos(angle[:, None] - class_centres(n_classes)) - 1.0))
    return peaked * rng.uniform(0.6, 1.4, peaked.shape) + 0.01


def walk(
    n: int = 30,
    *,
    seed: int = 0,
    dt: float = 0.1,
    uneven: bool = False,
    noise: float = 0.05,
    angle_kappa: float = 20.0,
    classes: bool = False,
    track_id: int = 1,
) -> Track:
    """Somebody who walks in a curve at about 1.3 m/s; body along the motion, head about it, with the truth.

    With ``classes`` the orientations are seen as class likelihoods, else as angles.
    """
    rng = np.random.default_rng(seed)
    steps = dt * (rng.uniform(0.5, 1.8, n) if uneven else np.ones(n))
    t = 3.0 + np.cumsum(steps)
    heading = rng.uniform(-np.pi, np.pi) + 0.6 * np.sin(0.7 * (t - t[0]))
    speed = 1.3 + 0.2 * np.cos(t)
    position = rng.uniform(-5.0, 5.0, 2) + np.cumsum(speed[:, None] * unit(heading) * steps[:, None], axis=0)
    head = heading + 0.4 * np.sin(1.3 * t)
    observed_body = wrap(heading + rng.vonmises(0.0, angle_kappa, n))
    observed_head = wrap(head + rng.vonmises(0.0, angle_kappa, n))
    track = Track(
        track_id=track_id,
        frame=np.arange(n) + 10,
        t=t,
        position=position + rng.normal(0.0, noise, (n, 2)),
        true_position=position,
        true_body=wrap(heading),
        true_head=wrap(head),
    )
    if classes:
        return replace(
            track,
            body_likelihood=scores(observed_body, 8, rng),
            head_likelihood=scores(observed_head, 12, rng),
        )
    return replace(track, body=observed_body, head=observed_head)


def without(track: Track, name: str, missing: slice | list[int] | np.ndarray) -> Track:
    """The track with one channel missing at some frames."""
    values = np.array(getattr(track, name))
    values[missing] = np.nan
    return replace(track, **{name: values})


def turned(track: Track, angle: float, shift: tuple[float, float] = (0.0, 0.0)) -> Track:
    """The track seen in a world that is turned by ``angle`` and then shifted; class likelihoods as well.

    Class likelihoods turn exactly only by multiples of a quarter turn.
    """
    quarters = angle / (np.pi / 2.0)
    changed = {"position": track.position @ rotation(angle).T + np.asarray(shift)}
    for name in ("body", "head"):
        if getattr(track, name) is not None:
            changed[name] = wrap(getattr(track, name) + angle)
        classes = getattr(track, f"{name}_likelihood")
        if classes is not None:
            assert quarters == round(quarters)
            changed[f"{name}_likelihood"] = np.roll(classes, round(quarters) * classes.shape[1] // 4, axis=1)
    return replace(track, **changed)


def rotation(angle: float) -> np.ndarray:
    """(2, 2) rotation matrix."""
    return np.column_stack([unit(angle), unit(angle + np.pi / 2.0)])


FPS = 30.0


def people(offset: float, count: int, seed: int, seconds: float = 6.0, head: float = 0.0) -> TrackSet:
    """People who walk in a bend with the body at an angle from the motion, and the head from the body."""
    rng = np.random.default_rng(seed)
    tracks = []
    for i in range(count):
        t = np.arange(int(seconds * FPS)) / FPS
        course = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.3, 0.3) * t
        position = np.cumsum(1.2 * unit(course) / FPS, axis=0)
        body = wrap(course + offset)
        tracks.append(Track(i, np.arange(len(t)), t, position, body=body, head=wrap(body + head)))
    return add_noise(TrackSet(tuple(tracks)), position_std=0.1, body_kappa=1.2, head_kappa=2.3, rng=rng)


def errors(tracks: Iterable[Track], found: Iterable[Track]) -> np.ndarray:
    """Mean errors of body and head, in degrees."""
    pairs, names = list(zip(tracks, found, strict=True)), ("body", "head")
    of = [[mean_absolute_error(getattr(e, a), getattr(t, f"true_{a}")) for t, e in pairs] for a in names]
    return np.degrees(np.mean(of, axis=1))


def out_and_back(seed: int) -> Track:
    """A straight walk out, a stop, and the same line back: to turn either way is as likely."""
    rng = np.random.default_rng(seed)
    n, dt, still = int(rng.integers(15, 40)), float(rng.choice([0.1, 0.2, 0.4])), int(rng.integers(0, 10))
    out = np.arange(n) * rng.uniform(0.5, 1.6) * dt
    x = np.concatenate([out, np.full(still, out[-1]), out[::-1]])
    return Track(seed, np.arange(len(x)), np.arange(len(x)) * dt, np.column_stack([x, np.zeros(len(x))]))
