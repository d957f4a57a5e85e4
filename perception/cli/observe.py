"""`perception observe`."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli.console import console
from graphtrack.display import counted
from perception.cli.common import (
    FILE,
    Boxes,
    Calibration,
    Fps,
    Homography,
    Render,
    VideoOrFolder,
    check_places,
    decoded_frames,
    frame_rate,
    in_time,
    print_camera_note,
    print_skipped,
    print_written,
    read_camera,
)
from perception.cli.own_networks import (
    Detector,
    InputSize,
    Keypoints,
    LeastScore,
    PersonClass,
    find_keypoints,
    keypoint_files,
    own_networks,
    say_how_far,
    stamp_of,
    with_their_keypoints,
)
from perception.cli.searching import PeopleSearch, key_of, search_journals
from perception.cli.teaching import check_adapt, forget, stamp_of_camera, teach

if TYPE_CHECKING:
    from perception.images.frames import Frame, FrameSource
    from perception.observe.identified import SeenTracks
    from perception.observe.seen import SeenFrame


def observe(
    source: VideoOrFolder,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .csv, .csv.gz, .parquet or .ndjson; - for NDJSON rows on standard output, "
            "frame by frame.",
        ),
    ],
    boxes: Boxes = None,
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
    head_localiser_model: Annotated[
        Path | None, typer.Option("--head-localiser-model", help="A model of your own (.npz).", **FILE)
    ] = None,
    camera_models: Annotated[
        Path | None,
        typer.Option(
            "--models", help="What the camera has taught itself (.npz, of `perception adapt`).", **FILE
        ),
    ] = None,
    adapt: Annotated[
        bool,
        typer.Option("--adapt", help="Let the camera teach itself first, as `perception adapt` does."),
    ] = False,
    write_boxes_to: Annotated[
        Path | None, typer.Option("--write-boxes", help="Write the detected boxes here, as MOT text.")
    ] = None,
    detector: Detector = None,
    keypoints: Keypoints = None,
    person_class: PersonClass = None,
    input_size: InputSize = None,
    least_score: LeastScore = None,
    render: Render = None,
    causal: Annotated[
        bool | None,
        typer.Option(
            "--causal/--whole-track",
            help="Choose heads from what came before alone, or along whole tracks, and find people by each "
            "frame alone, or by what all frames teach; the former with -o -, else the latter.",
            show_default=False,
        ),
    ] = None,
    appearance: Annotated[
        bool | None,
        typer.Option(
            "--appearance/--no-appearance",
            help="Write what people look like (appearance_0 ...), by which they are told apart; on for boxes "
            "without identities, else off.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Find people and say where they are and how their bodies and heads point, frame by frame.

    Boxes without identities, such as those that are detected without --boxes, stand alone, and so do the rows
    of the table, whose ids are -1: `graphtrack smooth` finds out who is who.

    A run that was broken off goes on where it was when it is called again in the same way.
    """
    from graphtrack.errors import InputError
    from graphtrack.io import write
    from graphtrack.io.reading import check_table_name, write_table
    from perception.adaptation.models import CameraModels
    from perception.cli.observe_stream import observe_stream
    from perception.detection.boxes import Detections, read_boxes, write_boxes
    from perception.images.drawing.output import is_video
    from perception.images.frames import FrameSource
    from perception.models import HEAD_POSE, load_classifier, load_head_localiser, load_keypoint_pose
    from perception.observe import pipeline
    from perception.observe.detections import to_detections
    from perception.observe.identified import to_tracks
    from perception.observe.journal import FrameJournal
    from perception.observe.live import LiveObserver

    if head_pose not in HEAD_POSE:
        raise InputError(f"--head-pose {head_pose}", " or ".join(HEAD_POSE))
    own_models = (head_pose_model, body_pose_model, head_localiser_model)
    if camera_models is not None and any(path is not None for path in own_models):
        raise InputError("--models beside a model for one of its parts", "one of them")
    if keypoints is not None and any(path is not None for path in (*own_models, camera_models)):
        raise InputError("--keypoints beside a model for body or head", "one of them")
    if boxes is not None and detector is not None:
        raise InputError("--detector beside --boxes", "one of them: given boxes are not detected")
    if boxes is not None and write_boxes_to is not None:
        raise InputError("--write-boxes beside --boxes", "one of them: given boxes are not detected")
    streamed = str(output) == "-"
    if adapt:
        check_adapt(streamed, homography or calibration, (*own_models, camera_models, keypoints))
    if streamed:
        _refuse_with_stream({"--write-boxes": write_boxes_to, "--render": render}, causal)
    points_so_far = output.with_name(f"{output.name}.keypoints")
    known_so_far = output.with_name(f"{output.name}.journal")
    taught_so_far = output.with_name(f"{output.name}.camera.npz")
    check_places(
        {}
        if streamed
        else {
            "--output": output,
            "the journals of --output": [
                *search_journals(output),
                points_so_far,
                known_so_far,
                taught_so_far,
            ],
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
            "--head-localiser-model": head_localiser_model,
            "--models": camera_models,
            "--detector": detector,
            "--keypoints": keypoint_files(keypoints),
        },
        table=None if streamed else output,
    )
    frames = FrameSource.open(source)
    rate = frame_rate(frames, fps)
    refused: dict[str, None] = {}  # what cannot be decoded may be told twice
    refuse = refused.setdefault
    networks = own_networks(frames, detector, keypoints, person_class, input_size, least_score)
    given = None if boxes is None else read_boxes(boxes, refuse)
    pointed = given is None and networks.makes_boxes  # boxes are made of keypoints
    identified = given is not None and (not given or given[0].identified)
    if not (identified or streamed):
        check_table_name(output)
    models = pipeline.Models(
        load_head_localiser(head_localiser_model),
        load_classifier("body_pose", body_pose_model),
        load_classifier(head_pose, head_pose_model),
        appearance=not identified if appearance is None else appearance,
        of_camera=None if camera_models is None else CameraModels.load(camera_models),
        of_keypoints=load_keypoint_pose() if networks.has_keypoints else None,
    )
    camera = read_camera(homography, calibration)
    models = models.seeing(camera, frames.size)
    if streamed:
        observer = LiveObserver(models, camera, rate, identified=identified)
        observe_stream(frames, given, observer, refused, networks)
        return
    one_size = render is not None and is_video(render)
    asked_of = stamp_of(homography), stamp_of(calibration), networks.asked
    search = PeopleSearch(
        frames,
        camera,
        rate,
        output,
        asked_of,
        causal=bool(causal),
        one_size=one_size,
        detector=networks.detector,
    )
    points = FrameJournal(
        points_so_far,
        key_of(frames.stamp(), networks.asked),
        Detections.to_record,
        Detections.from_record,
    )
    people = given if given is not None or pointed else search.people(refuse)
    if networks.has_keypoints:
        numbers = None if people is None else {item.frame for item in people}
        found = find_keypoints(frames, networks, numbers, points, refuse, one_size=one_size)
        people = with_their_keypoints(people, found, refuse)
    assert people is not None
    if given is None and write_boxes_to is not None:
        write_boxes(people, write_boxes_to)
    own = [stamp_of(path) for path in (*own_models, camera_models)]
    if adapt and camera is not None:
        asked = key_of(frames.stamp(), rate, people, stamp_of_camera(camera))
        taught, _ = teach(taught_so_far, asked, frames, people, camera, rate, refuse)
        models, own = replace(models, of_camera=taught).seeing(camera, frames.size), [asked]
    looked = time.perf_counter()
    leaning = None if models.view is None else stamp_of_camera(camera)
    key = key_of(frames.stamp(), head_pose, own, people, models.appearance, networks.has_keypoints, leaning)
    journal = FrameJournal(known_so_far, key, pipeline.SeenFrame.to_record, pipeline.SeenFrame.from_record)
    journal.open()
    say_how_far(journal)
    # Where people were detected, nothing new is to be found in frames without any.
    looked_at = search.found.keys() | points.frames.keys()
    empty = set() if boxes is not None else looked_at - {item.frame for item in people}
    try:
        with _decoded(frames, journal.frames.keys() | empty, one_size=one_size) as decoded:
            count = pipeline.observe(decoded, people, models, journal, refuse=refuse)
        seen = journal.frames, models.head_classes, camera, rate
        observed = to_tracks(*seen, causal=bool(causal)) if identified or render is not None else None
        alone = None if identified else to_detections(*seen, causal=bool(causal))
    except InputError:  # the same command would end in the same way
        for one in (journal, search, points):
            one.close(remove=True)
        forget(taught_so_far, adapt)
        raise
    finally:
        journal.close(remove=False)
    seconds = time.perf_counter() - looked
    if render is not None:  # what is drawn stays in memory
        assert observed is not None
        _render(frames, observed, journal.frames, render, rate)
    if alone is not None:
        write_table(alone.columns, output)
        left_out = alone.refused
        said = counted(len(alone.number), "detection")
    else:
        assert observed is not None
        people_seen = observed.tracks
        write(people_seen, output)
        left_out = people_seen.summary.refused
        said = f"{counted(people_seen.n_frames, 'person-frame')} in {counted(len(people_seen), 'track')}"
    for one in (journal, search, points):
        one.close(remove=True)
    forget(taught_so_far, adapt)
    print_skipped(list(refused))
    for reason, times in left_out.items():
        console.print(f"  refused {times}: {reason}", markup=False)
    print_camera_note(camera)
    console.print(f"observed {said}; {in_time(count, seconds)}", markup=False)
    print_written(output, render)


