"""What the particle filter draws from an observation alone: where it begins, and where it is lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.particle.data import Job, PackedCamera, PackedPose
from graphtrack.baselines.particle.densities import (
    add_pose_log_density,
    add_position_log_density,
    bearing,
)
from graphtrack.baselines.particle.kernels import BODY, HEAD, POSITION, VANISHED
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.geometry.camera import apply_homography


def draw_states(
    job: Job, k: int, count: int, initial_speed_std: float, rng: np.random.Generator
) -> FloatArray:
    """Positions about the one observed at frame k and velocities from their prior, (count, 4).

    With a flat prior on the position this is its posterior, so that the observation is used up.
    """
    position = job.position
    found = position.value[k] + position.std[k] * rng.standard_normal((count, 2))
    if position.kind[k] == 2:
        found = np.where(_visible(job, found)[:, None], found, position.value[k])
        found = apply_homography(job.camera.to_ground, found)
    return np.hstack([found, initial_speed_std * rng.standard_normal((count, 2))])


def recover(
    job: Job, k: int, particles: FloatArray, initial_speed_std: float, rng: np.random.Generator
) -> int:
    """Draw anew, in ``particles`` (n, 6), what is out of reach of the observations at frame k.

    Returns
    -------
    int
        The observations that are used up by that: the sum of `POSITION`, `BODY` and `HEAD`.
    """
    reach: dict[int, float] = {}
    found = np.zeros(len(particles))
    if job.position.kind[k]:
        add_position_log_density(particles, k, job.position, job.camera, found)
        reach[POSITION] = float(found.max())
    for part, place, pose, estimated in (
        (BODY, 4, job.body, job.motion.has_body),
        (HEAD, 5, job.head, job.motion.has_head),
    ):
        if estimated and pose.components[k]:
            found[:] = 0.0
            add_pose_log_density(particles, place, k, pose, job.camera, found)
            reach[part] = float(found.max())
    # If each is within reach of some particle, but none of them all, all are drawn anew.
    lost = [part for part, best in reach.items() if best < VANISHED / 3.0] or list(reach)
    if POSITION in lost:
        particles[:, :4] = draw_states(job, k, len(particles), initial_speed_std, rng)
    if BODY in lost:
        particles[:, 4] = draw_orientations(job.body, job.camera, k, particles[:, :2], rng)
    if HEAD in lost:
        particles[:, 5] = draw_orientations(job.head, job.camera, k, particles[:, :2], rng)
    return sum(lost)


def draw_orientations(
    pose: PackedPose, camera: PackedCamera, k: int, position: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Orientations (n,) of people at positions (n, 2) from what was observed of them at frame k."""
    size, n = int(pose.components[k]), len(position)
    heights = np.exp(pose.log_height[k, :size] - pose.log_height[k, :size].max())
    chosen = rng.choice(size, n, p=heights / heights.sum())
    if pose.closest[k]:
        off = rng.uniform(-np.pi / size, np.pi / size, n)
    else:
        off = rng.vonmises(0.0, pose.kappa[k], n)
    angle = np.arctan2(pose.sin_mean[k, chosen], pose.cos_mean[k, chosen]) + off
    if camera.judge_pose:
        towards = np.array([bearing(x, y, camera) for x, y in position.tolist()])
        angle = camera.sign * angle + towards + np.pi
    return wrap(angle)


def _visible(job: Job, pixel: FloatArray) -> NDArray[np.bool_]:
    """Which ideal pixels (m, 2) lie on the visible side of the horizon."""
    to_ground = job.camera.to_ground
    return np.asarray(pixel @ to_ground[2, :2] + to_ground[2, 2] > 0.0)
