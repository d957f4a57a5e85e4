"""Log likelihood of tracks as chains of detections, compiled: motion, misses, angles and appearance.

Each detection of a chain has the index of the next one (−1: none) and a filtered state of white-noise
acceleration. The evidence of a track is the log density of its detections, of the gaps between them and of
its birth, over that of false detections.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from graphtrack.constant_velocity import compiled_spread
from graphtrack.geometry.angles import FloatArray, class_centres, unit
from graphtrack.kernels.arithmetic import log_i0e
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.packages import optimize
from graphtrack.tracks.detections import Detections
from graphtrack.tracks.scene import NOTHING, Known, SceneParameters

IntArray = NDArray[np.int64]

STATE = np.dtype(
    [
        ("x", float),  # metres
        ("y", float),
        ("vx", float),  # m/s
        ("vy", float),
        ("pp", float),  # covariance of each axis: m², m²/s and m²/s²
        ("pv", float),
        ("vv", float),
        ("body_x", float),  # direction of the body, a vector as long as its concentration; 0: not known
        ("body_y", float),
        ("head_x", float),
        ("head_y", float),
    ]
)
"""Filtered state of a person."""

State: TypeAlias = Any
"""One record of `STATE`, as kernels take it; it does not keep its array alive."""

VELOCITY = np.dtype([("weight", float), ("vx", float), ("vy", float), ("variance", float)])
"""Gaussian component of a prior of velocities: its share, its mean (m/s), and its variance (m²/s²)."""

ANY_VELOCITY = np.array([(1.0, 0.0, 0.0, 1.0)], VELOCITY)
"""A prior of velocities of one component."""


COMPASS = unit(np.arange(16) * (math.pi / 8.0))
"""Directions (16, 2) along which the reach of fields of view is known."""

EDGE = 1.0
"""Metres across the edge of a field of view over which its probability goes from 1 to 0."""

ON_THE_WAY = 5
"""Places on the way between two detections that are farther apart at which fields of view are read."""


class SceneRow(NamedTuple):
    """`SceneParameters.packed`."""

    density: float
    speed_variance: float
    jump_probability: float
    jump_variance: float
    log_missed: float
    log_hidden: float
    hidden_seconds: float
    log_birth: float
    log_death: float
    longest_gap: float
    frame_seconds: float
    look_ahead: float
    body_variance: float
    body_turn: float  # variance per second
    body_outliers: float
    head_variance: float
    head_turn: float
    head_outliers: float
    heading_variance: float
    gaze_variance: float
    appearance_offset: float = 0.0
    appearance_slope: float = 0.0
    appearance_outliers: float = 1.0
    trust: float = 0.0  # log odds that two detections of one given identity are one person's
    velocities: NDArray[np.void] = ANY_VELOCITY  # components of the prior, of `VELOCITY`
    views: FloatArray = np.zeros((0, len(COMPASS)))  # `Views.heights` of several sensors
    weights: FloatArray = np.zeros(0)  # `SensorRates.weights`


def scene_of(
    parameters: SceneParameters, seconds: float, velocities: NDArray[np.void] = ANY_VELOCITY
) -> SceneRow:
    """Return the parameters of a scene for kernels, for a frame interval in seconds."""
    values: Any = parameters.packed(seconds)
    return SceneRow(*values)._replace(velocities=velocities)


DETECTION = np.dtype(
    [
        ("t", float),  # seconds
        ("frame", np.int64),  # in steps of the recording
        ("x", float),  # metres
        ("y", float),
        ("variance", float),  # m² of each axis
        ("gain", float),  # log likelihood ratio of a person against a false detection, without position
        ("birth", float),  # log of the local birth rate over its mean
        ("death", float),  # log of the local death rate over its mean
        ("body", float),  # radians, observed; NaN: not observed
        ("head", float),
        ("given", np.int64),  # identity given by a tracker; −1: none
        ("sensor", np.int64),  # number of its sensor, a column of `Chains.scans`
        ("following", np.int64),  # the next detection of the same person, or −1
        ("preceding", np.int64),  # the previous detection of the same person, or −1
        ("evidence", float),  # log likelihood of the detection given those before
        ("total", float),  # log evidence of the track up to it
        ("rest", float),  # log evidence of the track from it to its end, at the start of a sweep
        ("alone", float),  # value of the track from it on as a new person, when last computed
        ("changed_before", np.int64),  # number of the move that last changed its state or its next detection
        (
            "changed_after",
            np.int64,
        ),  # number of the move that last changed its chain behind it, or the link before
    ]
)
"""A detection as kernels read it: one record, since each array argument has an overhead."""

Row: TypeAlias = Any
"""One record of `DETECTION`, as kernels read it; type checkers do not know its fields."""


class Chains(NamedTuple):
    """n detections in the order of time, and their chaining into tracks; attributes are views.

    With several sensors a frame is a scan of one of them.
    """

    rows: NDArray[np.void]  # (n,) of DETECTION
    state: NDArray[np.void]  # (n,) of STATE, filtered there
    appearance: FloatArray  # (n, d) whitened descriptors, NaN where missing; (n, 0) without appearance
    scans: FloatArray  # (n, s) scans of each sensor before the detection's; (n, 0): one sensor
    views: FloatArray  # (n, s) probability that the place is in the field of view of each sensor

    @property
    def t(self) -> FloatArray:
        """(n,) seconds."""
        return self.rows["t"]

    @property
    def frame(self) -> IntArray:
        """(n,) in steps of the recording."""
        return self.rows["frame"]

    @property
    def sensor(self) -> IntArray:
        """(n,) number of the sensor."""
        return self.rows["sensor"]

    @property
    def variance(self) -> FloatArray:
        """(n,) m² of each axis."""
        return self.rows["variance"]

    @property
    def gain(self) -> FloatArray:
        """(n,) see `DETECTION`."""
        return self.rows["gain"]

    @property
    def following(self) -> IntArray:
        """(n,) the next detection, or −1."""
        return self.rows["following"]

    @property
    def preceding(self) -> IntArray:
        """(n,) the previous detection, or −1."""
        return self.rows["preceding"]

    @property
    def position(self) -> FloatArray:
        """(n, 2) metres, a copy."""
        return np.column_stack([self.rows["x"], self.rows["y"]])

    @property
    def velocity(self) -> FloatArray:
        """(n, 2) m/s, filtered, a copy."""
        return np.column_stack([self.state["vx"], self.state["vy"]])

    @property
    def facing(self) -> FloatArray:
        """(n, 2) radians, observed body and head, a copy."""
        return np.column_stack([self.rows["body"], self.rows["head"]])


def unlinked(t: FloatArray, frame: IntArray, position: FloatArray, facing: FloatArray) -> Chains:
    """Detections that are not linked yet; their variances, gains and appearance are to be set.

    Parameters
    ----------
    t, frame, position : (n,) seconds, (n,) steps of the recording, (n, 2) metres
    facing : (n, 2) radians, observed body and head; NaN: not observed
    """
    rows = np.zeros(len(t), DETECTION)
    rows["t"], rows["frame"] = t, frame
    rows["x"], rows["y"] = position.T
    rows["body"], rows["head"] = facing.T
    for name in ("given", "following", "preceding"):
        rows[name] = -1
    none = np.empty((len(t), 0))
    return Chains(rows, np.zeros(len(t), STATE), none, none.copy(), none.copy())


def chains_of(detections: Detections) -> Chains:
    """Detections that are not linked yet, with their observed angles and what their sensors see."""
    angles = observed_angles(detections.channels, len(detections))
    position = np.ascontiguousarray(detections.position)
    found = unlinked(detections.t, detections.step, position, angles)
    found.rows["sensor"] = detections.sensor
    return found._replace(scans=detections.scans, views=detections.views)


def link_by(chains: Chains, identity: IntArray) -> None:
    """Chain the detections of each identity in the order of time, one per frame; −1: no identity."""
    order = np.lexsort((np.arange(len(identity)), identity))
    before, after = order[:-1], order[1:]
    same = (identity[before] == identity[after]) & (identity[after] >= 0)
    same &= chains.frame[after] > chains.frame[before]
    chains.following[before[same]] = after[same]
    chains.preceding[after[same]] = before[same]


@compiled
def appearance_ratio(appearance: FloatArray, k: int, m: int, scene: SceneRow) -> float:
    """Log likelihood ratio of the appearance of two detections; see `AppearanceModel`."""
    if scene.appearance_outliers >= 1.0:
        return 0.0
    square = 0.0
    for i in range(appearance.shape[1]):
        square += (appearance[k, i] - appearance[m, i]) ** 2
    if math.isnan(square):
        return 0.0
    score = scene.appearance_offset - scene.appearance_slope * math.log(max(square, 1e-12))
    odds = math.exp(min(max(score, -50.0), 50.0))
    sure, unsure = 1.0 - scene.appearance_outliers, scene.appearance_outliers
    return math.log((sure * odds + unsure) / (sure + unsure * odds))


@compiled
def angle_update(
    angle: float, prior_x: float, prior_y: float, noise: float, outliers: float
) -> tuple[float, float, float, float]:
    """Return the log ratio of an observed angle (rad, or NaN), and what it makes of a direction.

    The direction is multiplied by the second number, and the third and the fourth are added. An unexpected
    angle is an outlier or a sudden turn, one as probable as the other: half of what was known is then
    forgotten.

    ``prior_x``, ``prior_y``: expected direction, as long as its concentration; ``outliers``: share of random
    angles, 1: angles are not used.
    """
    if outliers >= 1.0 or math.isnan(angle):
        return 0.0, 1.0, 0.0, 0.0
    kappa, share, ratio = math.hypot(prior_x, prior_y), 1.0 - outliers, 0.0
    if kappa > 1e-6:
        kappa = 1.0 / (1.0 / kappa + noise)
        deviation = angle - math.atan2(prior_y, prior_x)
        density = share * math.exp(kappa * (math.cos(deviation) - 1.0) - log_i0e(kappa))
        ratio = math.log(density + outliers)
        share = density / (density + outliers)
    kept = 0.5 * (1.0 + share)
    return ratio, kept, kept * math.cos(angle) / noise, kept * math.sin(angle) / noise


@compiled
def diffused(x: float, y: float, variance: float) -> tuple[float, float]:
    """Return a direction, as long as its concentration, after a random turn of that variance, rad²."""
    less = 1.0 / (1.0 + math.hypot(x, y) * variance)
    return less * x, less * y


@compiled
def update_orientations(earlier: Row, before: State, later: Row, scene: SceneRow, state: State) -> float:
    """Update the state with body and head of a later detection; return their log likelihood ratio."""
    if scene.body_outliers >= 1.0 and scene.head_outliers >= 1.0:
        return 0.0
    dt = later.t - earlier.t
    x, y = diffused(before.body_x, before.body_y, scene.body_turn * dt)
    head_x, head_y = diffused(before.head_x, before.head_y, scene.head_turn * dt)
    square = state.vx * state.vx + state.vy * state.vy
    way_x, way_y = x, y
    if square > 1e-4:
        # At low speed the direction of travel is undefined.
        length = 1.0 / ((scene.heading_variance + state.vv / square) * math.sqrt(square))
        way_x, way_y = x + length * state.vx, y + length * state.vy
    of_body, kept, more_x, more_y = angle_update(
        later.body, way_x, way_y, scene.body_variance, scene.body_outliers
    )
    state.body_x, state.body_y = kept * x + more_x, kept * y + more_y
    of_head, kept, more_x, more_y = angle_update(
        later.head, head_x, head_y, scene.head_variance, scene.head_outliers
    )
    state.head_x, state.head_y = kept * head_x + more_x, kept * head_y + more_y
    steer(later.body, scene.body_variance + scene.heading_variance, scene.body_outliers, state)
    steer(later.head, scene.head_variance + scene.gaze_variance, scene.head_outliers, state)
    return of_body + of_head


@compiled
def steer(angle: float, variance: float, outliers: float, state: State) -> None:
    """Turn the velocity of a state towards an observed angle (rad, or NaN): an extended Kalman update.

    The observation is the velocity across, speed · sin(deviation). ``variance`` is of the angle about the
    direction of travel, ``outliers`` the share of random angles.
    """
    speed = math.hypot(state.vx, state.vy)
    if outliers >= 1.0 or math.isnan(angle) or speed < 1e-2:
        return
    across_x, across_y = -state.vy / speed, state.vx / speed
    deviation = angle - math.atan2(state.vy, state.vx)
    kappa = 1.0 / (variance + state.vv / (speed * speed))
    density = (1.0 - outliers) * math.exp(kappa * (math.cos(deviation) - 1.0) - log_i0e(kappa))
    share = density / (density + outliers)
    gain = share * kappa / (speed * speed)
    off = speed * math.sin(deviation)
    p_gain, v_gain = gain * state.pv, gain * state.vv
    state.x += p_gain * off * across_x
    state.y += p_gain * off * across_y
    state.vx += v_gain * off * across_x
    state.vy += v_gain * off * across_y
    # The covariance is isotropic: the mean of both axes.
    state.pp -= 0.5 * p_gain * state.pv
    state.pv -= 0.5 * p_gain * state.vv
    state.vv -= 0.5 * v_gain * state.vv


GATE = 6.0  # standard deviations of the gate
SAME = 1e-7  # difference of states and of evidence below which links do not change


@compiled
def log_gap(frames: int, scene: SceneRow) -> float:
    """Log probability of a number of frames between two detections: chance misses, or one occlusion."""
    return log_misses(float(frames), frames, scene)


@compiled
def log_misses(missed: float, frames: int, scene: SceneRow) -> float:
    """`log_gap` of frames in which the person was missed by chance or hidden so many times."""
    if missed <= 0.0:
        return 0.0
    chance = missed * scene.log_missed
    hidden = scene.log_hidden - frames * scene.frame_seconds / scene.hidden_seconds
    return np.logaddexp(chance, hidden)


def misses_of(missed: FloatArray, frames: FloatArray, scene: SceneRow) -> FloatArray:
    """`log_misses` of arrays of one shape."""
    hidden_for = frames * scene.frame_seconds / scene.hidden_seconds
    together = np.logaddexp(missed * scene.log_missed, scene.log_hidden - hidden_for)
    return np.where(missed > 0.0, together, 0.0)


@compiled
def view_at(heights: FloatArray, sensor: int, x: float, y: float) -> float:
    """Return the probability that a place is in the field of view of a sensor; see `sensors.Views`."""
    beyond = -math.inf
    for k in range(len(COMPASS)):
        beyond = max(beyond, x * COMPASS[k, 0] + y * COMPASS[k, 1] - heights[sensor, k])
    return min(max(0.5 - beyond / EDGE, 0.0), 1.0)


@compiled
def misses_between(chains: Chains, k: int, m: int, heights: FloatArray, weights: FloatArray) -> float:
    """Return the scans between detections k and m whose sensors see the way between them, weighted.

    ``heights``: of `sensors.Views`; ``weights``: (s,) of a miss by each sensor
    """
    earlier, later = chains.rows[k], chains.rows[m]
    far = abs(later.x - earlier.x) + abs(later.y - earlier.y) > EDGE
    missed = 0.0
    for s in range(chains.scans.shape[1]):
        scans = chains.scans[m, s] - chains.scans[k, s] - (1.0 if s == earlier.sensor else 0.0)
        if scans <= 0.0:
            continue
        view = 0.5 * (chains.views[k, s] + chains.views[m, s])
        # Fields of view are convex: the way between two places inside is inside.
        if far and view < 1.0:
            view = 0.0
            for i in range(ON_THE_WAY):
                share = (i + 0.5) / ON_THE_WAY
                x, y = earlier.x + share * (later.x - earlier.x), earlier.y + share * (later.y - earlier.y)
                view += view_at(heights, s, x, y) / ON_THE_WAY
        missed += scans * view * weights[s]
    return missed


@compiled
def log_between(chains: Chains, k: int, m: int, scene: SceneRow) -> float:
    """`log_gap` between detections k and m, of the scans whose sensors see the way between them."""
    frames = chains.rows[m].frame - chains.rows[k].frame - 1
    if not chains.scans.shape[1] or frames <= 0:
        return log_gap(frames, scene)
    return log_misses(misses_between(chains, k, m, scene.views, scene.weights), frames, scene)


@allocating
def count_misses(
    chains: Chains, before: IntArray, after: IntArray, heights: FloatArray, missed: FloatArray
) -> None:
    """Fill `misses_between` of pairs (n,) of detections, with weights of 1."""
    even = np.ones(len(heights))
    for i in range(len(before)):
        missed[i] = misses_between(chains, before[i], after[i], heights, even)


@compiled
def kalman_step(earlier: Row, before: State, later: Row, scene: SceneRow, state: State) -> float:
    """Fill the state after a later detection; return the log density of its position.

    The position may have jumped, after which the velocity is unknown: both states are moment-matched.
    """
    if is_new(before):
        return first_kalman_step(earlier, before, later, scene, state)
    dt = later.t - earlier.t
    p, pv, v = compiled_spread(before.pp, before.pv, before.vv, dt, scene.density)
    x, y = before.x + dt * before.vx, before.y + dt * before.vy
    spread = p + later.variance
    off_x, off_y = later.x - x, later.y - y
    square = 0.5 * (off_x * off_x + off_y * off_y)
    wide = spread + scene.jump_variance
    # Avoids overflow of the exponential.
    likelier = square / spread - square / wide
    beyond = max(likelier - 500.0, 0.0) if scene.jump_probability > 0.0 else 0.0
    stays = 1.0 - scene.jump_probability
    odds = scene.jump_probability * spread / (stays * wide) * math.exp(min(likelier, 500.0))
    share = odds / (1.0 + odds)
    gain, turn = p / spread, pv / spread
    wide_gain, wide_turn = (p + scene.jump_variance) / wide, pv / wide
    apart, apart_turn = wide_gain - gain, wide_turn - turn
    between = share * (1.0 - share) * square
    gain, turn = gain + share * apart, turn + share * apart_turn
    state.x, state.y = x + gain * off_x, y + gain * off_y
    state.vx, state.vy = before.vx + turn * off_x, before.vy + turn * off_y
    state.pp = p * (1.0 - gain) + share * scene.jump_variance * (1.0 - wide_gain) + between * apart * apart
    state.pv = pv * (1.0 - gain) + between * apart * apart_turn
    state.vv = v - turn * pv + share * scene.speed_variance + between * apart_turn * apart_turn
    return math.log(stays * (1.0 + odds) / (2.0 * math.pi * spread)) + beyond - square / spread


@compiled
def is_new(state: State) -> bool:
    """Return whether the state is that of a person who was detected once: the velocity is not known."""
    return state.pv == 0.0


@compiled
def first_kalman_step(earlier: Row, before: State, later: Row, scene: SceneRow, state: State) -> float:
    """`kalman_step` of a person who was detected once, with the components of the velocity's prior."""
    dt = later.t - earlier.t
    off_x, off_y = later.x - before.x, later.y - before.y
    total, x, y, vx, vy = 0.0, 0.0, 0.0, 0.0, 0.0
    within_p, within_pv, within_v, between_p, between_pv, between_v = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for component in scene.velocities:
        p, pv, v = compiled_spread(before.pp, 0.0, component.variance, dt, scene.density)
        spread = p + later.variance
        ahead_x, ahead_y = off_x - dt * component.vx, off_y - dt * component.vy
        square = 0.5 * (ahead_x * ahead_x + ahead_y * ahead_y)
        weight = component.weight * math.exp(-min(square / spread, 700.0)) / spread
        gain, turn = p / spread, pv / spread
        # Relative to the detection, so that large coordinates lose no digits.
        here_x, here_y = (gain - 1.0) * ahead_x, (gain - 1.0) * ahead_y
        there_x, there_y = component.vx + turn * ahead_x, component.vy + turn * ahead_y
        total += weight
        x, y = x + weight * here_x, y + weight * here_y
        vx, vy = vx + weight * there_x, vy + weight * there_y
        within_p += weight * p * (1.0 - gain)
        within_pv += weight * pv * (1.0 - gain)
        within_v += weight * (v - turn * pv)
        between_p += weight * 0.5 * (here_x * here_x + here_y * here_y)
        between_pv += weight * 0.5 * (here_x * there_x + here_y * there_y)
        between_v += weight * 0.5 * (there_x * there_x + there_y * there_y)
    x, y, vx, vy = x / total, y / total, vx / total, vy / total
    state.x, state.y, state.vx, state.vy = later.x + x, later.y + y, vx, vy
    state.pp = within_p / total + max(between_p / total - 0.5 * (x * x + y * y), 0.0)
    state.pv = within_pv / total + between_pv / total - 0.5 * (x * vx + y * vy)
    state.vv = within_v / total + max(between_v / total - 0.5 * (vx * vx + vy * vy), 0.0)
    return math.log(total / (2.0 * math.pi))


