"""Head pose classifiers, one a module; all are a `perception.classifier.Classifier`."""

from __future__ import annotations

from perception.head_pose.deep_belief import DeepBelief
from perception.head_pose.exemplars import Exemplars
from perception.head_pose.templates import Templates

__all__ = ["DeepBelief", "Exemplars", "Templates"]
