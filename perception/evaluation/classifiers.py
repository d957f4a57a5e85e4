"""Measures of pose classifiers on rendered people.

Reliability and confusion; the last layer retrained on a part of the heads (Baxter et al. 2014, §III-C,
Fig. 3); keypoints; and Chen et al.'s (2011)
published forms compared with ours.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.experiments.harness import Cell, Table
from graphtrack.geometry.angles import FloatArray, difference
from perception.images.pixels import Image
from perception.models import HEAD_POSE, load_classifier
from perception.pose.classifier import FeatureClassifier, PoseScores, evaluate
from perception.pose.deep_belief import DeepBelief
from perception.pose.head_detection import HeadLocaliser
from perception.pose.keypoints import KeypointPose
from perception.synthetic import make_pedestrians
from perception.synthetic.heads import make_heads
from perception.synthetic.skeletons import (
    NetworkErrors,
    Skeletons,
    make_rendered_skeletons,
    make_skeletons,
    perceived,
)
from perception.training import (
    FAR,
    FOUND_AS_WALKING,
    PUBLISHED,
    keypoint_figures,
    localisation_figures,
    train_on_rendered,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def class_rates(confusion: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Return the true and false positive rates (k,) of each class; NaN for unobserved classes."""
    of_class, predicted, hits = confusion.sum(axis=1), confusion.sum(axis=0), np.diag(confusion)
    with np.errstate(invalid="ignore", divide="ignore"):
        false = (predicted - hits) / (of_class.sum() - of_class)
        return hits / of_class, np.where(of_class > 0, false, np.nan)


def reliability_figure(scores: Mapping[str, PoseScores], degrees: Mapping[str, np.ndarray]) -> Figure:
    """Draw accuracy against confidence of classifiers by name, and the confusion matrix of each.

    Parameters
    ----------
    scores : on the same kind of images
    degrees : (n_pan,) centres of the pan classes of each
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 + 3.4 * len(scores), 3.9 + 0.16 * len(scores)), layout="constrained")
    curves, *squares = figure.subplots(1, 1 + len(scores), width_ratios=[1.2] + [1.0] * len(scores))
    curves.plot([0, 1], [0, 1], color="#8A8F98", lw=1, ls="--")
    for (name, found), colour in zip(scores.items(), _COLOURS * len(scores), strict=False):
        curve = found.reliability
        label = f"{name.replace('_', ' ')}, error {curve.expected_calibration_error:.3f}"
        curves.plot(curve.confidence, curve.accuracy, color=colour, lw=1.2, label=label)
        curves.scatter(
            curve.confidence, curve.accuracy, s=160 * curve.count / curve.count.sum(), color=colour
        )
    curves.set(xlim=(0, 1), ylim=(0, 1), xlabel="likelihood of the most likely class", ylabel="share right")
    curves.set_title("Reliability (area of a dot: images)", fontsize=10)
    # Below the axes, where the legend covers no underconfident curve.
    curves.legend(
        fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.16), borderaxespad=0.0, frameon=False
    )
    for (name, found), axes in zip(scores.items(), squares, strict=True):
        order = np.argsort(degrees[name])
        ticks = [f"{degree:.0f}" for degree in degrees[name][order]]
        title = f"{name.replace('_', ' ')}: {100 * found.accuracy:.0f} % right"
        draw_confusion(axes, found.confusion[np.ix_(order, order)], ticks, title, numbers=len(ticks) <= 8)
    return figure


def draw_confusion(
    axes: Axes, confusion: NDArray[np.number], names: Sequence[str], title: str, *, numbers: bool = True
) -> None:
    """Draw a confusion matrix (n, n), rows the true classes, in per cent of the true class.

    Parameters
    ----------
    names : of the classes, degrees
    numbers : whether cells show their per cent
    """
    percent = 100.0 * confusion / np.maximum(confusion.sum(axis=1, keepdims=True), 1e-9)
    axes.imshow(percent, cmap="Blues", vmin=0.0, vmax=100.0)
    axes.set_xticks(range(len(names)), names, fontsize=7, rotation=90)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    for (row, column), value in np.ndenumerate(percent):
        if numbers and value >= 0.5:
            colour = "white" if value > 50.0 else "black"
            axes.text(column, row, f"{value:.0f}", ha="center", va="center", fontsize=7, color=colour)
    axes.set(xlabel="most likely (°)", ylabel="true (°)")
    axes.set_title(title, fontsize=9)


@dataclass(frozen=True, eq=False)
class SplitScores:
    """Scores of the last layer on held-out heads, over all repetitions.

    Attributes
    ----------
    confusion : (k, k) heads by true (row) and most likely (column) class
    mean_error : degrees, of the centre of the most likely class
    rates : (repetitions,) share of correct most likely classes
    """

    confusion: NDArray[np.int64]
    mean_error: float
    rates: FloatArray


def split_scores(
    model: DeepBelief,
    images: Sequence[Image],
    pan: ArrayLike,
    share: float,
    rng: np.random.Generator,
    *,
    repetitions: int = 5,
    groups: ArrayLike | None = None,
) -> SplitScores:
    """Retrain the last layer on a share of the heads and their reflections, and evaluate it on the rest.

    Parameters
    ----------
    model : its other layers stay
    images : of heads, cut out
    pan : (n,) radians in the image frame
    share : training share; 0.8 for 80:20
    rng : source of the splits
    repetitions : splits
    groups : (n,) person of each head, to keep people in one part; None: heads are split individually
    """
    classes, pan = model.classes, np.asarray(pan, float)
    labels = classes.index(pan)
    hidden, mirrored = hidden_both_ways(model, images)
    unit = np.arange(len(labels)) if groups is None else np.asarray(groups)
    confusion = np.zeros((len(classes), len(classes)), np.int64)
    errors, rates = [], []
    for _ in range(repetitions):
        names = rng.permutation(np.unique(unit))
        learned = np.isin(unit, names[: max(1, round(share * len(names)))])
        inputs = np.concatenate([hidden[learned], mirrored[learned]])
        of_inputs = np.concatenate([labels[learned], classes.reflected(labels[learned])])
        weight, bias = softmax_layer(inputs, of_inputs, len(classes))
        found = (hidden[~learned] @ weight + bias).argmax(axis=1)
        np.add.at(confusion, (labels[~learned], found), 1)
        errors.append(np.abs(difference(classes.pan[found], pan[~learned])))
        rates.append(float(np.mean(found == labels[~learned])))
    return SplitScores(confusion, float(np.degrees(np.concatenate(errors).mean())), np.array(rates))


def hidden_both_ways(
    model: DeepBelief, images: Sequence[Image]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the last hidden layer (n, d) of heads, and of their reflections."""
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in images]
    return model.hidden(model.features(images)), model.hidden(model.features(mirrored))


