"""Tracks as an MCAP file of ROS 2's messages, for robots, and for Foxglove and RViz to draw."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.ros.choice import OURS, OWN_INPUT
from graphtrack.ros.definitions import DETECTIONS, IDS, MARKERS, PEOPLE, SCENE, need_rosbags, typestore
from graphtrack.ros.drawings import markers_message, scene_message
from graphtrack.ros.estimates import (
    Person,
    detections_message,
    header_of,
    ids_message,
    people_message,
    person_of,
    quantities_of,
)
from graphtrack.ros.making import Made
from graphtrack.ros.repeated import Repeated
from graphtrack.ros.rotation import variance_of

if TYPE_CHECKING:
    from graphtrack.tracks import Track, TrackSet

FRAME = "map"
"""The frame of reference where none is known: a ground that does not move, by REP 105."""

TOPICS: Mapping[str, str] = {
    f"{OURS}people": PEOPLE,
    OWN_INPUT: DETECTIONS,
    f"{OURS}tracked": IDS,
    f"{OURS}markers": MARKERS,
    f"{OURS}scene": SCENE,
}
"""Topic → type of what is written."""

_DRAWN = (MARKERS, SCENE)
_BETWEEN_DRAWINGS = 95_000_000
"""Nanoseconds from one drawing to the next, at least: ten a second are seen as motion."""

_LATEST = 2**31 * 10**9
_CHUNK = 4 * 2**20
_AT_A_TIME = 4096
"""People times moments that are written together."""


def message_for(kind: str, make: Any, stamp: int, frame_id: str, people: list[Person]) -> Any:
    """Estimates of people at a time (ns) as a message of one of the types of `TOPICS`."""
    if kind == SCENE:
        return scene_message(make, stamp, frame_id, people)
    if kind == MARKERS:
        return markers_message(make, stamp, frame_id, people)
    build: Mapping[str, Callable[..., Any]] = {
        PEOPLE: people_message,
        DETECTIONS: detections_message,
        IDS: ids_message,
    }
    return build[kind](make, header_of(make, stamp, frame_id), people)


class Moments(NamedTuple):
    """Times at which the same people are told of in the same way.

    Attributes
    ----------
    stamps : (m,) nanoseconds
    people : as they are at the first
    quantities : (m, people, 23)
    """

    stamps: NDArray[np.int64]
    people: list[Person]
    quantities: FloatArray


def write_mcap(tracks: TrackSet, path: Path) -> None:
    """Write tracks; the topics are those of `TOPICS`."""
    need_rosbags()
    from mcap.writer import Writer

    frame_id = (tracks.as_read.frame if tracks.as_read is not None else "") or FRAME
    store = typestore()
    make = Made(store)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK)
        writer.start(profile="ros2", library="graphtrack")
        channels = {}
        for topic, kind in TOPICS.items():
            text = store.generate_msgdef(kind, ros_version=2)[0]
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channels[kind] = writer.register_channel(topic, "cdr", schema)
        drawn = -_BETWEEN_DRAWINGS
        for moments in moments_of(tracks):
            draws = np.zeros(len(moments.stamps), dtype=bool)
            for k, stamp in enumerate(moments.stamps.tolist()):
                if stamp - drawn >= _BETWEEN_DRAWINGS:
                    draws[k], drawn = True, stamp
            found: list[tuple[int, int, bytes]] = []
            for kind, channel in channels.items():
                said = draws if kind in _DRAWN else np.ones_like(draws)

                def serialised(stamp: int, people: list[Person], kind: str = kind) -> Any:
                    return store.serialize_cdr(message_for(kind, make, stamp, frame_id, people), kind)

                stamps = moments.stamps[said]
                if len(stamps):
                    raw = Repeated(serialised, moments.people).messages(stamps, moments.quantities[said])
                    found += zip(stamps.tolist(), [channel] * len(stamps), raw, strict=True)
            for stamp, channel, data in sorted(found, key=lambda one: one[:2]):
                writer.add_message(channel, log_time=stamp, publish_time=stamp, data=data)
        writer.finish()


def moments_of(tracks: TrackSet) -> Iterator[Moments]:
    """People time by time, in nanoseconds since 1970, or since the beginning where no date is known."""
    if not len(tracks):
        return
    scale = None if tracks.as_read is None else tracks.as_read.time
    names = {} if tracks.as_read is None else tracks.as_read.names
    stamps = np.concatenate([np.rint(track.t * 1e9).astype(np.int64) for track in tracks])
    stamps += 0 if scale is None else scale.origin
    if stamps.min() < 0 or stamps.max() >= _LATEST:
        found = stamps.min() if stamps.min() < 0 else stamps.max()
        raise InputError(f"the time {found / 1e9:g} s", "times from 1970 to 2038, which ROS can hold")
    state = np.concatenate([_state(track) for track in tracks])
    who = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    order = np.lexsort((who, stamps))
    order = order[np.isfinite(state[order, 0])]
    stamps, state, who = stamps[order], state[order], who[order]
    said = [names.get(one.track_id, str(one.track_id)) for one in tracks]
    labels = [one.label or name for one, name in zip(tracks, said, strict=True)]
    known = np.isfinite(state[:, [2, 4, 5, 6]])
    # Two moments are alike if the same people are known in the same way.
    edges = np.flatnonzero(np.diff(stamps, prepend=-1, append=_LATEST)).tolist()
    codes = who * 16 + known @ np.array([1, 2, 4, 8])
    first = 0
    for k in range(1, len(edges)):
        here, begun = slice(edges[k - 1], edges[k]), slice(edges[first], edges[first + 1])
        goes_on = k < len(edges) - 1 and edges[k] - edges[first] < _AT_A_TIME
        after = slice(edges[k], edges[k + 1]) if goes_on else here
        if goes_on and np.array_equal(codes[after], codes[begun]):
            continue
        rows = slice(edges[first], edges[k])
        quantities, of_rows = quantities_of(state[rows])
        size = edges[first + 1] - edges[first]
        people = [
            person_of(said[i], labels[i], int(i), numbers, flags)
            for i, numbers, flags in zip(who[begun], quantities[:size], of_rows[:size], strict=True)
        ]
        yield Moments(stamps[rows][::size], people, quantities.reshape(k - first, size, -1))
        first = k


def _state(track: Track) -> FloatArray:
    """State of a person, (n, 12) in the order of `graphtrack.ros.estimates.STATE`."""
    n = len(track)

    def of(values: FloatArray | None) -> FloatArray:
        return np.full(n, np.nan) if values is None else values

    velocity = np.full((n, 2), np.nan) if track.velocity is None else track.velocity
    if track.covariance is not None:
        cov = track.covariance
        spread = [cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1], cov[:, 4, 4], cov[:, 5, 5]]
    else:
        variance = of(track.position_std) ** 2
        of_angles = [variance_of(of(one)) for one in (track.body_kappa, track.head_kappa)]
        spread = [variance, np.where(np.isfinite(variance), 0.0, np.nan), variance, *of_angles]
    score = of(track.score)
    known = np.where(np.isfinite(score), score, 1.0)
    return np.column_stack([track.position, velocity, of(track.body), of(track.head), *spread, known])
