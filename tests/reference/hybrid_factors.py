"""GTSAM factors on the offsets of the couplings, `O(k)` of the body and `P(k)` of the head (Rot2).

They have unit noise: where the noise models of alternatives differ, GTSAM adds their normalisers when it
eliminates a hybrid graph, and leaves them out of its error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import O, P

from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Step
from graphtrack.model.factors.custom import unit_noise


def body_coupling(step: Step, kappa: float, threshold: float) -> gtsam.CustomFactor:
    """√κ·(‖v‖ − τ)·(u(θ − φ) − v/‖v‖): `BodyFollowsMotion` about an offset φ."""
    root, velocity_key, body_key, offset_key = (
        math.sqrt(kappa),
        step.velocity_key,
        step.body_key,
        O(step.index),
    )

    def residual(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        del this
        vx, vy = values.atVector(velocity_key).tolist()
        speed = math.hypot(vx, vy)
        excess = root * max(0.0, speed - threshold)
        if excess == 0.0:
            if jacobians is not None:
                jacobians[0], jacobians[1] = np.zeros((2, 2)), np.zeros((2, 1))
                jacobians[2] = np.zeros((2, 1))
            return np.zeros(2)
        turned = values.atRot2(body_key).theta() - values.atRot2(offset_key).theta()
        cos, sin, ux, uy = math.cos(turned), math.sin(turned), vx / speed, vy / speed
        apart = np.array([cos - ux, sin - uy])
        if jacobians is not None:
            along, across = np.array([ux, uy]), np.array([-uy, ux])
            jacobians[0] = root * np.outer(apart, along) - excess / speed * np.outer(across, across)
            jacobians[1] = excess * np.array([[-sin], [cos]])
            jacobians[2] = excess * np.array([[sin], [-cos]])
        return excess * apart

    return gtsam.CustomFactor(unit_noise(2), [velocity_key, body_key, offset_key], residual)


def head_coupling(step: Step, kappa: float) -> gtsam.CustomFactor:
    """√κ·(u(α − ψ) − u(θ)): `HeadFollowsBody` about an offset ψ."""
    root, body_key, head_key, offset_key = math.sqrt(kappa), step.body_key, step.head_key, P(step.index)

    def residual(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        del this
        body = values.atRot2(body_key).theta()
        head = values.atRot2(head_key).theta() - values.atRot2(offset_key).theta()
        if jacobians is not None:
            jacobians[0] = root * np.array([[math.sin(body)], [-math.cos(body)]])
            jacobians[1] = root * np.array([[-math.sin(head)], [math.cos(head)]])
            jacobians[2] = root * np.array([[math.sin(head)], [-math.cos(head)]])
        return root * np.array([math.cos(head) - math.cos(body), math.sin(head) - math.sin(body)])

    return gtsam.CustomFactor(unit_noise(2), [body_key, head_key, offset_key], residual)


def offset_drawn(keys: Sequence[int], mean: float, std: float, kappa: float = 0.0) -> gtsam.CustomFactor:
    """(offset − mean)/σ, wrapped, of the last key, and a von Mises of concentration κ about 0.

    A key before it has no part in it: GTSAM wants all alternatives on the same variables.
    """
    root = math.sqrt(kappa)

    def residual(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        del this
        offset = values.atRot2(keys[-1]).theta()
        cos, sin = math.cos(offset), math.sin(offset)
        if jacobians is not None:
            jacobians[0] = np.zeros((3, 1))
            jacobians[len(keys) - 1] = np.array([[1.0 / std], [-root * sin], [root * cos]])
        return np.array([math.remainder(offset - mean, math.tau) / std, root * (cos - 1.0), root * sin])

    return gtsam.CustomFactor(unit_noise(3), list(keys), residual)


def offset_kept(keys: Sequence[int], std: float) -> gtsam.CustomFactor:
    """(offset − offset before)/σ, wrapped; with two empty rows, as many as in `offset_drawn`."""
    slope = np.array([[1.0 / std], [0.0], [0.0]])

    def residual(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> FloatArray:
        del this
        if jacobians is not None:
            jacobians[0], jacobians[1] = -slope, slope
        turn = values.atRot2(keys[1]).theta() - values.atRot2(keys[0]).theta()
        return np.array([math.remainder(turn, math.tau) / std, 0.0, 0.0])

    return gtsam.CustomFactor(unit_noise(3), list(keys), residual)
