"""`perception calibrate` and `perception adapt`: the view of a camera, and models that it teaches itself.

`teach` does the latter within other commands, once for each recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, print_table, progress_bar
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted
from perception.cli.options import (
    CameraOptions,
    VideoOrFolder,
    check_places,
    print_skipped,
    read_given_boxes,
)
from perception.cli.searching import PeopleSearch, search_journals

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.adaptation.models import CameraModels
    from perception.detection.boxes import PersonBox
    from perception.ground.calibration import FoundView
    from perception.images.frames import Clock, FrameSource
    from perception.storage import ModelCard


PersonHeight = Annotated[
    float,
    typer.Option("--person-height", min=0.5, max=3.0, help="Metres that people's boxes are high on average."),
]


def calibrate(
    source: VideoOrFolder,
    boxes: options.InputFile,
    output: options.OutputPath,
    person_height: PersonHeight = 1.7,
    seed: options.Seed = 0,
) -> None:
    """Find out how a camera looks at the ground, from how high people's boxes are at each place.

    `--calibration` takes the file. Of the frames only the size is used.

    Parameters
    ----------
    boxes : MOT text, COCO JSON or CAVIAR XML with people's boxes, with identities or without.
    output : Calibration to write (.ci).
    """
    from perception.detection.boxes import read_boxes
    from perception.ground.calibration import found_view
    from perception.images.frames import FrameSource

    check_places({"--output": output}, None, source, {"--boxes": boxes})
    frames = FrameSource.open(source)
    refused: dict[str, None] = {}
    people = read_boxes(boxes, refused.setdefault)
    found = found_view(people, frames.size(), np.random.default_rng(seed), person_height)
    found.write(output)
    print_skipped(refused)
    emit(described(found))
    for note in found.notes:
        emit(f"  note: {note}")
    emit(f"wrote {output}")


def described(found: FoundView) -> str:
    """The view of a camera on the ground in words, with its uncertainty."""
    view, std = found.view, found.std
    return (
        f"from {found.boxes} boxes of {found.people} people, of which {100 * found.inliers:.0f} % agree: "
        f"focal length {view.focal:.0f} ± {std['focal']:.0f} pixels, "
        f"{np.degrees(view.tilt):.1f} ± {np.degrees(std['tilt']):.1f}° down, "
        f"roll {np.degrees(view.roll):.1f} ± {np.degrees(std['roll']):.1f}°, "
        f"{view.height:.2f} ± {std['height']:.2f} m above the ground; distances on the ground "
        f"± {100 * found.distance_std:.0f} %"
    )


def teach(
    path: Path,
    key: str,
    frames: FrameSource,
    people: Sequence[PersonBox],
    camera: GroundCamera,
    clock: Clock,
    refuse: Callable[[str], object],
    *,
    seed: int = 0,
) -> tuple[CameraModels | None, str]:
    """The models that a camera teaches itself, and a sentence about them.

    None, where too few people surely walk. What is learned is written to ``path``, and taken from there when
    it was learned with the same ``key`` before.
    """
    from perception.adaptation.learning import PackageModels, Recording, TooFewWalkers, adapted
    from perception.adaptation.models import CameraModels

    if path.is_file():
        known = CameraModels.load(path)
        if known.card.parameters.get("recording") == key:
            return known, _sentence(known)
    rng = np.random.default_rng(seed)
    try:
        recordings = [Recording(frames, people, clock)]
        models = adapted(recordings, camera, PackageModels.load(), rng, progress_bar, refuse).models
    except TooFewWalkers as error:
        sentence = f"the camera does not teach itself, the package's models look: {error.found}"
        emit(f"  note: {sentence}")
        return None, sentence
    models.card = replace(models.card, parameters={**models.card.parameters, "recording": key})
    models.save(path)
    sentence = _sentence(models)
    emit(sentence)
    return models, sentence


def check_adapt(streamed: bool, camera: Path | None, models: Sequence[object]) -> None:
    """Refuse `--adapt` with a stream, without a camera's file, or with other models than None."""
    if streamed:
        raise InputError("--adapt with -o -", "a file as the output: a camera learns from all frames")
    if camera is None:
        raise InputError("--adapt without a camera", "--calibration or --homography")
    if any(model is not None for model in models):
        raise InputError("--adapt beside models that are given", "one of them")


def stamp_of_camera(camera: GroundCamera | None) -> object:
    """Identity of a camera."""
    if camera is None:
        return None
    values = (camera.homography, camera.intrinsics, camera.distortion, camera.centre_on_ground)
    return camera.lens, [None if value is None else value.tolist() for value in values]


