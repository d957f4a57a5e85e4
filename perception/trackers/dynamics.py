"""Second-order autoregressive motion of boxes (Ba & Odobez 2003, §3.3), with another's prediction mixed
in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.particles import effective_sample_size, resample
from perception.trackers.tracker import Cloud, Proposal


@dataclass(frozen=True)
class BoxDynamics:
    """Of the centre in units of the box's size, and of the logarithm of the size; all for one frame.

    Attributes
    ----------
    persistence : share of the centre's last step that is made again, 0 (random walk) … 1 (constant velocity)
    centre_std : 1-σ of the noise of the centre, as a share of the box's width and height
    size_persistence : the same for the logarithm of the size
    size_std : 1-σ of the noise of the logarithm of the size
    reversion : share of the way back to the first size that is gone in each frame
    guided_share : share of the particles whose centre is drawn from a `Proposal`, where there is one
    """

    persistence: float = 0.8
    centre_std: float = 0.08
    size_persistence: float = 0.3
    size_std: float = 0.02
    reversion: float = 0.01
    guided_share: float = 0.8


def resampled(cloud: Cloud, below: float, rng: np.random.Generator) -> tuple[Cloud, NDArray[np.int64]]:
    """A cloud whose weights do their work, and the particles (n,) that it is made of.

    It is drawn anew where its effective sample size is less than a share ``below`` of its particles.
    """
    n = len(cloud.weights)
    if effective_sample_size(cloud.weights) >= below * n:
        return cloud, np.arange(n)
    ancestors = resample(cloud.weights, rng)
    return cloud.chosen(ancestors), ancestors


def predict(
    cloud: Cloud,
    reference: FloatArray,
    dynamics: BoxDynamics,
    rng: np.random.Generator,
    proposal: Proposal | None = None,
    shape: tuple[int, ...] | None = None,
) -> Cloud:
    """Draw the next states of all particles.

    x_t = x_{t−1} + a·(x_{t−1} − x_{t−2}) + noise for the centre; the size also goes back to its reference.
    With a proposal the motion is a mixture: the centres of ``guided_share`` of the particles come from it,
    with no step behind them, so that a cloud that lost its target is not carried on by its last speed.

    Parameters
    ----------
    reference : (2,) logarithms of the first width and height (pixels)
    shape : of an image (h, w) that the centres are kept within
    """
    now, step = cloud.now, cloud.now - cloud.before
    noise = rng.standard_normal(now.shape)
    size = np.exp(now[:, 2:])
    after = np.empty_like(now)
    after[:, :2] = now[:, :2] + dynamics.persistence * step[:, :2] + dynamics.centre_std * size * noise[:, :2]
    after[:, 2:] = (
        now[:, 2:]
        + dynamics.size_persistence * step[:, 2:]
        + dynamics.reversion * (reference - now[:, 2:])
        + dynamics.size_std * noise[:, 2:]
    )
    before = now.copy()
    if proposal is not None:
        guided = rng.random(len(now)) < dynamics.guided_share
        drawn = rng.multivariate_normal(proposal.centre, proposal.covariance, len(now))
        after[guided, :2] = drawn[guided]
        before[guided] = after[guided]
    if shape is not None:
        np.clip(after[:, :2], 0.0, shape[::-1], out=after[:, :2])
    return Cloud(after, before, cloud.weights)
