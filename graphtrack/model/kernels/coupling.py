"""Compiled twin of `graphtrack.model.coupling`."""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.frames import BODY, HEAD, VX, VY


@compiled
def add_body_follows_motion(
    state: FloatArray,
    cos: float,
    sin: float,
    kappa: float,
    threshold: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ₁·(‖v‖ − τ)²·(1 − cos(θ − ang v)) for speeds above τ; ``cos`` and ``sin`` are those of the body."""
    vx, vy = state[VX], state[VY]
    speed = math.sqrt(vx * vx + vy * vy)
    excess = speed - threshold
    if excess <= 0.0 or speed < 1e-12:
        return 0.0
    ux, uy = vx / speed, vy / speed
    aligned = cos * ux + sin * uy
    across = sin * ux - cos * uy
    far = 1.0 - aligned
    strength = kappa * excess * excess
    # Derivatives by speed s, direction φ of the velocity and body angle θ.
    by_s = 2.0 * kappa * excess * far
    by_theta = strength * across
    by_phi = -by_theta
    ss = 2.0 * kappa * far
    if exact:
        theta_theta = strength * aligned
        phi_phi = theta_theta
        s_theta = 2.0 * kappa * excess * across
        radial = phi_phi / speed + by_s
        mixed = (-s_theta - by_phi / speed) / speed
    else:
        # Gauss–Newton, from the rows √κ·(s − τ)·(u(θ) − u(φ)).
        theta_theta = strength
        phi_phi = strength
        s_theta = kappa * excess * across
        radial = phi_phi / speed
        mixed = -s_theta / speed
    tangential = radial / speed
    theta_phi = -strength * aligned / speed
    # To Cartesian velocities: e_s = (ux, uy), e_φ = (−uy, ux).
    gradient[VX] += by_s * ux - by_phi / speed * uy
    gradient[VY] += by_s * uy + by_phi / speed * ux
    gradient[BODY] += by_theta
    hessian[VX, VX] += ss * ux * ux - 2.0 * mixed * ux * uy + tangential * uy * uy
    hessian[VY, VX] += (ss - tangential) * ux * uy + mixed * (ux * ux - uy * uy)
    hessian[VY, VY] += ss * uy * uy + 2.0 * mixed * ux * uy + tangential * ux * ux
    hessian[BODY, VX] += s_theta * ux - theta_phi * uy
    hessian[BODY, VY] += s_theta * uy + theta_phi * ux
    hessian[BODY, BODY] += theta_theta
    return strength * far


@compiled
def add_head_follows_body(
    body_cos: float,
    body_sin: float,
    head_cos: float,
    head_sin: float,
    kappa: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ₂·(1 − cos(α − θ))."""
    cos = body_cos * head_cos + body_sin * head_sin
    pull = kappa * (head_sin * body_cos - head_cos * body_sin)
    curvature = kappa * cos if exact else kappa
    gradient[HEAD] += pull
    gradient[BODY] -= pull
    hessian[HEAD, HEAD] += curvature
    hessian[BODY, BODY] += curvature
    hessian[HEAD, BODY] -= curvature
    return kappa * (1.0 - cos)
