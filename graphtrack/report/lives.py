"""Estimates aligned with observations, and each person's birth, death, gaps and identity probability."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.report.content import Card, Chart, DataTable, Section
from graphtrack.report.style import longest_step
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import finite_rows

if TYPE_CHECKING:
    from graphtrack.evaluation.identity_events import IdentityEvent


@dataclass(frozen=True, eq=False)
class Pair:
    """One person's estimate, with the observations if there are any.

    Attributes
    ----------
    estimate : Track
    observation : Track or None
    name : the name of the person, unique on the page
    was_observed : (n,) bool
        True if the position was observed at a frame of the estimate; without observations, the flag of the
        estimate, None if it has none.
    observed_position : (n, 2) metres, the observed position at the estimate's frames; NaN where there is none
    observed_body, observed_head : (n,) radians, the observed angles there; NaN where there are none
    observed_covariance : (n, 2, 2) m², that of ellipses of observed positions; NaN where there is none
    sensor : (n,) names of the sensors; "" without one
    true_position, true_body, true_head : (n, 2), (n,), (n,)
        Truth at the frames of the estimate, from either track; NaN if unknown.
    """

    estimate: Track
    observation: Track | None
    name: str
    was_observed: NDArray[np.bool_] | None
    observed_position: FloatArray
    observed_body: FloatArray
    observed_head: FloatArray
    observed_covariance: FloatArray
    sensor: NDArray[np.str_]
    true_position: FloatArray
    true_body: FloatArray
    true_head: FloatArray

    @property
    def label(self) -> str:
        """The person's label, from either track; empty if there is none, or if it is the name."""
        label = self.estimate.label or (self.observation.label if self.observation is not None else "")
        return "" if label == self.name else label

    @property
    def title(self) -> str:
        """The name to display alone: ``person`` before an id, and the label if there is one."""
        name = f"person {self.name}" if self.name == str(self.estimate.track_id) else self.name
        return name + (f" ({self.label})" if self.label else "")

    def true_angle(self, name: str) -> FloatArray:
        """The true ``body`` or ``head`` (radians, (n,))."""
        return self.true_body if name == "body" else self.true_head


def pair_track(estimate: Track, observation: Track | None = None, name: str = "") -> Pair:
    """Align the observations and the truth of one person with the frames of the estimate.

    Parameters
    ----------
    name : the name of the person; by default the id
    """
    n = len(estimate)
    observed_position, ellipses = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    was_observed: NDArray[np.bool_] | None = None
    if observation is None and estimate.observed is not None:
        was_observed = np.asarray(estimate.observed != 0.0)
    if observation is not None:
        observed_position = _at_frames(observation.position, observation, estimate)
        was_observed = finite_rows(observed_position)
        if observation.position_covariance is not None:
            ellipses = _at_frames(observation.position_covariance, observation, estimate)
        if observation.pixel is not None:
            # A foot point in the image is an observation too, although it has no ground position yet.
            was_observed |= finite_rows(_at_frames(observation.pixel, observation, estimate))

    def truth(name: str, shape: tuple[int, ...]) -> FloatArray:
        own = getattr(estimate, name)
        if own is not None:
            return np.asarray(own)
        other = None if observation is None else getattr(observation, name)
        if observation is None or other is None:
            return np.full(shape, np.nan)
        return _at_frames(other, observation, estimate)

    def angle_of_observations(name: str) -> FloatArray:
        observed = None if observation is None else observed_angle(observation, name)
        if observation is None or observed is None:
            return np.full(n, np.nan)
        return _at_frames(observed, observation, estimate)

    return Pair(
        estimate=estimate,
        observation=observation,
        name=name or str(estimate.track_id),
        was_observed=was_observed,
        observed_position=observed_position,
        observed_body=angle_of_observations("body"),
        observed_head=angle_of_observations("head"),
        observed_covariance=ellipses,
        sensor=_sensor_of(estimate, observation),
        true_position=truth("true_position", (n, 2)),
        true_body=truth("true_body", (n,)),
        true_head=truth("true_head", (n,)),
    )