def _refuse_with_stream(files: Mapping[str, Path | None], causal: bool | None) -> None:
    """Refuse what cannot be had of frames that are gone when the next comes."""
    from graphtrack.errors import InputError

    for name, path in files.items():
        if path is not None:
            raise InputError(f"{name} with -o -", "a file as the output: rows are given away as they come")
    if causal is False:
        raise InputError("--whole-track with -o -", "a file as the output: rows are given before the rest")


@contextmanager
def _decoded(
    frames: FrameSource, known: Collection[int] = (), *, unit: str = "frames", one_size: bool = False
) -> Iterator[Iterator[Frame]]:
    """The frames but the known ones, with a progress bar.

    Parameters
    ----------
    one_size : whether a frame of another size than the first is an `InputError`
    """
    known = frozenset(known)
    count = frames.count - len(known)
    with decoded_frames(
        frames, lambda number: number not in known, count, unit=unit, one_size=one_size
    ) as decoded:
        yield decoded


def _render(
    frames: FrameSource, observed: SeenTracks, seen: Mapping[int, SeenFrame], path: Path, fps: float
) -> None:
    """Decode the frames once more, now that all tracks are known, and draw what was seen in them."""
    from perception.images.drawing.output import pictures
    from perception.images.drawing.people import draw_people, people_by_frame

    people, camera = people_by_frame(observed, seen), observed.tracks.camera
    assert camera is not None
    with pictures(path, fps) as write_picture, _decoded(frames, unit="frames drawn") as decoded:
        for frame in decoded:
            if frame.image is not None:
                shown = draw_people(frame.image, frame.number, people.get(frame.number, ()), camera)
                write_picture(frame.number, shown)
