"""`perception report`."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted
from perception.cli.adapt import PersonHeight, adapt_models
from perception.cli.observe import ModelOptions
from perception.cli.options import (
    PRINTED,
    Boxes,
    CameraOptions,
    FirstFrame,
    Reconnect,
    Reports,
    VideoOrLive,
    damage_note,
    notes_on_frames,
    read_given_boxes,
    skipped,
    stamp_of,
    stamp_of_camera,
)
from perception.cli.searching import NetworkOptions, OwnNetworks, PeopleSearch, look_at_people

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.tracks.track import TrackSet
    from perception.detection.boxes import PersonBox
    from perception.images.frames import Clock, FrameSource
    from perception.report_folder import ReportFolder

_STAGES = 7

UNADAPTED = (
    "directions are of the package's models, which learned from rendered people and are not adapted to this "
    "camera: they can be wrong for long, front and back swapped; --keypoints of a pose network are better"
)
"""What is assumed where directions are of the package's models alone."""


def report(
    source: VideoOrLive,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER")],
    camera: CameraOptions,
    network: NetworkOptions,
    showing: options.Showing,
    boxes: Boxes = None,
    boxes_first_frame: FirstFrame = None,
    adapt: Annotated[bool, typer.Option("--adapt/--no-adapt")] = True,
    method: Literal["smoother", "ffbs", "particle", "chain", "isam2", "fixed-lag"] = "smoother",
    person_height: PersonHeight = 1.7,
    seed: options.Seed = 0,
    figures: Annotated[bool, typer.Option("--figures")] = False,
    view: bool = False,
    live: Annotated[bool, typer.Option("--live")] = False,
    record_seconds: Annotated[float | None, typer.Option(min=0.1)] = None,
    reconnect: Reconnect = 60.0,
) -> None:
    """Detect, track and smooth people in one call: a table, an annotated video and a page.

    Without a camera its view is estimated from the boxes, as in `perception calibrate`.

    An interrupted run, or one with changed options, repeats only the stages that are out of date.

    Parameters
    ----------
    output : Folder to write or to continue.
    adapt : Fit the camera's own models of body and head first.
    method : smoother: the graph, offline. particle: the joint particle filter, online; ffbs: the same,
        offline. chain, isam2, fixed-lag: the graph, online.
    figures : Write the figures of the page, and of up to 12 people, as SVG and PDF into its folder figures.
    view : Show the result in Rerun.
    live : Record a live source into the folder first (recording.mkv), until Ctrl-C or its end.
    record_seconds : With --live: length of the recording.
    """
    if view:
        showing.target()
    elif showing.save is not None or showing.connect is not None:
        raise InputError("--save" if showing.connect is None else "--connect", "--view with it")
    recording = Path(source) if not live else record_live(source, output, record_seconds, reconnect, PRINTED)
    if not live and record_seconds is not None:
        raise InputError("--record-seconds without --live", "both, or neither")
    run = report_folder(
        recording,
        output,
        camera,
        network,
        boxes=boxes,
        boxes_first_frame=boxes_first_frame,
        adapt=adapt,
        method=method,
        person_height=person_height,
        seed=seed,
        figures=figures,
        other_output=showing.save,
        reports=PRINTED,
    )
    if view:
        run.view(showing)


def record_live(source: str, output: Path, seconds: float | None, reconnect: float, reports: Reports) -> Path:
    """Record a live source into the folder of a new report; return the recording.

    Raises
    ------
    InputError
        If it is no live source, gives no frame, or the folder has a recording.
    """
    from perception.images.live import LiveFrames, LiveSource, record
    from perception.report_folder import RECORDING, ReportFolder

    address = LiveSource.of(source)
    if address is None:
        expected = "a webcam (0), an address such as rtsp://..., a FIFO, or -"
        raise InputError(f"--live with {source}", expected)
    folder = ReportFolder(output, _STAGES, reports.emit)
    recording = output / RECORDING
    if recording.exists():
        expected = f"another folder, or `perception report {recording} -o {output}` to go on with it"
        raise InputError("a folder with a recording", expected, path=output)
    with LiveFrames(address, reconnect=reconnect, report=reports.emit) as frames:
        is_new = not output.exists()
        folder.open()
        reports.emit(f"recording {address.name}" + ("" if seconds else "; Ctrl-C ends it"))
        try:
            count = record(frames, recording, seconds)
        except InputError:
            if is_new and not frames.received:
                shutil.rmtree(output)
            raise
        reports.emit(f"recorded {counted(count, 'frame')}: {frames.state()}")
    return recording


