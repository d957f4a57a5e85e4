"""Smoothing and tracking of recordings, from what is given to estimates.

In this order: read files, find identities, insert missing frames, check the declared noise, find groups
(with a model that has them), and solve with an engine.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from graphtrack.association.reading import tracks_of
from graphtrack.errors import InputWarning, SolveError
from graphtrack.gaps import at_times, filled, with_times_at
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import OnlineEngine, engine_of
from graphtrack.inference.offline import solve_each
from graphtrack.inference.online import OnlineSmoother
from graphtrack.inference.solution import Failure, OfflineEngine, Solution, SolverOptions
from graphtrack.inference.state import Estimate, as_track
from graphtrack.inference.warm import make_all_ready
from graphtrack.model import Model
from graphtrack.model.observation import observations
from graphtrack.model.terms.faces_group import GROUP
from graphtrack.readiness import make_ready
from graphtrack.tracks import Track, TrackSet
from graphtrack.trust.verdict import Trust, trusted

if TYPE_CHECKING:
    from graphtrack.io.given import Given, Scene

Progress = Callable[[int], None]
Options = dict[str, Any]
"""Of an `OnlineSmoother`."""


def solve(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OfflineEngine | Literal["auto"] = "auto",
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    trust: Trust = "declared",
) -> list[Solution | Failure]:
    """Smooth every track; one that fails does not keep the others from coming out.

    Parameters
    ----------
    tracks : observations: a `TrackSet`, a `Track` or several, the path of a file, or a table as for
        `TrackSet.from_table`
    model : a `Model`, a preset's name or a model file; by default "full"
    engine : "auto", "chain" or "gtsam"; they minimise one cost, and may reach different minima of it
    jobs : threads of the chain engine, by default one for each processor; processes with GTSAM, which holds
        the interpreter's lock, by default one
    options : tolerances of the solver
    progress : called with the numbers of person-frames that are done
    trust : "declared": observations are as noisy as they, or the model, say; "check": warn where the data
        contradict that; "learn": correct it there, warn, and go on

    Returns
    -------
    list of Solution or Failure, in the order of the tracks
    """
    model = Model.named(model)
    solver = engine_of(model, engine)
    given, model, said = trusted(tracks_of(tracks, scene=model.scene), model, trust)
    for line in said:
        warnings.warn(line, InputWarning, stacklevel=2)
    return solve_tracks(given, model, solver, jobs=jobs, options=options, progress=progress)


def solve_tracks(
    tracks: TrackSet,
    model: Model,
    engine: OfflineEngine,
    *,
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    n_frames: int | None = None,
) -> list[Solution | Failure]:
    """Smooth tracks with the engine that `engine_of` has chosen; groups are found where the model has them.

    ``n_frames``: person-frames of all the work that the tracks are a part of, if there are others.
    """
    each = partial(
        solve_each,
        model=model,
        engine=engine,
        jobs=jobs,
        options=options,
        progress=progress,
        n_frames=n_frames,
    )
    if not (model.has_groups and lacks_groups(tracks)):
        return each(tracks)
    from graphtrack.interaction.coupled import solve_in_turn

    return solve_in_turn(tracks, each, model.parameters.social.correlation_time)


def lacks_groups(tracks: TrackSet) -> bool:
    """Return whether groups have to be found: of several people none has the input ``group``."""
    return len(tracks) > 1 and not any(GROUP in track.inputs for track in tracks)


@overload
def smooth(
    tracks: Track,
    model: Model | str | Path | None = None,
    *,
    engine: OfflineEngine | Literal["auto"] = "auto",
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    trust: Trust = "declared",
    fill: bool = False,
    resample: float | None = None,
    **reading: Any,
) -> Track: ...


@overload
def smooth(
    tracks: Scene,
    model: Model | str | Path | None = None,
    *,
    engine: OfflineEngine | Literal["auto"] = "auto",
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    trust: Trust = "declared",
    fill: bool = False,
    resample: float | None = None,
    **reading: Any,
) -> TrackSet: ...


def smooth(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OfflineEngine | Literal["auto"] = "auto",
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    trust: Trust = "declared",
    fill: bool = False,
    resample: float | None = None,
    **reading: Any,
) -> TrackSet | Track:
    """Smooth tracks offline: the maximum a posteriori estimate of every track, with covariances.

    Parameters
    ----------
    tracks, model, engine, jobs, options, progress, trust : as in `solve`
    fill : estimate the frames between a track's rows that its table leaves out, too; see `gaps.filled`
    resample : estimates at so many frames a second (Hz) in place of the tracks' own; see `gaps.with_times_at`
    **reading : options of `read`, where ``tracks`` is a path or a table, such as ``fps``

    Returns
    -------
    TrackSet or Track
        The estimates, one track for each of the input; of a single `Track` that is a `Track`.

    Raises
    ------
    SolveError
        For the first track that cannot be smoothed; use `solve` to get the others all the same.
    """
    model = Model.named(model)
    given = tracks_of(tracks, scene=model.scene, **reading)
    origin = min((float(track.t[0]) for track in given), default=0.0)
    if fill:
        given = filled(given)
    if resample is not None:
        given = with_times_at(given, resample)
    found = solve(given, model, engine=engine, jobs=jobs, options=options, progress=progress, trust=trust)
    for result in found:
        if isinstance(result, Failure):
            raise SolveError(result.track_id, result.reason)
    estimates = given.with_tracks(result.track for result in found if isinstance(result, Solution))
    if resample is not None:
        estimates = at_times(estimates, resample, origin)
    return estimates.tracks[0] if isinstance(tracks, Track) else estimates


@overload
def track_online(
    tracks: Track,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
    progress: Progress = ...,
    **reading: Any,
) -> Track: ...


@overload
def track_online(
    tracks: Scene,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
    progress: Progress = ...,
    **reading: Any,
) -> TrackSet: ...


def track_online(
    tracks: Given,
    model: Model | str | Path | None = None,
    *,
    engine: OnlineEngine = "auto",
    lag: float | None = 2.0,
    camera: GroundCamera | None = None,
    progress: Progress = lambda frames: None,
    **reading: Any,
) -> TrackSet | Track:
    """The online estimates of recorded tracks: at each frame, from what came before. NaN while waiting.

    With the model "social" the tracks of a scene are tracked in step, and their groups are found on the way,
    where no track has the input ``group``.

    Parameters
    ----------
    tracks : a `Track`, of which a `Track` comes out, or what `solve` takes, of which a `TrackSet` does
    model, engine, lag : as in `OnlineSmoother`
    camera : camera of the scene; by default that of the `TrackSet`
    progress : called with the numbers of person-frames that are done
    **reading : options of `read`, where ``tracks`` is a path or a table, such as ``fps``

    Raises
    ------
    InputError
        For a file of detections without identities too: who is who is found out from past and future by
        `associate`, and from the past alone by `OnlineTracker`.
    """
    if not isinstance(tracks, Track) or reading:
        scene, chosen = tracks_of(tracks, **{"associate": "never", **reading}), Model.named(model)
        camera = scene.camera if camera is None else camera
        options: Options = {"engine": engine, "lag": lag, "camera": camera}
        if chosen.has_groups and lacks_groups(scene):
            return _in_step(scene, chosen, options, progress)
        return scene.map(lambda one: _by_itself(one, chosen, options, progress))
    return _by_itself(tracks, Model.named(model), {"engine": engine, "lag": lag, "camera": camera}, progress)


def _by_itself(track: Track, model: Model, options: Options, progress: Progress) -> Track:
    smoother = OnlineSmoother(model, **options)
    found = [smoother.update(observation) for observation in observations(track)]
    progress(len(track))
    return as_track(track, found, model)


def _in_step(scene: TrackSet, model: Model, options: Options, progress: Progress) -> TrackSet:
    """Everybody frame by frame, each told of the conversations of the frames before."""
    from graphtrack.interaction.coupled import Conversations

    conversations = Conversations(model)
    people = [OnlineSmoother(model, **options) for _ in scene]
    found: list[list[Estimate]] = [[] for _ in scene]
    seen = [((one.t, place), one) for place, track in enumerate(scene) for one in observations(track)]
    for (_, place), observation in sorted(seen, key=itemgetter(0)):
        track_id = scene.tracks[place].track_id
        estimate = people[place].update(conversations.observed(track_id, observation))
        conversations.estimated(track_id, estimate)
        found[place].append(estimate)
        progress(1)
    return scene.with_tracks(map(partial(as_track, model=model), scene, found))


def warm_up(
    model: Model | str | Path | None = None,
    engine: OnlineEngine | Literal["gtsam"] = "auto",
    *,
    behaviour: bool = False,
    large: bool = False,
) -> None:
    """Compile, or load from disk, what smoothing and tracking with a model and an engine will call.

    Whoever does not do so waits at the first call: half a second for loading or, once on a machine, about
    half a minute for compiling. Then the log ("graphtrack") says so before and after, as a warning, which
    Python shows where logging is not set up.

    Parameters
    ----------
    model, engine : as in `solve` and `OnlineSmoother`
    behaviour : whether what groups, attention and forecasts call is wanted, too
    large : whether what solves many tracks in lanes is wanted, too, where the model has it: work of
        `engine.LARGE` person-frames and more calls that
    """
    if behaviour:
        from graphtrack.behaviour.warm import FORECASTS, ONLINE, forecast_rehearsal, online_rehearsal

        make_ready(f"{ONLINE}, {FORECASTS}", online_rehearsal(), forecast_rehearsal())
    make_all_ready(Model.named(model), engine, large=large)
