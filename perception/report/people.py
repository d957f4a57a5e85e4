"""Where estimated people are in the pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks import Track, TrackSet
from graphtrack.viewer.pictures import PersonBoxes
from perception.detection.boxes import PersonBox
from perception.images.drawing.tracked import ShownPerson
from perception.observe.estimates import BOX


class ShownPeople(Mapping[int, list[ShownPerson]]):
    """What there is to draw in each frame, made when it is asked for: of an hour, only columns are kept.

    Parameters
    ----------
    tracks : of everybody
    """

    def __init__(self, tracks: Sequence[_Shown]) -> None:
        self._tracks = tracks
        number, frame, row = [], [], []
        for k, one in enumerate(tracks):
            rows = np.flatnonzero(np.isfinite(one.place).all(axis=1))
            number.append(np.full(len(rows), k))
            frame.append(one.track.frame[rows])
            row.append(rows)
        frames: NDArray[np.int64] = np.concatenate([*frame, np.zeros(0, np.int64)])
        order = np.argsort(frames, kind="stable")
        self._frames, start = np.unique(frames[order], return_index=True)
        self._start = np.append(start, len(frames))
        self._number = np.concatenate([*number, np.zeros(0, np.int64)])[order]
        self._row = np.concatenate([*row, np.zeros(0, np.int64)])[order]

    def __getitem__(self, frame: int) -> list[ShownPerson]:
        k = int(np.searchsorted(self._frames, frame))
        if k == len(self._frames) or self._frames[k] != frame:
            raise KeyError(frame)
        inside = slice(self._start[k], self._start[k + 1])
        return [
            self._tracks[number].person(row)
            for number, row in zip(self._number[inside].tolist(), self._row[inside].tolist(), strict=True)
        ]

    def __iter__(self) -> Iterator[int]:
        return iter(self._frames.tolist())

    def __len__(self) -> int:
        return len(self._frames)


@dataclass(frozen=True, eq=False)
class _Shown:
    """Where somebody is in the picture.

    Attributes
    ----------
    place, seen : (n, 4) boxes of the rows of the track, and whether they were seen (n,)
    angles : (n, 4) of body and head, each with its standard deviation
    pixel : (n, 2) of the feet
    first : (n,) row at which the path begins that is drawn at each
    """

    track: Track
    place: FloatArray
    seen: NDArray[np.bool_]
    angles: FloatArray
    pixel: FloatArray
    first: NDArray[np.int64]

    def person(self, row: int) -> ShownPerson:
        """The person in a row."""
        body, body_std, head, head_std = self.angles[row].tolist()
        return ShownPerson(
            self.track.track_id,
            self.place[row],
            bool(self.seen[row]),
            self.track.position[row],
            body,
            body_std,
            head,
            head_std,
            self.pixel[self.first[row] : row + 1],
        )


def shown_by_frame(
    estimates: TrackSet,
    observations: TrackSet,
    boxes: Sequence[PersonBox],
    camera: GroundCamera,
    *,
    trail: float = 4.0,
) -> ShownPeople:
    """What there is to draw in each frame.

    Parameters
    ----------
    estimates, observations : matched by ``track_id``; the latter from `numbered` or `associated`
    boxes : that were looked at
    trail : seconds of the path
    """
    observed = {track.track_id: track for track in observations}
    found = []
    for track in estimates:
        place, seen = _boxes_of(track, observed[track.track_id], boxes, camera)
        angles = np.column_stack([*_angle(track, "body"), *_angle(track, "head")])
        first = np.searchsorted(track.t, track.t - trail)
        pixel = camera.ground_to_image(track.position)
        found.append(_Shown(track, place, seen, angles, pixel, first))
    return ShownPeople(found)


def boxes_shown(people: Mapping[int, Sequence[ShownPerson]]) -> PersonBoxes:
    """The boxes of what `shown_by_frame` found."""
    frame: list[int] = []
    number: list[int] = []
    box: list[FloatArray] = []
    for one, of_frame in people.items():
        frame += [one] * len(of_frame)
        number += [person.track_id for person in of_frame]
        box += [person.box for person in of_frame]
    return PersonBoxes(
        np.array(frame, np.int64), np.array(number, np.int64), np.array(box, float).reshape(-1, 4)
    )


def _angle(track: Track, name: str) -> tuple[FloatArray, FloatArray]:
    unknown = np.full(len(track), np.nan)
    angle, std = getattr(track, name), track.std("body" if name == "body" else "head")
    return unknown if angle is None else angle, unknown if std is None else std


def _boxes_of(
    track: Track, observation: Track, boxes: Sequence[PersonBox], camera: GroundCamera
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Boxes (n, 4) of the rows of an estimate, and whether they were seen (n,).

    Between two that were seen there are those of the estimated feet, of sizes in between.
    """
    number = observation.inputs[BOX].reshape(-1)
    known = np.flatnonzero(np.isfinite(number))
    at = {int(observation.frame[k]): boxes[int(number[k])].box for k in known.tolist()}
    seen = np.array([frame in at for frame in track.frame.tolist()])
    found = np.full((len(track), 4), np.nan)
    if not seen.any():
        return found, seen
    found[seen] = [at[frame] for frame in track.frame[seen].tolist()]
    for side in (2, 3):
        found[~seen, side] = np.interp(track.t[~seen], track.t[seen], found[seen, side])
    feet = camera.ground_to_image(track.position[~seen])
    found[~seen, 0], found[~seen, 1] = feet[:, 0] - found[~seen, 2] / 2.0, feet[:, 1] - found[~seen, 3]
    return found, seen
