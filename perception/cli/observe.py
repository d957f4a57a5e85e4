"""`perception observe`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import input_warnings_as_notes
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted
from perception.cli.adapt import adapt_models, check_adapt
from perception.cli.options import (
    PRINTED,
    Boxes,
    CameraOptions,
    FirstFrame,
    MotionOptions,
    Reconnect,
    Render,
    Reports,
    VideoOrLive,
    check_output_paths,
    damage_note,
    in_time,
    notes_on_frames,
    rate_note,
    read_given_boxes,
    report_camera,
    report_skipped,
    report_written,
    stamp_of,
    stamp_of_camera,
)
from perception.cli.searching import (
    NetworkOptions,
    OwnNetworks,
    PeopleSearch,
    ground_search,
    look_at_people,
    search_journals,
)
from perception.storage import key_of

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.geometry.poses import PosePath
    from perception.detection.boxes import FrameDetections, PersonBox
    from perception.detection.ground_search import GroundSearch
    from perception.detection.yolo import YoloNetwork
    from perception.ground.views import Ground, MovingCamera
    from perception.images.frames import FrameSource
    from perception.images.live import LiveFrames, LiveSource
    from perception.images.pixels import Image
    from perception.observation.live import LiveObserver
    from perception.observation.pipeline import FrameObservation, Models
    from perception.observation.tables import Observations, ObservedTracks


@dataclass(frozen=True)
class ModelOptions:
    """Options of the models of bodies and heads.

    Models of bodies and heads
    --------------------------
    head_pose : deep_belief, templates or exemplars.
    head_pose_model : A model of your own (.npz).
    body_pose_model : A model of your own (.npz).
    head_localiser_model : A model of your own (.npz).
    camera_models : The camera's own models (.npz, from `perception adapt`).
    adapt : Fit the camera's own models first, as `perception adapt` does.
    """

    head_pose: str = "deep_belief"
    head_pose_model: options.InputFile | None = None
    body_pose_model: options.InputFile | None = None
    head_localiser_model: options.InputFile | None = None
    camera_models: Annotated[Path | None, typer.Option("--models", exists=True, dir_okay=False)] = None
    adapt: bool = False

    @property
    def parts(self) -> tuple[Path | None, ...]:
        """Return the files of models for one part each."""
        return self.head_pose_model, self.body_pose_model, self.head_localiser_model

    @property
    def files(self) -> dict[str, Path | None]:
        """Return the files to read, by option name."""
        names = ("--head-pose-model", "--body-pose-model", "--head-localiser-model", "--models")
        return dict(zip(names, (*self.parts, self.camera_models), strict=True))

    def check(self, keypoints: Path | None) -> None:
        """Refuse two models of the same part."""
        from perception.models import HEAD_POSE

        if self.head_pose not in HEAD_POSE:
            raise InputError(f"--head-pose {self.head_pose}", " or ".join(HEAD_POSE))
        has_parts = any(path is not None for path in self.parts)
        if self.camera_models is not None and has_parts:
            raise InputError("--models with a model for one of its parts", "one of them")
        if keypoints is not None and (has_parts or self.camera_models is not None):
            raise InputError("--keypoints with a model for body or head", "one of them")

    def load(self, *, appearance: bool, has_keypoints: bool) -> Models:
        """The models."""
        from perception.adaptation.models import CameraModels
        from perception.models import load_classifier, load_head_localiser, load_keypoint_pose
        from perception.observation.pipeline import Models

        return Models(
            load_head_localiser(self.head_localiser_model),
            load_classifier("body_pose", self.body_pose_model),
            load_classifier(self.head_pose, self.head_pose_model),
            appearance=appearance,
            of_camera=None if self.camera_models is None else CameraModels.load(self.camera_models),
            of_keypoints=load_keypoint_pose() if has_keypoints else None,
        )


def observe(
    source: VideoOrLive,
    output: options.OutputPath,
    camera: CameraOptions,
    motion: MotionOptions,
    network: NetworkOptions,
    model: ModelOptions,
    boxes: Boxes = None,
    boxes_first_frame: FirstFrame = None,
    write_boxes_to: Annotated[Path | None, typer.Option("--write-boxes")] = None,
    render: Render = None,
    causal: Annotated[bool, typer.Option("--causal")] = False,
    appearance: bool | None = None,
    reconnect: Reconnect = 60.0,
) -> None:
    """Detect people and estimate their positions and body and head orientation, frame by frame.

    Boxes without identities, such as detections, give rows with id -1: `graphtrack smooth` associates them
    to tracks.

    An interrupted run continues when it is called again with the same options. A live source needs -o -.

    Parameters
    ----------
    output : File to write: .csv, .csv.gz, .parquet or .ndjson; - for NDJSON rows on standard output, frame by
        frame.
    write_boxes_to : Write the detected boxes here, as MOT text, whose frames count from 1.
    causal : Choose heads and detect people from past frames only, as with -o -, not from the whole recording.
    appearance : Write appearance descriptors (appearance_0 ...), which distinguish people; on for boxes
        without identities, else off.
    """
    from perception.images.live import LiveSource

    job = ObserveJob(
        LiveSource.of(source) or Path(source),
        output,
        camera,
        motion,
        network,
        model,
        boxes=boxes,
        boxes_first_frame=boxes_first_frame,
        write_boxes_to=write_boxes_to,
        render=render,
        causal=causal,
        appearance=appearance,
        reports=PRINTED,
        reconnect=reconnect,
    )
    with input_warnings_as_notes():
        if job.is_streamed:
            job.stream()
        else:
            job.run()


@dataclass(frozen=True, eq=False)
class _Opened:
    """A recording with what its options name, opened and checked."""

    frames: FrameSource | LiveFrames
    networks: OwnNetworks
    people: list[PersonBox] | None  # given boxes
    identified: bool  # whether these have identities
    models: Models
    moving: MovingCamera | PosePath | None  # None: still, or followed
    refused: dict[str, None]  # reasons; undecodable frames may be reported twice

    @property
    def recording(self) -> FrameSource:
        """Return the frames, which are not live."""
        from perception.images.frames import FrameSource

        assert isinstance(self.frames, FrameSource)
        return self.frames


@dataclass(frozen=True, eq=False)
class ObserveJob:
    """A call of `observe`, from the shell or from Python; ``output`` None: no file is written."""

    source: Path | LiveSource
    output: Path | None
    camera: CameraOptions
    motion: MotionOptions
    network: NetworkOptions
    model: ModelOptions
    _: KW_ONLY
    boxes: Path | None
    boxes_first_frame: int | None
    write_boxes_to: Path | None
    render: Path | None
    causal: bool
    appearance: bool | None
    reports: Reports
    reconnect: float = 60.0

    @property
    def is_streamed(self) -> bool:
        """Return True if rows go to standard output."""
        return str(self.output) == "-"

    def _open(self, unfinished: ExitStack) -> _Opened:
        """Open the recording and what the options name; options that exclude each other are refused.

        A connection to a live source ends with the context ``unfinished``.
        """
        from graphtrack.io.read_write import check_table_name
        from perception.images.frames import FrameSource
        from perception.images.live import LiveFrames

        camera, network, model, boxes = self.camera, self.network, self.model, self.boxes
        model.check(network.keypoints)
        self.motion.check(camera, streamed=self.is_streamed, adapt=model.adapt)
        if boxes is not None:
            detecting = {"--detector": network.detector, "--write-boxes": self.write_boxes_to}
            options.refuse(detecting, "with --boxes", "one of them: given boxes are not detected")
        if model.adapt:
            given_models = (*model.parts, model.camera_models, network.keypoints)
            check_adapt(self.is_streamed, camera.given, given_models)
        written = {"--write-boxes": self.write_boxes_to, "--render": self.render}
        if self.is_streamed:
            options.refuse(written, "with -o -", "a file as the output: rows are written frame by frame")
        output = None if self.is_streamed else self.output
        outputs: dict[str, Path | Sequence[Path] | None] = {
            "--output": output,
            "--write-boxes": self.write_boxes_to,
        }
        if output is not None:
            outputs["the journals of --output"] = [*search_journals(output), *_output_paths(output)]
        inputs = {
            "--boxes": boxes,
            **camera.files,
            **self.motion.files,
            **model.files,
            **network.files,
        }
        if isinstance(self.source, Path):
            check_output_paths(outputs, self.render, self.source, inputs, table=output)
            frames: FrameSource | LiveFrames = FrameSource.open(self.source)
        else:
            self._check_live(self.source)
            live = LiveFrames(self.source, reconnect=self.reconnect, report=self.reports.emit)
            frames = unfinished.enter_context(live)
        refused: dict[str, None] = {}
        moving = self._moving(frames)
        networks = network.load(frames)
        first, note = self.boxes_first_frame, self.reports
        people = read_given_boxes(boxes, frames, first, refused.setdefault, note)
        identified = people is not None and (not people or people[0].identified)
        if output is not None and not identified:
            check_table_name(output)
        with_appearance = not identified if self.appearance is None else self.appearance
        models = model.load(appearance=with_appearance, has_keypoints=networks.has_keypoints)
        ground = camera.on_ground(lambda line: self.reports.emit(f"  note: {line}"))
        models = models.seeing(ground, frames.size)
        if self.motion.follow_camera and models.view is not None:
            found = "--follow-camera with a view in which people lean in the image"
            raise InputError(found, "a view in which they are upright")
        return _Opened(frames, networks, people, identified, models, moving, refused)

    def _check_live(self, source: LiveSource) -> None:
        """Refuse what needs a recording."""
        if not self.is_streamed:
            expected = "-o - for rows as they come, or perception report --live"
            raise InputError(f"{source.name} with -o {self.output}", expected)
        of_files = self.network.keypoints if self.network.reads_keypoints else None
        given = {"--boxes": self.boxes, "--keypoints": of_files, "--homographies": self.motion.homographies}
        options.refuse(given, f"with {source.name}", "a recording, whose frames have numbers")

    def _moving(self, frames: FrameSource | LiveFrames) -> MovingCamera | PosePath | None:
        """Read the homographies or poses of a camera that moves."""
        from graphtrack.geometry.camera import GroundCamera
        from graphtrack.io.cameras import read_homographies
        from perception.ground.views import NO_HOMOGRAPHY, MovingCamera, View, path_of_camera

        motion = self.motion
        if motion.poses is not None:
            path, notes = path_of_camera(motion.poses, motion.pose_axes, self.camera.clock(frames).rate)
            for note in notes:
                self.reports.emit(f"  note: {note}")
            return path
        if motion.homographies is None:
            return None
        homographies = read_homographies(motion.homographies, frames.first)
        views = {n: View(GroundCamera.from_homography(one)) for n, one in homographies.items()}
        return MovingCamera(views, NO_HOMOGRAPHY)

    @property
    def searched_camera(self) -> GroundCamera | None:
        """Return the camera by whose view people are searched for; None for a view that changes."""
        return self.camera.on_ground() if self.motion.view_is_constant else None

    def stream(self) -> None:
        """Write the rows of each frame to standard output."""
        from graphtrack.geometry.poses import PosePath
        from perception.ground.camera_motion import CameraFollower
        from perception.ground.views import DECLARED
        from perception.images.live import LiveFrames
        from perception.observation.live import LiveObserver

        with ExitStack() as unfinished:
            opened = self._open(unfinished)
            camera, moving, clock = self.camera.on_ground(), opened.moving, self.camera.clock(opened.frames)
            assert not isinstance(moving, PosePath)  # refused
            observer = LiveObserver(
                opened.models,
                camera if moving is None else moving,
                clock,
                identified=opened.identified,
                follower=CameraFollower(camera) if self.motion.follow_camera else None,
            )
            view, moves = self.searched_camera, self.motion.moves
            _stream(
                opened.frames, opened.people, view, observer, opened.refused, opened.networks, moves=moves
            )
            notes = damage_note(opened.frames)
            if not isinstance(opened.frames, LiveFrames):
                notes += rate_note(opened.frames, clock, self.camera.fps)
            if self.motion.follow_camera:
                notes.append(DECLARED)
            for line in notes:
                PRINTED.emit(f"  note: {line}")

    def run(self) -> Observations:
        """Return the observations, and write them to the output."""
        with TemporaryDirectory() as folder, ExitStack() as unfinished:
            opened = self._open(unfinished)
            place = Path(folder) / "observations" if self.output is None else self.output
            return _observed(self, opened, place)


def _output_paths(output: Path) -> list[Path]:
    """Return the journals of keypoints and frames, and the file of the camera's models, of a run."""
    return [output.with_name(f"{output.name}.{name}") for name in ("keypoints", "journal", "camera.npz")]


