"""Options shared by commands on video, checks of paths, and common messages."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, progress_bar
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.detection.boxes import PersonBox
    from perception.images.frames import Clock, FrameSource, Progress
    from perception.images.live import LiveFrames


@dataclass(frozen=True)
class Reports:
    """Receivers of the messages and of the progress of a run; by default the log, and nobody."""

    emit: Callable[[str], object] = logging.getLogger("graphtrack").info
    progress: Progress = lambda total, unit: nullcontext(lambda count: None)


PRINTED = Reports(emit, progress_bar)
"""Reports of the commands: messages and progress bars on standard error."""

_SHOWN = 5
_FPS = 25.0

VideoOrFolder = Annotated[
    Path, typer.Argument(help="A video, or a folder of images.", metavar="VIDEO|FOLDER", exists=True)
]
VideoOrLive = Annotated[
    str,
    typer.Argument(
        help="A video, a folder of images, or a live source: a webcam (0, /dev/video0), an address "
        "(rtsp://, http:// ...), a FIFO, or - for standard input.",
        metavar="VIDEO|FOLDER|LIVE",
    ),
]
Reconnect = Annotated[
    float,
    typer.Option(
        help="Seconds for which a lost connection to a live source is tried again; 0: it is the end.",
        min=0.0,
    ),
]
Boxes = Annotated[
    Path | None,
    typer.Option(
        help="People's boxes as MOT text, COCO JSON, CAVIAR XML, a table with named columns or a folder of "
        "YOLO's labels, or of a detector (ids -1); without it people are detected.",
        exists=True,
    ),
]
FirstFrame = Annotated[
    int | None,
    typer.Option(
        "--boxes-first-frame",
        help="Number of the recording's first frame in --boxes: by default 1 in MOT text and YOLO's "
        "labels (0 if they have a frame 0), in other formats the recording's own number.",
    ),
]
Render = Annotated[
    Path | None, typer.Option(help="Draw the result: a video (.mp4, .avi), or a folder of images.")
]


@dataclass(frozen=True)
class CameraOptions:
    """Options of a camera: its view of the ground, and its frame rate.

    Camera
    ------
    homography : File with 3×3 numbers: image → ground in metres.
    point_pairs : File with rows 'u v X Y', X and Y in metres; a homography is fitted (DLT).
    calibration : Camera calibration (.ci), also of a fisheye.
    fps : Frames a second; by default the video's, or 25.
    """

    homography: options.InputFile | None = None
    point_pairs: options.InputFile | None = None
    calibration: options.InputFile | None = None
    fps: Annotated[float | None, typer.Option(min=0.1)] = None

    @property
    def files(self) -> dict[str, Path | None]:
        """Return the files to read, by option name."""
        return {
            "--homography": self.homography,
            "--point-pairs": self.point_pairs,
            "--calibration": self.calibration,
        }

    @property
    def given(self) -> Path | None:
        """Return the file of the camera, if any."""
        return self.homography or self.calibration or self.point_pairs

    def clock(self, frames: FrameSource | LiveFrames) -> Clock:
        """Return the times of frames, from the requested rate or else from the video."""
        from perception.images.frames import Clock

        return Clock(self.fps) if self.fps is not None else frames.clock(frames.fps or _FPS)

    def on_ground(self, note: Callable[[str], object] = lambda line: None) -> GroundCamera | None:
        """Return the camera; None without options. ``note`` receives the error of a fit to point pairs."""
        from graphtrack.io.cameras import known_camera
        from graphtrack.io.options import ReadOptions

        given = {name: path for name, path in self.files.items() if path is not None}
        if len(given) > 1:
            raise InputError(" and ".join(given), "one of them")
        pairs, homography, calibration = self.point_pairs, self.homography, self.calibration
        reading = ReadOptions(point_pairs=pairs, homography=homography, calibration=calibration)
        camera, notes = known_camera(reading, np.empty((0, 2)))
        for line in notes:
            note(line)
        return camera


def notes_on_frames(
    frames: FrameSource,
    clock: Clock,
    people: Iterable[PersonBox] | None,
    reports: Reports,
    *,
    fps: float | None,
    moves: bool = False,
) -> list[str]:
    """Inspect a recording; return notes on an assumed rate, on its pictures, and on a camera that moves.

    Parameters
    ----------
    people : known ones, whose boxes are no background; None: people are searched for
    fps : the requested rate; None: the recording's
    moves : whether the camera is known to move

    Raises
    ------
    InputError
        If the recording shows nothing in which people can be searched for.
    """
    from perception.ground.inspection import inspected

    found = inspected(frames, clock, people or (), reports.progress)
    if people is None and found.nothing_shown:
        expected = "a video that shows something; this one is empty, or decoded wrongly"
        nothing = f"a recording without people: one colour in all {found.count} inspected frames"
        raise InputError(nothing, expected, path=frames.path)
    return [*rate_note(frames, clock, fps), *found.notes(moves=moves)]


def rate_note(frames: FrameSource, clock: Clock, fps: float | None) -> list[str]:
    """Return a note on a rate that is assumed; none if it is requested or known."""
    if fps is not None or frames.fps is not None:
        return []
    what = "a folder of images" if frames.path.is_dir() else "the video"
    return [f"{clock.rate:g} frames a second are assumed: {what} gives no rate (--fps)"]


def damage_note(frames: FrameSource | LiveFrames) -> list[str]:
    """Return a note on frames whose errors the decoder concealed, in the passes so far."""
    if not frames.damaged:
        return []
    return [
        f"{counted(len(frames.damaged), 'frame')} damaged (bit errors), such as frame {min(frames.damaged)}: "
        "the decoder fills in what is missing, there and until the next key frame"
    ]


@dataclass(frozen=True)
class MotionOptions:
    """Options of a camera that moves.

    A camera that moves
    -------------------
    homographies : File with a homography of each frame, image → ground in metres: lines with the frame and
        nine numbers, or with the nine alone, of all frames in order.
    poses : File with the poses of the vehicle or robot that carries the camera, as of graphtrack smooth; the
        camera's --calibration or --homography is then in its frame (x forward, y left).
    pose_axes : Axes of poses in space: robot, x forward and z up; camera, z forward and y down. By default
        camera for KITTI odometry, else robot.
    video_start : Time of the poses at t = 0 of the video, seconds (since 1970, if the poses' times count from
        there); by default 0.
    follow_camera : Follow pan, tilt, zoom and hand-held motion by features of the background; --calibration
        or --homography is the view in the reference frame.
    reference_frame : Number of that frame; by default the first.
    """

    homographies: options.InputFile | None = None
    poses: Annotated[Path | None, typer.Option(metavar="FILE", exists=True)] = None
    pose_axes: Literal["robot", "camera"] | None = None
    video_start: Annotated[float | None, typer.Option(metavar="SECONDS")] = None
    follow_camera: bool = False
    reference_frame: Annotated[int | None, typer.Option(min=0)] = None

    @property
    def files(self) -> dict[str, Path | None]:
        """Return the files to read, by option name."""
        return {"--homographies": self.homographies, "--poses": self.poses}

    @property
    def moves(self) -> bool:
        """Return whether the camera moves."""
        return self.homographies is not None or self.poses is not None or self.follow_camera

    @property
    def view_is_constant(self) -> bool:
        """Return whether the camera's view of the ground around it is constant."""
        return self.homographies is None and not self.follow_camera

    def check(self, camera: CameraOptions, *, streamed: bool, adapt: bool) -> None:
        """Refuse options that exclude each other."""
        given = [
            name
            for name, value in (*self.files.items(), ("--follow-camera", self.follow_camera or None))
            if value is not None
        ]
        if len(given) > 1:
            raise InputError(" and ".join(given), "one of them")
        views = [name for name, path in camera.files.items() if path is not None]
        if self.homographies is not None and views:
            raise InputError(f"{views[0]} with --homographies", "one of them")
        if self.poses is not None and not views:
            expected = "--calibration or --homography too: the camera's view in the frame of the poses"
            raise InputError("--poses without a camera", expected)
        of_poses = {"--pose-axes": self.pose_axes, "--video-start": self.video_start}
        for name, value in of_poses.items():
            if value is not None and self.poses is None:
                raise InputError(f"{name} without --poses", "both, or neither")
        if self.reference_frame is not None and not self.follow_camera:
            raise InputError("--reference-frame without --follow-camera", "both, or neither")
        if streamed and self.poses is not None:
            expected = "a file as the output, or rows with poses in the stream of graphtrack track -"
            raise InputError("--poses with -o -", expected)
        if streamed and self.reference_frame is not None:
            raise InputError("--reference-frame with -o -", "a file as the output")
        if adapt and self.moves:
            raise InputError(f"--adapt with {given[0]}", "one of them: models are fitted to a still camera")


