"""Page sections on groups, gaze and forecasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.interaction.attention import Attention, LookSummary, summary_of
from graphtrack.interaction.groups import KINDS, Groups
from graphtrack.report.content import Card, DataTable, Note, Picture, Section
from graphtrack.report.interaction import Behaviour, by_main_group, group_spans, rows_of_each
from graphtrack.report.lives import Pair
from graphtrack.report.plots.interaction import (
    MOST,
    named_targets,
    plot_group_timeline,
    plot_heat_map,
    plot_look_timeline,
    plot_matrix,
)
from graphtrack.report.plots.interaction import MOST as MOST_GROUPS
from graphtrack.tracks.gaps import positions_at
from graphtrack.tracks.track import TrackSet

_LISTED = 8
"""Most members and intervals listed in a cell."""


def behaviour_sections(behaviour: Behaviour, tracks: TrackSet, pairs: Sequence[Pair]) -> list[Section]:
    """Return sections on groups, gaze and forecasts, if given.

    Parameters
    ----------
    behaviour : groups, gaze and forecasts with the times of the tracks
    tracks : tracks of the page
    pairs : the tracks with their truth, against which forecasts are scored if it is known
    """
    found, names = [], {pair.estimate.track_id: pair.name for pair in pairs}
    if behaviour.groups is not None:
        found.append(_groups_section(behaviour.groups, names))
    if behaviour.attention is not None:
        found.append(_gaze_section(behaviour, behaviour.attention, tracks, names))
    if behaviour.forecasts is not None:
        found.append(_forecast_section(behaviour.forecasts, pairs))
    return found


def behaviour_cards(behaviour: Behaviour) -> tuple[Card, ...]:
    """Return the number of groups, and the share of time with gaze at a person or place."""
    cards = []
    if behaviour.groups is not None:
        grouped = float(np.mean(behaviour.groups.group >= 0)) if len(behaviour.groups) else 0.0
        number = len(np.unique(behaviour.groups.group[behaviour.groups.group >= 0]))
        cards.append(Card("Groups", str(number), f"{100 * grouped:.0f} % of the person-frames in one"))
    if behaviour.attention:
        nothing = np.concatenate([one.probability[:, -1] for one in behaviour.attention])
        if np.isfinite(nothing).any():
            observed = 100.0 * (1.0 - float(np.nanmean(nothing)))
            cards.append(Card("Gaze", f"{observed:.0f} %", "of the time at a person or a place"))
    return tuple(cards)


def _groups_section(groups: Groups, names: Mapping[int, str]) -> Section:
    spans = group_spans(groups)
    if not spans:
        return Section("Groups", (Note("No groups were found."),))
    words = (
        "Groups over time, with their members over all of it; the height of a band is the number of members, "
        "with minimum and maximum at its end; hatched: walking together"
    )
    if len(spans) > MOST_GROUPS:
        words += f". The {MOST_GROUPS} of {len(spans)} with most person-seconds"
    picture = Picture(words, plot_group_timeline(groups, spans, names), f"Time spans of {len(spans)} groups.")
    rows = [
        {
            "group": span.number,
            "kind": KINDS[span.kind],
            "from (s)": span.start,
            "to (s)": span.end,
            "members at a time": round(span.mean, 1),
            "who": _listed([names[one] for one in span.members]),
            "probability": round(span.probability, 2),
        }
        for span in spans
    ]
    note = (
        "A group keeps its number while most of its members stay. Who: all members over time, longest "
        "membership first. Probability: mean membership probability."
    )
    return Section("Groups", (picture, DataTable.of("All groups", rows, note)))


def _gaze_section(
    behaviour: Behaviour, attention: Sequence[Attention], tracks: TrackSet, names: Mapping[int, str]
) -> Section:
    summary = summary_of(attention)
    if not len(summary.people):
        return Section("Gaze", (Note("There are no gaze estimates."),))
    order = by_main_group(behaviour.groups, summary.people)
    of = f" of the first {MOST} of {len(order)} people" if len(order) > MOST else ""
    longest = f", the {MOST} with most gaze at others" if of else ""
    pictures = (
        Picture(
            "Gaze on the ground: seconds of gaze at the positions of people and places; grey: all paths",
            plot_heat_map(tracks, behaviour.places, attention),
            "Heat map of gaze on the ground.",
        ),
        Picture(
            f"Gaze between people{of}, % of the looking person's time; members of a group are adjacent"
            if behaviour.groups is not None
            else f"Gaze between people{of}, % of the looking person's time",
            plot_matrix(summary, order, names),
            "Matrix of gaze between people.",
        ),
        Picture(
            f"Most probable gaze target of each person{longest}, in the target's colour; "
            "blank: none of these",
            plot_look_timeline(attention, names),
            "Timeline of looks.",
        ),
    )
    missing = sorted(set(attention[0].places) - {place.name for place in behaviour.places})
    notes = (
        (Note(f"No position of {', '.join(missing)} was given: gaze there is in no map."),) if missing else ()
    )
    tables = (*_dwell(summary, names), _persons(summary, names), *_mutual(summary, names))
    return Section("Gaze", (*pictures, *notes, *tables))


def _dwell(summary: LookSummary, names: Mapping[int, str]) -> list[DataTable]:
    rows: list[dict[str, Any]] = [
        {
            "person": names[person],
            "place": place,
            "seconds": round(seconds, 1),
            "of the time (%)": round(
                100.0 * seconds / max(float(summary.matrix[summary.people.index(person)].sum()), 1e-9), 1
            ),
            "looks": len(intervals),
            "likelier than not (s)": _listed([f"{start:.1f}–{end:.1f}" for start, end in intervals]) or "–",
        }
        for place, people in summary.dwell.items()
        for person, (seconds, intervals) in people.items()
        if seconds >= 0.05
    ]
    if not rows:
        return []
    rows.sort(key=lambda row: (row["place"], -row["seconds"]))
    note = (
        "Seconds are expected values, the sum of probabilities; looks and their intervals are the times in "
        "which the probability of gaze at the place exceeds one half."
    )
    return [DataTable.of("Gaze at places", rows, note, person_column="person")]


def _persons(summary: LookSummary, names: Mapping[int, str]) -> DataTable:
    rows, targets = [], named_targets(summary, names)
    for k, person in enumerate(summary.people):
        spent = summary.matrix[k]
        best = int(np.argmax(spent[:-1]))
        target, seconds = targets[best], round(float(spent[best]), 1)
        rows.append(
            {
                "person": names[person],
                "looks most at": target if spent[best] > 0.0 else None,
                "for (s)": seconds if spent[best] > 0.0 else None,
                "at nothing (%)": round(100.0 * float(spent[-1]) / max(float(spent.sum()), 1e-9), 1),
                "looked at by others (s)": round(float(summary.matrix[:, k].sum()), 1),
            }
        )
    return DataTable.of("Gaze of each person", rows, person_column="person")


def _mutual(summary: LookSummary, names: Mapping[int, str]) -> list[DataTable]:
    rows = [
        {"person": names[a], "and": names[b], "seconds": round(seconds, 1)}
        for (a, b), seconds in sorted(summary.mutual.items(), key=lambda item: -item[1])
        if seconds >= 0.05
    ]
    return [DataTable.of("Mutual gaze, longest first", rows, person_column="person")] if rows else []


def _forecast_section(columns: Mapping[str, NDArray[Any]], pairs: Sequence[Pair]) -> Section:
    error = _errors(columns, pairs)
    times, rows = np.round(columns["ahead"], 6), []
    for ahead in np.unique(times).tolist():
        at = times == ahead
        known = at & np.isfinite(error)
        row: dict[str, float | None] = {"ahead (s)": ahead, "forecasts": int(at.sum())}
        for share in (50, 90):
            row[f"{share} % radius (m)"] = round(float(np.median(columns[f"radius_{share}"][at])), 3)
        row |= {
            "judged": int(known.sum()),
            "error (m)": None,
            "inside 50 % (%)": None,
            "inside 90 % (%)": None,
        }
        if known.any():
            row["error (m)"] = round(float(error[known].mean()), 3)
            for share in (50, 90):
                inside = error[known] <= columns[f"radius_{share}"][known]
                row[f"inside {share} % (%)"] = round(100.0 * float(inside.mean()), 1)
        rows.append(row)
    true = any(np.isfinite(pair.true_position).any() for pair in pairs)
    note = (
        "Radii are medians. Forecasts are scored where the person's later position is known: "
        + ("by the true positions." if true else "by the positions of the tracks.")
        + " 'graphtrack score' gives all scores."
    )
    return Section("Forecasts", (DataTable.of("Forecasts by time ahead", rows, note),))


def _errors(columns: Mapping[str, NDArray[Any]], pairs: Sequence[Pair]) -> FloatArray:
    """Return (rows,) errors of the forecasts in metres; NaN if the later position is unknown."""
    error = np.full(len(columns["t"]), np.nan)
    of = {pair.estimate.track_id: pair for pair in pairs}
    for person, rows in rows_of_each(columns["track_id"]):
        pair = of[person]
        true = np.isfinite(pair.true_position).any()
        position = pair.true_position if true else pair.estimate.position
        then = positions_at(pair.estimate.t, position, columns["t"][rows] + columns["ahead"][rows])
        error[rows] = np.hypot(then[:, 0] - columns["x"][rows], then[:, 1] - columns["y"][rows])
    return error


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more