def pair_tracks(estimates: TrackSet, observations: TrackSet | None = None) -> tuple[Pair, ...]:
    """Pair every estimate with the observations of the same ``track_id``, in the order of the estimates."""
    by_id = {} if observations is None else {track.track_id: track for track in observations}
    names = person_names(estimates, observations)
    return tuple(pair_track(one, by_id.get(one.track_id), names[one.track_id]) for one in estimates)


def person_names(estimates: TrackSet, observations: TrackSet | None = None) -> dict[int, str]:
    """Return track id → name (`TrackSet.names`), of the observations where estimates have ids alone."""
    names = estimates.names
    if observations is None or any(name != str(k) for k, name in names.items()):
        return names
    given = observations.names
    found = {k: given.get(k, name) for k, name in names.items()}
    return found if len({*found.values()}) == len(found) else names


def observed_angle(track: Track, name: str) -> FloatArray | None:
    """Return the observed ``body`` or ``head`` (radians, (n,)); None if the track has no such channel.

    If only class likelihoods were observed, the angle is the centre of the most likely class.
    """
    angle = getattr(track, name)
    likelihood = getattr(track, f"{name}_likelihood")
    if likelihood is None:
        return None if angle is None else np.asarray(angle)
    scored = finite_rows(likelihood)
    best = np.full(len(track), np.nan)
    best[scored] = np.argmax(likelihood[scored], axis=1) * (2.0 * np.pi / likelihood.shape[1])
    best = np.where(best > np.pi, best - 2.0 * np.pi, best)
    return best if angle is None else np.where(np.isfinite(angle), angle, best)


def has_angle(pair: Pair, name: str) -> bool:
    """Return True if any ``body`` or ``head`` is known, as an estimate or as an observation."""
    values = [getattr(pair.estimate, name)]
    if pair.observation is not None:
        values.append(observed_angle(pair.observation, name))
    return any(value is not None and np.isfinite(value).any() for value in values)


def _at_frames(values: FloatArray, source: Track, target: Track) -> FloatArray:
    """Return ``values`` of ``source`` at the frames of ``target``; NaN at frames missing in ``source``."""
    out = np.full((len(target), *values.shape[1:]), np.nan)
    there, here = _same_rows(source, target)
    out[here] = values[there]
    return out


