"""Appearance and detection scores as calibrated likelihood ratios, learned from tracks.

Differences of descriptors are whitened by those within people, as in KISSME (Köstinger et al., CVPR 2012).
The ratio is a logistic function of the logarithm of the whitened distance (Platt 1999), calibrated on people
held out from the whitening; a ratio of two Gaussians would be overconfident, as appearance has heavy tails.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.association.likelihood import Chains, IntArray, SceneRow
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.packages import csgraph, optimize, sparse, spatial
from graphtrack.tracks.time import TIME_TOLERANCE

_LEAST = 1e-12  # least squared distance; smaller values are clipped
_STEEPEST = 5.0  # 1-σ of the prior of the slope; learned slopes are near 4
_SHRINKAGE = 0.3  # shrinkage of the within-person covariance towards an isotropic matrix
_OUTLIER = 0.02  # least probability that appearance is uninformative; it bounds the ratio
_FOLDS = 5  # groups of people that are held out in turn, to calibrate on
_LEAST_PEOPLE = 4  # least people to learn from; with fewer, appearance is not used
_MOST_PAIRS = 20_000  # most pairs of either kind that are used


@dataclass(frozen=True, eq=False)
class AppearanceModel:
    """Log likelihood ratio of appearance: the same person against two people.

    With the squared distance d of whitened descriptors and s = exp(offset - slope · log d), the ratio is
    ((1 - outlier) s + outlier) / ((1 - outlier) + outlier s): it falls with d, and its logarithm stays within
    ± log((1 - outlier) / outlier).

    Attributes
    ----------
    whitening : (k, k), applied from the right; two people are about 1 apart after it
    offset, slope : of the logistic function; with both 0 the ratio is uninformative
    outlier : probability that the appearance is uninformative
    """

    whitening: FloatArray
    offset: float = 0.0
    slope: float = 0.0
    outlier: float = _OUTLIER

    @classmethod
    def learned(
        cls,
        descriptors: ArrayLike,
        same: ArrayLike,
        different: ArrayLike,
        shrinkage: float = _SHRINKAGE,
    ) -> AppearanceModel:
        """Learn the model from pairs of detections; return an uninformative model if they are too few.

        ``descriptors``: (n, k), NaN where one is missing. ``same``, ``different``: (m, 2) rows of pairs that
        show one person, such as neighbours in tracklets, and two people, such as those of one frame. The
        model holds for pairs as far apart in time as these. Raise InputError for other shapes or rows.
        """
        values = np.asarray(descriptors, float)
        if values.ndim != 2 or not values.shape[1]:
            raise InputError(f"descriptors of shape {values.shape}", "shape (n, k)")
        one, other = (_usable(values, pairs, _MOST_PAIRS) for pairs in (same, different))
        person = _people(one, len(values))
        people = len(np.unique(person))
        if people < _LEAST_PEOPLE or len(other) < _LEAST_PEOPLE:
            return cls(np.eye(values.shape[1]), outlier=_OUTLIER)
        of_one, of_two = _held_out(values, one, person, other, shrinkage)
        offset, slope = _logistic(np.log(of_one), np.log(of_two), people)
        # Beta prior of the outlier probability: one outlier in two further people.
        outlier = max(_OUTLIER, 1.0 / (people + 2.0))
        return cls(_whitening(values, one, other, shrinkage), offset, slope, outlier)

    def log_ratio(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Log likelihood ratio (...) of descriptors (..., k), which broadcast; 0 where one is missing.

        Raise InputError for descriptors of another size.
        """
        return self.of_squares(np.sum((self.whitened(first) - self.whitened(second)) ** 2, axis=-1))

    def whitened(self, descriptors: ArrayLike) -> FloatArray:
        """Descriptors (..., k) whose squared Euclidean distances are those of `of_squares`.

        Raise InputError for descriptors of another size.
        """
        values, k = np.asarray(descriptors, float), len(self.whitening)
        if values.shape[-1:] != (k,):
            raise InputError(f"descriptors of shape {values.shape}", f"shape (..., {k})")
        return np.asarray(values @ self.whitening, float)

    def of_squares(self, square: FloatArray) -> FloatArray:
        """Log likelihood ratio (...) of squared distances (...) after whitening; 0 where one is NaN."""
        missing = np.isnan(square)
        score = self.offset - self.slope * np.log(np.maximum(np.where(missing, 1.0, square), _LEAST))
        sure, unsure = np.log1p(-self.outlier), np.log(self.outlier)
        ratio = np.logaddexp(sure + score, unsure) - np.logaddexp(sure, unsure + score)
        return np.asarray(np.where(missing, 0.0, ratio), float)