def softmax_layer(
    inputs: NDArray[np.floating], labels: NDArray[np.int64], n_classes: int, *, penalty: float = 1e-3
) -> tuple[FloatArray, FloatArray]:
    """Fit weights (d, n_classes) and biases (n_classes,) of multinomial logistic regression.

    ``penalty`` is that of the squared weights, for standardised inputs.
    """
    from sklearn.linear_model import LogisticRegression

    mean, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-6
    x = (np.asarray(inputs, float) - mean) / spread
    found = LogisticRegression(C=1.0 / (penalty * len(labels)), max_iter=300, tol=1e-5).fit(x, labels)
    slopes, constants = found.coef_, found.intercept_
    if len(found.classes_) == 2:  # scikit-learn returns only the difference
        slopes, constants = (np.concatenate([-part, part]) / 2.0 for part in (slopes, constants))
    weight, bias = np.zeros((x.shape[1], n_classes)), np.full(n_classes, -np.inf)
    weight[:, found.classes_] = slopes.T / spread[:, None]
    bias[found.classes_] = constants - mean @ weight[:, found.classes_]
    return weight, bias


_SIZES = ((30.0, 50.0), (50.0, 100.0), (100.0, 200.0))
_NETWORKS = {
    "as in training": NetworkErrors(),
    "points half as far off": NetworkErrors(deviation=0.5, pixels=0.5),
    "points 1.5 times as far off": NetworkErrors(deviation=1.5, pixels=1.5),
    "left and right exchanged in a tenth": NetworkErrors(swapped=0.1),
    "without confidences": NetworkErrors(unsaid=1.0),
    "unsure points left out": NetworkErrors(cut=1.0, unsaid=0.0),
    "confidences that follow occlusion": NetworkErrors(uninformed=0.0),
    "confidences that do not follow occlusion": NetworkErrors(uninformed=1.0),
}


