"""What `perception observe` and `perception follow` share: options, checks of places, and what they say."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli.console import console, progress_bar
from graphtrack.cli.options import check_outputs
from graphtrack.display import counted
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.images.frames import Frame, FrameSource

_SHOWN = 5
_FPS = 25.0
FILE = {"exists": True, "dir_okay": False}
"""Of options that name a file to read."""

VideoOrFolder = Annotated[
    Path, typer.Argument(help="A video, or a folder of images.", metavar="VIDEO|FOLDER", exists=True)
]
Boxes = Annotated[
    Path | None,
    typer.Option(
        "--boxes",
        help="MOT text or CAVIAR XML with people's boxes, or a detector's, whose ids are -1; without it "
        "people are detected.",
        **FILE,
    ),
]
Homography = Annotated[
    Path | None,
    typer.Option("--homography", help="File with 3×3 numbers: image → ground in metres.", **FILE),
]
Calibration = Annotated[
    Path | None, typer.Option("--calibration", help="Camera calibration (.ci), of a fisheye too.", **FILE)
]
Fps = Annotated[
    float | None,
    typer.Option("--fps", min=0.1, help=f"Frames a second, if not the video's (else {_FPS:g})."),
]
Render = Annotated[
    Path | None,
    typer.Option("--render", help="Draw it all: a video .mp4 or .avi, or else a folder of images."),
]


def check_places(
    outputs: Mapping[str, Path | Sequence[Path] | None],
    render: Path | None,
    source: Path,
    inputs: Mapping[str, Path | Sequence[Path] | None],
    *,
    table: Path | None = None,
) -> None:
    """Refuse, before the work, what could not be written in the end, as `check_outputs` does.

    Parameters
    ----------
    outputs, inputs, table : as there, besides the two that follow
    render : a video or a folder of images to write
    source : a video or a folder of images to read

    Raises
    ------
    InputError
        As there.
    """
    from perception.images.drawing.output import check_render, is_video
    from perception.images.frames import FrameSource

    if render is not None:
        check_render(render)
    in_folder = render is not None and not is_video(render)
    check_outputs(
        {**outputs, "--render": None if in_folder else render},
        {"the input": FrameSource.files(source), **inputs},
        folders={"--render": render if in_folder else None},
        table=table,
    )


def frame_rate(frames: FrameSource, fps: float | None) -> float:
    """Frames a second: those that are asked for, or else the video's."""
    return fps or frames.fps or _FPS


@contextmanager
def decoded_frames(
    frames: FrameSource,
    wanted: Callable[[int], bool],
    count: int,
    *,
    unit: str = "frames",
    one_size: bool = False,
) -> Iterator[Iterator[Frame]]:
    """The frames whose numbers are wanted, ``count`` of them, with a progress bar.

    Parameters
    ----------
    one_size : whether a frame of another size than the first is an `InputError`
    """
    from perception.images.told import told_frames

    with told_frames(frames, wanted, count, progress_bar, unit=unit, one_size=one_size) as decoded:
        yield decoded


def read_camera(homography: Path | None, calibration: Path | None) -> GroundCamera | None:
    """The camera that the options name; None if they name none.

    Raises
    ------
    InputError
        If both are given, or the file cannot be used.
    """
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.io.cameras import read_calibration, read_homography

    if homography is not None and calibration is not None:
        raise InputError("--homography and --calibration", "one of them")
    if calibration is not None:
        return read_calibration(calibration)
    return None if homography is None else GroundCamera.from_homography(read_homography(homography))


def in_time(count: int, seconds: float) -> str:
    """How long so many frames took."""
    return f"{counted(count, 'frame')} in {seconds:.1f} s ({count / max(seconds, 1e-9):.1f} a second)"


def print_skipped(reasons: Sequence[str]) -> None:
    """Say what was left out: the first few reasons, and how many more there are."""
    for reason in reasons[:_SHOWN]:
        console.print(f"  skipped: {reason}", markup=False)
    if len(reasons) > _SHOWN:
        console.print(f"  skipped: {len(reasons) - _SHOWN} more", markup=False)


def print_camera_note(camera: GroundCamera | None) -> None:
    """Say what positions are if no camera is known."""
    if camera is None:
        console.print("  note: no camera is known: positions are pixels times a scale", markup=False)


def print_written(output: Path, render: Path | None) -> None:
    """Say where everything is."""
    console.print(f"wrote {output}" + ("" if render is None else f" and {render}"), markup=False)
