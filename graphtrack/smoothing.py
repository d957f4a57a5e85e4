"""Smoothing of recordings, from files or tracks to estimates.

Steps: read files, associate identities, insert missing frames, check the declared noise, find groups (with a
model that has them), and solve with an engine.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypedDict, Unpack, overload

from graphtrack.association.associate import tracks_of
from graphtrack.constants import filters
from graphtrack.constants.declared import Trust, trusted
from graphtrack.constants.personal import Constants, is_learned, population_of, solve_learned
from graphtrack.constants.population import Population
from graphtrack.errors import InputWarning, SolveError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.walkable import AreaLike, WalkableArea
from graphtrack.inference.engines import (
    Failure,
    OfflineEngine,
    PersonalConstants,
    Solution,
    SolverOptions,
    engine_of,
    make_solver_ready,
)
from graphtrack.inference.offline import solve_each
from graphtrack.io.options import FileReading
from graphtrack.io.read_write import are_paths, is_table
from graphtrack.model import Model
from graphtrack.model.terms.conversation import GROUP
from graphtrack.model.terms.walls import StaysInside
from graphtrack.tracks.gaps import (
    at_times,
    split_at_gaps,
    with_missing_frames,
    with_times_at,
    without_absences,
)
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given, Scene


Progress = Callable[[int], None]


def solve(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OfflineEngine | Literal["auto"] = "auto",
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    trust: Trust = "declared",
    walkable: AreaLike | None = None,
    constants: Constants | None = None,
) -> list[Solution | Failure]:
    """Smooth every track; a track that fails does not stop the rest.

    Parameters
    ----------
    tracks : observations: a `TrackSet`, a `Track` or several, the path of a file, or a table as for
        `TrackSet.from_table`
    model : a `Model`, a preset's name or a model file; by default "joint"
    engine : "auto", "chain" or "gtsam"; they minimise one cost, and may reach different minima of it
    jobs : threads of the chain engine, by default one for each processor; processes with GTSAM, which holds
        the interpreter's lock, by default one
    options : tolerances of the solver
    progress : called with the numbers of person-frames that are done
    trust : "declared": use the noise declared by the observations or the model; "check": warn where the data
        contradict it; "learn": correct it there, warn, and go on
    walkable : area in which people walk, in metres: a file of GeoJSON or well-known text, or a polygon of
        Shapely or PedPy
    constants : "learn": those of each person, learned from the tracks; a `Population` or its file: the same,
        with that prior in place of what these people have in common; "default": those of the model. By
        default "learn" with the default model, and "default" with another

    Returns
    -------
    list of Solution or Failure, in the order of the tracks
    """
    model = Model.named(model)
    solver = engine_of(model, engine)
    work = prepare(tracks_of(tracks, scene=model.scene), model, solver, trust=trust, constants=constants)
    for line in work.notes:
        warnings.warn(line, InputWarning, stacklevel=2)
    return work.solve(jobs=jobs, options=options, progress=progress, walkable=walkable)


class Prepared(NamedTuple):
    """A recording before it is solved.

    Attributes
    ----------
    tracks : with the times of the estimates
    observed : the same with the noise that is believed
    model : with the noise that is believed
    notes : what was changed, and where the data contradict the declared noise
    engine, constants : of the solution
    resample, origin : frames a second of the estimates, if they have other times, and where these begin
    """

    tracks: TrackSet
    observed: TrackSet
    model: Model
    notes: tuple[str, ...]
    engine: OfflineEngine
    constants: Constants | None
    resample: float | None
    origin: float

    def solve(
        self,
        *,
        jobs: int | None = None,
        options: SolverOptions | None = None,
        progress: Progress | None = None,
        walkable: AreaLike | None = None,
    ) -> list[Solution | Failure]:
        """Smooth every track; parameters as of `solve`."""
        return solve_tracks(
            self.observed,
            self.model,
            self.engine,
            jobs=jobs,
            options=options,
            progress=progress,
            walkable=None if walkable is None else WalkableArea.of(walkable),
            constants=self.constants,
        )

    def estimates(self, found: Iterable[Solution | Failure]) -> TrackSet:
        """Return the solutions' estimates at their times."""
        estimates = self.tracks.with_tracks(one.track for one in found if isinstance(one, Solution))
        return estimates if self.resample is None else at_times(estimates, self.resample, self.origin)