@compiled
def start_track(first: Row, scene: SceneRow, state: State) -> float:
    """The state of a new person at the first detection; its evidence."""
    state.x, state.y = first.x, first.y
    state.vx = state.vy = state.pv = 0.0
    state.pp, state.vv = first.variance, scene.speed_variance
    _, _, state.body_x, state.body_y = angle_update(
        first.body, 0.0, 0.0, scene.body_variance, scene.body_outliers
    )
    _, _, state.head_x, state.head_y = angle_update(
        first.head, 0.0, 0.0, scene.head_variance, scene.head_outliers
    )
    return scene.log_birth + first.birth + first.gain


@compiled
def extend_track(chains: Chains, before: State, k: int, m: int, scene: SceneRow, state: State) -> float:
    """The state after detection m of a person whose state was ``before`` at detection k; its evidence.

    ``state`` may be ``before``.
    """
    earlier, later = chains.rows[k], chains.rows[m]
    density = kalman_step(earlier, before, later, scene, state)
    skipped = log_between(chains, k, m, scene)
    shown = update_orientations(earlier, before, later, scene, state) + appearance_ratio(
        chains.appearance, k, m, scene
    )
    return density + later.gain + skipped + shown + trusted(chains, k, m, scene)


_BETWEEN = 8
"""Detections of other sensors between two of one sensor, at most."""