def report_folder(
    source: Path,
    output: Path,
    camera: CameraOptions,
    network: NetworkOptions,
    *,
    boxes: Path | None,
    boxes_first_frame: int | None,
    adapt: bool,
    method: str,
    person_height: float,
    seed: int,
    figures: bool,
    reports: Reports,
    other_output: Path | None = None,
) -> _Run:
    """Write or continue the folder of a report; see `report`."""
    from graphtrack.io.atomic import check_distinct
    from perception.adaptation.labels import check_camera
    from perception.images.frames import FrameSource
    from perception.report_folder import FILES, STAGES, ReportFolder, check_folder

    check_folder(output)
    inputs = {
        "the input": FrameSource.files(source),
        "--boxes": boxes,
        **camera.files,
        **network.files,
    }
    if boxes is not None:
        detecting = {"--detector": network.detector}
        options.refuse(detecting, "with --boxes", "one of them: given boxes are not detected")
    written = [output / name for name in (*FILES.values(), STAGES)]
    check_distinct({"--output": written, "--save": other_output}, inputs, to_make=[output])
    frames = FrameSource.open(source)
    fitted: list[str] = []
    known = camera.on_ground(fitted.append)
    if known is not None:
        check_camera(known, frames.size())
    networks = network.load(frames)
    refused: dict[str, None] = {}
    given = read_given_boxes(boxes, frames, boxes_first_frame, refused.setdefault, reports)
    folder = ReportFolder(output, _STAGES, reports.emit)
    folder.open()
    run = _Run(folder, frames, camera.clock(frames), known, networks, person_height, seed, reports)
    run.assumed.append(_of_rate(frames, run.clock, camera.fps))
    points = network.files["--keypoints"]
    run.find_people(boxes, given, list(refused), points if isinstance(points, list) else [points])
    run.find_ground(camera.given, fitted)
    run.adapt_models(adapt)
    run.observe()
    run.estimate(method)
    run.draw()
    run.write_page(source.name, figures)
    for line in run.assumed:
        reports.emit(f"  note: {line}")
    names = ", ".join(name for name in FILES.values() if (output / name).is_file())
    reports.emit(f"wrote {output}: {names}")
    return run


def _of_rate(frames: FrameSource, clock: Clock, fps: float | None) -> str:
    source = (
        "as given"
        if fps
        else "from the video"
        if frames.fps
        else "assumed: neither the video nor --fps gives it"
    )
    if clock.stamps is not None:
        source = "on average; times are the video's time stamps"
    return f"{counted(frames.count, 'frame')}, {clock.rate:g} a second ({source})"