def read_given_boxes(
    boxes: Path | None,
    frames: FrameSource | LiveFrames,
    named: int | None,
    refuse: Callable[[str], object],
    reports: Reports = PRINTED,
) -> list[PersonBox] | None:
    """Read the boxes of a recording, if any, and emit a note on how their frame numbers are matched.

    Parameters
    ----------
    frames : the recording
    named : the same in the file; None: see `read_boxes`
    """
    from perception.detection.boxes import read_boxes

    if boxes is None:
        if named is not None:
            raise InputError("--boxes-first-frame without --boxes", "both, or neither")
        return None
    return read_boxes(
        boxes,
        refuse,
        first=frames.first,
        named=named,
        size=frames.size() if boxes.is_dir() else None,
        note=lambda line: reports.emit(f"  note: {line}"),
    )


def stamp_of(path: Path | None) -> object:
    """Return a key of a file's content: path, size and time."""
    if path is None:
        return None
    state = path.stat()
    return str(path), state.st_size, state.st_mtime_ns


def stamp_of_camera(camera: GroundCamera | None) -> object:
    """Return a key of a camera's parameters."""
    if camera is None:
        return None
    values = (camera.homography, camera.intrinsics, camera.distortion, camera.centre_on_ground)
    return camera.lens, [None if value is None else value.tolist() for value in values]


