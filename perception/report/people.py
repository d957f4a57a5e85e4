"""Who is who in what was seen, where everybody is, and in which box."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.tracks import associate
from graphtrack.errors import InputError
from graphtrack.evaluation.methods import make_method, own_model
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import engine_of
from graphtrack.inference.solution import Solution
from graphtrack.model import Model
from graphtrack.smoothing.recording import solve_tracks
from graphtrack.table.columns import to_columns
from graphtrack.tracks import Track, TrackSet
from graphtrack.viewer.pictures import PersonBoxes
from perception.detection.boxes import PersonBox

METHODS = ("smoother", "ffbs", "particle", "chain", "isam2", "fixed-lag")
"""The graph's smoother; Chen et al.'s joint particle filter, smoothed (``ffbs``) or online (``particle``);
the graph online."""
FILTERS = ("ffbs", "particle")
"""What a camera teaches itself of the graph's share of outliers is none of theirs: they forget as they go."""

_BOX = "box"
"""The input of a track that says which box each row was seen in; NaN in rows of nothing."""


def who_is_who(tracks: TrackSet, boxes: Sequence[PersonBox], *, identified: bool) -> TrackSet:
    """Tracks of people, each row of which knows the number of its box.

    Parameters
    ----------
    tracks : as `perception.observe.pipeline.to_tracks` makes them; without identities one for each box
    boxes : that were looked at
    identified : whether the boxes say who is in them; else that is found out

    Raises
    ------
    InputError
        If everything was taken for false.
    """
    if identified:
        number = {(item.track_id, item.frame): k for k, item in enumerate(boxes)}
        return tracks.map(lambda track: _numbered(track, number))
    columns = to_columns(tracks)
    ids = columns["track_id"]
    columns["track_id"] = np.full(len(ids), -1)
    return who_is_who_of({name: values for name, values in columns.items() if name != "label"}, ids, boxes)


def who_is_who_of(
    columns: Mapping[str, NDArray[Any]], number: NDArray[np.int64], boxes: Sequence[PersonBox]
) -> TrackSet:
    """The same of a table of detections.

    Parameters
    ----------
    columns : as `perception.observe.detections.to_detections` makes them
    number : (n,) of each row's box
    boxes : that were looked at
    """
    of_box = {item.track_id: k for k, item in enumerate(boxes)}
    found = associate({**columns, f"input_{_BOX}": np.array([of_box[k] for k in number.tolist()], float)})
    if not len(found):
        raise InputError("detections that are all taken for false", "people who are seen for a while")
    return found


def _numbered(track: Track, number: Mapping[tuple[int, int], int]) -> Track:
    of_rows = [number[track.track_id, frame] for frame in track.frame.tolist()]
    return replace(track, inputs={**track.inputs, _BOX: np.array(of_rows, float)})


def estimated(
    tracks: TrackSet,
    camera: GroundCamera,
    method: str,
    advance: Callable[[int], None],
    adapted: Callable[[Model], Model] = lambda model: model,
) -> tuple[TrackSet, list[str]]:
    """Where everybody is, how they move and point, and what is to be said of it.

    Parameters
    ----------
    tracks : of observations
    camera : over the ground
    method : one of `METHODS`
    advance : is told of person-frames that are done
    adapted : makes of a model that of the camera, as `CameraModels.graph`

    Raises
    ------
    InputError
        If nobody's track can be estimated.
    """
    chosen = make_method(method, adapted(own_model(method)))
    placed = replace(tracks, camera=camera)
    said: list[str] = []
    if method == "smoother":
        model = adapted(Model.named(None))
        found = solve_tracks(placed, model, engine_of(model), progress=advance)
        good = [result.track for result in found if isinstance(result, Solution)]
        bad = [one for one in found if not isinstance(one, Solution)]
        said += [f"track {one.track_id} is left out: {one.reason}" for one in bad]
    else:
        good = []
        for track in placed:
            good.append(chosen.estimate(track, camera))
            advance(len(track))
    if not good:
        raise InputError("no track that can be estimated", "people who are seen for a while")
    return placed.with_tracks(good), [f"estimates by `{method}`: {chosen.information}", *said]


@dataclass(frozen=True, eq=False)
class ShownPerson:
    """An estimated person in one frame.

    Attributes
    ----------
    track_id : whose colour it has
    box : (4,) left, top, width, height in pixels
    seen : whether somebody was seen there; else the box is where it should be
    position : (2,) metres
    body, body_std, head, head_std : radians; NaN where not known
    path : (n, 2) pixels, on the ground, of the last seconds
    """

    track_id: int
    box: FloatArray
    seen: bool
    position: FloatArray
    body: float
    body_std: float
    head: float
    head_std: float
    path: FloatArray


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
    estimates, observations : matched by ``track_id``; the observations are as `who_is_who` has them
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
    number = observation.inputs[_BOX].reshape(-1)
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
