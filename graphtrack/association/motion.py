"""Motion that pairs and triples of detections show before anybody is identified.

The displacements from one frame to a later one are those of all pairs of detections: of one person, which
the prior of velocities describes, and of two, whose distribution the pairs within a frame show (correlations
do so in particle image velocimetry, Adrian 1991, Annu. Rev. Fluid Mech. 23). The first kind is what is left
over. In the same way, the third detection of a person lies where the first two predict it, up to noise, and
those of other people lie anywhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.likelihood import VELOCITY, IntArray
from graphtrack.geometry.angles import FloatArray
from graphtrack.packages import ndimage, spatial

WALKING = np.array(
    [(0.3, 0.0, 0.15), (0.6, 1.34, 0.26), (0.1, 1.0, 1.0)],
    [("share", float), ("speed", float), ("std", float)],
)
"""Share, speed and its 1-σ (m/s) of people who stand, who walk (Weidmann 1993) and of all others."""

_SPACING = 0.5
"""m/s between the centres of the components of the prior of velocities, and twice their 1-σ."""

_FASTEST = 3.0  # m/s of a component's centre
_REST = 0.05  # weight of a component for all other velocities
_LIGHTEST = 1e-3  # weight below which a component is left out
_PRIOR_PEOPLE = 20.0  # people that the prior is worth
_APART = 0.4
"""Seconds between the frames of pairs, or one step: after less, noise hides the velocity."""

_BIN = 0.1  # m/s
_BINS = 65  # along an axis
_REPEATS = 60  # of expectation maximisation
_MOVED = 1.0  # m/s, 1-σ of each axis of the velocity of the other person of a pair

_MOST_DETECTIONS = 20_000
_MOST_PAIRS = 20_000

_NEAR = 0.8, 3.0  # metres, least and greatest distance from the prediction at which third detections count
_PRIOR_STD = 0.15  # metres
_PRIOR_TRIPLES = 10.0
_MOST_SHARE = 0.7  # of detections that are the first of a triple


def velocities_of(
    frame: IntArray,
    position: FloatArray,
    axes: FloatArray,
    step_seconds: float,
    noise: float,
    rest_std: float,
) -> NDArray[np.void]:
    """The prior of velocities: components (m,) of `VELOCITY`.

    Parameters
    ----------
    frame, position : (n,) in steps, increasing, and (n, 2) metres
    axes : (2, 2) unit vectors along which components lie, one a row
    noise : 1-σ of positions, metres
    rest_std : 1-σ of all other velocities, m/s
    """
    steps = max(1, round(_APART / step_seconds))
    seconds = steps * step_seconds
    frames, count = np.unique(frame, return_counts=True)
    after = np.minimum(np.searchsorted(frames, frames + steps), len(frames) - 1)
    later = np.where(frames[after] == frames + steps, count[after], 0)  # detections so many steps later
    prior = _of_walkers()
    if not later.any():
        return _packed(prior, axes, rest_std)
    every = max(1, len(frame) // _MOST_DETECTIONS)
    chosen = (frame - frame[0]) % every == 0
    counted = count * ((frames - frames[0]) % every == 0)
    place = position @ axes.T
    found = _histogram(place, frame, chosen, steps, seconds)
    within = _histogram(place, frame, chosen, 0, seconds)
    of_two = float(counted @ (count - 1))
    pairs, own = float(counted @ later), float(np.minimum(counted, later).sum())
    # A person's pairs are no more than the detections of the frame with fewer.
    most, across = _PRIOR_PEOPLE + own, pairs - own
    shape = _shape((0.5 * _SPACING) ** 2 + 2.0 * (noise / seconds) ** 2)
    # The other person has moved too.
    background = ndimage.gaussian_filter(within, _MOVED / _BIN, mode="nearest")
    background = background * max(across, 0.0) / max(of_two, 1.0) + 1e-9
    weight, total, amount = prior, most, 1.0
    for _ in range(_REPEATS):
        ratio = found / (total * (shape @ weight @ shape.T) + amount * background)
        each = total * weight * (shape.T @ ratio @ shape) + _PRIOR_PEOPLE * prior
        amount *= float((ratio * background).sum()) / float(background.sum())
        weight, total = each / each.sum(), min(float(each.sum()), most)
    return _packed(weight, axes, rest_std)


def _centres() -> FloatArray:
    """Coordinates (k,) of the components' centres, which lie on a square grid (k, k)."""
    return np.arange(-_FASTEST, _FASTEST + 0.5 * _SPACING, _SPACING)


def _of_walkers() -> FloatArray:
    """Weights (k, k) of a scene that nobody has watched, 0 beyond `_FASTEST`; see `WALKING`."""
    speed = np.hypot(*np.meshgrid(_centres(), _centres(), indexing="ij"))[..., None]
    each = np.exp(-0.5 * (speed - WALKING["speed"]) ** 2 / (WALKING["std"] ** 2 + (0.5 * _SPACING) ** 2))
    each *= speed <= _FASTEST + 1e-9
    found: FloatArray = (each / each.sum(axis=(0, 1))) @ WALKING["share"]
    return found


