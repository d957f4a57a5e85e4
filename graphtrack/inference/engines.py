"""Engines: choice, options, results, the diagnosis of extreme input, and compilation ahead of use."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.basin_search import find_other_basin, unwind
from graphtrack.inference.chain.batch import (
    Options,
    Solved,
    challenge,
    is_chain,
    solve_packed,
    solve_tracks,
)
from graphtrack.inference.chain.covariance import find_covariances
from graphtrack.inference.chain.initialisation import (
    empty_result,
    initial_states,
    pack,
    pack_to_solve,
    problem_of,
)
from graphtrack.inference.chain.newton import Descent, workspace
from graphtrack.kernels.compilation import TRACK, Rehearsal, compile_for, make_ready
from graphtrack.kernels.layout import Chain, N
from graphtrack.model import Model, Observation, Step
from graphtrack.model.function_term import FunctionTerm
from graphtrack.model.model import has_kernels
from graphtrack.model.observation import chain, observations, seconds_between
from graphtrack.model.same_time import of_every_row
from graphtrack.model.terms.motion import LARGEST_ROUNDING, rounding
from graphtrack.tracks.display import counted, html_pairs
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import check_count, is_number

OnlineEngine = Literal["auto", "chain", "fixed-lag", "isam2"]
ENGINES: tuple[OnlineEngine, ...] = ("auto", "chain", "fixed-lag", "isam2")


def engine_of(model: Model, engine: str = "auto") -> OfflineEngine:
    """Return the requested engine, or for "auto" "chain" wherever that is possible.

    Raises
    ------
    InputError
        For an engine that is not offline, or the chain with a term that has no compiled kernel.
    """
    if engine in ("isam2", "fixed-lag"):
        raise InputError(
            f"engine {engine!r}, which is online, for offline smoothing",
            "gtsam, or graphtrack track with --engine isam2 --lag none",
        )
    if engine not in ("auto", "chain", "gtsam"):
        raise InputError(f"engine {engine!r}", "auto, chain or gtsam")
    if engine == "gtsam" or (engine == "auto" and not is_chain(model)):
        return "gtsam"
    for term in model.terms:
        if not term.is_compiled:
            raise InputError(
                f"engine 'chain' and the term {term.label}, which has no compiled kernel",
                "engine 'auto' or 'gtsam'",
            )
    return "chain"


def online_engine(model: Model, engine: OnlineEngine = "auto") -> OnlineEngine:
    """Return the requested online engine, or for "auto" "chain" where possible; errors as `engine_of`."""
    if engine not in ENGINES:
        raise InputError(f"engine {engine!r}", f"one of {', '.join(ENGINES)}")
    if engine == "auto":
        engine = "chain" if is_chain(model) else "isam2"
    if engine == "chain":
        engine_of(model, "chain")
    return engine


def check_lag(lag: float | None, engine: OnlineEngine) -> None:
    """Raise InputError for an invalid window length (seconds), or none where the engine needs one."""
    if lag is None and engine != "isam2":
        raise InputError(f"no lag with the engine {engine}", "seconds; the full history is for isam2")
    if lag is not None and not (is_number(lag) and math.isfinite(lag) and lag > 0.0):
        raise InputError(f"lag = {lag!r}", "a positive number of seconds")


OfflineEngine = Literal["chain", "gtsam"]


@dataclass(frozen=True)
class SolverOptions:
    """Termination criteria and options of the offline solvers.

    Attributes
    ----------
    max_iterations : most steps
    relative_tolerance : of the cost. GTSAM stops after a smaller decrease; the chain engine, whose steps
        converge quadratically, when the predicted decrease is less than ten times that.
    step_tolerance : norm of the whole step (metres, m/s, radians), for GTSAM
    basin_search : basin search: where observations contradict each other, search a grid of orientations for a
        better basin, and descend from there (with GTSAM too, where every term has compiled kernels)
    """

    max_iterations: int = 100
    relative_tolerance: float = 1e-9
    step_tolerance: float = 1e-6
    basin_search: bool = True

    def __post_init__(self) -> None:
        check_count("max_iterations", self.max_iterations)
        for name in ("relative_tolerance", "step_tolerance"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < math.inf:
                raise InputError(f"{name} = {value!r}", "a finite number that is not negative")


SMALL_NOISE = math.radians(5.0)
"""Learned noise of angles that few detectors reach: it may be the part of their errors that does not last."""


@dataclass(frozen=True)
class PersonalConstants:
    """The constants of a person.

    Attributes
    ----------
    acceleration_density : q, m²/s³
    body_diffusion, head_diffusion : rad²/s
    coupling : probability of each way in which orientations follow the motion, by its name
    noise : 1-σ of observations where none was declared, the same for all people: ``position_std`` in metres
        or ``pixel_std``; ``offset_along`` and ``offset_across`` the camera's ray, of what lasts, in metres;
        ``body_std`` and ``head_std`` in radians
    assumed : keys of ``noise`` that are the model's, since there are too few observations to learn them
    """

    acceleration_density: float
    body_diffusion: float
    head_diffusion: float
    coupling: Mapping[str, float]
    noise: Mapping[str, float] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()

    def described_noise(self, *, assumed: bool = False) -> str:
        """Return the noise that was learned, or was ``assumed``, in words; empty without any."""
        own = {name: std for name, std in self.noise.items() if (name in self.assumed) == assumed}
        along, across = own.get("offset_along"), own.get("offset_across")
        parts = [
            f"positions {own['position_std']:.2g} m" if "position_std" in own else "",
            f"foot points {own['pixel_std']:.2g} pixels" if "pixel_std" in own else "",
        ]
        if along is not None and along == across:
            parts.append(f"lasting {along:.2g} m")
        elif along is not None:
            parts.append(f"lasting {along:.2g} m along, {across:.2g} m across the camera's ray")
        parts += [
            f"{name} {math.degrees(own[f'{name}_std']):.0f}°"
            for name in ("body", "head")
            if f"{name}_std" in own
        ]
        parts += [
            f"{100.0 * own[f'{name}_outliers']:.0f} % of the {name} angles are outliers"
            for name in ("body", "head")
            if own.get(f"{name}_outliers")
        ]
        return ", ".join(filter(None, parts))

    def noise_lines(self) -> list[str]:
        """Return a line on the noise that was learned, and one on noise that could not be."""
        learned, assumed = self.described_noise(), self.described_noise(assumed=True)
        lines = [f"noise, learned: {learned}"] if learned else []
        if assumed:
            lines.append(f"noise, of the model, with too few observations to learn it: {assumed}")
        small = [
            name
            for name in ("body", "head")
            if f"{name}_std" not in self.assumed and self.noise.get(f"{name}_std", np.inf) < SMALL_NOISE
        ]
        if small:
            lines.append(
                f"noise of {' and '.join(small)} below {math.degrees(SMALL_NOISE):.0f}°: errors that last "
                "for several frames look like turns, and intervals are then too narrow; a detector's known "
                f"noise helps ({small[-1]}_kappa, the inverse of its variance in rad²)"
            )
        return lines

    def described(self) -> str:
        """Return the constants in units that a reader knows."""
        turns = [math.degrees(math.sqrt(one)) for one in (self.body_diffusion, self.head_diffusion)]
        likely = max(self.coupling, key=lambda name: self.coupling[name])
        return (
            f"q = {self.acceleration_density:.2g} m²/s³, body turns {turns[0]:.0f}°/√s, "
            f"head turns {turns[1]:.0f}°/√s, {likely} ({100.0 * self.coupling[likely]:.0f} %)"
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """The smoothed solution of one track.

    Attributes
    ----------
    track : the estimates, with ``velocity`` and ``covariance``
    initial_cost, cost : negative log density at the start and at the end
    iterations : steps taken
    converged : True if a tolerance was met
    engine : "chain" or "gtsam"
    constants : those of the person, if they were learned
    """

    track: Track
    initial_cost: float
    cost: float
    iterations: int
    converged: bool
    engine: OfflineEngine
    constants: PersonalConstants | None = None

    def __repr__(self) -> str:
        parts = [f"track {self.track.track_id}", counted(len(self.track), "frame"), *self._outcome().values()]
        return f"Solution({', '.join(parts)})"

    def _repr_html_(self) -> str:
        return html_pairs(f"Solution: {self.track!r}", self._outcome())

    def _outcome(self) -> dict[str, str]:
        return {
            "cost": f"cost {self.initial_cost:.6g} → {self.cost:.6g}",
            "steps": counted(self.iterations, "step"),
            "end": "converged" if self.converged else "not converged",
            "engine": self.engine,
            **({} if self.constants is None else {"constants": self.constants.described()}),
        }


@dataclass(frozen=True, eq=False)
class Failure:
    """A track that could not be smoothed, and the reason."""

    track_id: int
    reason: str


def with_every_row(
    found: Sequence[Solution | Failure], tracks: TrackSet, frames: Mapping[int, NDArray[np.int64]]
) -> list[Solution | Failure]:
    """Return solutions of the frames of `with_merged_rows` as those of all rows of the tracks."""
    answers: list[Solution | Failure] = []
    for one, track in zip(found, tracks, strict=True):
        if isinstance(one, Solution) and track.track_id in frames:
            one = replace(one, track=of_every_row(one.track, track, frames[track.track_id]))
        answers.append(one)
    return answers


def estimated_tracks(
    tracks: Sequence[Track],
    offsets: NDArray[np.int64],
    states: FloatArray,
    covariance: FloatArray,
) -> list[Track]:
    """Tracks with estimates, (n, 6) states and (n, 6, 6) covariances, in place of their observations.

    Those of track m are in the rows from ``offsets`` (m + 1,) on. Angles are wrapped. Orientations
    are absent where they begin with NaN. All tracks share the arrays, and ``covariance`` is not copied.
    """
    position, velocity = states[:, :2].copy(), states[:, 2:4].copy()
    optional = {
        "body": states[:, 4],
        "head": states[:, 5],
    }
    has = {name: np.isfinite(other[offsets[:-1]]) for name, other in optional.items()}
    optional = {name: other.copy() for name, other in optional.items() if has[name].any()}
    there = [(name, other, has[name].tolist()) for name, other in optional.items()]
    starts, found = offsets.tolist(), []
    for m, track in enumerate(tracks):
        rows = slice(starts[m], starts[m + 1])
        channels = {name: other[rows] for name, other, is_there in there if is_there[m]}
        found.append(
            track.with_estimates(
                position=position[rows], velocity=velocity[rows], covariance=covariance[rows], **channels
            )
        )
    return found


def lost_by_rounding(
    dt: FloatArray,
    offsets: NDArray[np.int64],
    covariance: FloatArray,
    model: Model,
    reach: float = 0.0,
) -> dict[int, str]:
    """Number of each track whose estimates have an error by rounding above a tenth of their σ → the reason.

    Parameters
    ----------
    dt : (N,) seconds since the previous frame of the same track; 0 at its first
    offsets : (m + 1,) the tracks' first frames, and the end
    covariance : (N, 6, 6) of the estimates
    reach : metres from a track's origin, where the engine does not refine its solution: it loses the more
    """
    information = 1.0 / model.parameters.motion.acceleration_density
    variance = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])
    close = np.flatnonzero((dt > 0.0) & (dt < _CLOSE))
    variance = np.maximum(variance[close], variance[close - 1])
    lost = rounding(dt[close], information, variance) * np.maximum(1.0, 0.1 * reach / np.sqrt(variance))
    found: dict[int, str] = {}
    for place in np.flatnonzero(lost > LARGEST_ROUNDING).tolist():
        k, q = close[place], 1.0 / information
        found.setdefault(
            int(np.searchsorted(offsets, k, side="right")) - 1,
            f"rounding hides the observations: {dt[k]:.3g} s between two frames, with a 1-σ of "
            f"{math.sqrt(variance[place]):.2g} m and acceleration_density = {q:g} m²/s³; "
            "expected longer steps, or another acceleration_density",
        )
    return found


_CLOSE = 0.05
"""Seconds between frames, below which rounding is of interest."""

_USUAL = {"position_std": (1e-4, 1e3), "body_kappa": (0.0, 1e6), "head_kappa": (0.0, 1e6)}
"""Values of the channels for which the solvers are well conditioned."""

_FARTHEST = 1e6  # Metres from the origin, likewise

NOT_FINITE = "the estimate is not finite"

_INDETERMINATE = re.compile(
    r"Indetermin(?:ate|ant) linear system.*?near variable\s+\d+ \(Symbol: (\w+)\)", re.DOTALL
)
"""GTSAM's message for a linear system without a unique solution, with the variable."""
_NUMERICAL = (_INDETERMINATE, re.compile("a step of the solver is not finite"))
"""Reasons that extreme input can cause."""