def _usable(values: FloatArray, pairs: ArrayLike, most: int) -> IntArray:
    """Pairs (m, 2) of rows that have descriptors, spread evenly over those given."""
    found = np.asarray(pairs)
    if not found.size:
        return np.empty((0, 2), np.int64)
    if found.ndim != 2 or found.shape[1] != 2 or found.dtype.kind not in "iu":
        raise InputError(f"pairs of shape {found.shape} and type {found.dtype}", "whole numbers (m, 2)")
    if found.min() < 0 or found.max() >= len(values):
        raise InputError(f"a pair of row {found.max()}", f"rows from 0 to {len(values) - 1}")
    known = np.asarray(np.isfinite(values).all(axis=1))
    found = found[known[found].all(axis=1)].astype(np.int64)
    return (
        found[np.linspace(0, len(found) - 1, min(len(found), most)).astype(np.int64)] if len(found) else found
    )


def _people(pairs: IntArray, n: int) -> IntArray:
    """A number (m,) for the person of each pair; pairs that share a detection belong to the same person."""
    links = sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, component = csgraph.connected_components(links, directed=False)
    return np.unique(component[pairs[:, 0]], return_inverse=True)[1].astype(np.int64)


def _squares(values: FloatArray, pairs: IntArray, whitening: FloatArray) -> FloatArray:
    """Squared distances (m,) of the whitened descriptors of pairs."""
    difference = (values[pairs[:, 0]] - values[pairs[:, 1]]) @ whitening
    return np.asarray(np.maximum(np.sum(difference**2, axis=1), _LEAST), float)


def _whitening(values: FloatArray, same: IntArray, different: IntArray, shrinkage: float) -> FloatArray:
    """Whitening (k, k): isotropic differences within people, and unit scale of those between people.

    The unit scale makes whitenings that were learned from different people comparable.
    """
    difference = values[same[:, 0]] - values[same[:, 1]]
    covariance = difference.T @ difference / len(difference)
    k = len(covariance)
    even = np.trace(covariance) / k + 1e-12
    eigenvalues, vectors = np.linalg.eigh((1.0 - shrinkage) * covariance + shrinkage * even * np.eye(k))
    whitening = vectors / np.sqrt(eigenvalues)
    apart = np.log(_squares(values, different, whitening)).mean()
    return np.asarray(whitening * np.exp(-0.5 * apart), float)


def _held_out(
    values: FloatArray, same: IntArray, person: IntArray, different: IntArray, shrinkage: float
) -> tuple[FloatArray, FloatArray]:
    """Squared distances of both kinds of pairs, each whitened by people other than those of the pair."""
    folds = min(_FOLDS, int(person.max()) + 1)
    of_one, of_two = np.empty(len(same)), np.empty(len(different))
    mine, other = person % folds, np.arange(len(different)) % folds
    for fold in range(folds):
        whitening = _whitening(values, same[mine != fold], different, shrinkage)
        of_one[mine == fold] = _squares(values, same[mine == fold], whitening)
        of_two[other == fold] = _squares(values, different[other == fold], whitening)
    return of_one, of_two


def _logistic(same: FloatArray, different: FloatArray, people: int) -> tuple[float, float]:
    """Offset and slope (at least 0) of the log ratio in log distances of pairs; both kinds have equal weight.

    The number of people is taken as the number of independent observations.
    """

    def cost(parameters: FloatArray) -> float:
        offset, slope = parameters
        lost = np.logaddexp(0.0, slope * same - offset).mean()
        taken = np.logaddexp(0.0, offset - slope * different).mean()
        return float(lost + taken + 0.5 * (slope / _STEEPEST) ** 2 / people)

    found = optimize.minimize(
        cost, np.array([0.0, 1.0]), method="L-BFGS-B", bounds=[(None, None), (0.0, None)]
    )
    offset, slope = found.x
    return float(offset), float(slope)


_TAUGHT_SECONDS = 0.6  # longest time between two detections of a positive pair
_APART = 1.0  # least distance in metres between two detections of a negative pair
_PRIOR = 5.0  # pseudo-count of pairs of false detections with ratio 0
_BINS = 6  # bins of scores, with equal counts


