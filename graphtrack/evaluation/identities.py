"""Tracking scores: CLEAR MOT, HOTA and IDF1, of a sequence and of all sequences together.

CLEAR MOT: Bernardin and Stiefelhagen, EURASIP Journal on Image and Video Processing 2008, section 2; mostly
tracked, mostly lost and fragmentations: Li, Huang and Nevatia, CVPR 2009. Open details are as in TrackEval.

HOTA: Luiten et al., International Journal of Computer Vision 129, 2021, section 5. At one α

    HOTA = √(Σ_c A(c) / (TP + FN + FP)),    A(c) = TPA(c) / (TPA(c) + FNA(c) + FPA(c)),

over the matches c, where TPA(c) counts the frames in which the same two are matched, FNA(c) and FPA(c) the
other rows of the true person and of the track. With DetA = TP / (TP + FN + FP) and AssA the mean of A(c) it
is √(DetA·AssA). The figure is the mean over α.

IDF1: Ristani et al., ECCV workshops 2016, section 3.2. True and computed trajectories are paired once for
the whole sequence: IDP = IDTP / (IDTP + IDFP), IDR = IDTP / (IDTP + IDFN),
IDF1 = 2·IDTP / (2·IDTP + IDFP + IDFN).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial, reduce
from itertools import pairwise
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.association.matching import match
from graphtrack.errors import InputError, InputWarning
from graphtrack.evaluation.matching import (
    EPSILON,
    IdentifiedRows,
    IntArray,
    SharedFrames,
    Similarity,
    Summed,
    at_shared_times,
    box_similarity,
    boxes,
    estimated_detections,
    ground_similarity,
    missing_in_words,
    renumbered,
    share_frames,
    true_detections,
)
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.io.read_write import paired_files, read_boxes
from graphtrack.packages import optimize
from graphtrack.tracks.display import LONGEST, MOST, counted, html_table
from graphtrack.tracks.validation import check_positive

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given


MOSTLY_TRACKED, MOSTLY_LOST = 0.8, 0.2
"""Shares of matched rows for mostly tracked and mostly lost people."""

KEEPING = 1000.0
"""Score of a pair kept from the previous frame; above the sum of all similarities of a frame."""

NOBODY = -1


@dataclass(frozen=True)
class ClearCounts(Summed):
    """Counts of CLEAR MOT.

    Attributes
    ----------
    matches, misses, false_positives : rows
    switches : rows of the truth matched to another track than the last time they were matched
    fragmentations : number of times that a person is matched again after a loss
    mostly_tracked, partly_tracked, mostly_lost : people
    similarity : sum over the matches
    """

    matches: int
    misses: int
    false_positives: int
    switches: int
    fragmentations: int
    mostly_tracked: int
    partly_tracked: int
    mostly_lost: int
    similarity: float

    @property
    def mota(self) -> float:
        """1 − (misses + false positives + switches) / rows of the truth; negative with many errors."""
        wrong = self.false_positives + self.switches
        return (self.matches - wrong) / max(1, self.matches + self.misses)

    @property
    def motp(self) -> float:
        """Mean similarity of the matches; 0 without matches."""
        return self.similarity / max(1, self.matches)

    @property
    def recall(self) -> float:
        """The share of the truth that is matched."""
        return self.matches / max(1, self.matches + self.misses)

    @property
    def precision(self) -> float:
        """The share of the estimates that is matched."""
        return self.matches / max(1, self.matches + self.false_positives)


@dataclass(frozen=True, eq=False)
class FrameMatches:
    """Matches in a frame that has both truth and estimates, k pairs.

    Attributes
    ----------
    frame : frame number
    row : (k,) rows of the truth
    truth, estimates : (k,) people and tracks, numbered as in `SharedFrames`
    similarity : (k,)
    before : (k,) last track matched with each person; `NOBODY` at the first match
    lost : (k,) True without a match in the previous frame with truth and estimates
    """

    frame: int
    row: IntArray
    truth: IntArray
    estimates: IntArray
    similarity: FloatArray
    before: IntArray
    lost: BoolArray

    @property
    def switched(self) -> BoolArray:
        """(k,) True if the matched track changed."""
        return (self.before != NOBODY) & (self.before != self.estimates)

    @property
    def found_again(self) -> BoolArray:
        """(k,) True if the person had been lost: end of a fragmentation."""
        return (self.before != NOBODY) & self.lost


def clear_matches(frames: SharedFrames, threshold: float) -> Iterator[FrameMatches]:
    """Match truth and estimates frame by frame.

    Parameters
    ----------
    threshold : minimum similarity of a match
    """
    last = np.full(len(frames.truth_rows), NOBODY, dtype=np.int64)
    now = last.copy()
    # As in TrackEval, a frame without truth or estimates does not end a tracked interval.
    for k in np.flatnonzero(frames.shared).tolist():
        here = slice(frames.start[k], frames.start[k + 1])
        row, column, similarity = frames.row[here], frames.column[here], frames.similarity[here]
        people, tracks = frames.truth[row], frames.estimates[column]
        # Keep pairs of the previous frame first, then maximise similarity.
        worth = np.where(
            similarity >= threshold - EPSILON, KEEPING * (tracks == now[people]) + similarity, 0.0
        )
        found = matched_in_frame(frames, k, worth)
        row, people, tracks = row[found], people[found], tracks[found]
        number, before = int(frames.numbers[k]), last[people]
        yield FrameMatches(number, row, people, tracks, similarity[found], before, now[people] == NOBODY)
        now[:] = NOBODY
        last[people] = now[people] = tracks


def matched_pairs(row: IntArray, column: IntArray, worth: FloatArray) -> IntArray:
    """Return the indices of the pairs (p,) with the greatest total score, each row and column once."""
    if not len(row):
        return np.zeros(0, np.int64)
    rows, i = np.unique(row, return_inverse=True)
    columns, j = np.unique(column, return_inverse=True)
    partner = match((i, j, np.ascontiguousarray(worth, float)), (len(rows), len(columns)))
    return np.flatnonzero((partner[i] == j) & (worth > EPSILON))


MOST_CELLS = 40_000
"""Largest product of the rows of both sides in a frame for which ties are broken as in TrackEval."""


def matched_in_frame(frames: SharedFrames, k: int, worth: FloatArray) -> IntArray:
    """Return the indices of the best pairs as `matched_pairs`, among those of the k-th shared frame.

    Equal scores, as of positions on a grid, are decided by SciPy's assignment of all rows, as in TrackEval.
    """
    here = slice(frames.start[k], frames.start[k + 1])
    row, column = frames.row[here], frames.column[here]
    i, j = row - frames.truth_start[k], column - frames.estimate_start[k]
    shape = tuple(int(first[k + 1] - first[k]) for first in (frames.truth_start, frames.estimate_start))
    if not len(row) or np.prod(shape) > MOST_CELLS:
        return matched_pairs(row, column, worth)
    full = np.zeros(shape)
    full[i, j] = worth
    partner = np.full(shape[0], -1)
    rows, columns = optimize.linear_sum_assignment(full, maximize=True)
    partner[rows] = columns
    return np.flatnonzero((partner[i] == j) & (worth > EPSILON))


def clear_counts(frames: SharedFrames, threshold: float) -> ClearCounts:
    """Match truth and estimates frame by frame, and count.

    Parameters
    ----------
    threshold : minimum similarity of a match
    """
    found = np.zeros(len(frames.truth_rows), dtype=np.int64)
    matches, switches, fragmentations, total = 0, 0, 0, 0.0
    for matched in clear_matches(frames, threshold):
        matches += len(matched.truth)
        switches += int(np.count_nonzero(matched.switched))
        fragmentations += int(np.count_nonzero(matched.found_again))
        total += float(matched.similarity.sum())
        found[matched.truth] += 1
    share = found / frames.truth_rows
    tracked, lost = (int(np.count_nonzero(some)) for some in (share > MOSTLY_TRACKED, share < MOSTLY_LOST))
    n_people = len(frames.truth_rows)
    return ClearCounts(
        matches=matches,
        misses=int(frames.truth_rows.sum()) - matches,
        false_positives=int(frames.estimate_rows.sum()) - matches,
        switches=switches,
        fragmentations=fragmentations,
        mostly_tracked=tracked,
        partly_tracked=n_people - tracked - lost,
        mostly_lost=lost,
        similarity=total,
    )


ALPHAS = np.arange(0.05, 0.99, 0.05)
"""(19,) minimum similarities of a match: α = 0.05, 0.1 … 0.95."""


@dataclass(frozen=True, eq=False)
class HotaCounts(Summed):
    """Sums over the rows, (19,) each, one for each value of `ALPHAS`.

    Attributes
    ----------
    matches, misses, false_positives : TP, FN, FP
    association, association_recall, association_precision : sums over the matches of A(c), and of
        it without FPA(c) or without FNA(c)
    similarity : sum over the matches
    """

    matches: FloatArray
    misses: FloatArray
    false_positives: FloatArray
    association: FloatArray
    association_recall: FloatArray
    association_precision: FloatArray
    similarity: FloatArray

    def curves(self) -> dict[str, FloatArray]:
        """Return the figures at each α, (19,) each: HOTA, DetA, AssA and their parts, and LocA."""
        matches = np.maximum(1.0, self.matches)
        rows = self.matches + self.misses
        detection = self.matches / np.maximum(1.0, rows + self.false_positives)
        association = self.association / matches
        return {
            "HOTA": np.sqrt(detection * association),
            "DetA": detection,
            "AssA": association,
            "DetRe": self.matches / np.maximum(1.0, rows),
            "DetPr": self.matches / np.maximum(1.0, self.matches + self.false_positives),
            "AssRe": self.association_recall / matches,
            "AssPr": self.association_precision / matches,
            # Without matches the localisation error is 0.
            "LocA": np.where(self.matches > 0.0, self.similarity / matches, 1.0),
        }


def hota_counts(frames: SharedFrames) -> HotaCounts:
    """Match truth and estimates with consistent identities, and sum the counts for every α."""
    found = hota_matches(frames)
    truth, estimates = frames.truth[frames.row[found]], frames.estimates[frames.column[found]]
    sums = [_sums(frames, truth, estimates, frames.similarity[found], alpha) for alpha in ALPHAS]
    matches, *rest = np.array(sums).T
    misses, false_positives = frames.truth_rows.sum() - matches, frames.estimate_rows.sum() - matches
    return HotaCounts(matches, misses, false_positives, *rest)


def hota_matches(frames: SharedFrames, threshold: float = 0.0) -> IntArray:
    """Return the indices (k,) of matching pairs; as in TrackEval, one matching serves all α.

    In each frame the matching maximises the sum of similarities, each weighted by the alignment of the two
    over the whole sequence.

    Parameters
    ----------
    threshold : minimum similarity of a match
    """
    worth = _alike(frames) * np.where(frames.similarity >= threshold - EPSILON, frames.similarity, 0.0)
    parts = [
        start + matched_in_frame(frames, k, worth[start:end])
        for k, (start, end) in enumerate(pairwise(frames.start.tolist()))
        if end > start
    ]
    return np.concatenate([*parts, np.zeros(0, np.int64)])


def _alike(frames: SharedFrames) -> FloatArray:
    """Return the alignment over the whole sequence, from 0 to 1, of person and track of each pair (p,).

    It is the number of potentially shared rows over the rows of both. In a frame a pair counts by its
    similarity over all similarities of either of them, so that a crowd contributes at most one row to each.
    """
    row, column, similarity = frames.row, frames.column, frames.similarity
    of_rows, of_columns = np.bincount(row, similarity), np.bincount(column, similarity)
    either = of_rows[row] + of_columns[column] - similarity
    share = np.divide(similarity, either, out=np.zeros_like(either), where=either > EPSILON)
    person, track, common, place = frames.common(share)
    return (common / (frames.truth_rows[person] + frames.estimate_rows[track] - common))[place]


def _sums(
    frames: SharedFrames, truth: IntArray, estimates: IntArray, similarity: FloatArray, alpha: float
) -> tuple[float, ...]:
    """Return the number of matches at one α, and the sums of `HotaCounts` over them."""
    close = similarity >= alpha - EPSILON
    pair, rows = np.unique(truth[close] * len(frames.estimate_rows) + estimates[close], return_counts=True)
    person, track = np.divmod(pair, max(1, len(frames.estimate_rows)))
    of_person, of_track = frames.truth_rows[person], frames.estimate_rows[track]
    return (
        float(rows.sum()),
        float(np.sum(rows * rows / (of_person + of_track - rows))),
        float(np.sum(rows * rows / of_person)),
        float(np.sum(rows * rows / of_track)),
        float(similarity[close].sum()),
    )


@dataclass(frozen=True)
class IdentityCounts(Summed):
    """Rows of the truth and of the estimates under the best pairing: IDTP, IDFN, IDFP."""

    true_positives: int
    misses: int
    false_positives: int

    @property
    def idp(self) -> float:
        """Share of correctly paired estimates."""
        return self.true_positives / max(1, self.true_positives + self.false_positives)

    @property
    def idr(self) -> float:
        """Share of correctly paired rows of the truth."""
        return self.true_positives / max(1, self.true_positives + self.misses)

    @property
    def idf1(self) -> float:
        """The harmonic mean of both."""
        wrong = self.misses + self.false_positives
        return 2 * self.true_positives / max(1, 2 * self.true_positives + wrong)


def identity_counts(frames: SharedFrames, threshold: float) -> IdentityCounts:
    """Pair each true person with at most one track for the whole sequence, and count.

    Minimising misses and false positives maximises the shared rows: each shared row removes one of both.

    Parameters
    ----------
    threshold : minimum similarity of two rows of the same person
    """
    *_, common = identity_pairs(frames, threshold)
    paired = int(common.sum())
    return IdentityCounts(
        paired, int(frames.truth_rows.sum()) - paired, int(frames.estimate_rows.sum()) - paired
    )


def identity_pairs(frames: SharedFrames, threshold: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Return person, track and shared rows (p,) of the best one-to-one pairing over the whole sequence."""
    person, track, common, _ = frames.common((frames.similarity >= threshold).astype(float))
    paired = matched_pairs(person, track, common)
    return person[paired], track[paired], common[paired]