@compiled
def trusted(chains: Chains, k: int, m: int, scene: SceneRow) -> float:
    """Log odds of the given identity of detection m, by that of its sensor at or before detection k."""
    later = chains.rows[m]
    if scene.trust == 0.0 or later.given < 0:
        return 0.0
    for _ in range(_BETWEEN):
        one = chains.rows[k]
        if one.sensor == later.sensor or one.preceding < 0:
            break
        k = one.preceding
    return scene.trust if chains.rows[k].given == later.given else 0.0


@compiled
def spread_after(dt: float, state: State, variance: float, scene: SceneRow) -> float:
    """Innovation variance (m²) on each axis, of a detection of that variance."""
    return compiled_spread(state.pp, state.pv, state.vv, dt, scene.density)[0] + variance


@compiled
def reach(state: State, dt: float, variance: float, scene: SceneRow) -> float:
    """Gate radius in metres about the position predicted ``dt`` seconds ahead."""
    spread = spread_after(dt, state, variance, scene)
    return GATE * math.sqrt(spread + (scene.jump_variance if scene.jump_probability > 0.0 else 0.0))


@compiled
def is_within(state: State, dt: float, later: Row, scene: SceneRow) -> bool:
    """Return whether a detection ``dt`` seconds after a state is within the gate about its prediction."""
    spread = spread_after(dt, state, later.variance, scene)
    if scene.jump_probability > 0.0:
        spread += scene.jump_variance
    off_x, off_y = later.x - state.x - dt * state.vx, later.y - state.y - dt * state.vy
    return off_x * off_x + off_y * off_y < GATE * GATE * spread