def prepare(
    tracks: TrackSet,
    model: Model,
    engine: OfflineEngine,
    *,
    fill: bool = False,
    split: bool = False,
    split_gap: float | None = None,
    resample: float | None = None,
    trust: Trust = "check",
    constants: Constants | None = None,
) -> Prepared:
    """Split tracks, insert missing frames, and check the declared noise; the solver is made ready.

    Parameters
    ----------
    split : whether tracks are split where a person was absent, and rows in which they were are left out
    others : as in `smooth`
    """
    notes: tuple[str, ...] = ()
    if split:
        tracks, notes = without_absences(tracks)
        tracks, more = split_at_gaps(tracks, split_gap)
        notes += more
    origin = min((float(track.t[0]) for track in tracks), default=0.0)
    if fill:
        tracks, more = with_missing_frames(tracks)
        notes += more
    if resample is not None:
        tracks, more = with_times_at(tracks, resample)
        notes += more
    make_smoothing_ready(model, engine, tracks.camera, constants, trust)
    observed, model, verdict = trusted(tracks, model, trust, constants)
    notes = (*notes, *verdict)
    return Prepared(tracks, observed, model, notes, engine, constants, resample, origin)


def solve_tracks(
    tracks: TrackSet,
    model: Model,
    engine: OfflineEngine,
    *,
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    walkable: WalkableArea | None = None,
    constants: Constants | None = None,
) -> list[Solution | Failure]:
    """Smooth tracks with the engine of `engine_of`; groups are found where the model has them.

    Parameters
    ----------
    constants : as in `solve`
    """
    tracks = tracks.map(with_position_noise)
    if walkable is not None:
        from graphtrack.interaction.walls import solve_inside

        plain = partial(solve_tracks, engine=engine, jobs=jobs, options=options, constants=constants)
        return solve_inside(
            tracks,
            partial(plain, model=model, progress=progress),
            partial(plain, model=model.with_terms(StaysInside)),
            walkable,
        )
    given: dict[str, Any] = {"jobs": jobs, "options": options, "progress": progress}

    def each(some: TrackSet) -> list[Solution | Failure]:
        if is_learned(constants, model):
            return _with_learned(some, model, engine, constants, **given)[0]
        return solve_each(some, model, engine, **given)

    if not (model.has_groups and lacks_groups(tracks)):
        return each(tracks)
    from graphtrack.interaction.coupled import solve_in_turn

    return solve_in_turn(tracks, each, model.parameters.social.correlation_time)


def learn_constants(
    tracks: Given, model: Model | str | Path | None = None, *, jobs: int | None = None
) -> tuple[Population, dict[int, PersonalConstants]]:
    """Learn what `smooth` learns with ``constants="learn"``: the population, and each person's constants.

    Parameters
    ----------
    tracks, jobs : as in `solve`
    model : as in `solve`; by default "joint"

    Returns
    -------
    The shares of the population, for ``constants`` of `solve`, and the constants of each track by its id,
    without those of tracks that cannot be smoothed

    Raises
    ------
    InputError
        For a model whose constants cannot be learned.
    """
    chosen = Model.named(model)
    engine = engine_of(chosen)
    given = tracks_of(tracks, scene=chosen.scene).map(with_position_noise)
    found, population = _with_learned(given, chosen, engine, "learn", None, jobs=jobs)
    solved = (one for one in found if isinstance(one, Solution))
    return population, {one.track.track_id: one.constants for one in solved if one.constants is not None}