@dataclass(frozen=True)
class GospaCounts(Summed):
    """Sums of GOSPA over the frames (Rahmathullah, García-Fernández & Svensson 2017; p = 2, α = 2).

    Attributes
    ----------
    squared : squared distances of the pairs, in units of the cutoff
    unpaired : rows of the truth and of the estimates without a partner
    frames : frames
    """

    squared: float
    unpaired: int
    frames: int

    @property
    def gospa(self) -> float:
        """The root mean square over frames, in units of the cutoff."""
        return float(np.sqrt((self.squared + 0.5 * self.unpaired) / max(1, self.frames)))


def gospa_counts(frames: SharedFrames) -> GospaCounts:
    """Pair truth and estimates in each frame to minimise GOSPA; beyond the cutoff similarity is 0."""
    squared = np.square(1.0 - frames.similarity)
    found = matched_pairs(frames.row, frames.column, 1.0 - squared)
    rows = int(frames.truth_rows.sum() + frames.estimate_rows.sum())
    return GospaCounts(float(squared[found].sum()), rows - 2 * len(found), len(frames))


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
    "gospa": "GOSPA m",
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
"""Figure → heading in tables."""

SHARES, COUNTS = tuple(HEADINGS)[:12], tuple(HEADINGS)[12:]
"""Figures with 1 as best value, and counts of rows, events and people."""