@dataclass
class _Run:
    """Run of the stages; results of completed stages are read from their files."""

    folder: ReportFolder
    frames: FrameSource
    clock: Clock
    known: GroundCamera | None
    networks: OwnNetworks
    person_height: float
    seed: int
    reports: Reports
    people: list[PersonBox] = field(default_factory=list)
    camera: GroundCamera | None = None
    to_scale: bool = False
    assumed: list[str] = field(default_factory=list)

    def find_people(
        self,
        boxes: Path | None,
        given: list[PersonBox] | None,
        left_out: list[str],
        keypoints: Sequence[Path | None],
    ) -> None:
        """Stage 1: boxes, detected or ``given`` by a file, without the rows ``left_out``; and keypoints."""
        from perception.detection.boxes import read_boxes, write_boxes
        from perception.detection.keypoint_files import keypoints_by_box, write_keypoints

        detected, points = self.folder.file("boxes"), self.folder.file("keypoints")
        networks = self.networks

        def work(key: str) -> list[str]:
            known = () if given is None and networks.known is not None else given
            notes = notes_on_frames(self.frames, self.clock, known, self.reports, fps=self.clock.rate)
            for path in (detected, points):
                path.unlink(missing_ok=True)
            refused = dict.fromkeys(left_out)
            asked, own = (networks.asked,), networks.detector
            search = PeopleSearch(
                self.frames, self.known, self.clock, detected, asked, detector=own, reports=self.reports
            )
            with search.with_keypoints(networks, given, refused.setdefault) as (found, _):
                if not found:
                    nobody = "a recording without detections of people"
                    raise InputError(nobody, "people, or their boxes (--boxes)")
                if given is None:
                    write_boxes(found, detected, first=self.frames.first)
                if networks.has_keypoints:
                    write_keypoints(found, points)
            what = (
                f"{len(found)} detected boxes of people"
                if given is None
                else f"{len(given)} boxes of {boxes}"
            )
            if networks.has_keypoints:
                count = sum(item.keypoints is not None for item in found)
                what += f"; keypoints of {count} of them give body and head"
            return [what, *skipped(refused), *notes, *networks.notes(), *damage_note(self.frames)]

        files = [stamp_of(path) for path in keypoints]
        asked = self.frames.stamp(), stamp_of_camera(self.known), self.clock, given, networks.asked, files
        outputs = [*([] if given else ["boxes"]), *(["keypoints"] if networks.has_keypoints else [])]
        self.assumed += self.folder.stage("people", asked, outputs, work)
        self.people = read_boxes(detected) if given is None else given
        if networks.has_keypoints:
            self.people = keypoints_by_box(self.people, points)
        if not self.people:
            raise InputError("no boxes of people", "at least one person", path=boxes)
        if not self.people[0].identified:
            self.assumed.append(
                "the boxes have no identities: they are associated to tracks, with possible errors"
            )

    def find_ground(self, given: Path | None, fitted: Sequence[str]) -> None:
        """Stage 2: the camera, given (with notes on how it was ``fitted``) or estimated."""
        from graphtrack.io.cameras import read_calibration
        from perception.ground.calibration import FoundScale, found_view
        from perception.ground.scale import ViewScale

        place = self.folder.file("calibration")

        def work(key: str) -> list[str]:
            place.unlink(missing_ok=True)
            if self.known is not None:
                return [f"the camera is that of {given}", *fitted]
            rng = np.random.default_rng(self.seed)
            found = found_view(self.people, self.frames.size(), rng, self.person_height)
            if isinstance(found, FoundScale):
                return [
                    f"no camera is known ({found.reason}), scale only: positions are pixels times a scale at "
                    f"which the median box is {self.person_height:g} m high, {found.scale.described()}; "
                    "directions are approximate"
                ]
            found.write(place)
            return [f"the camera is estimated, {found.described()}", *found.notes]

        asked = (stamp_of_camera(self.known), str(given), self.person_height, self.seed)
        self.assumed += self.folder.stage("ground", asked, (), work)
        if self.known is not None:
            self.camera = self.known
        elif place.is_file():
            self.camera = read_calibration(place)
        else:
            self.to_scale = True
            self.camera = ViewScale.of([item.box for item in self.people], self.person_height).camera

    def adapt_models(self, adapt: bool) -> None:
        """Stage 3: the camera's own models."""
        place = self.folder.file("models")

        def work(key: str) -> list[str]:
            assert self.camera is not None
            refused: dict[str, None] = {}
            summary = "no models of the camera's own are fitted, the package's models are used"
            if self.networks.has_keypoints:
                place.unlink(missing_ok=True)
                return []
            if not adapt or self.to_scale:
                place.unlink(missing_ok=True)
                return [f"{summary}: {'as asked' if not adapt else 'no ground is known'}"]
            refuse, seed = refused.setdefault, self.seed
            models, summary = adapt_models(
                place,
                key,
                self.frames,
                self.people,
                self.camera,
                self.clock,
                refuse,
                seed=seed,
                reports=self.reports,
            )
            if models is None:
                place.unlink(missing_ok=True)
            return [summary]

        self.assumed += self.folder.stage("models", (adapt, self.clock, self.seed), (), work)

    def observe(self) -> None:
        """Stage 4: observations of all people, and data association."""
        from graphtrack.io import write
        from perception.observation.journal import FrameJournal
        from perception.observation.pipeline import FrameObservation
        from perception.observation.tables import associated, cut_note, numbered, to_detections, to_tracks

        place, own_models = self.folder.file("observations"), self.folder.file("models")
        identified = self.people[0].identified

        def work(key: str) -> list[str]:
            refused: dict[str, None] = {}
            chosen = ModelOptions(camera_models=own_models if own_models.is_file() else None)
            models = chosen.load(appearance=not identified, has_keypoints=self.networks.has_keypoints)
            models = models.seeing(self.camera, self.frames.size)
            with FrameJournal(place.with_name(f"{place.name}.journal"), key, FrameObservation) as journal:
                look_at_people(
                    self.frames, self.people, models, journal, refused.setdefault, reports=self.reports
                )
                inputs = journal, models.head_classes, self.camera, self.clock
                if identified:
                    observed = to_tracks(*inputs).tracks
                    beyond = observed.summary.refused
                    tracks = numbered(observed, self.people)
                else:
                    found = to_detections(*inputs)
                    beyond = found.refused
                    tracks = associated(found.columns, found.number, self.people)
                write(tracks, place)
                cut = cut_note(journal)
            left_out = [f"refused {n}: {why}" for why, n in beyond.items()]
            if not (self.networks.has_keypoints or own_models.is_file()):
                left_out.append(UNADAPTED)
            return [*tracks.summary.notes, *cut, *left_out, *skipped(refused)]

        self.assumed += self.folder.stage("observations", self.clock, ("observations",), work)

    def estimate(self, method: str) -> None:
        """Stage 5: position, motion and orientation of all people."""
        from graphtrack.io import write
        from perception.adaptation.models import CameraModels
        from perception.observation.tables import FILTERS, estimated

        def work(key: str) -> list[str]:
            assert self.camera is not None
            observations = self.read("observations")
            own_models = self.folder.file("models")
            own = own_models.is_file() and method not in FILTERS
            adapted = CameraModels.load(own_models).graph if own else lambda model: model
            with self.reports.progress(observations.n_frames, "person-frames") as advance:
                found = estimated(observations, self.camera, method, advance, adapted)
            write(found.tracks, self.folder.file("tracks"))
            self._write_lines("methods", found.methods)
            return found.notes

        self.assumed += self.folder.stage("estimates", method, ("tracks", "methods"), work)

    def draw(self) -> None:
        """Stage 6: the annotated video."""
        from perception.report_folder import shown_by_frame, write_video

        def work(key: str) -> list[str]:
            assert self.camera is not None
            estimates, observations = self.read("tracks"), self.read("observations")
            people = shown_by_frame(estimates, observations, self.people, self.camera)
            with self.frames.reported(
                lambda number: True,
                self.frames.count,
                self.reports.progress,
                unit="frames drawn",
                one_size=True,
            ) as decoded:
                write_video(self.folder.file("video"), decoded, people, self.camera, self.clock)
            return []

        self.folder.stage("video", self.clock, ("video",), work)

    def write_page(self, title: str, figures: bool) -> None:
        """Stage 7: the page, the view from above, and the assumptions."""
        from perception.report_folder import FIGURES, background_of, write_above, write_page

        lines = tuple(self.assumed)

        def work(key: str) -> list[str]:
            estimates, observations = self.read("tracks"), self.read("observations")
            heading = f"People in {title}"
            under = None if self.camera is None else background_of(self.frames, self.camera)
            write_above(self.folder.file("above"), f"{heading}, from above", estimates, observations, under)
            self._write_lines("assumptions", lines)
            video = self.folder.file("video")
            write_page(
                self.folder.file("page"),
                heading,
                estimates,
                observations,
                video,
                lines,
                methods=self.folder.file("methods").read_text("utf-8").splitlines(),
                background=under,
                figures=self.folder.path / FIGURES if figures else None,
            )
            return []

        self.folder.stage("page", (title, lines, figures), ("above", "assumptions", "page"), work)

    def _write_lines(self, name: str, lines: Sequence[str]) -> None:
        from graphtrack.io.atomic import atomic_path

        with atomic_path(self.folder.file(name)) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")

    def view(self, showing: options.Showing) -> None:
        """Show the result in Rerun."""
        from graphtrack.interaction.groups import groups
        from graphtrack.viewer.shown import view
        from perception.report_folder import boxes_shown, shown_by_frame

        assert self.camera is not None
        estimates = self.read("tracks")
        people = shown_by_frame(estimates, self.read("observations"), self.people, self.camera)
        view(
            estimates,
            save=showing.save,
            connect=showing.connect,
            groups=groups(estimates) if len(estimates) > 1 else None,
            video=self.frames.path,
            boxes=boxes_shown(people),
        )
        if showing.save is not None:
            self.reports.emit(f"wrote {showing.save}; to see it: rerun {showing.save}")

    def read(self, name: str) -> TrackSet:
        """Read the tracks of a file of the folder."""
        from graphtrack.io import read_identified

        return read_identified(self.folder.file(name))
