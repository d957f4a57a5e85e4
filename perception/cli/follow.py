"""`perception follow`."""

from __future__ import annotations

import math
import time
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli.console import console, progress_bar
from graphtrack.cli.options import Seed
from perception.cli.common import (
    Calibration,
    Fps,
    Homography,
    Render,
    VideoOrFolder,
    check_places,
    frame_rate,
    in_time,
    print_camera_note,
    print_skipped,
    print_written,
    read_camera,
)

if TYPE_CHECKING:
    from perception.follow.guidance import GraphGuide
    from perception.images.pixels import Image
    from perception.trackers.tracker import Box, BoxEstimate


def follow(
    source: VideoOrFolder,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .csv.")],
    tracker: Annotated[
        str, typer.Option("--tracker", help="mixed-state, sigma-pi or color.")
    ] = "mixed-state",
    init: Annotated[
        str | None,
        typer.Option(
            "--init",
            help="The target's box in the first frame, in pixels; without it, mixed-state looks for a "
            "head and sigma-pi waits for something that moves.",
            metavar="LEFT,TOP,WIDTH,HEIGHT",
        ),
    ] = None,
    guided: Annotated[
        bool, typer.Option("--guided", help="The graph tells the tracker where to look next.")
    ] = False,
    render: Render = None,
    particles: Annotated[
        int | None, typer.Option("--particles", min=2, help="Number of particles.", show_default=False)
    ] = None,
    seed: Seed = 0,
    homography: Homography = None,
    calibration: Calibration = None,
    foot_at: Annotated[
        float | None,
        typer.Option(
            "--foot-at",
            min=-20.0,
            max=20.0,
            help="Where the foot point is, in box heights below the box's top; by default 1, or 7.3 for the "
            "box of a head before a known camera.",
            show_default=False,
        ),
    ] = None,
    middle_at: Annotated[
        float | None,
        typer.Option(
            "--middle-at",
            min=0.0,
            max=20.0,
            help="For a camera that looks down: metres above the ground of what is in the middle of the box, "
            "in place of a foot point. By default with a fisheye: 1, or 1.6 for the box of a head.",
            show_default=False,
        ),
    ] = None,
    pan_limit: Annotated[
        float | None,
        typer.Option(
            "--pan-limit",
            min=0.0,
            max=180.0,
            help="Degrees: mixed-state leaves out heads that face away from the camera by more; 90 if they "
            "never turn their backs. By default 180, in the paper 90.",
            show_default=False,
        ),
    ] = None,
    colour_rate: Annotated[
        float | None,
        typer.Option(
            "--colour-rate",
            min=0.0,
            max=1.0,
            help="Share of the colours that the tracker color remembers which a frame replaces; 0, the "
            "default: the first box's stay. mixed-state has 0.05.",
            show_default=False,
        ),
    ] = None,
    as_in_the_paper: Annotated[
        bool,
        typer.Option(
            "--as-in-the-paper", help="The tracker as its paper has it, without what was found to be better."
        ),
    ] = False,
    background: Annotated[
        list[Path] | None,
        typer.Option(
            "--background",
            help="Image, or folder of images, of what is never the person (furniture), for sigma-pi; can be "
            "given several times.",
            metavar="IMAGE|FOLDER",
            exists=True,
        ),
    ] = None,
    fps: Fps = None,
    head_pose: Annotated[
        str,
        typer.Option(
            "--head-pose", help="head_p*: frame (what each frame says by itself) or filtered (the tracker's)."
        ),
    ] = "frame",
) -> None:
    """Follow one person or head through a video, and write its boxes as observations for graphtrack."""
    from graphtrack.errors import InputError
    from perception.follow import following
    from perception.images.drawing.estimates import draw
    from perception.images.drawing.output import pictures
    from perception.images.frames import FrameSource
    from perception.trackers.registry import OF_HEADS, make_tracker, parameters_of

    if head_pose not in ("frame", "filtered"):
        raise InputError(f"--head-pose {head_pose}", "frame or filtered")
    if output.suffix.lower() != ".csv":
        raise InputError(f"{output.name}", "a file to write that ends in .csv", path=output)
    cameras = {"--homography": homography, "--calibration": calibration}
    never = [path for given in background or () for path in FrameSource.files(given)]
    check_places({"--output": output}, render, source, {**cameras, **{f"--background {p}": p for p in never}})
    box = None if init is None else following.parse_box(init)
    frames = FrameSource.open(source)
    rate = frame_rate(frames, fps)
    camera = read_camera(homography, calibration)
    parameters = parameters_of(tracker, as_in_the_paper=as_in_the_paper)
    if pan_limit is not None and hasattr(parameters, "pan_limit"):
        parameters = replace(parameters, pan_limit=math.radians(pan_limit))
    if colour_rate is not None:
        if tracker != "color":
            raise InputError(f"--colour-rate with {tracker}", "the tracker color")
        parameters = replace(parameters, rate=colour_rate)
    images = [image for given in background or () for image in following.background_images(given)]
    follower = make_tracker(tracker, particles, seed, parameters, background=images)
    of_heads = tracker in OF_HEADS
    on_ground = following.box_cameras(camera, of_heads=of_heads, foot_at=foot_at, middle_at=middle_at)

    def guide(first: Box) -> GraphGuide:
        from perception.follow.guidance import GraphGuide

        return GraphGuide(on_ground(first), follower.pan_classes, fps=rate)

    refused: list[str] = []
    with (
        progress_bar(frames.count, "frames") as advance,
        nullcontext() if render is None else pictures(render, rate) as write,
    ):
        begun = time.perf_counter()

        def show(number: int, image: Image, estimate: BoxEstimate) -> None:
            if write is not None:
                write(number, draw(image, number, estimate, follower.pan_classes))

        found = following.follow(
            follower,
            frames,
            partial(_start, box, tracker),
            guide=guide if guided else None,
            refuse=refused.append,
            advance=advance,
            show=show,
        )
        seconds = time.perf_counter() - begun
        first = next(item.estimate.box for item in found if item.estimate.found)
        track = following.to_track(
            found, on_ground(first), follower.pan_classes, rate, filtered=head_pose == "filtered"
        )
        following.write_boxes(found, track, output)
    print_skipped(refused)
    for note in following.notes(found, track):
        console.print(f"  note: {note}", markup=False)
    print_camera_note(camera)
    console.print(f"followed {in_time(len(found), seconds)}", markup=False)
    print_written(output, render)


def _start(box: Box | None, tracker: str, image: Image) -> Box | None:
    """The box to begin with; a head is looked for where the tracker needs one, and nothing else."""
    from graphtrack.errors import InputError
    from perception.follow.following import find_head

    if box is not None or tracker == "sigma-pi":
        return box
    if tracker == "mixed-state":
        return find_head(image)
    raise InputError("no target in the first frame", f"--init with its box, for the tracker {tracker}")