def not_finite(track: Track, model: Model) -> str:
    """Reason for a non-finite estimate of a track, with the input that is the likeliest cause."""
    return with_extreme(NOT_FINITE, track, model)


def with_extreme(reason: str, track: Track, model: Model) -> str:
    """Failure reason of a track, with its most extreme input, if there is one."""
    return with_extreme_of(reason, list(observations(track)), model)


def with_extreme_of(reason: str, observed: Sequence[Observation], model: Model) -> str:
    """The same of some observations, such as those of a window."""
    return _joined(reason, _extremes(observed, model))


def _extremes(observed: Sequence[Observation], model: Model) -> Iterator[tuple[float, str]]:
    """Yield the factor by which each extreme input exceeds its usual range, and its name."""
    frame = np.array([one.frame for one in observed])
    none = math.nan, math.nan
    position = np.array([none if one.position is None else one.position for one in observed])
    yield from _outside(np.abs(position).max(axis=1), frame, (0.0, _FARTHEST), "a coordinate of {} m")
    for name, usual in _USUAL.items():
        values = np.array([getattr(one, name) for one in observed], dtype=float)  # None becomes NaN
        yield from _outside(values, frame, usual, f"{name} = {{}}")
    std, (low, high) = model.parameters.likelihood.position_std, _USUAL["position_std"]
    if not low <= std <= high:
        words = f"position_std = {std:.3g} of the model, expected {low:g} to {high:g}"
        yield max(low / std, std / high), words


