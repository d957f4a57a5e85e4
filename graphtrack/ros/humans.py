"""Positions of people who are known by name alone, by the frames of REP 155 (ROS4HRI)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.ros.bag import Bag
from graphtrack.ros.definitions import TEXT
from graphtrack.ros.rotation import yaw_of
from graphtrack.ros.transforms import Transforms

Part = Literal["person", "body", "face"]
_PARTS: Mapping[str, Part] = {"persons": "person", "bodies": "body", "faces": "face"}
_MATCH = re.compile(r"/humans/persons/([^/]+)/(face|body)_id")


@dataclass(frozen=True)
class Humans:
    """Meaning of the names of people.

    Attributes
    ----------
    part : what the names are of
    matched : (person, "face" or "body") → the name of that, as last told
    """

    part: Part
    matched: Mapping[tuple[str, str], str]

    @classmethod
    def of(cls, bag: Bag, topic: str) -> Humans:
        """Meaning of the names of a topic such as /humans/persons/tracked."""
        kind: Part = next((part for plural, part in _PARTS.items() if f"/{plural}/" in topic), "person")
        matched: dict[tuple[str, str], str] = {}
        if kind == "person":
            told = {
                name: m
                for name, type_ in bag.topics.items()
                if type_ == TEXT and (m := _MATCH.fullmatch(name))
            }
            for one, text in bag.decoded(TEXT, told, lambda message: str(message.data)):
                if text:
                    matched[told[one.topic][1], told[one.topic][2]] = text
        return cls(kind, matched)

    def placed(
        self, name: str, fixed: str, stamps: NDArray[np.int64], transforms: Transforms
    ) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]] | None:
        """Position (n, 2), body and head (n,), whether they are known (n,); None where no frame is theirs.

        The position is that of the frame of the name; bodies look along x of ``body_``, heads along z of
        ``gaze_``, else x of ``face_``, else x of ``head_``.
        """
        body = self.matched.get((name, "body"), name)
        face = self.matched.get((name, "face"), name)
        frames = {"person": f"person_{name}", "body": f"body_{body}", "face": f"face_{face}"}
        of_place = [frames[self.part], *(frames[one] for one in ("body", "face") if one != self.part)]
        where = next((one for one in of_place if one in transforms), None)
        if where is None:
            return None
        pose = transforms.placement(where, fixed, stamps)

        def looks(*candidates: tuple[str, str]) -> FloatArray:
            for frame, axis in candidates:
                if frame in transforms:
                    try:
                        turned = transforms.placement(frame, fixed, stamps)
                    except InputError:  # what is not connected is not known
                        continue
                    return np.where(turned.known, yaw_of(turned.quaternion, axis), np.nan)
            return np.full(len(stamps), np.nan)

        head = looks((f"gaze_{face}", "z"), (frames["face"], "x"), (f"head_{body}", "x"))
        return pose.translation[:, :2], looks((frames["body"], "x")), head, pose.known