def check_output_paths(
    outputs: Mapping[str, Path | Sequence[Path] | None],
    render: Path | None,
    source: Path,
    inputs: Mapping[str, Path | Sequence[Path] | None],
    *,
    table: Path | None = None,
) -> None:
    """Refuse paths that cannot be written, before the work starts, as `check_outputs` does.

    Parameters
    ----------
    outputs, inputs, table : as in `check_outputs`
    render : a video or a folder of images to write
    source : a video or a folder of images to read
    """
    from perception.images.encoding import check_render, is_video
    from perception.images.frames import FrameSource

    if render is not None:
        check_render(render)
    in_folder = render is not None and not is_video(render)
    options.check_outputs(
        {**outputs, "--render": None if in_folder else render},
        {"the input": FrameSource.files(source), **inputs},
        folders={"--render": render if in_folder else None},
        table=table,
    )


def in_time(count: int, seconds: float) -> str:
    """Describe the processing time of frames."""
    return f"{counted(count, 'frame')} in {seconds:.1f} s ({count / max(seconds, 1e-9):.1f} a second)"


def skipped(reasons: Iterable[str]) -> list[str]:
    """Return lines on skipped input: the first few reasons, and the number of the rest."""
    every = [f"skipped: {reason}" for reason in reasons]
    more = len(every) - _SHOWN
    return [*every[:_SHOWN], f"skipped: {more} more"] if more > 0 else every


def report_skipped(reasons: Iterable[str], reports: Reports = PRINTED) -> None:
    """Emit skipped input."""
    for line in skipped(reasons):
        reports.emit(f"  {line}")


def report_camera(ground: object | None, reports: Reports) -> None:
    """Emit a note on the unit of positions if no camera is known."""
    if ground is None:
        reports.emit("  note: no camera is known: positions are pixels times a scale")


def report_written(paths: Iterable[Path | None], reports: Reports) -> None:
    """Emit the paths of the outputs."""
    if written := [str(path) for path in paths if path is not None]:
        reports.emit(f"wrote {' and '.join(written)}")