def _with_learned(
    tracks: TrackSet,
    model: Model,
    engine: OfflineEngine,
    constants: Constants | None,
    progress: Progress | None = None,
    **options: Any,
) -> tuple[list[Solution | Failure], Population]:
    known = population_of(constants)
    make_smoothing_ready(model, engine, tracks.camera, constants)

    def smoothed(
        some: TrackSet, model: Model, own: Mapping[str, FloatArray], done: Progress | None
    ) -> list[Solution | Failure]:
        return solve_each(some, model, engine, personal=own, progress=done, **options)

    return solve_learned(tracks, model, smoothed, known, progress)


def make_smoothing_ready(
    model: Model,
    engine: OfflineEngine,
    camera: GroundCamera | None,
    constants: Constants | None,
    trust: Trust = "declared",
) -> None:
    """Compile, or load, the solver of `make_solver_ready` and the filters that smoothing calls."""
    needs_filters = trust != "declared" or is_learned(constants, model)
    make_solver_ready(model, engine, camera, *[filters.REHEARSAL] * needs_filters)


def lacks_groups(tracks: TrackSet) -> bool:
    """Return whether groups have to be found: several people, none with the input ``group``."""
    return len(tracks) > 1 and not any(GROUP in track.inputs for track in tracks)


class Solving(TypedDict, total=False):
    """Keywords of `solve`."""

    engine: OfflineEngine | Literal["auto"]
    jobs: int | None
    options: SolverOptions | None
    progress: Progress | None
    trust: Trust
    walkable: AreaLike | None
    constants: Constants | None


class Smoothing(Solving, FileReading, total=False):
    """Keywords of `smooth`."""

    fill: bool | None
    split_gap: float | None
    resample: float | None


@overload
def smooth(tracks: Track, model: Model | str | Path | None = None, **options: Unpack[Smoothing]) -> Track: ...
@overload
def smooth(
    tracks: Scene, model: Model | str | Path | None = None, **options: Unpack[Smoothing]
) -> TrackSet: ...
def smooth(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OfflineEngine | Literal["auto"] = "auto",
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    trust: Trust = "check",
    fill: bool | None = None,
    split_gap: float | None = None,
    resample: float | None = None,
    walkable: AreaLike | None = None,
    constants: Constants | None = None,
    **reading: Unpack[FileReading],
) -> TrackSet | Track:
    """Smooth tracks offline: the maximum a posteriori estimate of every track, with covariances.

    Parameters
    ----------
    tracks, model, engine, jobs, options, progress, trust, walkable, constants : as in `solve`
    fill : also estimate frames between a track's rows that its table leaves out (`gaps.filled`), and those in
        which a person whose detections were associated was missed; by default where ``tracks`` is read
    split_gap : seconds; see `gaps.split_at_gaps`. A single `Track` is not split
    resample : frames a second (Hz) of estimates in place of the tracks' times; see `gaps.with_times_at`
    **reading : options of `read`, where ``tracks`` is a path or a table, such as ``fps``

    Returns
    -------
    TrackSet or Track
        The estimates, one track for each of the input; a `Track` for a single `Track`.

    Raises
    ------
    SolveError
        For the first track that cannot be smoothed; `solve` returns the rest in that case.
    """
    model = Model.named(model)
    solver = engine_of(model, engine)
    read = isinstance(tracks, str | Path) or is_table(tracks) or are_paths(tracks)
    if fill is False and read:
        reading["missed_rows"] = False
    given = tracks_of(tracks, scene=model.scene, **reading)
    work = prepare(
        given,
        model,
        solver,
        fill=read if fill is None else fill,
        split=not isinstance(tracks, Track),
        split_gap=split_gap,
        resample=resample,
        trust=trust,
        constants=constants,
    )
    for line in work.notes:
        warnings.warn(line, InputWarning, stacklevel=2)
    found = work.solve(jobs=jobs, options=options, progress=progress, walkable=walkable)
    for result in found:
        if isinstance(result, Failure):
            raise SolveError(result.track_id, result.reason)
    estimates = work.estimates(found)
    return estimates.tracks[0] if isinstance(tracks, Track) else estimates
