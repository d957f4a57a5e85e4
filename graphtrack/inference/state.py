"""State of the online engines: checked observations, the marginal prior, windows, and saved states."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal, NamedTuple

import numpy as np

from graphtrack.constant_velocity import predict_covariance
from graphtrack.errors import GraphtrackError, InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.planar import speed_std
from graphtrack.kernels.layout import BODY, HEAD, STATE_SLICES, N
from graphtrack.model import Model, Observation, Step
from graphtrack.model.observation import CHANNELS, Covariance, OwnParameters
from graphtrack.model.terms.motion import LARGEST_ROUNDING, rounding
from graphtrack.packages import gtsam
from graphtrack.saved import DAMAGES, check_numbers, damaged, integer, pack_tree, real, unpack_tree
from graphtrack.tracks.display import html_pairs
from graphtrack.tracks.schema import INPUT_NAME, LARGEST_CORRELATION, is_input_name
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track
from graphtrack.tracks.validation import (
    FIELDS,
    FINITE,
    LARGEST_SECONDS,
    SENSOR_NAME,
    SHAPES,
    Bounds,
    is_sensor_name,
    real_numbers,
)

_COVARIANCES = tuple(name for name in CHANNELS if len(SHAPES[name]) == 2)
_SIZES = {name: SHAPES[name][0] for name in CHANNELS if SHAPES[name]}
_CHECKS = tuple(
    (name, FIELDS[name].low, FIELDS[name].high, _SIZES.get(name, 0))
    for name in CHANNELS
    if name not in _COVARIANCES
)


def checked(observation: Observation) -> Observation:
    """Return a checked observation, with tuples in place of lists and arrays.

    Raises
    ------
    InputError
        Naming the channel whose value is out of bounds or of a wrong size, or the input without numbers.
    """
    if not isinstance(observation, Observation):
        found = "None" if observation is None else f"a {type(observation).__name__}"
        raise InputError(found, "an Observation; its channels are None where nothing was observed")
    if type(observation.frame) is not int:
        observation = replace(observation, frame=_frame_number(observation.frame))
    if observation.inputs:
        observation = replace(observation, inputs=_checked_inputs(observation.inputs))
    if observation.sensor and not is_sensor_name(observation.sensor):
        raise InputError(f"sensor = {_shown(observation.sensor)}", SENSOR_NAME)
    given: dict[str, Any] = {name: getattr(observation, name) for name in _COVARIANCES}
    if any(one is not None for one in given.values()):
        given = {name: _checked_covariance(name, one) for name, one in given.items() if one is not None}
        observation = replace(observation, **given)
    return observation if _is_valid(observation) else _repaired(observation)


def _checked_inputs(inputs: Mapping[str, Any]) -> dict[str, float | tuple[float, ...]]:
    found: dict[str, float | tuple[float, ...]] = {}
    if not isinstance(inputs, Mapping):
        raise InputError(f"inputs = {_shown(inputs)}", "a mapping of names to a number or several")
    for name, value in inputs.items():
        if not isinstance(name, str) or not is_input_name(name):
            raise InputError(f"an input {name!r}", INPUT_NAME)
        numbers = _numbers(value)
        if numbers is None or numbers.ndim > 1 or not numbers.size or _is_outside(numbers, FINITE):
            expected = "a finite number, or several; left out where nothing is known"
            raise InputError(f"input {name} = {_shown(value)}", expected)
        found[name] = tuple(numbers.tolist()) if numbers.ndim else float(numbers)
    return found


def _frame_number(frame: object) -> int:
    """Return the number of a frame, also NumPy's; InputError for other values."""
    if isinstance(frame, bool) or not isinstance(frame, int | np.integer):
        raise InputError(f"frame = {_shown(frame)}", "a whole number")
    return int(frame)


def _checked_covariance(name: str, value: object) -> Covariance:
    """Return a covariance as tuples; InputError unless it is positive definite."""
    numbers = _numbers(value)
    if numbers is not None and numbers.shape == (2, 2) and not _is_outside(numbers, FIELDS[name]):
        (xx, xy), (yx, yy) = numbers.tolist()
        alike = math.isclose(xy, yx, abs_tol=1e-12 * (xx + yy))
        if alike and xx > 0.0 and yy > 0.0 and abs(xy) <= LARGEST_CORRELATION * math.sqrt(xx * yy):
            return ((xx, xy), (xy, yy))
    raise InputError(f"{name} = {_shown(value)}", "a 2 × 2 matrix, positive definite, or None")


