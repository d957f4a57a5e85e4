"""`perception observe`."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.cli.console import console, progress_bar
from graphtrack.display import counted
from perception.cli.common import (
    FILE,
    Calibration,
    Fps,
    Homography,
    Render,
    Source,
    check_places,
    frame_rate,
    in_time,
    print_camera_note,
    print_skipped,
    print_written,
    read_camera,
)

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.tracks import TrackSet
    from perception.detection.boxes import PersonBox
    from perception.images.frames import FrameSource
    from perception.observe.journal import Journal
    from perception.observe.pipeline import Seen


def observe(
    source: Source,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .csv, .csv.gz or .parquet.")],
    boxes: Annotated[
        Path | None,
        typer.Option(
            "--boxes",
            help="MOT text or CAVIAR XML with people's boxes; without it they are detected.",
            **FILE,
        ),
    ] = None,
    homography: Homography = None,
    calibration: Calibration = None,
    fps: Fps = None,
    head_pose: Annotated[
        str, typer.Option("--head-pose", help="deep_belief, templates or exemplars.")
    ] = "deep_belief",
    head_pose_model: Annotated[
        Path | None, typer.Option("--head-pose-model", help="A model of your own (.npz).", **FILE)
    ] = None,
    body_pose_model: Annotated[
        Path | None, typer.Option("--body-pose-model", help="A model of your own (.npz).", **FILE)
    ] = None,
    write_boxes_to: Annotated[
        Path | None, typer.Option("--write-boxes", help="Write the detected boxes here, as MOT text.")
    ] = None,
    render: Render = None,
) -> None:
    """Find people and say where they are and how their bodies and heads point, frame by frame.

    A run that was broken off goes on where it was when it is called again in the same way.
    """
    from graphtrack.errors import InputError
    from graphtrack.io import write
    from perception.detection.boxes import read_boxes, write_boxes
    from perception.images.drawing.output import is_video
    from perception.images.frames import FrameSource, of_one_size
    from perception.models import HEAD_POSE, load_classifier, load_head_localiser
    from perception.observe import pipeline
    from perception.observe.journal import Journal

    if head_pose not in HEAD_POSE:
        raise InputError(f"--head-pose {head_pose}", " or ".join(HEAD_POSE))
    if boxes is not None and write_boxes_to is not None:
        raise InputError("--write-boxes beside --boxes", "one of them: given boxes are not detected")
    found_so_far = output.with_name(f"{output.name}.detections")
    known_so_far = output.with_name(f"{output.name}.journal")
    check_places(
        {
            "--output": output,
            "the journals of --output": [found_so_far, known_so_far],
            "--write-boxes": write_boxes_to,
        },
        render,
        source,
        {
            "--boxes": boxes,
            "--homography": homography,
            "--calibration": calibration,
            "--head-pose-model": head_pose_model,
            "--body-pose-model": body_pose_model,
        },
        table=output,
    )
    frames = FrameSource.open(source)
    rate = frame_rate(frames, fps)
    models = pipeline.Models(
        load_head_localiser(),
        load_classifier("body_pose", body_pose_model),
        load_classifier(head_pose, head_pose_model),
    )
    camera = read_camera(homography, calibration)
    refused: list[str] = []
    detections = Journal(found_so_far, _key(frames.stamp()), list, _detection)
    if boxes is not None:
        people = read_boxes(boxes, refused.append)
    else:
        people = _detect(frames, camera, detections, refused.append)
        if write_boxes_to is not None:
            write_boxes(people, write_boxes_to)
    looked = time.perf_counter()
    key = _key(frames.stamp(), head_pose, _stamp(head_pose_model), _stamp(body_pose_model), people)
    journal = Journal(known_so_far, key, pipeline.Seen.to_record, pipeline.Seen.from_record)
    journal.open()
    _say_how_far(journal)
    try:
        shown = of_one_size(frames) if render is not None and is_video(render) else frames
        with progress_bar(frames.count, "frames") as advance:
            count = pipeline.observe(shown, people, models, journal, refuse=refused.append, advance=advance)
        seen = pipeline.seen_in(journal)
        tracks = pipeline.to_tracks(seen, models.head_pose.classes, camera, rate)
    except InputError:  # the same command would end in the same way
        journal.close(remove=True)
        detections.close(remove=True)
        raise
    finally:
        journal.close(remove=False)
    seconds = time.perf_counter() - looked
    if render is not None:
        _render(frames, seen, tracks, render, rate)
    write(tracks, output)
    journal.close(remove=True)
    detections.close(remove=True)
    print_skipped(refused)
    for reason, times in tracks.summary.refused.items():
        console.print(f"  refused {times}: {reason}", markup=False)
    print_camera_note(camera)
    console.print(
        f"observed {counted(tracks.n_frames, 'person-frame')} in {counted(len(tracks), 'track')}; "
        f"{in_time(count, seconds)}",
        markup=False,
    )
    print_written(output, render)


def _stamp(path: Path | None) -> object:
    """What tells a file from what it is after a change."""
    if path is None:
        return None
    state = path.stat()
    return str(path), state.st_size, state.st_mtime_ns


def _key(*asked: object) -> str:
    return hashlib.sha256(repr(asked).encode()).hexdigest()


def _say_how_far(journal: Journal[Any]) -> None:
    if journal.frames:
        console.print(f"going on after {counted(len(journal.frames), 'frame')}", markup=False)


def _detection(values: Any) -> list[float]:
    """A detection as the journal has it: left, top, width, height and score."""
    left, top, width, height, score = (float(value) for value in values)
    return [left, top, width, height, score]


def _detect(
    frames: FrameSource,
    camera: GroundCamera | None,
    journal: Journal[list[float]],
    refuse: Callable[[str], None],
) -> list[PersonBox]:
    """Detected people as tracks; frames that the journal has are decoded for their colours only."""
    import numpy as np

    from perception.detection.people import PeopleDetector, PeopleTracker

    detector, tracker = PeopleDetector(), PeopleTracker(camera)
    journal.open()
    _say_how_far(journal)
    start, count, detected = time.perf_counter(), 0, 0
    try:
        with progress_bar(frames.count, "frames") as advance:
            for frame in frames:
                advance(1)
                if frame.image is None:
                    continue
                if frame.number not in journal.frames:
                    found, scores = detector.detect(frame.image)
                    journal.add(frame.number, np.column_stack([found, scores]).tolist())
                    count += 1
                boxes = np.array(journal.frames[frame.number], float).reshape(-1, 5)
                tracker.update(frame.number, frame.image, boxes[:, :4], boxes[:, 4])
                detected += len(boxes)
    finally:
        journal.close(remove=False)
    seconds = time.perf_counter() - start
    console.print(f"looked for people in {in_time(count, seconds)}", markup=False)
    if tracker.passing:
        refuse(
            f"{tracker.passing} of {detected} detected boxes, in tracks of less than {tracker.least} boxes"
        )
    return tracker.tracks()


def _render(frames: FrameSource, seen: list[Seen], tracks: TrackSet, path: Path, fps: float) -> None:
    """Decode the frames once more and draw what was seen in them."""
    from perception.images.drawing import draw_people, people_by_frame, pictures

    people = people_by_frame(seen, tracks)
    assert tracks.camera is not None
    with pictures(path, fps) as write_picture, progress_bar(frames.count, "frames drawn") as advance:
        for frame in frames:
            advance(1)
            if frame.image is not None:
                shown = draw_people(frame.image, frame.number, people.get(frame.number, ()), tracks.camera)
                write_picture(frame.number, shown)
