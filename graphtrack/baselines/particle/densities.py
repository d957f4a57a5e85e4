"""Compiled densities of the particle filter: the von Mises, and the likelihoods of what was observed."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.baselines.particle.data import PackedCamera, PackedPose, PackedPosition
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled


@compiled
def wrapped(angle: float) -> float:
    """The angle in (−π, π]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


@compiled
def sample_von_mises(rng: np.random.Generator, mean: float, kappa: float) -> float:
    """One von Mises variate in (−π, π] (Best & Fisher 1979)."""
    if kappa < 1e-8:
        return math.pi * (2.0 * rng.random() - 1.0)
    if kappa > 1e6:
        return wrapped(mean + rng.standard_normal() / math.sqrt(kappa))
    if kappa < 1e-5:
        shape = 1.0 / kappa + kappa
    else:
        r = 1.0 + math.sqrt(1.0 + 4.0 * kappa * kappa)
        rho = (r - math.sqrt(2.0 * r)) / (2.0 * kappa)
        shape = (1.0 + rho * rho) / (2.0 * rho)
    while True:
        z = math.cos(math.pi * rng.random())
        w = (1.0 + shape * z) / (shape + z)
        y = kappa * (shape - w)
        v = rng.random()
        if y * (2.0 - y) >= v or math.log(y / v) + 1.0 - y >= 0.0:
            break
    deviation = math.acos(min(max(w, -1.0), 1.0))
    return wrapped(mean + (deviation if rng.random() < 0.5 else -deviation))


@compiled
def add_position_log_density(
    particles: FloatArray, k: int, position: PackedPosition, camera: PackedCamera, found: FloatArray
) -> None:
    """Add to ``found`` (n,) the log-likelihood of the position observed at frame k (Chen et al. 2011, eq.
    12)."""
    kind = position.kind[k]
    if kind == 0:
        return
    seen_x, seen_y = position.value[k]
    scale = 1.0 / position.std[k]
    peak = math.log(scale * scale / (2.0 * math.pi))
    robust, threshold = position.robust, position.threshold
    h = camera.to_image
    for i in range(len(particles)):
        x, y = particles[i, 0], particles[i, 1]
        if kind == 2:
            depth = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            if depth <= 0.0:
                found[i] = -math.inf
                continue
            x, y = (
                (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / depth,
                (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / depth,
            )
        dx, dy = scale * (x - seen_x), scale * (y - seen_y)
        squared = dx * dx + dy * dy
        loss = 0.5 * squared
        if robust == 1 and squared > threshold * threshold:
            loss = threshold * (math.sqrt(squared) - 0.5 * threshold)
        elif robust == 2:
            loss = 0.5 * threshold * threshold * math.log(1.0 + squared / (threshold * threshold))
        found[i] += peak - loss


@compiled
def bearing(x: float, y: float, camera: PackedCamera) -> float:
    """World direction in which the camera looks at a ground point, as `GroundCamera.ray_bearing`."""
    if camera.has_centre:
        return math.atan2(y - camera.centre[1], x - camera.centre[0])
    g, h = camera.to_image, camera.to_ground
    depth = g[2, 0] * x + g[2, 1] * y + g[2, 2]
    u = (g[0, 0] * x + g[0, 1] * y + g[0, 2]) / depth
    v = (g[1, 0] * x + g[1, 1] * y + g[1, 2]) / depth
    top_x = h[0, 0] * u + h[0, 1] * v + h[0, 2]
    top_y = h[1, 0] * u + h[1, 1] * v + h[1, 2]
    below = h[2, 0] * u + h[2, 1] * v + h[2, 2]
    # Up the image column: the derivative by −v, times the positive below².
    return math.atan2(-(h[1, 1] * below - top_y * h[2, 1]), -(h[0, 1] * below - top_x * h[2, 1]))


@compiled
def add_pose_log_density(
    particles: FloatArray, place: int, k: int, pose: PackedPose, camera: PackedCamera, found: FloatArray
) -> None:
    """Add to ``found`` (n,) the log-likelihood of an orientation observed at frame k (Chen et al. 2011, eq.
    13–14)."""
    count = pose.components[k]
    if count == 0:
        return
    for i in range(len(particles)):
        angle = particles[i, place]
        if camera.judge_pose:
            angle = camera.sign * (angle - bearing(particles[i, 0], particles[i, 1], camera) - math.pi)
        if pose.closest[k]:
            nearest = math.floor(angle * count / (2.0 * math.pi) + 0.5) % count
            found[i] += pose.log_height[k, nearest]
        else:
            found[i] += mixture_log_density(
                math.cos(angle),
                math.sin(angle),
                pose.log_height[k, :count],
                pose.cos_mean[k],
                pose.sin_mean[k],
                pose.kappa[k],
                pose.log_uniform[k],
            )


@compiled
def mixture_log_density(
    cos: float,
    sin: float,
    log_height: FloatArray,
    cos_mean: FloatArray,
    sin_mean: FloatArray,
    kappa: float,
    log_uniform: float,
) -> float:
    """Log of a uniform density plus von Mises of given heights, without underflow far from sharp ones."""
    greatest = log_uniform
    for j in range(len(log_height)):
        value = log_height[j] + kappa * (cos * cos_mean[j] + sin * sin_mean[j] - 1.0)
        greatest = max(greatest, value)
    if len(log_height) == 1 and log_uniform == -math.inf:
        return greatest
    density = math.exp(log_uniform - greatest)
    for j in range(len(log_height)):
        value = log_height[j] + kappa * (cos * cos_mean[j] + sin * sin_mean[j] - 1.0)
        density += math.exp(value - greatest)
    return greatest + math.log(density)