def _numbers(value: object) -> FloatArray | None:
    try:
        return real_numbers(value)
    except (TypeError, ValueError):
        return None


def _is_outside(numbers: FloatArray, bounds: Bounds) -> bool:
    return bool(np.isnan(numbers).any()) or bounds.first_outside(numbers) is not None


def _shown(value: object) -> str:
    return " ".join(repr(value).split())[:60]


def _is_valid(observation: Observation) -> bool:
    """Return True if all channels are numbers, or tuples of them, within bounds; for every observation."""
    try:
        if not -LARGEST_SECONDS <= observation.t <= LARGEST_SECONDS:
            return False
        for name, low, high, size in _CHECKS:
            value = getattr(observation, name)
            if value is None:
                continue
            if size and (type(value) is not tuple or len(value) != size):
                return False
            for number in value if size else (value,):
                if not low <= number <= high:
                    return False
    except (TypeError, ValueError):  # no numbers at all
        return False
    return True


def _repaired(observation: Observation) -> Observation:
    changed: dict[str, Any] = {}
    for name in ("t", *(name for name, *_ in _CHECKS)):
        value, bounds, size = getattr(observation, name), FIELDS[name], _SIZES.get(name, 0)
        if value is None and name != "t":
            continue
        numbers = _numbers(value)
        if numbers is None or numbers.shape != ((size,) if size else ()) or _is_outside(numbers, bounds):
            expected = f"{size} numbers, each {bounds.expected}" if size else bounds.expected
            missing = "" if name == "t" else ", or None where nothing was observed"
            raise InputError(f"{name} = {_shown(value)}", expected + missing)
        changed[name] = tuple(numbers.tolist()) if size else float(numbers)
    return replace(observation, **changed)


@dataclass(frozen=True, eq=False)
class MarginalPrior:
    """½·dᵀ·Λ·d − ηᵀ·d + ½·c on the state of a step, d its deviation from a linearisation point.

    Attributes
    ----------
    information, linear, constant : Λ (6, 6), η (6,) and c; zero for coordinates outside the model
    point : (6,) the linearisation point: metres, m/s, radians
    """

    information: FloatArray
    linear: FloatArray
    point: FloatArray
    constant: float = 0.0

    @classmethod
    def of(
        cls, factor: gtsam.HessianFactor, step: Step, linearization: gtsam.Values, model: Model
    ) -> MarginalPrior:
        """A marginal on the variables of a step, computed at a linearisation point."""
        parts, keys = dict(variables(step, model)), factor.keys()
        rows = np.concatenate([np.arange(N)[parts[key]] for key in keys])
        information, linear = np.zeros((N, N)), np.zeros(N)
        information[np.ix_(rows, rows)] = factor.information()
        linear[rows] = np.array(factor.linearTerm()).ravel()
        point = np.nan_to_num(read_step(linearization, step, model))
        return cls(information, linear, point, float(factor.constantTerm()))

    def rows(self, origin: FloatArray) -> FloatArray:
        """Λ, η and the point relative to an origin (2,) in metres, as rows (8, 6) for the kernels."""
        rows = np.vstack([self.information, self.linear, self.point])
        rows[N + 1, :2] -= origin
        return rows

    def firm(self, kappa: float) -> MarginalPrior:
        """The same prior with at least a given concentration on each orientation."""
        information = self.information.copy()
        for place in (BODY, HEAD):
            information[place, place] = max(information[place, place], kappa)
        return replace(self, information=information)

    def turned(self, turns: FloatArray, near: float) -> MarginalPrior:
        """The prior in another basin: radians (2,) to there; ``near``: cosine within the same basin."""
        point = self.point.copy()
        point[BODY:] += np.where(np.cos(turns) < near, turns, 0.0)
        return replace(self, point=point)

    def factor(self, step: Step, model: Model) -> gtsam.LinearContainerFactor:
        """The factor, with its linearisation point: without one its error would be 0 everywhere."""
        parts, keys = gtsam.GaussianFactorGraph(), variables(step, model)
        for key, rows in keys:
            constant = self.constant if key == keys[0][0] else 0.0
            parts.push_back(
                gtsam.HessianFactor(key, self.information[rows, rows], self.linear[rows], constant)
            )
        # GTSAM's Python offers Hessian factors of up to three variables; sums of pairs make larger ones.
        for (first, rows), (second, columns) in combinations(keys, 2):
            block, left, right = self.information[rows, columns], np.zeros(N)[rows], np.zeros(N)[columns]
            corners = np.zeros((len(left), len(left))), np.zeros((len(right), len(right)))
            parts.push_back(
                gtsam.HessianFactor(first, second, corners[0], block, left, corners[1], right, 0.0)
            )
        values = values_of([step], self.point[None], model)
        return gtsam.LinearContainerFactor(gtsam.HessianFactor(parts), values)