def learn_appearance(chains: Chains, identity: IntArray, descriptors: FloatArray) -> AppearanceModel:
    """Learn the appearance model of a recording from neighbours in its tracks and from pairs of one frame."""
    later = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    earlier = chains.preceding[later]
    near = chains.t[later] - chains.t[earlier] <= _TAUGHT_SECONDS + TIME_TOLERANCE
    pairs = []
    for shift in (1, 2, 3):
        first = np.arange(max(len(identity) - shift, 0))
        second = first + shift
        together = chains.frame[first] == chains.frame[second]
        apart = np.hypot(*(chains.position[first] - chains.position[second]).T) > _APART
        pairs.append(np.column_stack([first, second])[together & apart])
    same = np.column_stack([earlier, later])[near]
    return AppearanceModel.learned(descriptors, same, np.concatenate(pairs))


def constancy(chains: Chains, identity: IntArray, model: AppearanceModel, descriptors: FloatArray) -> float:
    """Mean log ratio of appearance along tracks, at least 0, by which the gain of detections is lowered.

    A false detection of an object resembles itself from frame to frame as much as a person does: appearance
    is evidence of identity, not of existence. ``identity``: (n,), −1: false; ``descriptors``: (n, d), or NaN.
    """
    later = np.flatnonzero((identity >= 0) & (chains.preceding >= 0))
    ratios = model.log_ratio(descriptors[chains.preceding[later]], descriptors[later])
    has = has_descriptor(descriptors)
    both = has[later] & has[chains.preceding[later]]
    return max(float(ratios[both].mean()), 0.0) if both.any() else 0.0


def resemblance_of_false_detections(
    chains: Chains, identity: IntArray, model: AppearanceModel, descriptors: FloatArray
) -> float:
    """`constancy` for online use: the mean log ratio of a false detection and a near one before, at least 0.

    Online, links are made because appearance agrees, which biases the mean along tracks upwards.
    """
    false = np.flatnonzero((identity < 0) & has_descriptor(descriptors))
    if not len(false):
        return 0.0
    # Frames are far apart on a third axis, so that neighbours are of one frame and the next.
    step = np.array([0.0, 0.0, 10.0 * _APART])
    points = np.column_stack([chains.position[false], step[2] * chains.frame[false]])
    distance, before = spatial.cKDTree(points).query(points - step, distance_upper_bound=_APART)
    later = np.flatnonzero(np.isfinite(distance))
    ratios = model.log_ratio(descriptors[false[before[later]]], descriptors[false[later]])
    return max(float(ratios.sum()) / (len(ratios) + _PRIOR), 0.0)


def has_descriptor(descriptors: FloatArray) -> NDArray[np.bool_]:
    """Return whether each detection (n,) has a descriptor."""
    return np.asarray(np.isfinite(descriptors).all(axis=1))


def widened(descriptors: FloatArray, size: int) -> FloatArray:
    """Descriptors (n, size): those given, or NaN if their size is 0."""
    return descriptors if descriptors.shape[1] == size else np.full((len(descriptors), size), np.nan)


@dataclass(frozen=True, eq=False)
class ScoreRatio:
    """Likelihood ratio of detection scores, people against false detections.

    Attributes
    ----------
    edges : (bins − 1,) between the bins of scores
    ratio : (bins,) log likelihood ratio of people in each bin; empty: scores are not used
    """

    edges: FloatArray = field(default_factory=lambda: np.zeros(0))
    ratio: FloatArray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def learned(cls, score: FloatArray, identity: IntArray) -> ScoreRatio:
        """Learn from scores (n,), or NaN, and identities (n,), −1: false, from three counts a bin."""
        known = np.isfinite(score)
        if known.sum() < 10 * _BINS or np.ptp(score[known]) == 0.0:
            return cls()
        edges = np.unique(np.quantile(score[known], np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))
        place, bins = np.searchsorted(edges, score[known], "right"), len(edges) + 1
        person = identity[known] >= 0
        shares = [np.bincount(place[side], minlength=bins) + 3.0 for side in (person, ~person)]
        return cls(edges, np.log(shares[0] / shares[0].sum()) - np.log(shares[1] / shares[1].sum()))

    def of(self, score: FloatArray) -> FloatArray:
        """Log ratio (n,) of scores (n,); 0: no score."""
        if not len(self.ratio):
            return np.zeros(len(score))
        return np.where(np.isfinite(score), self.ratio[np.searchsorted(self.edges, score, "right")], 0.0)


_FEWEST_PAIRED = 5  # people of two sensors from which their colours are compared person by person
_PRIOR_PEOPLE = 10.0  # people with unchanged scales that those of a sensor are weighed against