def _observed(job: ObserveJob, opened: _Opened, place: Path) -> Observations:
    """Detect and observe people, and write the table, if asked for; journals are kept next to ``place``."""
    from graphtrack.io.read_write import write, write_table
    from graphtrack.tracks.track import ReadSummary, to_columns
    from perception.detection.boxes import write_boxes
    from perception.images.encoding import is_video
    from perception.observation.journal import FrameJournal, while_unfinished
    from perception.observation.pipeline import FrameObservation
    from perception.observation.tables import Observations, cut_note, to_detections, to_tracks

    people, models, networks = opened.people, opened.models, opened.networks
    frames = opened.recording
    identified, refused, reports = opened.identified, opened.refused, job.reports
    output, render, causal, chosen = job.output, job.render, job.causal, job.model
    refuse, given = refused.setdefault, people is not None
    camera, clock = job.camera.on_ground(), job.camera.clock(frames)
    _, frames_place, models_place = _output_paths(place)
    one_size = job.motion.follow_camera or (render is not None and is_video(render))
    known = () if people is None and networks.known is not None else people
    notes = notes_on_frames(frames, clock, known, reports, fps=job.camera.fps, moves=job.motion.moves)
    with ExitStack() as unfinished:
        asked, view = (networks.asked,), job.searched_camera
        alone = causal or job.motion.moves  # a background moves
        search = PeopleSearch(frames, view, clock, place, asked, alone, one_size, networks.detector, reports)
        people, searched = unfinished.enter_context(search.with_keypoints(networks, people, refuse))
        notes += networks.notes()
        if job.write_boxes_to is not None:
            write_boxes(people, job.write_boxes_to, first=frames.first)
        own: list[object] = [stamp_of(path) for path in (*chosen.parts, chosen.camera_models)]
        if chosen.adapt and camera is not None:
            unfinished.enter_context(while_unfinished(models_place))
            own = [key_of(frames.stamp(), clock, people, stamp_of_camera(camera))]
            fitted, _ = adapt_models(
                models_place, str(own[0]), frames, people, camera, clock, refuse, reports=reports
            )
            models = replace(models, of_camera=fitted).seeing(camera, frames.size)
        looked = time.perf_counter()
        leaning = None if models.view is None else stamp_of_camera(camera)
        asked_of = (chosen.head_pose, own, people, models.appearance, networks.has_keypoints, leaning)
        key = key_of(frames.stamp(), *asked_of)
        journal = unfinished.enter_context(FrameJournal(frames_place, key, FrameObservation))
        # Frames without detections need no second pass.
        empty = frozenset() if given else searched - {item.frame for item in people}
        count = look_at_people(
            frames, people, models, journal, refuse, empty, one_size=one_size, reports=reports
        )
        seconds = time.perf_counter() - looked
        ground, of_camera = _ground(job, opened, people, journal)
        notes += [*of_camera, *cut_note(journal), *damage_note(frames)]
        frames_observed = journal, models.head_classes, ground, clock
        drawn = identified or render is not None
        observed = to_tracks(*frames_observed, causal=causal) if drawn else None
        if not identified:
            table = to_detections(*frames_observed, causal=causal)
            if output is not None:
                write_table(table.columns, output)
            columns, left_out, summary = table.columns, table.refused, counted(len(table.number), "detection")
        if observed is not None and render is not None:
            _render(frames, observed, journal, ground, render, clock.rate, reports)
        if observed is not None and identified:
            tracks = observed.tracks
            if output is not None:
                write(tracks, output)
            columns, left_out = to_columns(tracks), tracks.summary.refused
            summary = f"{counted(tracks.n_frames, 'person-frame')} in {counted(len(tracks), 'track')}"
    report_skipped(refused, reports)
    for reason, times in left_out.items():
        reports.emit(f"  refused {times}: {reason}")
    report_camera(ground, reports)
    for note in notes:
        reports.emit(f"  note: {note}")
    reports.emit(f"observed {summary}; {in_time(count, seconds)}")
    report_written((output, render), reports)
    rows = len(columns["track_id"])
    beyond = sum(left_out.values())
    return Observations(columns, ReadSummary("video", rows + beyond, left_out, (*refused, *notes)))