@compiled
def is_same(state: State, other: State) -> bool:
    """Return whether two states lead to the same links."""
    off = max(
        abs(state.x - other.x), abs(state.y - other.y), abs(state.vx - other.vx), abs(state.vy - other.vy)
    )
    off = max(off, abs(state.pp - other.pp), abs(state.pv - other.pv), abs(state.vv - other.vv))
    off = max(off, abs(state.body_x - other.body_x), abs(state.body_y - other.body_y))
    return max(off, abs(state.head_x - other.head_x), abs(state.head_y - other.head_y)) < SAME


@compiled
def evidence_after(chains: Chains, state: State, k: int, scene: SceneRow) -> float:
    """Evidence of the detections after k in its chain, given the state there, which is overwritten.

    Stored values are used from ``look_ahead`` detections on, or from where the state is that of the chain.
    """
    total, count = 0.0, 0
    m = chains.rows[k].following
    while m >= 0 and count < scene.look_ahead and not is_same(state, chains.state[k]):
        total += extend_track(chains, state, k, m, scene, state)
        k, m, count = m, chains.rows[m].following, count + 1
    return total + (chains.rows[m].rest if m >= 0 else log_end(chains, k, scene))


@compiled
def remember_rest(chains: Chains, scene: SceneRow, move: int) -> None:
    """Set ``rest``, which holds for a detection as long as only earlier detections change.

    ``move``: number of the move that changes what follows, see `DETECTION`
    """
    for m in range(len(chains.rows) - 1, -1, -1):
        one = chains.rows[m]
        rest = one.evidence + (
            chains.rows[one.following].rest if one.following >= 0 else log_end(chains, m, scene)
        )
        # The far part counts where the person may have left.
        if abs(rest - one.rest) > SAME and one.alone < max(one.rest - rest, 0.0) + SAME:
            one.changed_after = move
        one.rest = rest


