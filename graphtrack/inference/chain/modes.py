"""Modes and offsets of the couplings given the states: what the couplings are to be in the next descent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.layout import BODY, VX, VY
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.body_follows_motion import squared_excess
from graphtrack.model.terms.gait import (
    ROW,
    Gait,
    Modes,
    add_seen,
    add_seen_classes,
    aligned,
    deviation,
    expected,
    infer_modes,
    mistaken,
)
from graphtrack.model.terms.intentional_motion import steer

BODY_MODE, HEAD_MODE = 0, 1
"""Places of the two couplings in arrays of both."""


@compiled
def leading_angles(
    dt: FloatArray, states: FloatArray, lead: float, of_motion: bool, angle: FloatArray
) -> None:
    """The direction of motion, or of the body, ``lead`` seconds after each frame; the last one's beyond."""
    # ``since``: seconds from frame ``at`` to the moment looked for.
    n, at, since = len(states), 0, lead
    for k in range(n):
        if k > 0:
            since += dt[k]
        while at < n - 1 and since >= dt[at + 1]:
            since -= dt[at + 1]
            at += 1
        while at > 0 and since < 0.0:
            since += dt[at]
            at -= 1
        share = 0.0
        if at < n - 1:
            share = min(max(since / dt[at + 1], 0.0), 1.0)
        after = min(at + 1, n - 1)
        if of_motion:
            vx = (1.0 - share) * states[at, VX] + share * states[after, VX]
            vy = (1.0 - share) * states[at, VY] + share * states[after, VY]
            angle[k] = math.atan2(vy, vx)
        else:
            # Neighbours may be written in different turns.
            turn = states[after, BODY] - states[at, BODY]
            angle[k] = states[at, BODY] + share * math.atan2(math.sin(turn), math.cos(turn))


@compiled
def seconds(problem: Problem, track: int, n: int, dt: FloatArray) -> None:
    """Seconds since the frame before, of the frames of a track."""
    offset = problem.offsets[track]
    for k in range(n):
        dt[k] = problem.records[offset + k].dt


@compiled
def is_seen(frame: Any) -> bool:
    """Whether a position was seen in a frame."""
    return bool(frame.position_information > 0.0 or frame.pixel_information > 0.0)


@compiled
def loosened(frame: Any, kappa: float, excess: float, missing: float, diffusion: float) -> float:
    """A coupling's κ where the lead is not known for ``missing`` seconds: by so much the one may have turned.

    ``excess`` is what κ is multiplied with in the cost: (‖v‖ − τ)², or 1.
    """
    if not missing > 0.0:
        return kappa
    return kappa / (1.0 + kappa * excess / frame.coupling_weight * diffusion * missing)


@compiled
def judge_body(
    problem: Problem, track: int, states: FloatArray, motion: FloatArray, gait: Gait, row: FloatArray
) -> None:
    """Log likelihoods (n, ROW) of what was seen of body and head at each offset from the motion."""
    offset, threshold = problem.offsets[track], problem.shared[0].speed_threshold
    row[:] = 0.0
    for k in range(len(states)):
        frame = problem.records[offset + k]
        # What holds an aligned body to the motion in this frame; κ₁ contains the weight w here.
        coupling = frame.body_aligned_kappa * squared_excess(states[k, VX], states[k, VY], threshold)
        if coupling == 0.0 or not is_seen(frame):
            continue
        # Frames within the time in which deviations persist tell of the same deviation, so of the information
        # remains what the coupling lets through.
        share = coupling / (coupling + frame.body_information)
        head, spread = frame.head_information, frame.head_aligned_kappa
        loose = coupling * spread
        head_share = gait.head_evidence * loose / (loose + head * (coupling + spread) + 1e-300)
        add_seen(
            row[k],
            gait.body,
            share,
            motion[k],
            frame.seen_body_cos,
            frame.seen_body_sin,
            frame.body_kappa,
            frame.body_uniform,
        )
        add_seen(
            row[k],
            gait.body,
            head_share,
            motion[k],
            frame.seen_head_cos,
            frame.seen_head_sin,
            frame.head_kappa,
            frame.head_uniform,
        )
        if frame.body_class_kappa > 0.0:
            heights, directions = problem.body_heights[offset + k], problem.body_directions
            add_seen_classes(row[k], gait.body, share, motion[k], heights, directions, frame.body_class_kappa)
        if frame.head_class_kappa > 0.0:
            heights, directions = problem.head_heights[offset + k], problem.head_directions
            add_seen_classes(
                row[k], gait.body, head_share, motion[k], heights, directions, frame.head_class_kappa
            )


@compiled
def judge_head(
    problem: Problem, track: int, states: FloatArray, body: FloatArray, modes: Modes, row: FloatArray
) -> None:
    """Log likelihoods (n, ROW) of what was seen of the head at each offset from the body."""
    offset, threshold = problem.offsets[track], problem.shared[0].speed_threshold
    row[:] = 0.0
    for k in range(len(states)):
        frame = problem.records[offset + k]
        coupling = frame.head_aligned_kappa
        # Of whom neither motion nor body is known, as of those who stand, the head would be judged by itself.
        moves = squared_excess(states[k, VX], states[k, VY], threshold) > 0.0 and is_seen(frame)
        if coupling == 0.0 or not (moves or frame.body_information > 0.0):
            continue
        share = coupling / (coupling + frame.head_information)
        add_seen(
            row[k],
            modes,
            share,
            body[k],
            frame.seen_head_cos,
            frame.seen_head_sin,
            frame.head_kappa,
            frame.head_uniform,
        )
        if frame.head_class_kappa > 0.0:
            heights, directions = problem.head_heights[offset + k], problem.head_directions
            add_seen_classes(row[k], modes, share, body[k], heights, directions, frame.head_class_kappa)


