"""Metrics from counts: of a sequence, and of all sequences together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from graphtrack.display import LONGEST, MOST, counted, html_table
from graphtrack.evaluation.tracking.clear import ClearCounts, clear_counts
from graphtrack.evaluation.tracking.hota import ALPHAS, HotaCounts, hota_counts
from graphtrack.evaluation.tracking.identity import IdentityCounts, identity_counts
from graphtrack.evaluation.tracking.similarity import SharedFrames, Summed

TOGETHER = "together"

Measure = Literal["metres", "iou"]

HEADINGS = {
    "hota": "HOTA",
    "det_a": "DetA",
    "ass_a": "AssA",
    "loc_a": "LocA",
    "idf1": "IDF1",
    "idp": "IDP",
    "idr": "IDR",
    "mota": "MOTA",
    "motp": "MOTP",
    "precision": "precision",
    "recall": "recall",
    "switches": "identity switches",
    "fragmentations": "fragmentations",
    "false_positives": "false positives",
    "misses": "misses",
    "mostly_tracked": "mostly tracked",
    "partly_tracked": "partly",
    "mostly_lost": "mostly lost",
}
"""Figure → what tables call it."""

SHARES, COUNTS = tuple(HEADINGS)[:11], tuple(HEADINGS)[11:]
"""The figures of which 1 is best, and those that are numbers of rows, events and people."""

IN_SHORT = ("hota", "det_a", "ass_a", "idf1", "mota", "precision", "recall", "switches", "fragmentations")


@dataclass(frozen=True)
class Threshold:
    """The largest distance or least overlap of two detections of the same person.

    Attributes
    ----------
    measure : "metres", the distance on the ground at most, or "iou", the overlap of boxes at least
    value : in metres, or from 0 to 1
    """

    measure: Measure
    value: float

    @property
    def similarity(self) -> float:
        """The similarity from which on two detections can match; on the ground 0 is twice the distance."""
        return 0.5 if self.measure == "metres" else self.value

    def distance(self, similarity: float) -> float | None:
        """The distance in metres that a similarity stands for; None in the image."""
        return 2.0 * self.value * (1.0 - similarity) if self.measure == "metres" else None

    def __str__(self) -> str:
        return f"within {self.value:g} m" if self.measure == "metres" else f"IoU from {self.value:g}"


@dataclass(frozen=True)
class SequenceScore:
    """Metrics of tracks and identities in one sequence, or in all together.

    Attributes
    ----------
    name : of the sequence
    frames : those with anybody in the truth or the estimates
    people, tracks : identities of the truth and of the estimates
    rows, estimated_rows : detections of each
    hota, det_a, ass_a, loc_a : HOTA and its parts, means over the 19 demands α of ``curves``
    idf1, idp, idr : of the best lasting pairing of people and tracks
    mota : below 0 where errors outnumber people
    motp : mean similarity of the matches
    mean_distance : of the matches, in metres; None in the image, and where nothing matches
    precision, recall : shares of the estimates and of the truth that are matched
    matches, misses, false_positives : rows
    switches, fragmentations : how often a person's track changes, and is found again after having been lost
    mostly_tracked, partly_tracked, mostly_lost : people found in more than 80 % of their frames, in between,
        and in less than 20 %
    curves : "alpha", "HOTA", "DetA", "AssA", "DetRe", "DetPr", "AssRe", "AssPr", "LocA" → 19 values
    """

    name: str
    frames: int
    people: int
    tracks: int
    rows: int
    estimated_rows: int
    hota: float
    det_a: float
    ass_a: float
    loc_a: float
    idf1: float
    idp: float
    idr: float
    mota: float
    motp: float
    mean_distance: float | None
    precision: float
    recall: float
    matches: int
    misses: int
    false_positives: int
    switches: int
    fragmentations: int
    mostly_tracked: int
    partly_tracked: int
    mostly_lost: int
    curves: Mapping[str, tuple[float, ...]]

    def shown(self, names: tuple[str, ...] = tuple(HEADINGS)) -> dict[str, Any]:
        """Some of the figures by what tables call them."""
        return {HEADINGS[name]: getattr(self, name) for name in names}


@dataclass(frozen=True)
class TrackingScore:
    """Metrics of tracks and identities.

    Attributes
    ----------
    sequences : each by itself
    together : of the sums over all sequences
    threshold : how close two detections have to be
    notes : what was left out, one sentence each
    """

    sequences: tuple[SequenceScore, ...]
    together: SequenceScore
    threshold: Threshold
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        all_of_it = self.together
        figures = f"HOTA {all_of_it.hota:.3f}, IDF1 {all_of_it.idf1:.3f}, MOTA {all_of_it.mota:.3f}"
        return f"TrackingScore({figures}; {counted(len(self.sequences), 'sequence')}, {self.threshold})"

    def _repr_html_(self) -> str:
        lines = self.sequences if len(self.sequences) == 1 else (self.together, *self.sequences)
        rows = [
            (one.name[:LONGEST], *(_cell(value) for value in one.shown(IN_SHORT).values()))
            for one in lines[: MOST + 1]
        ]
        header = ("", *(HEADINGS[name] for name in IN_SHORT))
        return html_table(repr(self), header, rows, max(0, len(lines) - MOST - 1))

    def lines(self) -> tuple[SequenceScore, ...]:
        """The lines of a table: the sequences and, of several, all together."""
        return self.sequences if len(self.sequences) == 1 else (*self.sequences, self.together)

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types, ready for JSON."""
        return {
            "measure": self.threshold.measure,
            "threshold": self.threshold.value,
            "together": _plain(self.together),
            "sequences": [_plain(one) for one in self.sequences],
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Counts(Summed):
    """All that is counted in one sequence, or in several."""

    frames: int
    people: int
    tracks: int
    hota: HotaCounts
    identity: IdentityCounts
    clear: ClearCounts


def count(frames: SharedFrames, threshold: Threshold) -> Counts:
    """Count all that figures are made of in one sequence."""
    return Counts(
        frames=len(frames),
        people=len(frames.truth_rows),
        tracks=len(frames.estimate_rows),
        hota=hota_counts(frames),
        identity=identity_counts(frames, threshold.similarity),
        clear=clear_counts(frames, threshold.similarity),
    )


def figures(name: str, counts: Counts, threshold: Threshold) -> SequenceScore:
    """The figures that follow from what was counted."""
    clear, identity, curves = counts.clear, counts.identity, counts.hota.curves()
    means = {"hota": "HOTA", "det_a": "DetA", "ass_a": "AssA", "loc_a": "LocA"}
    alike: dict[str, Any] = {key: float(curves[curve].mean()) for key, curve in means.items()}
    alike |= {
        name: getattr(clear, name) for name in ("mota", "motp", "precision", "recall", "matches", *COUNTS)
    }
    return SequenceScore(
        name=name,
        frames=counts.frames,
        people=counts.people,
        tracks=counts.tracks,
        rows=clear.matches + clear.misses,
        estimated_rows=clear.matches + clear.false_positives,
        idf1=identity.idf1,
        idp=identity.idp,
        idr=identity.idr,
        mean_distance=threshold.distance(clear.motp) if clear.matches else None,
        **alike,
        curves={key: tuple(values.tolist()) for key, values in {"alpha": ALPHAS, **curves}.items()},
    )


def _plain(score: SequenceScore) -> dict[str, Any]:
    return asdict(score) | {"curves": {name: list(values) for name, values in score.curves.items()}}


def _cell(value: float) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