@compiled
def log_end(chains: Chains, k: int, scene: SceneRow) -> float:
    """Log probability that a track's last detection is k: death, or misses until the end."""
    left = chains.rows[-1].frame - chains.rows[k].frame
    if left <= 0:
        return 0.0
    missed = float(left)
    if chains.scans.shape[1]:
        own, newest = chains.rows[k].sensor, chains.rows[-1].sensor
        missed = chains.views[k, newest] * scene.weights[newest] - chains.views[k, own] * scene.weights[own]
        for s in range(chains.scans.shape[1]):
            missed += (chains.scans[-1, s] - chains.scans[k, s]) * chains.views[k, s] * scene.weights[s]
    return max(min(scene.log_death + chains.rows[k].death, 0.0), log_misses(missed, left, scene))


@compiled
def evidence_as_new(chains: Chains, k: int, scene: SceneRow, state: State) -> float:
    """Evidence of the track from detection k on, as of a new person, over that of false detections.

    ``state`` is overwritten.
    """
    value = start_track(chains.rows[k], scene, state)
    value += evidence_after(chains, state, k, scene)
    chains.rows[k].alone = max(0.0, value)
    return value


@compiled
def state_after(chains: Chains, k: int, scene: SceneRow, state: State) -> float:
    """Evidence of the whole track of detection k, whose link to the next detection may be new.

    ``state`` is overwritten.
    """
    m = chains.rows[k].following
    if m < 0:
        return chains.rows[k].total + log_end(chains, k, scene)
    evidence = extend_track(chains, chains.state[k], k, m, scene, state)
    return chains.rows[k].total + evidence + evidence_after(chains, state, m, scene)