@compiled
def is_classified(problem: Problem, track: int) -> bool:
    """Whether class likelihoods are known of the head in any frame of a track."""
    for k in range(problem.offsets[track], problem.offsets[track + 1]):
        if problem.records[k].head_class_kappa > 0.0:
            return True
    return False


@compiled
def couple(
    modes: Modes, kappa: float, lead: float, probability: FloatArray
) -> tuple[float, float, float, float]:
    """Concentration, and cosine and sine of the offset, of a coupling by the probabilities of its modes.

    And the standard deviation of what it pulls with, by modes and offsets. ``lead``: radians that it is
    turned by until the lead is over.
    """
    cos, sin = expected(probability, modes, modes.strength, modes.free_strength)
    size = math.hypot(cos, sin)
    if not size > 0.0:
        return 0.0, 1.0, 0.0, 0.0
    cos, sin = cos / size, sin / size
    spread = kappa * deviation(probability, modes, modes.strength, modes.free_strength, cos, sin)
    ahead_cos, ahead_sin = math.cos(lead), math.sin(lead)
    return kappa * size, cos * ahead_cos - sin * ahead_sin, sin * ahead_cos + cos * ahead_sin, spread


@allocating
def renew_couplings(
    problem: Problem,
    track: int,
    states: FloatArray,
    gait: Gait,
    classified: bool,
    before: FloatArray,
    filtered: FloatArray,
    modes: FloatArray,
    spread: FloatArray,
) -> None:
    """Set the couplings of a track's frames, and the steering between them, by the modes the states imply.

    Parameters
    ----------
    states : (n, 6)
    classified : whether the head is seen by a classifier, which may see it turned all along
    before : (2, ROW) filtered probabilities of both couplings in the frame before the first
    filtered : (2, n, ROW) filled in: those of all frames
    modes : (n, 2) filled in: the probability that the body is aligned, and the offset from motion to body
    spread : (n, 2) filled in: the standard deviation of what each coupling pulls with, as its κ
    """
    n, offset = len(states), problem.offsets[track]
    dt, angle, own = np.empty(n), np.empty(n), np.empty(n)
    row, smoothed, held = np.empty((n, ROW)), np.empty((n, ROW)), np.empty((n, 2))
    seconds(problem, track, n, dt)
    leading_angles(dt, states, gait.body.lead, True, angle)
    leading_angles(dt, states, 0.0, True, own)
    judge_body(problem, track, states, angle, gait, row)
    infer_modes(dt, row, gait.body, before[BODY_MODE], filtered[BODY_MODE], smoothed)
    shared, left = problem.shared[0], 0.0
    for k in range(n - 1, -1, -1):
        frame, lead = problem.records[offset + k], angle[k] - own[k]
        given, cos, sin, pull = couple(gait.body, frame.body_aligned_kappa, lead, smoothed[k])
        excess = squared_excess(states[k, VX], states[k, VY], shared.speed_threshold)
        kappa = loosened(frame, given, excess, gait.body.lead - left, shared.body_diffusion)
        spread[k, BODY_MODE] = pull * kappa / given if given > 0.0 else 0.0
        frame.motion_body_kappa, frame.motion_body_cos, frame.motion_body_sin = kappa, cos, sin
        cos, sin = expected(smoothed[k], gait.body, 1.0, 1.0)
        modes[k, 0], modes[k, 1] = aligned(smoothed[k]), math.atan2(sin, cos)
        held[k, 0], held[k, 1] = cos, sin
        left += dt[k]
    of_head = gait.classified_head if classified else gait.head
    leading_angles(dt, states, of_head.lead, False, angle)
    judge_head(problem, track, states, angle, of_head, row)
    infer_modes(dt, row, of_head, before[HEAD_MODE], filtered[HEAD_MODE], smoothed)
    left = 0.0
    for k in range(n - 1, -1, -1):
        frame, lead = problem.records[offset + k], angle[k] - states[k, BODY]
        given, cos, sin, pull = couple(of_head, frame.head_aligned_kappa, lead, smoothed[k])
        kappa = loosened(frame, given, 1.0, of_head.lead - left, shared.body_diffusion)
        spread[k, HEAD_MODE] = math.sqrt(gait.head_common) * pull * kappa / given if given > 0.0 else 0.0
        frame.head_body_kappa, frame.head_body_cos, frame.head_body_sin = kappa, cos, sin
        frame.head_doubt = mistaken(smoothed[k], of_head)
        left += dt[k]
        if k < n - 1:
            # The head steers as far as it is expected to point where the motion goes.
            cos, sin = expected(smoothed[k], of_head, 1.0, 1.0)
            after, ahead = problem.records[offset + k + 1], held[k, 0] * cos - held[k, 1] * sin
            share = gait.head_rate_seen if is_seen(after) else 1.0
            steer(after, after.steer_rate * share * max(ahead, 0.0))


@allocating
def renew_tracks(
    problem: Problem,
    states: FloatArray,
    gait: Gait,
    before: FloatArray,
    modes: FloatArray,
    spread: FloatArray,
    kept: FloatArray,
) -> None:
    """`renew_couplings` of all tracks, each with the same probabilities ``before`` its first frame.

    ``kept`` (2, N, ROW) is filled in with the filtered probabilities of all frames; no frames: nobody asks.
    """
    for track in range(len(problem.offsets) - 1):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        filtered = np.empty((2, b - a, ROW))
        classified = is_classified(problem, track)
        renew_couplings(
            problem, track, states[a:b], gait, classified, before, filtered, modes[a:b], spread[a:b]
        )
        if kept.shape[1] > 0:
            for coupling in range(2):
                for k in range(b - a):
                    for j in range(ROW):
                        kept[coupling, a + k, j] = filtered[coupling, k, j]