def variable_keys(step: Step, model: Model) -> list[int]:
    """GTSAM keys of the variables of a step, in the order of the state."""
    return [key for key, _ in variables(step, model)]


def variables(step: Step, model: Model) -> list[tuple[int, slice]]:
    """GTSAM keys of a step's variables, and their indices in the state."""
    found = [(step.position_key, STATE_SLICES["position"]), (step.velocity_key, STATE_SLICES["velocity"])]
    if model.has_body:
        found.append((step.body_key, slice(BODY, BODY + 1)))
    if model.has_head:
        found.append((step.head_key, slice(HEAD, HEAD + 1)))
    return found


STATE_VERSION = 9

FAILURES = (RuntimeError, ArithmeticError, np.linalg.LinAlgError, GraphtrackError)
"""Errors of a smoother for an observation that it cannot use."""

Status = Literal["new", "late", "duplicate", "too-late", "waiting", "failed", "unconfirmed"]
Angles = tuple[float, float]
Newest = tuple[FloatArray, FloatArray]
"""State (6,) and covariance (6, 6) of the newest step: as reported by the compiled chain, the inverse
curvature by engines of GTSAM."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """The estimate after an observation, at the latest time so far.

    Attributes
    ----------
    t, frame : the time of the estimate (seconds) and its frame
    position : (2,) metres; velocity : (2,) m/s; NaN while waiting for a first position
    body, head : radians; NaN when the model does not estimate them
    covariance : (6, 6) in the order of `graphtrack.tracks.track.STATE`
    status : result of the observation. "new": in order. "late": out of sequence within the window, and
        used. "duplicate": known time and nothing new, ignored. "too-late": older than the window, ignored.
        "waiting": no position so far, ignored. "failed": it could not be used; the state is the previous one.
        "unconfirmed": in streams, its time is far from the stream's; used once the next row agrees with it.
    reason : the reason of a failure, or that an observation contradicts that of its time
    sensor : the sensor of that frame; "" without a name
    """

    t: float
    frame: int
    position: FloatArray
    velocity: FloatArray
    body: float
    head: float
    covariance: FloatArray
    status: Status
    reason: str = ""
    sensor: str = ""

    def __repr__(self) -> str:
        known = [f"{name} {value}" for name, value in self._described().items()]
        return f"Estimate(t={self.t:.6g} s, frame {self.frame}, {', '.join([repr(self.status), *known])})"

    def _repr_html_(self) -> str:
        caption = f"Estimate at t = {self.t:.6g} s, frame {self.frame}: {self.status}"
        return html_pairs(caption, self._described())

    @property
    def speed(self) -> float:
        """The length of the velocity, m/s."""
        return math.hypot(*self.velocity.tolist())

    @property
    def speed_std(self) -> float:
        """Half the width of the interval that contains the speed with 68.3 %, m/s."""
        return speed_std(self.velocity[None], self.covariance[None, 2:4, 2:4]).item()

    def ahead(self, dt: float, acceleration_density: float) -> tuple[FloatArray, FloatArray]:
        """Return position (2,) and covariance (2, 2) ``dt`` seconds later, at constant velocity.

        ``acceleration_density``: of white-noise acceleration, m²/s³
        """
        covariance = predict_covariance(self.covariance, dt, acceleration_density)
        return self.position + dt * self.velocity, covariance[:2, :2]

    def _described(self) -> dict[str, str]:
        """Return the estimate as text, with 1-σ."""
        x, y, vx, vy, body, head = np.sqrt(np.diagonal(self.covariance)).tolist()
        found = {}
        for name, value, spread, unit in (
            ("position", self.position, math.hypot(x, y) / math.sqrt(2.0), "m"),
            ("velocity", self.velocity, math.hypot(vx, vy) / math.sqrt(2.0), "m/s"),
        ):
            if np.isfinite(value).all():
                found[name] = f"({value[0]:.2f}, {value[1]:.2f}) ± {spread:.2f} {unit}"
        for name, angle, spread in (("body", self.body, body), ("head", self.head, head)):
            if math.isfinite(angle):
                found[name] = f"{math.degrees(angle):.0f}° ± {math.degrees(spread):.0f}°"
        return found | ({"reason": self.reason} if self.reason else {})


def as_track(track: Track, estimates: Iterable[Estimate], model: Model) -> Track:
    """A track of online estimates, one for each frame of the recorded track."""
    found, channels = list(estimates), ["position", "velocity", "covariance"]
    channels += [name for name, has in (("body", model.has_body), ("head", model.has_head)) if has]
    arrays: dict[str, Any] = {name: np.array([getattr(e, name) for e in found]) for name in channels}
    return track.with_estimates(**arrays)


@dataclass(frozen=True, eq=False)
class Window:
    """The window from which a smoother is rebuilt.

    Attributes
    ----------
    steps : the steps whose variables are not marginalised, oldest first
    states : (n, 6) their linearisation points: x, y, vx, vy, body, head (metres, m/s, radians)
    prior : marginal of the earlier steps; None if there were none
    anchor : else the angles (radians) at which first orientations are held; see `graph.batch.beginning`
    """

    steps: tuple[Step, ...]
    states: FloatArray
    prior: MarginalPrior | None
    anchor: Angles | None


EMPTY = Window((), np.zeros((0, N)), None, None)


def present(model: Model) -> list[int]:
    """The indices of a model's variables in a state of six."""
    return [0, 1, 2, 3, *([4] if model.has_body else []), *([5] if model.has_head else [])]