def _outside(
    values: FloatArray, frame: NDArray[np.int64], usual: tuple[float, float], words: str
) -> Iterator[tuple[float, str]]:
    low, high = usual
    known = np.flatnonzero(np.isfinite(values))
    if not known.size:
        return
    k, m = int(known[values[known].argmin()]), int(known[values[known].argmax()])
    expected = f", expected {low:g} to {high:g}" if low else f", expected at most {high:g}"
    if low and values[k] < low:
        factor = low / values[k] if values[k] > 0.0 else math.inf
        yield factor, f"{words.format(f'{values[k]:.3g}')} in frame {frame[k]}{expected}"
    if values[m] > high:
        yield values[m] / high, f"{words.format(f'{values[m]:.3g}')} in frame {frame[m]}{expected}"


def _joined(reason: str, extremes: Iterable[tuple[float, str]]) -> str:
    """The reason and the most extreme input; only the input for a numerical reason that it explains."""
    worst = max(extremes, default=None)
    if worst is not None:
        return f"{NOT_FINITE if any(one.match(reason) for one in _NUMERICAL) else reason}: {worst[1]}"
    indeterminate = _INDETERMINATE.match(reason)
    if indeterminate is None:
        return reason
    return f"the linear system has no unique solution: the factors do not determine {indeterminate[1]}"


