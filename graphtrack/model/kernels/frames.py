"""What the kernels know of a frame: observations and weights, one record for each frame of all tracks."""

from __future__ import annotations

import numpy as np

X, Y, VX, VY, BODY, HEAD = range(6)
"""Places in the state."""

FRAME = np.dtype(
    [
        ("dt", float),  # seconds since the person's frame before; 0 at the first
        ("motion_information", float),  # 1/q in s³/m²; 0 at the first frame
        ("steer_gain", float),  # share of the velocity that turns to the head; 0: white-noise acceleration
        ("steer_reach", float),  # seconds that the old velocity carries on
        ("steer_place", float),  # information on position, both and velocity
        ("steer_cross", float),
        ("steer_spread", float),
        ("steer_rate", float),  # λ in 1/s, where modes choose how much of it holds
        ("velocity_information", float),  # of the prior on the velocity, where it stands
        ("x", float),  # observed position, metres from the track's origin
        ("y", float),
        ("position_information", float),  # 1/σ²; 0: no position was observed
        ("u", float),  # observed pixel without the lens
        ("v", float),
        ("pixel_information", float),  # 1/σ² in pixels⁻²; 0: judged in metres, if at all
        ("body_turn_kappa", float),  # rotational diffusion since the frame before
        ("head_turn_kappa", float),
        ("motion_body_kappa", float),  # κ₁ with the frame's weight
        ("head_body_kappa", float),  # κ₂ with the frame's weight
        ("motion_body_cos", float),  # of the angle from motion to body at which their coupling rests
        ("motion_body_sin", float),
        ("head_body_cos", float),  # of the angle from body to head
        ("head_body_sin", float),
        ("body_aligned_kappa", float),  # κ₁ and κ₂ with the weight, where modes choose how much of them holds
        ("head_aligned_kappa", float),
        ("coupling_weight", float),  # that weight
        ("body_information", float),  # Fisher information of what was seen of the body, and of the head
        ("head_information", float),
        ("body_cos", float),  # direction, concentration and ε/2π of an observed body angle
        ("body_sin", float),
        ("body_kappa", float),
        ("body_uniform", float),
        ("head_cos", float),
        ("head_sin", float),
        ("head_kappa", float),
        ("head_uniform", float),
        ("body_class_kappa", float),  # concentration of the classes; 0: no class likelihoods
        ("head_class_kappa", float),
        ("body_anchor", float),  # concentration that holds a first orientation to its initial value
        ("head_anchor", float),
    ]
)
"""One frame. Concentrations are 0 where there is nothing to say."""

SHARED = np.dtype(
    [
        ("speed_threshold", float),
        ("body_diffusion", float),  # rad²/s, where modes need it
        ("robust", np.int64),  # 0 none, 1 Huber, 2 Cauchy
        ("robust_threshold", float),
        ("to_image", float, (3, 3)),  # from metres about the world's origin to ideal pixels
    ]
)
"""What all frames of a job share."""
