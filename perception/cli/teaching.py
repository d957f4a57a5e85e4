"""A camera teaches itself on the way of another command, and is not taught twice by one recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.cli.console import emit, progress_bar

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.adaptation.learning import PackageModels
    from perception.adaptation.models import CameraModels
    from perception.detection.boxes import PersonBox
    from perception.images.frames import FrameSource

_KEY = "recording"
"""Key in the card of such a file: the recording it learned from."""


def package_models() -> PackageModels:
    """The package's models that look while a camera teaches itself."""
    from perception.adaptation.learning import PackageModels
    from perception.models import HEAD_POSE, load_classifier, load_head_localiser

    return PackageModels(load_head_localiser(), load_classifier("body_pose"), load_classifier(HEAD_POSE[0]))


def teach(
    path: Path,
    key: str,
    frames: FrameSource,
    people: Sequence[PersonBox],
    camera: GroundCamera,
    rate: float,
    refuse: Callable[[str], object],
    *,
    seed: int = 0,
) -> tuple[CameraModels | None, str]:
    """The models that a camera teaches itself, and a sentence about them.

    None, where too few people surely walk. What is learned is written to ``path``, and taken from there when
    it was learned with the same ``key`` before.
    """
    from perception.adaptation.adapting import Recording, adapted
    from perception.adaptation.learning import TooFewWalkers
    from perception.adaptation.models import CameraModels

    if path.is_file():
        known = CameraModels.load(path)
        if known.card.parameters.get(_KEY) == key:
            return known, _sentence(known)
    rng = np.random.default_rng(seed)
    try:
        recordings = [Recording(frames, people, rate)]
        models = adapted(recordings, camera, package_models(), rng, progress_bar, refuse).models
    except TooFewWalkers as error:
        sentence = f"the camera does not teach itself, the package's models look: {error.found}"
        emit(f"  note: {sentence}")
        return None, sentence
    models.card = replace(models.card, parameters={**models.card.parameters, _KEY: key})
    models.save(path)
    sentence = _sentence(models)
    emit(sentence)
    return models, sentence


def check_adapt(streamed: bool, camera: Path | None, models: Sequence[object]) -> None:
    """Refuse what cannot be had beside models that are learned from the recording itself.

    Parameters
    ----------
    camera : the file that says where the ground is
    models : that are given; None: they are not
    """
    from graphtrack.errors import InputError

    if streamed:
        raise InputError("--adapt with -o -", "a file as the output: a camera learns from all frames")
    if camera is None:
        raise InputError("--adapt without a camera", "--calibration or --homography")
    if any(model is not None for model in models):
        raise InputError("--adapt beside models that are given", "one of them")


def forget(taught: Path, adapt: bool) -> None:
    """Remove what this run has learned, and needs no more."""
    if adapt:
        taught.unlink(missing_ok=True)


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
