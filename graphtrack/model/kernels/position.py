"""Compiled twin of `graphtrack.model.position`."""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.frames import X, Y

HUBER, CAUCHY = 1, 2


@compiled
def robust(square: float, kind: int, threshold: float) -> tuple[float, float, float]:
    """Cost ρ of a residual whose squared length is ``square``, and ρ' and ρ'' by that square, doubled.

    The doubling makes ρ' the weight of iteratively reweighted least squares: 1 without a robust loss.
    """
    if kind == HUBER and square > threshold * threshold:
        distance = math.sqrt(square)
        weight = threshold / distance
        return threshold * (distance - 0.5 * threshold), weight, -0.5 * weight / square
    if kind == CAUCHY:
        scale = threshold * threshold
        weight = scale / (scale + square)
        return 0.5 * scale * math.log1p(square / scale), weight, -weight * weight / scale
    return 0.5 * square, 1.0, 0.0


@compiled
def add_position(
    state: FloatArray,
    x: float,
    y: float,
    information: float,
    kind: int,
    threshold: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """An observed position in metres."""
    dx, dy = state[X] - x, state[Y] - y
    cost, weight, slope = robust(information * (dx * dx + dy * dy), kind, threshold)
    pull = weight * information
    gradient[X] += pull * dx
    gradient[Y] += pull * dy
    bend = 2.0 * slope * information * information if exact else 0.0
    hessian[X, X] += pull + bend * dx * dx
    hessian[Y, X] += bend * dx * dy
    hessian[Y, Y] += pull + bend * dy * dy
    return cost


@compiled
def add_pixel(
    state: FloatArray,
    origin_x: float,
    origin_y: float,
    u: float,
    v: float,
    information: float,
    to_image: FloatArray,
    kind: int,
    threshold: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """An observed foot point in pixels, through the homography from the ground to the image."""
    x, y = state[X] + origin_x, state[Y] + origin_y
    depth = to_image[2, 0] * x + to_image[2, 1] * y + to_image[2, 2]
    pu = (to_image[0, 0] * x + to_image[0, 1] * y + to_image[0, 2]) / depth
    pv = (to_image[1, 0] * x + to_image[1, 1] * y + to_image[1, 2]) / depth
    cx, cy = to_image[2, 0] / depth, to_image[2, 1] / depth
    ux, uy = to_image[0, 0] / depth - pu * cx, to_image[0, 1] / depth - pu * cy
    vx, vy = to_image[1, 0] / depth - pv * cx, to_image[1, 1] / depth - pv * cy
    du, dv = pu - u, pv - v
    cost, weight, slope = robust(information * (du * du + dv * dv), kind, threshold)
    pull = weight * information
    gx, gy = ux * du + vx * dv, uy * du + vy * dv
    gradient[X] += pull * gx
    gradient[Y] += pull * gy
    hxx, hyx, hyy = ux * ux + vx * vx, uy * ux + vy * vx, uy * uy + vy * vy
    bend = 0.0
    if exact:
        # The second derivatives of a projection follow from the first ones.
        hxx -= 2.0 * cx * gx
        hyx -= cx * gy + cy * gx
        hyy -= 2.0 * cy * gy
        bend = 2.0 * slope * information * information
    hessian[X, X] += pull * hxx + bend * gx * gx
    hessian[Y, X] += pull * hyx + bend * gx * gy
    hessian[Y, Y] += pull * hyy + bend * gy * gy
    return cost