def _ground(
    job: ObserveJob, opened: _Opened, people: list[PersonBox], observed: Mapping[int, FrameObservation]
) -> tuple[Ground | None, list[str]]:
    """Return the ground as the camera sees it, still or moving, and notes; None: no camera is known."""
    from graphtrack.geometry.poses import PosePath
    from perception.ground.camera_motion import image_motions
    from perception.ground.views import DECLARED, carried_views, followed_views
    from perception.observation.tables import scaled_camera

    frames, camera, motion, moving = opened.recording, job.camera.on_ground(), job.motion, opened.moving
    if isinstance(moving, PosePath):
        assert camera is not None
        numbers = [number for number, known in observed.items() if known.people]
        views = carried_views(camera, moving, numbers, job.camera.clock(frames), motion.video_start or 0.0)
        return views, [] if moving.is_exact else [DECLARED]
    if not motion.follow_camera:
        return camera if moving is None else moving, []
    reference = scaled_camera(observed, causal=job.causal) if camera is None else camera
    with frames.reported(
        lambda number: True, frames.count, job.reports.progress, unit="frames followed", one_size=True
    ) as decoded:
        refuse = opened.refused.setdefault
        motions = image_motions(decoded, people, camera, refuse, motion.reference_frame)
    scaled = ["no camera is known: positions are pixels of the reference frame times a scale"]
    return followed_views(reference, motions), [DECLARED, *(scaled if camera is None else [])]


