"""`perception observe`."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli.console import console, counted, progress_bar
from graphtrack.cli.options import check_outputs

if TYPE_CHECKING:
    from graphtrack.geometry import GroundCamera
    from perception.boxes import PersonBox
    from perception.frames import FrameSource
    from perception.journal import Journal

_FILE = {"exists": True, "dir_okay": False}
_SHOWN = 5


def observe(
    source: Annotated[
        Path, typer.Argument(help="A video, or a folder of images.", metavar="VIDEO|FOLDER", exists=True)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .csv, .csv.gz or .parquet.")],
    boxes: Annotated[
        Path | None,
        typer.Option(
            "--boxes",
            help="MOT text or CAVIAR XML with people's boxes; without it they are detected.",
            **_FILE,
        ),
    ] = None,
    homography: Annotated[
        Path | None,
        typer.Option("--homography", help="File with 3×3 numbers: image → ground in metres.", **_FILE),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Camera calibration (.ci).", **_FILE)
    ] = None,
    fps: Annotated[
        float | None, typer.Option("--fps", min=0.1, help="Frames a second, if not the video's (else 25).")
    ] = None,
    head_pose: Annotated[
        str, typer.Option("--head-pose", help="deep_belief, templates or exemplars.")
    ] = "deep_belief",
    head_pose_model: Annotated[
        Path | None, typer.Option("--head-pose-model", help="A model of your own (.npz).", **_FILE)
    ] = None,
    body_pose_model: Annotated[
        Path | None, typer.Option("--body-pose-model", help="A model of your own (.npz).", **_FILE)
    ] = None,
    write_boxes_to: Annotated[
        Path | None, typer.Option("--write-boxes", help="Write the detected boxes here, as MOT text.")
    ] = None,
) -> None:
    """Find people and say where they are and how their bodies and heads point, frame by frame.

    A run that was broken off goes on where it was when it is called again in the same way.
    """
    from graphtrack.errors import InputError
    from graphtrack.geometry import GroundCamera
    from graphtrack.io import write
    from graphtrack.io.cameras import read_calibration, read_homography
    from perception import pipeline
    from perception.boxes import read_boxes, write_boxes
    from perception.frames import FrameSource
    from perception.journal import Journal
    from perception.models import HEAD_POSE, load_classifier, load_head_localiser

    if head_pose not in HEAD_POSE:
        raise InputError(f"--head-pose {head_pose}", " or ".join(HEAD_POSE))
    check_outputs(write_boxes_to, table=output)
    frames = FrameSource.open(source)
    models = pipeline.Models(
        load_head_localiser(),
        load_classifier("body_pose", body_pose_model),
        load_classifier(head_pose, head_pose_model),
    )
    camera = None
    if calibration is not None:
        camera = read_calibration(calibration)
    elif homography is not None:
        camera = GroundCamera.from_homography(read_homography(homography))
    refused: list[str] = []
    state = source.stat()
    video = (str(source), state.st_size, state.st_mtime_ns)
    detections = Journal(output.with_name(f"{output.name}.detections"), _key(video))
    if boxes is not None:
        people = read_boxes(boxes)
    else:
        people = _detect(frames, camera, detections)
        if write_boxes_to is not None:
            write_boxes(people, write_boxes_to)
    looked = time.perf_counter()
    key = _key(video, head_pose, str(head_pose_model), str(body_pose_model), people)
    journal = Journal(output.with_name(f"{output.name}.journal"), key)
    journal.open()
    _say_how_far(journal)
    try:
        with progress_bar(frames.count) as advance:
            count = pipeline.observe(frames, people, models, journal, refuse=refused.append, advance=advance)
        seen = pipeline.seen_in(journal)
        tracks = pipeline.to_tracks(seen, models.head_pose.classes, camera, fps or frames.fps or 25.0)
        write(tracks, output)
    except InputError:
        journal.close(remove=True)
        detections.close(remove=True)
        raise
    except BaseException:
        journal.close(remove=False)
        raise
    journal.close(remove=True)
    detections.close(remove=True)
    seconds = time.perf_counter() - looked
    for reason in refused[:_SHOWN]:
        console.print(f"  skipped: {reason}", markup=False)
    if len(refused) > _SHOWN:
        console.print(f"  skipped: {len(refused) - _SHOWN} more", markup=False)
    if camera is None:
        console.print("  note: no camera is known: positions are pixels times a scale", markup=False)
    console.print(
        f"observed {counted(tracks.n_frames, 'person-frame')} in {counted(len(tracks), 'track')}; "
        f"{counted(count, 'frame')} in {seconds:.1f} s ({count / max(seconds, 1e-9):.1f} a second)",
        markup=False,
    )
    console.print(f"wrote {output}", markup=False)


def _key(*asked: object) -> str:
    return hashlib.sha256(repr(asked).encode()).hexdigest()


def _say_how_far(journal: Journal) -> None:
    if journal.frames:
        console.print(f"going on after {counted(len(journal.frames), 'frame')}", markup=False)


def _detect(frames: FrameSource, camera: GroundCamera | None, journal: Journal) -> list[PersonBox]:
    """Detected people as tracks; frames that the journal has are decoded for their colours only."""
    import numpy as np

    from perception.people import PeopleDetector, PeopleTracker

    detector, tracker = PeopleDetector(), PeopleTracker(camera)
    journal.open()
    _say_how_far(journal)
    start, count = time.perf_counter(), 0
    try:
        with progress_bar(frames.count) as advance:
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
    finally:
        journal.close(remove=False)
    seconds = time.perf_counter() - start
    console.print(
        f"looked for people in {counted(count, 'frame')} in {seconds:.1f} s "
        f"({count / max(seconds, 1e-9):.1f} a second)",
        markup=False,
    )
    return tracker.tracks()