IN_SHORT = ("hota", "det_a", "ass_a", "idf1", "mota", "precision", "recall", "switches", "fragmentations")


@dataclass(frozen=True)
class Threshold:
    """Largest distance or smallest overlap of two matching detections.

    Attributes
    ----------
    measure : "metres", largest distance on the ground, or "iou", smallest overlap of boxes
    value : in metres, or from 0 to 1
    """

    measure: Measure
    value: float

    @property
    def similarity(self) -> float:
        """Minimum similarity of a match; on the ground, similarity is 0 at twice the distance."""
        return 0.5 if self.measure == "metres" else self.value

    def distance(self, similarity: float) -> float | None:
        """Return the distance in metres of a similarity; None in the image."""
        return 2.0 * self.value * (1.0 - similarity) if self.measure == "metres" else None

    def __str__(self) -> str:
        return f"within {self.value:g} m" if self.measure == "metres" else f"IoU from {self.value:g}"


@dataclass(frozen=True)
class SequenceScore:
    """Metrics of tracks and identities in one sequence, or in all together.

    Attributes
    ----------
    name : name of the sequence
    frames : number of frames with a person in the truth or the estimates
    people, tracks : identities of the truth and of the estimates
    rows, estimated_rows : detections of each
    hota, det_a, ass_a, loc_a : HOTA and its parts, means over the 19 thresholds α of ``curves``
    idf1, idp, idr : scores of the best pairing of people and tracks over the sequence
    mota : negative if errors outnumber people
    motp : mean similarity of the matches
    gospa : root mean square over frames, in metres, with twice the threshold as the cutoff; None in the image
    mean_distance : mean over the matches, in metres; None in the image, and without matches
    precision, recall : shares of the estimates and of the truth that are matched
    matches, misses, false_positives : rows
    switches, fragmentations : numbers of track changes, and of matches regained after a loss
    mostly_tracked, partly_tracked, mostly_lost : people matched in more than 80 % of their frames, in
        between, and in less than 20 %
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
    gospa: float | None
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
        """Return some of the figures by their table headings."""
        return {HEADINGS[name]: getattr(self, name) for name in names}


@dataclass(frozen=True)
class TrackingScore:
    """Metrics of tracks and identities.

    Attributes
    ----------
    sequences : metrics of each sequence
    together : metrics of the sums over all sequences
    threshold : condition for a match of two detections
    notes : omitted data, one sentence each
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
        """Return the lines of a table: each sequence and, if there are several, all together."""
        return self.sequences if len(self.sequences) == 1 else (*self.sequences, self.together)

    def to_dict(self) -> dict[str, Any]:
        """Return all metrics in plain types, ready for JSON."""
        return {
            "measure": self.threshold.measure,
            "threshold": self.threshold.value,
            "together": _plain(self.together),
            "sequences": [_plain(one) for one in self.sequences],
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Counts(Summed):
    """All counts of one sequence, or of several."""

    frames: int
    people: int
    tracks: int
    hota: HotaCounts
    identity: IdentityCounts
    clear: ClearCounts
    gospa: GospaCounts


def count(frames: SharedFrames, threshold: Threshold) -> Counts:
    """Compute the counts of one sequence."""
    return Counts(
        frames=len(frames),
        people=len(frames.truth_rows),
        tracks=len(frames.estimate_rows),
        hota=hota_counts(frames),
        identity=identity_counts(frames, threshold.similarity),
        clear=clear_counts(frames, threshold.similarity),
        gospa=gospa_counts(frames),
    )


def figures(name: str, counts: Counts, threshold: Threshold) -> SequenceScore:
    """Compute the figures from the counts."""
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
        gospa=2.0 * threshold.value * counts.gospa.gospa if threshold.measure == "metres" else None,
        mean_distance=threshold.distance(clear.motp) if clear.matches else None,
        **alike,
        curves={key: tuple(values.tolist()) for key, values in {"alpha": ALPHAS, **curves}.items()},
    )