OFFLINE = "the offline solver"


def rehearsals(
    model: Model, engine: OnlineEngine | Literal["gtsam"], *, offline: bool, online: bool
) -> list[Rehearsal]:
    """Return the rehearsals of smoothing and tracking with a model and an engine.

    Parameters
    ----------
    engine : "gtsam" has no online solver; "fixed-lag" and "isam2" have no offline solver
    offline, online : solvers that are wanted
    """
    if not is_chain(model):
        return [_graph_rehearsal(None)]
    found: list[Rehearsal] = []
    if offline and engine == "gtsam":
        found += _solver_rehearsals(model, "gtsam", None)
    elif offline and engine in ("auto", "chain"):
        found += _solver_rehearsals(model, "chain", None)
    if online and engine != "gtsam":
        found.append(_online_rehearsal(model) if engine in ("auto", "chain") else _graph_rehearsal(model))
    return found


def make_solver_ready(
    model: Model,
    engine: OfflineEngine,
    camera: GroundCamera | None = None,
    *further: Rehearsal,
    complete: bool = False,
) -> None:
    """Compile, or load, the offline functions of an engine, and ``further`` ones.

    ``complete``: Newton's steps even where the model is linear, and GTSAM's basin search with user-defined
    terms.
    """
    make_ready(OFFLINE, *_solver_rehearsals(model, engine, camera, complete=complete), *further)


def make_online_ready(model: Model, engine: OnlineEngine, *further: Rehearsal) -> None:
    """Compile, or load, the functions of a compiled window, or those of GTSAM's online engines."""
    solver = _online_rehearsal(model) if engine == "chain" else _graph_rehearsal(model)
    make_ready("the online solver", solver, *further)


def has_own_kernels(model: Model) -> bool:
    """Return True if a model has kernels that no preset has: an engine is compiled for them."""
    return any(map(has_kernels, model.own_terms))