def _sentence(models: CameraModels) -> str:
    card = models.card
    errors = " and ".join(f"{card.figures[f'{part}_error_deg']:.0f}° ({part})" for part in ("body", "head"))
    return (
        f"the camera taught itself body and head, by {card.parameters['people']} people who surely walk:"
        f" of people left out the directions are {errors} off where they go, by chance 90°"
    )


def adapt(
    sources: Annotated[list[Path], typer.Argument(metavar="VIDEO|FOLDER...", exists=True)],
    output: options.OutputPath,
    camera: CameraOptions,
    boxes: Annotated[list[Path] | None, typer.Option(exists=True, dir_okay=False)] = None,
    write_model: Path | None = None,
    seed: options.Seed = 0,
) -> None:
    """Let a camera teach itself how bodies and heads point, from people who surely walk.

    `perception observe --models` uses the file.

    Parameters
    ----------
    sources : Videos or folders of images, all of one camera.
    output : Model file to write (.npz).
    boxes : MOT text, COCO JSON or CAVIAR XML with people's boxes, or a detector's, whose ids are -1, once for
        each recording in their order; without it people are detected.
    write_model : Write the graph's model file (.toml) that goes with these models, for `graphtrack smooth
        --model`.
    """
    from graphtrack.model import Model
    from perception.adaptation.labels import check_camera
    from perception.adaptation.learning import PackageModels, Recording, adapted
    from perception.images.frames import FrameSource

    if output.suffix != ".npz":
        raise InputError(f"--output {output.name}", "a name that ends in .npz")
    given: list[Path | None] = [*boxes] if boxes else [None] * len(sources)
    if len(given) != len(sources):
        raise InputError(
            f"--boxes {len(given)} times for {counted(len(sources), 'recording')}",
            "once for each of them, in their order, or for none",
        )
    # A search that was broken off goes on: each recording has journals of its own.
    places = [output if k == 0 else output.with_name(f"{output.name}.{k}") for k in range(len(sources))]
    journals = [path for place in places for path in search_journals(place)]
    inputs = {"--boxes": boxes, **camera.files}
    outputs = {"--output": output, "--write-model": write_model, "the journals of --output": journals}
    for source in sources:
        check_places(outputs, None, source, inputs)
    on_ground = camera.on_ground()
    if on_ground is None:
        raise InputError("no camera", "--calibration or --homography: where people go is seen on the ground")
    opened = [FrameSource.open(source) for source in sources]
    for frames in opened:
        check_camera(on_ground, frames.size())
    refused: dict[str, None] = {}
    refuse = refused.setdefault
    rng = np.random.default_rng(seed)
    recordings = []
    with ExitStack() as searches:
        for frames, place, of_recording in zip(opened, places, given, strict=True):
            clock = camera.clock(frames)
            if of_recording is None:
                search = PeopleSearch(frames, on_ground, clock, place, camera.stamps)
                people, _ = searches.enter_context(search.people(refuse))
            else:
                people = read_given_boxes(of_recording, frames, None, refuse)
            recordings.append(Recording(frames, people, clock))
        found = adapted(recordings, on_ground, PackageModels.load(), rng, progress_bar, refuse)
        found.models.save(output)
        if write_model is not None:
            found.models.graph(Model.named(None)).save(write_model)
    print_skipped(refused)
    emit(
        f"learned from {len(found.labels)} boxes of {found.people} people who "
        f"surely walk, of {counted(found.labels.tracks, 'track')}"
    )
    print_figures(found.models.card)
    share = found.models.class_outlier_probability
    emit(f"the graph is to take {share:.0%} of the class likelihoods for nothing")
    emit(f"wrote {output}" + ("" if write_model is None else f" and {write_model}"))


def print_figures(card: ModelCard) -> None:
    """Errors on people left out, step by step."""
    steps = (
        ("chance", None),
        ("the package's models", "_package"),
        ("learned in the boxes as given", "_boxes_as_given"),
        ("learned in aligned boxes" if card.parameters["aligned"] else "what is written", ""),
    )
    rows = [
        {
            "people left out": name,
            **{
                part: 90.0 if of is None else card.figures.get(f"{part}_error_deg{of}", float("nan"))
                for part in ("body", "head", "both")
            },
        }
        for name, of in steps
    ]
    print_table("mean error against the direction of travel, degrees", rows)
    errors = ", ".join(
        f"{part} {card.figures[f'{part}_expected_calibration_error']:.3f}" for part in ("body", "head")
    )
    emit(f"expected calibration error: {errors}")
    emit(f"fails with: {card.fails_when}")
