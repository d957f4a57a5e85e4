"""`perception follow`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.errors import InputError
from graphtrack.io.text import parse_number
from perception.cli.options import (
    PRINTED,
    CameraOptions,
    Render,
    Reports,
    VideoOrFolder,
    check_output_paths,
    damage_note,
    in_time,
    rate_note,
    report_camera,
    report_skipped,
    report_written,
)

if TYPE_CHECKING:
    from perception.following.guidance import GraphGuide
    from perception.images.frames import FrameSource
    from perception.images.pixels import Image
    from perception.observation.tables import Observations
    from perception.trackers.tracker import Box, BoxEstimate

_ROUNDING = 1e-6  # seconds


def follow(
    source: VideoOrFolder,
    output: options.OutputPath,
    camera: CameraOptions,
    tracker: str = "mixed-state",
    init: Annotated[str | None, typer.Option(metavar="LEFT,TOP,WIDTH,HEIGHT")] = None,
    start: Annotated[float, typer.Option(min=0.0, metavar="SECONDS")] = 0.0,
    check: Annotated[bool, typer.Option("--check/--no-check")] = True,
    guided: bool = False,
    render: Render = None,
    particles: Annotated[int | None, typer.Option(min=2)] = None,
    seed: options.Seed = 0,
    foot_at: Annotated[float | None, typer.Option(min=-20.0, max=20.0)] = None,
    middle_at: Annotated[float | None, typer.Option(min=0.0, max=20.0)] = None,
    pan_limit: Annotated[float | None, typer.Option(min=0.0, max=180.0)] = None,
    as_in_the_paper: bool = False,
    background: Annotated[list[Path] | None, typer.Option(metavar="IMAGE|FOLDER", exists=True)] = None,
) -> None:
    """Track one person or head through a video, and write its boxes as observations for graphtrack.

    Parameters
    ----------
    output : File to write: .csv.
    tracker : mixed-state, head-graph, sigma-pi, cue-graph or color.
    init : The target's box in the first frame, in pixels; without it, mixed-state and head-graph
        detect a head in the first two seconds, sigma-pi and cue-graph wait for motion.
    start : Time in the video at which to start.
    check : Refuse a start on no person, and search for a lost person; --no-check to follow anything.
    guided : The graph predicts the next box for the tracker.
    particles : Number of particles.
    foot_at : Foot point, in box heights below the box's top; by default 1, or 7.3 for the box of a head with
        a known camera.
    middle_at : For a camera that looks down: height of the box's middle above the ground in metres, instead
        of a foot point. By default with a fisheye: 1, or 1.6 for the box of a head.
    pan_limit : Degrees: largest pan away from the camera, of trackers of heads; 90 if heads never turn their
        backs. By default 180, in the paper 90.
    as_in_the_paper : Use the published form of the tracker, without later improvements.
    background : Image, or folder of images, without the person (furniture), for sigma-pi and
        cue-graph; can be given several times.
    """
    if output.suffix.lower() != ".csv":
        raise InputError(f"{output.name}", "a file to write that ends in .csv", path=output)
    follow_target(
        source,
        output,
        camera,
        tracker=tracker,
        init=None if init is None else parse_box(init),
        start=start,
        check=check,
        guided=guided,
        render=render,
        particles=particles,
        seed=seed,
        foot_at=foot_at,
        middle_at=middle_at,
        pan_limit=pan_limit,
        as_in_the_paper=as_in_the_paper,
        background=background or (),
        reports=PRINTED,
    )


def parse_box(text: str) -> Box:
    """Parse a box from ``left,top,width,height``; trackers refuse invalid boxes."""
    values = [parse_number(cell) for cell in text.split(",")]
    numbers = [value for value in values if value is not None]
    if len(values) != 4 or len(numbers) != 4:
        raise InputError(f"a box {text!r}", "LEFT,TOP,WIDTH,HEIGHT in pixels")
    left, top, width, height = numbers
    return left, top, width, height


def follow_target(
    source: Path,
    output: Path | None,
    camera: CameraOptions,
    *,
    tracker: str,
    init: Box | None,
    start: float,
    check: bool,
    guided: bool,
    render: Path | None,
    particles: int | None,
    seed: int,
    foot_at: float | None,
    middle_at: float | None,
    pan_limit: float | None,
    as_in_the_paper: bool,
    background: Sequence[Path],
    reports: Reports,
) -> Observations:
    """Return the observations of one target, and write them if a file is given; see `follow`."""
    from graphtrack.io.read_write import write_table
    from graphtrack.tracks.track import ReadSummary
    from perception.drawing.people import draw
    from perception.following import run as following
    from perception.following.watch import TargetWatch
    from perception.ground.inspection import FrameInspection
    from perception.images.encoding import pictures
    from perception.images.frames import FrameSource
    from perception.observation.tables import Observations
    from perception.trackers.registry import OF_HEADS, make_tracker, parameters_of

    never = {f"--background {p}": p for given in background for p in FrameSource.files(given)}
    check_output_paths({"--output": output}, render, source, {**camera.files, **never})
    frames = FrameSource.open(source)
    clock = camera.clock(frames)
    ground = camera.on_ground(lambda line: reports.emit(f"  note: {line}"))
    parameters = parameters_of(tracker, as_in_the_paper=as_in_the_paper)
    if pan_limit is not None and hasattr(parameters, "pan_limit"):
        parameters = replace(parameters, pan_limit=math.radians(pan_limit))
    images = [image for given in background for image in following.background_images(given)]
    follower = make_tracker(tracker, particles, seed, parameters, background=images, rate=clock.rate)
    of_heads = tracker in OF_HEADS
    on_ground = following.box_cameras(ground, of_heads=of_heads, foot_at=foot_at, middle_at=middle_at)

    def guide(first: Box) -> GraphGuide:
        from perception.following.guidance import GraphGuide

        return GraphGuide(on_ground(first), follower.pan_classes, clock=clock)

    def at(number: int) -> float:
        return float(clock.seconds(number))

    refused: list[str] = []
    inspection = FrameInspection()
    with (
        reports.progress(frames.count, "frames") as advance,
        nullcontext() if render is None else pictures(render, clock.rate) as picture,
    ):
        begun = time.perf_counter()

        def show(number: int, image: Image, estimate: BoxEstimate) -> None:
            inspection.add(number, image, at(number))
            if picture is not None:
                picture(number, draw(image, number, estimate, follower.pan_classes))

        shown = frames.where(lambda number: at(number) >= start - _ROUNDING)
        found = following.follow(
            follower,
            shown if start > 0.0 else frames,
            partial(_start, init, tracker),
            guide=guide if guided else None,
            watch=TargetWatch(tracker, at, partial(_later, frames, at), person=check),
            search=at if init is None and tracker in OF_HEADS else None,
            refuse=refused.append,
            advance=advance,
            show=show,
        )
        seconds = time.perf_counter() - begun
        first = next(item.estimate.box for item in found if item.estimate.found)
        track = following.to_track(found, on_ground(first), follower.pan_classes, clock)
        table = following.box_table(found, track)
        notes = [*following.notes(found, track), *rate_note(frames, clock, camera.fps)]
        notes += [*inspection.notes(), *damage_note(frames)]
        if output is not None:
            write_table(table, output)
    report_skipped(refused, reports)
    for note in notes:
        reports.emit(f"  note: {note}")
    report_camera(ground, reports)
    lost = following.lost_frames(found)
    loss = f", lost in {lost} of them ({lost / clock.rate:.1f} s)" if lost else ""
    reports.emit(f"followed {in_time(len(found), seconds)}{loss}")
    report_written((output, render), reports)
    return Observations(table, ReadSummary("video", len(found), {}, (*refused, *notes)))


def _later(frames: FrameSource, at: Callable[[int], float], number: int) -> Image | None:
    """Return the image a second after a frame, or the last one; None if there is none."""
    last = None
    for frame in frames.where(lambda other: other > number):
        last = last if frame.image is None else frame.image
        if at(frame.number) >= at(number) + 1.0 - _ROUNDING:
            break
    return last


def _start(box: Box | None, tracker: str, image: Image) -> Box | None:
    """Return the initial box; a head is detected if the tracker needs one and no box is given."""
    from perception.following.run import find_head
    from perception.trackers.registry import OF_HEADS, WITH_BACKGROUND

    if box is not None or tracker in WITH_BACKGROUND:
        return box
    if tracker in OF_HEADS:
        return find_head(image)
    raise InputError("no target in the first frame", f"--init with its box, for the tracker {tracker}")
