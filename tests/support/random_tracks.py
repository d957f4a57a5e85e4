"""Random tracks and models for comparing engines: everything that can be missing or uneven is."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from walks import walk, without

from graphtrack.geometry.angles import class_centres, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import (
    CouplingParameters,
    LikelihoodParameters,
    Model,
    MotionParameters,
    OrientationParameters,
    Parameters,
)
from graphtrack.tracks.track import Track


def lens_camera() -> GroundCamera:
    """6 m above (0, −16), looking down at the walkers through a lens that bends."""
    look = Rotation.from_euler("x", -1.1).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    intrinsics = np.array([[900.0, 0.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]])
    translation = -look @ np.array([0.0, -16.0, 6.0])
    return GroundCamera.from_calibration(
        look, translation, intrinsics, np.array([-0.08, 0.01, 1e-3, 0.0, 0.0])
    )


def random_parameters(rng: np.random.Generator) -> Parameters:
    """Parameters within an order of magnitude of the defaults; each option is taken at times."""
    return Parameters(
        MotionParameters(rng.uniform(0.2, 2.0), rng.uniform(0.5, 3.0)),
        OrientationParameters(rng.uniform(0.2, 1.5), rng.uniform(0.3, 3.0)),
        CouplingParameters(
            rng.uniform(1.0, 20.0), rng.choice([0.0, 0.2]), rng.uniform(0.5, 6.0), rng.choice([0.0, 0.2, 1.0])
        ),
        likelihood=LikelihoodParameters(
            position_std=rng.uniform(0.05, 0.3),
            robust=rng.choice(["none", "huber", "cauchy"]).item(),
            robust_threshold=rng.uniform(1.0, 3.0),
            body_outliers=rng.choice([0.0, 0.1]),
            head_outliers=rng.choice([0.0, 0.1]),
            class_outlier_probability=rng.choice([0.01, 0.05, 0.3]),
        ),
    )


def random_track(rng: np.random.Generator, camera: GroundCamera | None = None) -> Track:
    """A walk of 1 to 40 frames; each channel has gaps or is absent, and may declare its own spread."""
    n = int(rng.integers(1, 41))
    track = walk(
        n,
        seed=int(rng.integers(10_000)),
        dt=rng.choice([0.04, 0.1, 0.4]),
        uneven=bool(rng.random() < 0.5),
        noise=rng.choice([0.02, 0.1]),
        angle_kappa=rng.choice([8.0, 30.0]),
        classes=True,
    )
    assert track.true_position is not None
    centred = track.position - track.true_position.mean(axis=0)
    seen = {
        name: wrap(getattr(track, f"true_{name}") + rng.vonmises(0.0, 10.0, n)) for name in ("body", "head")
    }
    track = replace(track, position=centred, true_position=None, **seen)
    if camera is not None:
        track = replace(track, pixel=camera.ground_to_image(centred))
    for name in ("position", "pixel", "body", "head", "body_likelihood", "head_likelihood"):
        if getattr(track, name) is None:
            continue
        missing = rng.random(n) < rng.choice([0.0, 0.2, 0.9])
        if rng.random() < 0.3:
            missing |= np.abs(np.arange(n) - rng.integers(n)) < 0.15 * n
        if name in ("position", "body", "head"):
            # GTSAM needs something to hold on to; the chain's own tests go without.
            missing[rng.integers(n)] = False
        elif rng.random() < 0.3:
            track = replace(track, **{name: None})
            continue
        track = without(track, name, missing)
    for name, values in (("position_std", [0.05, 0.2, np.nan]), ("body_kappa", [2.0, 9.0, np.nan])):
        if rng.random() < 0.5:
            track = replace(track, **{name: rng.choice(values, n)})
    return track


def contradicted(rng: np.random.Generator, kind: str) -> Track:
    """A walk whose front is taken for its back, in 40 % of faint angles or by all class likelihoods."""
    n = int(rng.integers(20, 100))
    track = walk(n, seed=int(rng.integers(10_000)), dt=rng.choice([0.04, 0.1, 0.2]), angle_kappa=1.2)
    if kind == "flipped":
        angles = {
            name: wrap(getattr(track, name) + np.pi * (rng.random(n) < 0.4)) for name in ("body", "head")
        }
        return replace(track, body_kappa=np.full(n, 1.2), head_kappa=np.full(n, 1.2), **angles)
    classes = {}
    for name, k in (("body", 8), ("head", 12)):
        off = getattr(track, f"true_{name}")[:, None] - class_centres(k)
        front = np.clip(rng.normal(0.5, 0.25, n), 0.02, 0.98)[:, None]
        peaks = front * np.exp(6.0 * (np.cos(off) - 1.0)) + (1.0 - front) * np.exp(-6.0 * (np.cos(off) + 1.0))
        classes[f"{name}_likelihood"] = peaks + 0.01
    return replace(track, body=None, head=None, **classes)


def hard_models() -> dict[str, Model]:
    """Models under which contradictions are hard in different ways."""
    return {
        "joint": Model("joint"),
        "separate": Model("separate"),
        "slow turns": Model("joint", Parameters(orientation=OrientationParameters(0.05, 0.1))),
        "weak couplings": Model("joint", Parameters(coupling=CouplingParameters(1.0, 0.2, 1.0, 0.2))),
    }