@allocating
def refresh(chains: Chains, first: int, end: int, scene: SceneRow, move: int) -> None:
    """Filter the detections from ``first`` up to ``end`` along their chains.

    ``move``: number of the move that changes states, see `DETECTION`
    """
    before = np.empty(1, STATE)
    for m in range(first, end):
        one, state = chains.rows[m], chains.state[m]
        before[0] = state
        worth = head_worth(chains, m, scene)
        k = one.preceding
        if k < 0:
            one.evidence = start_track(one, scene, state)
            one.total = one.evidence
        else:
            one.evidence = extend_track(chains, chains.state[k], k, m, scene, state)
            one.total = chains.rows[k].total + one.evidence
        if not (abs(head_worth(chains, m, scene) - worth) < SAME and is_same(state, before[0])):
            one.changed_before = move


@compiled
def head_worth(chains: Chains, k: int, scene: SceneRow) -> float:
    """Evidence of the track up to detection k over that of its ending there, or of false detections."""
    total = chains.rows[k].total
    return total - max(0.0, total + log_end(chains, k, scene))


@compiled
def change_after(chains: Chains, k: int, scene: SceneRow, move: int) -> None:
    """Mark the link of detection k as changed: for it, and for earlier detections that look so far ahead."""
    chains.rows[k].changed_before = move
    count = 0
    while k >= 0 and count < scene.look_ahead:
        chains.rows[k].changed_after = move
        k, count = chains.rows[k].preceding, count + 1


