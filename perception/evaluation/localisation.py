"""Head localisation in crops of people: Chen et al. 2011, Table 1, on rendered people.

Two kinds of weak classifier, HoG differential and Fisher discriminant, in our form and as printed. The number
of candidates is compared at thresholds that do not fix it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.evaluation.metrics import Interval, bootstrap
from graphtrack.experiments.harness import Cell, Table
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import intersection_over_union
from perception.models import load_head_localiser
from perception.pose.boosting import Weak
from perception.pose.head_detection import HeadLocaliser
from perception.synthetic import PedestrianSet, make_pedestrians

PAPER: Mapping[str, tuple[float, float, float]] = {
    "differential": (0.60, 0.64, 2.3),
    "fisher": (0.58, 0.65, 3.0),
}
"""Chen et al. 2011, Table 1, on real pictures: IOU of the first candidate, best IOU, number of candidates."""

MEASURES = ("IOU top", "IOU all", "candidates")
WEAK: tuple[Weak, ...] = ("differential", "fisher")
FORMS: Mapping[str, Callable[[Weak], HeadLocaliser]] = {
    "ours": HeadLocaliser,
    "as printed": HeadLocaliser.as_published,
}
RECALL = 0.95
"""Share of the localisable heads of the validation crops that the threshold accepts."""
HIT = 0.5
"""Least IOU of a candidate that is on the head."""
NATURAL, SAME_RECALL = "score above 0", f"{100 * RECALL:g} % recall"
OWN = "the model's own"
_ANYTHING = -np.inf


@dataclass(frozen=True, eq=False)
class Located:
    """Candidates of n crops without a threshold.

    Attributes
    ----------
    overlap, scores : of each crop, (k,) IOU with the true head and score of its candidates, best score first
    """

    overlap: list[FloatArray]
    scores: list[FloatArray]

    @classmethod
    def of(cls, model: HeadLocaliser, people: PedestrianSet) -> Located:
        """Locate the heads of all crops."""
        found = [model.locate(image, _ANYTHING) for image in people.images]
        overlap = [
            intersection_over_union(one.boxes, true) for one, true in zip(found, people.head_box, strict=True)
        ]
        return cls(overlap, [one.scores for one in found])

    def figures(self, threshold: float) -> FloatArray:
        """Return `MEASURES` (3, n) of each crop: the first candidate always counts, others from a score."""
        rows = []
        for overlap, scores in zip(self.overlap, self.scores, strict=True):
            kept = scores >= threshold
            kept[0] = True
            rows.append((overlap[0], overlap[kept].max(), kept.sum()))
        return np.array(rows, float).T

    def threshold_of_recall(self, recall: float) -> float:
        """Return the largest threshold that accepts a share of the heads on which there is a candidate.

        A head is accepted if a candidate with an IOU of at least `HIT` has this score.
        """
        best = [
            scores[overlap >= HIT].max()
            for overlap, scores in zip(self.overlap, self.scores, strict=True)
            if (overlap >= HIT).any()
        ]
        return float(np.quantile(best, 1.0 - recall, method="lower")) if best else _ANYTHING


def localisation_tables(
    count: int, train: int, rng: np.random.Generator, *, rounds: int = 500
) -> Iterator[Table]:
    """Yield Chen et al.'s Table 1 on ``count`` rendered people, and the differences of the two features.

    Parameters
    ----------
    count : crops to evaluate on; half as many validation crops choose the threshold of equal recall
    train : crops to train on, the same for all localisers; a fifth of them is held out as in
        `HeadLocaliser.fit`
    rounds : weak classifiers of a localiser
    """
    people, validation = make_pedestrians(train, rng), make_pedestrians(max(count // 2, 1), rng)
    judged = make_pedestrians(count, rng)
    package = load_head_localiser()
    of_package = Located.of(package, judged).figures(package.threshold)
    rows = [_row("the package's", "differential", OWN, of_package, rng)]
    differences: list[dict[str, Cell]] = []
    for form, make in FORMS.items():
        figures: dict[tuple[str, str], FloatArray] = {}
        for weak in WEAK:
            model = make(weak)
            model.rounds = rounds
            model.fit(people.images, people.head_box)
            equal = Located.of(model, validation).threshold_of_recall(RECALL)
            found = Located.of(model, judged)
            for rule, threshold in ((NATURAL, 0.0), (SAME_RECALL, equal)):
                figures[rule, weak] = found.figures(threshold)
                rows.append(_row(form, weak, rule, figures[rule, weak], rng))
        for rule in (NATURAL, SAME_RECALL):
            both = figures[rule, "differential"], figures[rule, "fisher"]
            differences += [_difference(form, rule, k, *both, rng) for k in range(len(MEASURES))]
    yield Table.of(
        f"Head localisation on {count} rendered people, trained on {train} (Chen et al. 2011, Table 1)",
        rows,
    )
    yield Table.of(
        "HoG differential less Fisher on the same crops, 95 % intervals over the crops", differences
    )


def _mean(values: FloatArray) -> FloatArray:
    return np.asarray(values.mean(axis=-1), float)


def _cells(name: str, one: Interval) -> dict[str, Cell]:
    return {name: one.value, f"{name}: low": one.low, f"{name}: high": one.high}


def _row(form: str, weak: str, rule: str, figures: FloatArray, rng: np.random.Generator) -> dict[str, Cell]:
    row: dict[str, Cell] = {"form": form, "weak classifier": weak, "threshold": rule}
    paper = PAPER[weak] if form in FORMS else (None,) * len(MEASURES)
    for name, values, printed in zip(MEASURES, figures, paper, strict=True):
        row |= _cells(name, bootstrap(_mean, values, rng=rng))
        row[f"paper: {name}"] = printed
    return row


def _difference(
    form: str, rule: str, k: int, first: FloatArray, second: FloatArray, rng: np.random.Generator
) -> dict[str, Cell]:
    apart: Sequence[float] = [PAPER[weak][k] for weak in WEAK]
    return {
        "form": form,
        "threshold": rule,
        "measure": MEASURES[k],
        "paper": apart[0] - apart[1],
        **_cells("difference", bootstrap(_mean, first[k] - second[k], rng=rng)),
    }