def _plain(score: SequenceScore) -> dict[str, Any]:
    return asdict(score) | {"curves": {name: list(values) for name, values in score.curves.items()}}


def _cell(value: float) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


METRES = 1.0
"""Default largest distance of a match in metres, as in MOTChallenge 3D."""

Pair = tuple[str, IdentifiedRows, IdentifiedRows]
"""Name of a sequence, its estimates and its truth."""


def score(
    estimates: Given,
    truth: Given,
    *,
    metres: float | None = None,
    iou: float | None = None,
    frame_offset: int = 0,
) -> TrackingScore:
    """Score tracks and identities: HOTA, IDF1, MOTA and their parts.

    Parameters
    ----------
    estimates, truth : of one sequence, tracks in any form that `smooth` takes; of several, two folders or two
        lists of files, with files of the same names. With ``iou``, files of a format that holds boxes. A
        truth is compared by its true positions (``true_x``, ``true_y``) if any, else by its positions.
    metres : largest distance of a match on the ground; 1 m if ``iou`` is not given either
    iou : smallest intersection over union of matching boxes
    frame_offset : added to the frame numbers of the estimates, such as 1 where they begin at 0 and those of
        the truth at 1; times that count frames move with them

    Warns
    -----
    InputWarning
        For frame numbers that begin at another number, and people who are compared by time. Rows without a
        position, as in the gaps of associated tracks, are a note of the result alone.

    Raises
    ------
    InputError
        For both thresholds at once, or one out of range; files that do not pair up or cannot be read; a truth
        without positions, or without a frame in common with the estimates.
    """
    threshold = threshold_of(metres, iou)
    files, true_files = _paths(estimates), _paths(truth)
    pairs: Iterable[tuple[str, Given, Given]] = [("", estimates, truth)]
    if files and true_files:
        pairs = [(name, *pair) for name, pair in paired_files(files, true_files).items()]
    detect = _boxes_of if threshold.measure == "iou" else _positions_of
    doubts: list[str] = []
    found = judge((detect(*pair, frame_offset) for pair in pairs), threshold, doubts.append)
    for note in doubts:
        warnings.warn(note, InputWarning, stacklevel=2)
    return found