@dataclass(frozen=True, eq=False)
class Colours:
    """Change of descriptors between sensors, such as of colours: descriptors of the first sensor are kept.

    Attributes
    ----------
    shift, scale : (s, d), of each sensor; what the first would have is (descriptor − shift)/scale
    """

    shift: FloatArray
    scale: FloatArray

    @classmethod
    def learned(cls, descriptors: FloatArray, sensor: IntArray, identity: IntArray) -> Colours | None:
        """Learn the changes from the people of each sensor; None: one sensor, or no descriptors.

        Of people whom a sensor and the first observe the mean change is taken, else the change of the mean
        over all people. ``identity`` (n,) is −1 for false detections.
        """
        count = int(sensor.max(initial=0)) + 1
        if count < 2 or not descriptors.shape[1]:
            return None
        known = has_descriptor(descriptors) & (identity >= 0)
        people = int(identity.max(initial=0)) + 1
        each = [_person_means(descriptors, known & (sensor == s), identity, people) for s in range(count)]
        shift, scale = np.zeros((count, descriptors.shape[1])), np.ones((count, descriptors.shape[1]))
        first = each[0]
        for s in range(1, count):
            own, both = each[s], ~np.isnan(first[:, 0] + each[s][:, 0])
            some = ~np.isnan(own[:, 0])
            if not some.any() or np.isnan(first[:, 0]).all():
                continue
            spreads = [np.nanstd(part, axis=0) + 1e-9 for part in (own, first)]
            weight = some.sum() / (some.sum() + _PRIOR_PEOPLE)
            scale[s] = (spreads[0] / spreads[1]) ** weight
            if both.sum() >= _FEWEST_PAIRED:
                shift[s] = (own[both] - scale[s] * first[both]).mean(axis=0)
            else:
                shift[s] = np.nanmean(own, axis=0) - scale[s] * np.nanmean(first, axis=0)
        return cls(shift, scale)

    def removed(self, descriptors: FloatArray, sensor: IntArray) -> FloatArray:
        """Return descriptors (n, d) as the first sensor would have them; new sensors change nothing."""
        number = np.minimum(sensor, len(self.shift))
        shift = np.vstack([self.shift, np.zeros_like(self.shift[:1])])[number]
        scale = np.vstack([self.scale, np.ones_like(self.scale[:1])])[number]
        return np.asarray((descriptors - shift) / scale)


def _person_means(
    descriptors: FloatArray, known: NDArray[np.bool_], identity: IntArray, people: int
) -> FloatArray:
    """Return the mean descriptor (people, d) of each person, NaN for those without one."""
    count = np.bincount(identity[known], minlength=people)
    total = np.zeros((people, descriptors.shape[1]))
    np.add.at(total, identity[known], descriptors[known])
    return np.asarray(total / np.where(count, count, np.nan)[:, None])


@dataclass(frozen=True, eq=False)
class AppearanceEvidence:
    """Evidence of appearance and detection scores, learned from tracks.

    Attributes
    ----------
    model : of descriptors; None: no descriptors
    constancy : see `resemblance_of_false_detections`
    scores : ratio of detection scores
    colours : changes of descriptors between sensors; None: none
    """

    model: AppearanceModel | None = None
    constancy: float = 0.0
    scores: ScoreRatio = field(default_factory=ScoreRatio)
    colours: Colours | None = None

    def in_scene(self, scene: SceneRow) -> SceneRow:
        """A scene with the constants of the appearance model."""
        model = self.model
        if model is None:
            return scene
        return scene._replace(
            appearance_offset=model.offset, appearance_slope=model.slope, appearance_outliers=model.outlier
        )

    def in_chains(self, chains: Chains, descriptors: FloatArray) -> Chains:
        """Chains with descriptors (n, d), whitened by the model."""
        if self.model is None:
            return chains
        if self.colours is not None:
            descriptors = self.colours.removed(descriptors, chains.sensor)
        return chains._replace(appearance=np.ascontiguousarray(self.model.whitened(descriptors)))

    def gain(self, descriptors: FloatArray, score: FloatArray) -> FloatArray:
        """(n,) log gain of detections as a person's by descriptors (n, d) and scores (n,); NaN: missing."""
        less = 0.0 if self.model is None else self.constancy
        return self.scores.of(score) - less * has_descriptor(descriptors)


def evidence_of_tracks(
    chains: Chains, identity: IntArray, descriptors: FloatArray, score: FloatArray
) -> AppearanceEvidence:
    """Learn the evidence from tracks; arguments as in `constancy` and `ScoreRatio`."""
    scores = ScoreRatio.learned(score, identity)
    if not descriptors.shape[1]:
        return AppearanceEvidence(scores=scores)
    model = learn_appearance(chains, identity, descriptors)
    return AppearanceEvidence(
        model, resemblance_of_false_detections(chains, identity, model, descriptors), scores
    )