def _solver_rehearsals(
    model: Model,
    engine: OfflineEngine,
    camera: GroundCamera | None,
    *,
    complete: bool = False,
) -> list[Rehearsal]:
    """Return rehearsals of an offline engine; of chains the linear solution where it holds, else Newton's."""
    if engine == "gtsam":
        own = has_own_kernels(model)
        return [_graph_rehearsal(None if own and not complete else model)]
    # Linear with the camera of a scene, where its tracks have no pixels.
    linear, like = model.is_linear(pack([TRACK], model)), _like(model)
    found = [Rehearsal("offline linear", partial(_solve, Model("position")), 1.0)] if linear else []
    if linear and camera is None and not complete:
        return found
    found.append(Rehearsal(f"offline {_kind(model)}", partial(_solve, like), 7.0, _parts(model)))
    return found if has_own_kernels(model) else [*found, _start()]


def _graph_rehearsal(model: Model | None) -> Rehearsal:
    """Return the rehearsal of GTSAM's engines; without basin search for None."""
    known = None if model is None else model.compiled
    if known is None or not (known.has_body or known.has_head):
        return _start()
    return Rehearsal(f"graph {_kind(known)}", partial(_search, _like(known)), 8.0)


def _online_rehearsal(model: Model) -> Rehearsal:
    """Return the rehearsal of the compiled window."""
    like = _like(model)
    return Rehearsal(f"online {_kind(model)}", partial(_slide, like), 20.0, _parts(model))


def _start() -> Rehearsal:
    return Rehearsal("start", partial(initial_states, TRACK, Model("position")), 4.0)


def _parts(model: Model) -> tuple[Rehearsal, ...]:
    """Return rehearsals of parts of the solver; none with kernels of a user's own."""
    if has_own_kernels(model):
        return ()
    return (
        Rehearsal("descent", _compile_descent, 10.0),
        Rehearsal("basin search", _compile_basin_search, 9.0),
    )


def _compile_descent() -> None:
    solved = _solved()
    ended = Descent(0.0, 0.0, 0, 0, True)
    compile_for(challenge, solved, Options(1, 1.0, True), ended, 0.0)
    compile_for(find_covariances, solved.chain, solved.states, solved.memory, np.empty((len(TRACK), N, N)))


def _compile_basin_search() -> None:
    chain, states, memory = _solved()
    compile_for(find_other_basin, chain, states, 0.0, memory)
    compile_for(unwind, chain, states, 0.0, memory)


def _solved() -> Solved:
    """Return the arrays of one track, uninitialised."""
    n, problem = len(TRACK), problem_of(pack_to_solve([TRACK], Model("joint")))
    memory = workspace.py_func(n)  # type: ignore[attr-defined]
    return Solved(Chain(problem, 0, n, 0), np.empty((n, N)), memory)


def _like(model: Model) -> Model:
    """A model that calls the same functions, with any parameters."""
    if has_own_kernels(model):
        return Model(model.preset, terms=model.own_terms)
    return Model("joint")


def _kind(model: Model) -> str:
    """Return a key of the functions that a model calls."""
    own = [kind for kind in model.own_terms if has_kernels(kind)]
    functions = [one.function if isinstance(one, FunctionTerm) else one for one in own]
    return "angles" + "".join(f" {one.__module__}.{one.__qualname__}" for one in functions)


def _solve(model: Model) -> None:
    packed = pack_to_solve([TRACK], model)
    if not model.is_linear(packed):
        # What comes first in a solution may be compiled by another process meanwhile.
        compile_for(solve_tracks, problem_of(packed), 1, Options(1, 1.0, True), empty_result(packed))
    solve_packed(packed, model)


def _search(model: Model) -> None:
    from graphtrack.inference.graph.chain_view import ChainView

    initial_states(TRACK, Model("position"))
    view, states = ChainView(model), np.zeros((len(TRACK), 6))
    view.follow(chain(TRACK), states, None)
    view.other(states, 0.0)


def _slide(model: Model) -> None:
    from graphtrack.inference.chain.window import ChainWindow

    window, previous = ChainWindow(model, 0.15, 1e-8, 5), None
    for k, observation in enumerate(observations(TRACK)):
        step = Step(k, observation, previous, seconds_between(previous, observation), previous is None)
        window.extend(step, (*TRACK.position[k].tolist(), 0.0, 0.0, 0.0, 0.0))
        previous = step.alone()