def threshold_of(metres: float | None = None, iou: float | None = None) -> Threshold:
    """Return the match threshold: a distance on the ground, unless an overlap in the image is given.

    Raises
    ------
    InputError
        For both, or one out of range.
    """
    if metres is not None and iou is not None:
        raise InputError("metres and iou", "one of them: matches on the ground or in the image")
    check_positive("metres", metres, 1e6)
    check_positive("iou", iou, 1.0)
    if iou is not None:
        return Threshold("iou", iou)
    return Threshold("metres", METRES if metres is None else metres)


def judge(
    pairs: Iterable[Pair], threshold: Threshold, doubt: Callable[[str], object] = lambda note: None
) -> TrackingScore:
    """Score the sequences one by one, and sum the counts.

    ``doubt`` receives the notes that put the score in doubt: on frame numbers.

    Raises
    ------
    InputError
        For a sequence without a frame in common.
    """
    similarity = similarity_of(threshold)
    counts, notes = {}, []
    for name, estimates, truth in pairs:
        counts[name] = count(share_frames(truth, estimates, similarity, name), threshold)
        apart = _numbered_apart(estimates, truth, similarity, threshold, counts[name])
        for note in (*missing_in_words(truth, estimates), *apart):
            notes.append(f"{name}: {note}" if name else note)
            if note in apart:
                doubt(notes[-1])
    return TrackingScore(
        sequences=tuple(figures(name, of_sequence, threshold) for name, of_sequence in counts.items()),
        together=figures(TOGETHER, reduce(add, counts.values()), threshold),
        threshold=threshold,
        notes=tuple(notes),
    )