def _stream(
    frames: FrameSource | LiveFrames,
    boxes: list[PersonBox] | None,
    camera: GroundCamera | None,
    observer: LiveObserver,
    refused: dict[str, None],
    networks: OwnNetworks,
    *,
    moves: bool,
) -> None:
    """Write the rows of each frame as soon as it is observed; report skipped input at the end.

    Parameters
    ----------
    camera : as `ObserveJob.searched_camera`
    moves : whether the camera is known to move
    """
    from graphtrack.streaming.session import give
    from perception.detection.boxes import boxes_by_frame, boxes_of, with_keypoints
    from perception.detection.hog import PeopleDetector
    from perception.detection.rescoring import PersonProbability
    from perception.ground.inspection import FrameInspection
    from perception.images.frames import seconds

    given = boxes_by_frame(boxes or ())
    detector: YoloNetwork | PeopleDetector | None = networks.detector
    if boxes is None and camera is None:
        detector = detector or PeopleDetector()
    probability = PersonProbability.of_package(foreground=False)
    search: GroundSearch | None = None

    def detected(image: Image) -> FrameDetections:
        nonlocal search
        if detector is not None:
            return detector.detect(image)
        assert camera is not None
        search = search or ground_search(camera, image)
        return probability.detections(search.candidates(image, None))

    def people_in(number: int, image: Image) -> list[PersonBox]:
        if boxes is None and networks.makes_boxes:
            return boxes_of({number: networks.look(number, image, ())})
        people = given.get(number, []) if boxes is not None else boxes_of({number: detected(image)})
        if not networks.has_keypoints:
            return people
        return with_keypoints(people, {number: networks.look(number, image, people)})

    inspection = FrameInspection()
    for frame in frames:
        if frame.image is None:
            refused.setdefault(frame.reason)
            continue
        people = people_in(frame.number, frame.image)
        inspection.add(frame.number, frame.image, float(seconds(frame.number, observer.clock)), people)
        for row in observer.rows(frame.image, frame.number, people, refused.setdefault):
            give(row)
    report_skipped(refused)
    report_camera(observer.ground, PRINTED)
    for line in (*inspection.notes(moves=moves), *networks.notes()):
        PRINTED.emit(f"  note: {line}")


def _render(
    frames: FrameSource,
    observed: ObservedTracks,
    frames_observed: Mapping[int, FrameObservation],
    ground: Ground | None,
    path: Path,
    fps: float,
    reports: Reports,
) -> None:
    """Decode the frames again, now that all tracks are known, and draw the observations."""
    from perception.drawing.people import draw_people, people_by_frame
    from perception.ground.views import view_in
    from perception.images.encoding import pictures

    people, ground = people_by_frame(observed, frames_observed), ground or observed.tracks.camera
    assert ground is not None
    view = next(one for number in people if (one := view_in(ground, number)) is not None)
    every = frames.reported(lambda number: True, frames.count, reports.progress, unit="frames drawn")
    with pictures(path, fps) as write_picture, every as decoded:
        for frame in decoded:
            if frame.image is not None:
                view = view_in(ground, frame.number) or view  # without a view nobody is drawn
                of_frame = people.get(frame.number, ())
                write_picture(
                    frame.number, draw_people(frame.image, f"frame {frame.number}", of_frame, view.camera)
                )
