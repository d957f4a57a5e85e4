"""Head pose classifiers, one a module; all are a `perception.pose.classifier.FeatureClassifier`."""

from __future__ import annotations

from perception.pose.head_pose.deep_belief import DeepBelief
from perception.pose.head_pose.exemplars import Exemplars
from perception.pose.head_pose.templates import Templates

__all__ = ["DeepBelief", "Exemplars", "Templates"]