_BETTER = 0.01  # least gain of IDF1 for which a note advises to number frames otherwise


def _numbered_apart(
    estimates: IdentifiedRows,
    truth: IdentifiedRows,
    similarity: Similarity,
    threshold: Threshold,
    counts: Counts,
) -> tuple[str, ...]:
    """Return a note if the estimates match better one frame later or earlier: one side counts from 0."""
    if not len(truth.frame) or not len(estimates.frame):
        return ()
    ends = {int(end(truth.frame) - end(estimates.frame)) for end in (np.min, np.max)}
    now = figures("", counts, threshold).idf1
    for shift in sorted(ends & {-1, 1}):
        moved = share_frames(truth, estimates.renumbered(shift), similarity, "")
        if (other := figures("", count(moved, threshold), threshold).idf1) > now + _BETTER:
            first = f"{int(estimates.frame.min())} and those of the truth at {int(truth.frame.min())}"
            return (
                f"frames of the estimates begin at {first}: with {shift} added to those of the estimates "
                f"IDF1 is {other:.3f}, and now {now:.3f}; if they are the same images, --frame-offset "
                f"{shift} (in Python frame_offset={shift})",
            )
    return ()


def similarity_of(threshold: Threshold) -> Similarity:
    """Return the similarity function for a threshold."""
    if threshold.measure == "iou":
        return box_similarity
    # Zero at twice the distance, so that a similarity of one half is the distance itself.
    return partial(ground_similarity, zero_distance=2.0 * threshold.value)


def _paths(given: Given) -> list[Path] | None:
    """Return the paths, if paths are given."""
    several = given if isinstance(given, list | tuple) else [given]
    found = [Path(one) for one in several if isinstance(one, str | Path)]
    return found if found and len(found) == len(several) else None


def _positions_of(name: str, estimates: Given, truth: Given, offset: int) -> Pair:
    true = tracks_of(truth)
    found, true, note = at_shared_times(renumbered(tracks_of(estimates), true, offset), true)
    if note:
        warnings.warn(f"{name}: {note}" if name else note, InputWarning, stacklevel=4)
    return name, estimated_detections(found), true_detections(true)


def _boxes_of(name: str, estimates: Given, truth: Given, offset: int) -> Pair:
    for given in (estimates, truth):
        if not isinstance(given, str | Path):
            raise InputError(f"a {type(given).__name__}, which has no boxes", "with iou the path of a file")
    found = boxes(read_boxes(estimates))  # type: ignore[arg-type]
    return name, found.renumbered(offset), boxes(read_boxes(truth))  # type: ignore[arg-type]