def _packed(weight: FloatArray, axes: FloatArray, rest_std: float) -> NDArray[np.void]:
    kept = weight > _LIGHTEST
    centres = _centres()[np.argwhere(kept)] @ axes
    weight = (1.0 - _REST) * weight[kept] / weight[kept].sum()
    found = np.empty(len(weight) + 1, VELOCITY)
    found["weight"][:-1], found["variance"] = weight, (0.5 * _SPACING) ** 2
    found["vx"][:-1], found["vy"][:-1] = centres.T
    found[-1] = _REST, 0.0, 0.0, rest_std**2
    return found


def _shape(variance: float) -> FloatArray:
    """Probability (bins, k) of each bin along an axis given each coordinate of a component's centre."""
    middle = _BIN * (np.arange(_BINS) + 0.5 * (1 - _BINS))
    off = middle[:, None] - _centres()
    found: FloatArray = np.exp(-0.5 * off**2 / variance) * _BIN / np.sqrt(2.0 * np.pi * variance)
    return found


def _histogram(
    position: FloatArray, frame: IntArray, chosen: np.ndarray, steps: int, seconds: float
) -> FloatArray:
    """Count (bins, bins) velocities from chosen detections to those some steps later; 0: within a frame."""
    edges = _BIN * (np.arange(_BINS + 1) - 0.5 * _BINS)
    reach = float(np.hypot(edges[-1], edges[-1])) * seconds
    first, second = _pairs(position, frame, chosen, steps, reach)
    two = first != second
    first, second = first[two], second[two]
    velocity = (position[second] - position[first]) / seconds
    found: FloatArray = np.histogram2d(velocity[:, 0], velocity[:, 1], bins=[edges, edges])[0]
    return found


def _pairs(
    position: FloatArray, frame: IntArray, chosen: np.ndarray, steps: int, reach: float
) -> tuple[IntArray, IntArray]:
    """Pairs of a chosen detection and one that is some steps later, within reach (m)."""
    some = np.flatnonzero(chosen)
    here = spatial.cKDTree(np.column_stack([position[some], frame[some] * (4.0 * reach)]))
    there = spatial.cKDTree(np.column_stack([position, (frame - steps) * (4.0 * reach)]))
    found = here.query_ball_tree(there, reach)
    first = np.repeat(some, [len(one) for one in found])
    return first, np.fromiter((k for one in found for k in one), np.int64, len(first))


def noise_of(frame: IntArray, position: FloatArray, square: float, step_seconds: float) -> float:
    """The 1-σ of positions in metres, with the unexpected motion of a step, from triples of frames.

    Parameters
    ----------
    frame, position : (n,) in steps, increasing, and (n, 2) metres
    square : area on which the detections lie, m²
    step_seconds : seconds between frames
    """
    n, frames = len(frame), int(frame[-1] - frame[0]) + 1
    every = max(1, n // _MOST_DETECTIONS)
    chosen = (frame - frame[0]) % every == 0
    first, second = _pairs(position, frame, chosen, 1, _FASTEST * step_seconds + 2.0 * _PRIOR_STD)
    # About two other people are within that distance.
    near = float(np.clip(np.sqrt(2.0 * square * frames / (np.pi * n)), *_NEAR))
    triples = float(chosen.sum())
    if len(first) > _MOST_PAIRS:
        triples *= _MOST_PAIRS / len(first)
        some = np.linspace(0, len(first) - 1, _MOST_PAIRS).astype(int)
        first, second = first[some], second[some]
    goal = 2.0 * position[second] - position[first]
    apart = 4.0 * near
    tree = spatial.cKDTree(np.column_stack([position, frame * apart]))
    found = tree.query_ball_point(np.column_stack([goal, (frame[second] + 1) * apart]), near)
    whose = np.repeat(np.arange(len(goal)), [len(one) for one in found])
    third = np.fromiter((k for one in found for k in one), np.int64, len(whose))
    off = np.sum((position[third] - goal[whose]) ** 2, axis=1)
    prior = 2.0 * 6.0 * _PRIOR_STD**2  # squared deviation of x₃ − 2 x₂ + x₁, both axes
    mean, share, most = prior, 0.5, _MOST_SHARE * triples / max(len(off), 1)
    for _ in range(100):
        # Exponential up to the greatest distance, and uniform.
        cut = np.exp(-(near**2) / mean)
        each = share * np.exp(-off / mean) / (mean * (1.0 - cut))
        of_one = each / (each + (1.0 - share) / near**2)
        share = min((float(of_one.sum()) + 1.0) / (len(off) + 2.0), most, 0.95)
        known = (float(of_one @ off) + _PRIOR_TRIPLES * prior) / (float(of_one.sum()) + _PRIOR_TRIPLES)
        mean = min(known + near**2 * cut / (1.0 - cut), near**2)
    return float(np.sqrt(mean / 12.0))