def leaving(steps: Sequence[Step], lag: float, newest: Step | None = None) -> int:
    """Return the number of a window's first steps that are older than the lag (seconds)."""
    if not steps:
        return 0
    horizon = (newest or steps[-1]).observation.t - lag - TIME_TOLERANCE
    return bisect_left(steps, horizon, key=lambda step: step.observation.t)


def predicted(step: Step, before: FloatArray | None) -> tuple[float, ...]:
    """Initial values of a new step: constant velocity, angles constant or as observed.

    ``before`` (6,) is the state of the previous step; None without one.
    """
    observation = step.observation
    if before is None or step.dt is None:
        x, y = observation.position if observation.position is not None else (math.nan, math.nan)
        vx, vy, body, head = 0.0, 0.0, math.nan, math.nan
    else:
        x, y, vx, vy, body, head = before.tolist()
        x, y = x + step.dt * vx, y + step.dt * vy
    if not math.isfinite(body):
        body = next((a for a in (observation.body, observation.head) if a is not None), 0.0)
    if not math.isfinite(head):
        head = observation.head if observation.head is not None else body
    return x, y, vx, vy, body, head


def read_step(values: gtsam.Values, step: Step, model: Model) -> tuple[float, ...]:
    """x, y, vx, vy, body, head of a step from GTSAM values; NaN for variables outside the model."""
    body = values.atRot2(step.body_key).theta() if model.has_body else math.nan
    head = values.atRot2(step.head_key).theta() if model.has_head else math.nan
    position, velocity = values.atPoint2(step.position_key), values.atVector(step.velocity_key)
    return (*position.tolist(), *velocity.tolist(), body, head)


def values_of(steps: Sequence[Step], states: FloatArray, model: Model) -> gtsam.Values:
    """States (n, 6) as the variables of some steps."""
    values = gtsam.Values()
    for step, state in zip(steps, states.tolist(), strict=True):
        values.insert(step.position_key, np.array(state[:2]))
        values.insert(step.velocity_key, np.array(state[2:4]))
        if model.has_body:
            values.insert(step.body_key, gtsam.Rot2(state[4]))
        if model.has_head:
            values.insert(step.head_key, gtsam.Rot2(state[5]))
    return values


def states_of(values: gtsam.Values, steps: Sequence[Step], model: Model) -> FloatArray:
    """The inverse of `values_of`."""
    return np.array([read_step(values, step, model) for step in steps])


NOT_DETERMINED = "the estimate is not finite, or lost by rounding"


def determined(newest: Newest, step: Step, model: Model) -> Newest:
    """The newest estimate; ArithmeticError unless it is finite, NaN angles aside, and exceeds rounding."""
    state, covariance = newest
    fine = bool(np.isfinite(state[:4]).all()) and not np.isinf(state).any()
    if fine and step.dt is not None:
        variance = float(np.trace(covariance[:2, :2])) / 2.0
        information = 1.0 / model.parameters.motion.acceleration_density
        fine = 0.0 <= rounding(step.dt, information, variance) <= LARGEST_ROUNDING
    if not fine:
        raise ArithmeticError(NOT_DETERMINED)
    return newest