@allocating
def innovations(chains: Chains, scene: SceneRow) -> tuple[float, float, int]:
    """Filter all linked detections; return the log densities of places and of angles, and their number."""
    position_cost, angles, count = 0.0, 0.0, 0
    here = np.empty(1, STATE)
    for m in range(len(chains.rows)):
        k = chains.rows[m].preceding
        if k < 0:
            start_track(chains.rows[m], scene, chains.state[m])
            continue
        here[0] = chains.state[k]
        position_cost += kalman_step(chains.rows[k], here[0], chains.rows[m], scene, chains.state[m])
        angles += update_orientations(chains.rows[k], here[0], chains.rows[m], scene, chains.state[m])
        count += 1
    return position_cost, angles, count


@compiled
def roots(chains: Chains, scene: SceneRow, root: IntArray, value: FloatArray) -> None:
    """Fill the first detection of each detection's track (n,), and at each first detection its evidence."""
    for k in range(len(root)):
        before = chains.rows[k].preceding
        root[k] = k if before < 0 else root[before]
        value[k] = -math.inf
    for k in range(len(root)):
        if chains.rows[k].following < 0:
            value[root[k]] = chains.rows[k].total + log_end(chains, k, scene)


@compiled
def count_up(chains: Chains, times: IntArray) -> None:
    """Fill the length of each detection's track up to it (n,); first detections have it already."""
    for k in range(len(times)):
        before = chains.rows[k].preceding
        if before >= 0:
            times[k] = times[before] + 1


