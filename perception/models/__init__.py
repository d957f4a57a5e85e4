"""The models that ship with the package, trained on rendered people by `perception train`."""

from __future__ import annotations

from pathlib import Path

from graphtrack.errors import InputError
from perception.pose.body import BodyPose
from perception.pose.classifier import FeatureClassifier
from perception.pose.deep_belief import DeepBelief
from perception.pose.exemplars import Exemplars
from perception.pose.head_detection import HeadLocaliser
from perception.pose.keypoints import KeypointPose
from perception.pose.templates import Templates

CLASSIFIERS: dict[str, type[FeatureClassifier]] = {
    "templates": Templates,
    "exemplars": Exemplars,
    "deep_belief": DeepBelief,
    "body_pose": BodyPose,
}
HEAD_POSE = ("deep_belief", "templates", "exemplars")
NAMES = (*CLASSIFIERS, HeadLocaliser.kind, "head_exemplars", KeypointPose.kind, "follow_confidence")


def model_path(name: str) -> Path:
    """Return the path of a model of the package.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name not in NAMES:
        raise InputError(f"model {name!r}", f"one of {', '.join(NAMES)}")
    return Path(__file__).parent / f"{name}.npz"


def load_classifier(name: str, path: str | Path | None = None) -> FeatureClassifier:
    """Load a pose classifier by name, from the package or from a file.

    Raises
    ------
    InputError
        If the name is unknown, or the file is no such model.
    """
    if name not in CLASSIFIERS:
        raise InputError(f"classifier {name!r}", f"one of {', '.join(CLASSIFIERS)}")
    return CLASSIFIERS[name].load(path or model_path(name))


def load_head_localiser(path: str | Path | None = None) -> HeadLocaliser:
    """Load the head localiser of the package or of a file."""
    return HeadLocaliser.load(path or model_path(HeadLocaliser.kind))


def load_keypoint_pose(path: str | Path | None = None) -> KeypointPose:
    """Load the model of body and head from keypoints, of the package or of a file."""
    return KeypointPose.load(path or model_path(KeypointPose.kind))