class SavedState(NamedTuple):
    """An online smoother between two observations."""

    engine: str
    window: Window  # for any engine
    arrays: Mapping[str, FloatArray]  # for the same engine, bit for bit
    last: Estimate | None
    next_index: int


def pack_state(saved: SavedState) -> dict[str, Any]:
    """A state as JSON-able data: arrays as Base64 of their bytes."""
    window, prior, last = saved.window, saved.window.prior, saved.last
    steps = [
        {name: getattr(step, name) for name in ("index", "starts", "dt")}
        | {"observation": pack_observation(step.observation)}
        | ({} if step.own is None else {"own": list(step.own)})
        for step in window.steps
    ]
    arrays = {
        "states": window.states,
        "prior": None if prior is None else vars(prior),
        "anchor": None if window.anchor is None else np.array(window.anchor),
    }
    return {
        "version": STATE_VERSION,
        "engine": saved.engine,
        "next_index": saved.next_index,
        "steps": steps,
        "window": pack_tree(arrays),
        "arrays": pack_tree(saved.arrays),
        "last": None if last is None else _pack_estimate(last),
    }


def pack_observation(observation: Observation) -> dict[str, Any]:
    """An observation as JSON-able data."""
    return {name: value for name, value in vars(observation).items() if value not in (None, "", {})}


def unpack_observation(saved: Mapping[str, Any]) -> Observation:
    """The inverse of `pack_observation`; an error of `DAMAGES` if a value has another type."""
    integer(saved["frame"])
    check_numbers(saved)
    return checked(Observation(**saved))


def unpack_state(state: dict[str, Any], camera: GroundCamera | None) -> SavedState:
    """Return the saved state of `pack_state`'s data; InputError for other data."""
    if not isinstance(state, dict) or state.get("version") != STATE_VERSION:
        raise InputError("a state of another version", f"version {STATE_VERSION}")
    try:
        return SavedState(
            state["engine"],
            _unpack_window(state, camera),
            unpack_tree(state["arrays"]),
            None if state["last"] is None else _unpack_estimate(state["last"]),
            integer(state["next_index"]),
        )
    except DAMAGES as error:
        raise damaged(error) from error


def _unpack_window(state: dict[str, Any], camera: GroundCamera | None) -> Window:
    steps: list[Step] = []
    for entry in state["steps"]:
        previous = steps[-1].alone() if steps else None
        observation = unpack_observation(entry["observation"])
        dt = None if entry["dt"] is None else real(entry["dt"])
        if not isinstance(entry["starts"], bool):
            raise TypeError(f"starts = {entry['starts']!r}")
        if steps and not observation.t > steps[-1].observation.t:
            raise ValueError("steps that are not in order")
        own = None if entry.get("own") is None else OwnParameters(*map(real, entry["own"]))
        steps.append(Step(integer(entry["index"]), observation, previous, dt, entry["starts"], camera, own))
    saved = unpack_tree(state["window"])
    prior, anchor = saved["prior"], saved["anchor"]
    if prior is not None:
        linear, point = (prior[name].reshape(N) for name in ("linear", "point"))
        prior = MarginalPrior(prior["information"].reshape(N, N), linear, point, real(prior["constant"]))
    if anchor is not None:
        body, head = anchor.tolist()
        anchor = body, head
    return Window(tuple(steps), saved["states"].reshape(len(steps), N), prior, anchor)


def _pack_estimate(last: Estimate) -> dict[str, Any]:
    state = np.array([*last.position, *last.velocity, last.body, last.head])
    return {
        "t": last.t,
        "frame": last.frame,
        **({"sensor": last.sensor} if last.sensor else {}),
        **pack_tree({"state": state, "covariance": last.covariance}),
    }


def _unpack_estimate(saved: dict[str, Any]) -> Estimate:
    arrays = unpack_tree(saved)
    x, y, vx, vy, body, head = arrays["state"].tolist()
    return Estimate(
        real(saved["t"]),
        integer(saved["frame"]),
        np.array([x, y]),
        np.array([vx, vy]),
        body,
        head,
        arrays["covariance"].reshape(N, N),
        "new",
        sensor=str(saved.get("sensor", "")),
    )
