"""Detections of a camera whose ground plane is known, each with the probability that it is a person."""

from __future__ import annotations

from dataclasses import dataclass

from graphtrack.geometry.camera import GroundCamera
from perception.detection.background import Background
from perception.detection.blocks import foot_boxes
from perception.detection.boxes import Detections
from perception.detection.ground_search import Candidates, GroundSearch, joined
from perception.detection.rescoring import PersonProbability
from perception.images.pixels import Image


@dataclass(frozen=True, eq=False)
class GroundDetector:
    """Finds people where they have the height of a person.

    Attributes
    ----------
    search : where they may be
    probability : how probably a candidate is one
    background : behind them; None: not known
    """

    search: GroundSearch
    probability: PersonProbability
    background: Background | None = None

    @classmethod
    def of_frame(cls, camera: GroundCamera, image: Image) -> GroundDetector:
        """One that knows nothing but the camera, for images like this one."""
        size = image.shape[1], image.shape[0]
        return cls(GroundSearch(camera, size), PersonProbability.untaught(foreground=False))

    def detect(self, image: Image) -> Detections:
        """Return people with the probabilities of them, best first."""
        return self.chosen(self.search.candidates(image, self.background))

    def chosen(self, candidates: Candidates) -> Detections:
        """The candidates of a frame that are more like people than like nobody."""
        scored = candidates.scored(self.probability.of(candidates))
        best = joined(scored, self.search.parameters.apart)
        kept = best.score >= self.probability.even
        return Detections(foot_boxes(best.foot[kept], best.height[kept]), best.score[kept])