def _same_rows(source: Track, target: Track) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows of both tracks that have one frame; where one alone has sensors, one time."""
    if source.sensor is None and target.sensor is None:
        frames = source.frame, target.frame
        _, there, here = np.intersect1d(*frames, assume_unique=True, return_indices=True)
        return there, here
    if source.sensor is None or target.sensor is None:
        nearest = np.clip(np.searchsorted(source.t, target.t - TIME_TOLERANCE), 0, len(source) - 1)
        here = np.flatnonzero(np.abs(source.t[nearest] - target.t) <= TIME_TOLERANCE)
        return nearest[here], here
    # Each sensor counts its own frames.
    row_of = {key: row for row, key in enumerate(zip(source.sensor.tolist(), source.frame, strict=True))}
    rows = [row_of.get(key, -1) for key in zip(target.sensor.tolist(), target.frame, strict=True)]
    here = np.flatnonzero(np.array(rows) >= 0)
    return np.array(rows)[here], here


def _sensor_of(estimate: Track, observation: Track | None) -> NDArray[np.str_]:
    """Return the names of the sensors (n,) at the rows of the estimate."""
    if estimate.sensor is not None:
        return estimate.sensor
    if observation is None or observation.sensor is None:
        return np.full(len(estimate), "")
    found = np.full(len(estimate), "", dtype=observation.sensor.dtype)
    there, here = _same_rows(observation, estimate)
    found[here] = observation.sensor[there]
    return found


UNSURE = 0.9
"""Probability below which a link is shown as uncertain."""

_TITLE = "Identities over time"
_NOTE = (
    "A bar for each person from first to last row, fainter where the identity is less certain. Point at it "
    "for details; a click selects the person and moves the replay to that time. Drag to move, "
    "ctrl + wheel to zoom, double-click to fit."
)


@dataclass(frozen=True)
class Gap:
    """Interval in which a person was not observed.

    Attributes
    ----------
    start : seconds, last observation before the gap, or the first row if there is none
    end : seconds, first observation after the gap, or the last row if there is none
    filled : True if there are estimates in between
    joined : True if the person was observed before and after
    probability : probability that both ends are the same person; NaN if unknown
    """

    start: float
    end: float
    filled: bool
    joined: bool
    probability: float = float("nan")


@dataclass(frozen=True)
class Life:
    """One person from birth to death: times (s) of the first and last row, and the gaps between.

    Attributes
    ----------
    person : the name
    birth, death : seconds
    gaps : gaps in temporal order
    least : probability of the least certain link, across a gap or from one row to the next; NaN: none
    unsure : number of links with a probability below `UNSURE`
    """

    person: str
    birth: float
    death: float
    gaps: tuple[Gap, ...]
    least: float
    unsure: int

    @property
    def joined(self) -> tuple[Gap, ...]:
        """The gaps across which tracks were joined."""
        return tuple(gap for gap in self.gaps if gap.joined)


def is_associated(pairs: Sequence[Pair]) -> bool:
    """Return True if the tracks have identity probabilities: their identities were not in the data."""
    return any(pair.estimate.identity_p is not None for pair in pairs)


def life_of(pair: Pair) -> Life:
    """Return the life of one person, from its rows."""
    track = pair.estimate
    t, sure = track.t, track.identity_p
    # NaN: unknown, as in a table in which only other tracks have the value.
    links = np.empty(0) if sure is None else sure[1:][np.isfinite(sure[1:])]
    return Life(
        person=pair.name,
        birth=float(t[0]),
        death=float(t[-1]),
        gaps=_gaps(t, _observed(pair), sure),
        least=float(links.min()) if len(links) else float("nan"),
        unsure=int(np.count_nonzero(links < UNSURE)),
    )


def least_between(values: FloatArray, at: NDArray[np.intp]) -> FloatArray:
    """Return the minimum of values (n,) since the previous kept row, for each kept row; NaN if all are NaN.

    Parameters
    ----------
    at : (k,) kept rows, increasing, including the last row
    """
    return np.asarray(np.fmin.reduceat(values, np.concatenate([[0], at[:-1] + 1])))


def identities_section(
    pairs: Sequence[Pair], lives: Sequence[Life], events: Sequence[IdentityEvent], drawn: bool
) -> Section:
    """Return the section with the timeline, births, deaths, gaps and joins.

    Parameters
    ----------
    pairs, lives : for every person
    events : identity errors, if the truth is known
    drawn : True if the page has a replay, whose data the timeline uses
    """
    items: list[Chart | DataTable] = [Chart("timeline", _TITLE, _NOTE)] if drawn else []
    items.append(_lives_table(pairs, lives, events))
    items += _gaps_table(lives)
    if events:
        items.append(_events_table(pairs, events))
    return Section("Identities", tuple(items))


def identity_cards(lives: Sequence[Life]) -> tuple[Card, ...]:
    """Return the numbers of joined gaps, and of uncertain joins."""
    joins = [gap for life in lives for gap in life.joined]
    if not joins:
        return ()
    unsure = sum(gap.probability < UNSURE for gap in joins)
    words = f"{unsure} of them less than {UNSURE:.0%} sure".replace("%", "\u202f%")
    return (Card("Gaps joined", str(len(joins)), words),)


def event_times(pairs: Sequence[Pair], events: Sequence[IdentityEvent]) -> list[float]:
    """Return the times of the events in seconds, from the rows of the new track."""
    tracks = {pair.estimate.track_id: pair.estimate for pair in pairs}
    return [float(tracks[one.after].t[np.searchsorted(tracks[one.after].frame, one.frame)]) for one in events]


def _observed(pair: Pair) -> NDArray[np.bool_]:
    if pair.estimate.observed is not None:
        return np.asarray(pair.estimate.observed != 0.0)
    return np.ones(len(pair.estimate), dtype=bool) if pair.was_observed is None else pair.was_observed


def _gaps(t: FloatArray, was_observed: NDArray[np.bool_], sure: FloatArray | None) -> tuple[Gap, ...]:
    rows = np.flatnonzero(was_observed)
    if not len(rows):
        return (Gap(float(t[0]), float(t[-1]), True, False),)
    found = []
    if rows[0] > 0:
        found.append(Gap(float(t[0]), float(t[rows[0]]), True, False))
    before, after = rows[:-1], rows[1:]
    filled = after - before > 1
    for i in np.flatnonzero(filled | (t[after] - t[before] > longest_step(t))).tolist():
        p = float("nan") if sure is None else float(sure[after[i]])
        found.append(Gap(float(t[before[i]]), float(t[after[i]]), bool(filled[i]), True, p))
    if rows[-1] < len(t) - 1:
        found.append(Gap(float(t[rows[-1]]), float(t[-1]), True, False))
    return tuple(found)


def _lives_table(pairs: Sequence[Pair], lives: Sequence[Life], events: Sequence[IdentityEvent]) -> DataTable:
    names = {pair.estimate.track_id: pair.name for pair in pairs}
    switches = Counter(names.get(track) for one in events if one.switch for track in {one.before, one.after})
    rows = [
        {
            "person": life.person,
            "born (s)": life.birth,
            "died (s)": life.death,
            "gaps": len(life.gaps),
            "longest gap (s)": max((gap.end - gap.start for gap in life.gaps), default=None),
            "least sure link": round(life.least, 3),
            "unsure links": life.unsure,
            **({"switches": switches[life.person]} if events else {}),
        }
        for life in lives
    ]
    note = (
        "Born and died: first and last row. The certainty of a link is the probability that a row is "
        f"of the same person as the row before; unsure below {UNSURE:g}."
    )
    if events:
        note += " Switches: identity switches from or to this track."
    return DataTable.of("Births and deaths", rows, note, person_column="person")


def _gaps_table(lives: Sequence[Life]) -> list[DataTable]:
    rows: list[dict[str, Any]] = [
        {
            "person": life.person,
            "from (s)": gap.start,
            "to (s)": gap.end,
            "seconds": gap.end - gap.start,
            "filled in": gap.filled,
            "joined, how sure": round(gap.probability, 3) if gap.joined else None,
        }
        for life in lives
        for gap in life.gaps
    ]
    if not rows:
        return []

    def doubt(row: Mapping[str, Any]) -> tuple[bool, float, float]:
        """Order uncertain joins first, unknown probabilities last."""
        sure = row["joined, how sure"]
        unknown = sure is None or np.isnan(sure)
        return unknown, 0.0 if unknown else sure, row["from (s)"]

    note = (
        "From the last observation of a person to the next, least certain first. A dash: no later "
        "observation, or the probability is unknown."
    )
    return [DataTable.of("Gaps and joins", sorted(rows, key=doubt), note, person_column="person")]


def _events_table(pairs: Sequence[Pair], events: Sequence[IdentityEvent]) -> DataTable:
    names = {pair.estimate.track_id: pair.name for pair in pairs}
    rows = [
        {
            "person": names.get(one.after, str(one.after)),
            "at (s)": t,
            "who it is in the truth": one.person,
            "tracked before as": names.get(one.before, str(one.before)),
            "switch": one.switch,
            "found again": one.found_again,
        }
        for one, t in zip(events, event_times(pairs, events), strict=True)
    ]
    note = "Found again: matched after a loss, which ends a fragmentation. The score counts both kinds."
    return DataTable.of("Switches and fragmentations", rows, note, person_column="person")