def keypoint_table(model: KeypointPose, count: int, rng: np.random.Generator) -> Table:
    """Compute errors in degrees and calibration errors, by sizes of people and kinds of networks.

    Parameters
    ----------
    count : rendered people of each size
    """
    rows: list[dict[str, Cell]] = []
    usual = NetworkErrors()

    def judge(name: str, people: Skeletons, errors: NetworkErrors) -> None:
        points = perceived(people.points, people.visibility, people.height, rng, errors)
        rows.append({"people": name, **keypoint_figures(model, points, people.body, people.head)})

    sets = [make_rendered_skeletons(count, rng, size) for size in _SIZES]
    for (least, most), people in zip(_SIZES, sets, strict=True):
        judge(f"rendered, {least:g}-{most:g} pixels", people, usual)
    names = ("points", "visibility", "height", "body", "head")
    every = Skeletons(*(np.concatenate([getattr(people, name) for people in sets]) for name in names))
    for name, errors in _NETWORKS.items():
        judge(f"rendered, all sizes: {name}", every, errors)
    judge("skeletons as in training", make_skeletons(3 * count, rng, (_SIZES[0][0], _SIZES[-1][1])), usual)
    return Table.of(f"Body and head by keypoints, {count} rendered people of each size", rows)


FORMS = {"ours": False, "as printed": True}


def published_tables(train: int, count: int, rng: np.random.Generator) -> Iterator[Table]:
    """Yield figures of the head localiser, body pose and templates in both forms.

    Parameters
    ----------
    train : number of rendered training images
    count : number of test images
    rng : source of the test images
    """
    people = make_pedestrians(count, rng)
    exact, found = make_heads(count, rng), make_heads(count, rng, FOUND_AS_WALKING)
    heads = {
        "heads of 16-32 pixels": (exact.images, exact.pan),
        "heads as they are found": (found.images, found.pan),
    }
    bodies = {"people of 70-140 pixels": (people.images, people.body)}
    for name in PUBLISHED:
        rows: list[dict[str, Cell]] = []
        for form, printed in FORMS.items():
            model = train_on_rendered(name, images=train, test_images=50, as_published=printed)
            if isinstance(model, HeadLocaliser):
                rows.append({"form": form, **localisation_figures(model, people)})
                continue
            assert isinstance(model, FeatureClassifier)
            for what, (images, angle) in (bodies if name == "body_pose" else heads).items():
                figures = evaluate(model, images, angle).figures()
                rows.append({"form": form, "images": what, **figures})
        title = f"{name}: ours and Chen et al.'s as printed, both trained on {train} rendered images"
        yield Table.of(title, rows)


def pose_table(count: int, rng: np.random.Generator) -> tuple[Table, Figure]:
    """Compute errors, calibration and reliability of all classifiers on ``count`` rendered images each."""
    exact, found = make_heads(count, rng), make_heads(count, rng, FOUND_AS_WALKING)
    near, far = make_pedestrians(count, rng), make_pedestrians(count, rng, FAR)
    sets: list[tuple[str, str, list[Image], FloatArray]] = []
    for name in HEAD_POSE:
        sets += [(name, "heads of 16-32 pixels", exact.images, exact.pan)]
        sets += [(name, "heads as they are found", found.images, found.pan)]
    sets += [("body_pose", "people of 70-140 pixels", near.images, near.body)]
    sets += [("body_pose", "people of 24-80 pixels", far.images, far.body)]
    rows: list[dict[str, Cell]] = []
    scores: dict[str, PoseScores] = {}
    degrees: dict[str, FloatArray] = {}
    for name, what, images, angle in sets:
        model = load_classifier(name)
        result = evaluate(model, images, angle)
        scores.setdefault(name, result)
        degrees.setdefault(name, np.rad2deg(model.classes.pan))
        rows.append({"classifier": name, "images": what, **result.figures()})
    table = Table.of(f"Errors and calibration on {count} rendered images each", rows)
    return table, reliability_figure(scores, degrees)