_LEAST = 20  # neighbours in tracks below which angles are not used
_OUTLIERS = (0.02, 0.9)  # bounds of the learned share of outliers


def observed_angles(channels: Mapping[str, FloatArray], n: int) -> FloatArray:
    """Observed body and head of each detection, (n, 2) radians; NaN where missing.

    ``channels``: by the names of a track's attributes; where there is no angle, class likelihoods are taken
    by their circular mean
    """
    found = np.full((n, 2), np.nan)
    for column, name in enumerate(("body", "head")):
        if name in channels:
            found[:, column] = channels[name]
        classes = channels.get(f"{name}_likelihood")
        if classes is not None:
            centres = class_centres(classes.shape[1])
            mean = np.arctan2(classes @ np.sin(centres), classes @ np.cos(centres))
            found[:, column] = np.where(np.isnan(found[:, column]), mean, found[:, column])
    return found


def learn_orientation(
    chains: Chains,
    scene: SceneParameters,
    seconds: float,
    known: Known = NOTHING,
    velocities: NDArray[np.void] = ANY_VELOCITY,
) -> SceneParameters:
    """The parameters of angles of maximum likelihood for the tracks; the tracks are filtered again."""

    def densities(tried: SceneParameters) -> tuple[float, float, int]:
        return innovations(chains, scene_of(tried, seconds, velocities))

    later = np.flatnonzero(chains.preceding >= 0)
    both = np.isfinite(chains.facing[later]) & np.isfinite(chains.facing[chains.preceding[later]])
    neutral: dict[str, Any] = {"body_outliers": 1.0, "head_outliers": 1.0}
    kinds = ("body_std", "body_turn", "heading_std"), ("head_std", "head_turn", "gaze_std")
    for column, names in enumerate(kinds):
        outliers = f"{names[0][:4]}_outliers"
        kept = {name: known[name] for name in (*names, outliers) if name in known}
        if both[:, column].sum() >= _LEAST and len(kept) <= len(names):
            candidates = replace(scene, **neutral)
            scene = replace(scene, **_fitted(densities, candidates, names, outliers, kept))
    return scene


def _fitted(
    densities: Callable[[SceneParameters], tuple[float, float, int]],
    scene: SceneParameters,
    names: tuple[str, ...],
    outliers: str,
    kept: Known,
) -> dict[str, Any]:
    """Maximum-likelihood spreads and share of outliers of one kind of angle; some may be fixed."""
    ranges = [SceneParameters.__dataclass_fields__[name].metadata["range"] for name in names]
    low, high = np.array(ranges).T

    def parameters(given: FloatArray) -> dict[str, Any]:
        spreads = np.clip(np.exp(given[:-1]), low, high).tolist()
        share = float(np.clip(given[-1], *_OUTLIERS))
        return dict(zip(names, spreads, strict=True)) | {outliers: share} | dict(kept)

    # Angles turn the velocity too, and so change the predicted position.
    before, candidates, _ = densities(scene)

    def cost(given: FloatArray) -> float:
        found = parameters(given)
        share = found[outliers]
        # A weak prior, worth a few angles.
        doubt = 0.0 if outliers in kept else 2.0 * np.log(share) + 2.0 * np.log1p(-share)
        position_cost, angles, _ = densities(replace(scene, **found))
        return before + candidates - position_cost - angles - float(doubt)

    start = [*np.log([getattr(SceneParameters(), name) for name in names]), 0.2]
    found = optimize.minimize(
        cost, start, method="Nelder-Mead", options={"maxfev": 40 * len(start), "fatol": 0.1}
    )
    best = parameters(found.x)
    # Angles that fit no better than uniform angles are not used.
    return best | ({outliers: 1.0} if found.fun > 0.0 else {}) | dict(kept)
