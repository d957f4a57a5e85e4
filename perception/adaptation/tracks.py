"""How much the pictures of one person along their way are worth together.

Pictures of one person resemble each other, and mistakes are made again: who is taken for their back is so
in frame after frame, by body and head. The graph multiplies what it is told frame by frame, as if each were
news. Its share of outliers among class likelihoods says how little news each is; here it is found by people
left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Model
from perception.adaptation.teaching import CLASSES

OUTLIERS = "class_outlier_probability"
"""What the card of a camera's models calls it."""
_SHARES = np.linspace(0.05, 0.98, 94)
_EQUAL = 0.01
"""Log likelihood a person by which no share is better than another."""


def class_outlier_probability(
    parts: list[FloatArray], angle: FloatArray, person: NDArray[np.int64], count: FloatArray
) -> float:
    """The graph's ``likelihood.class_outlier_probability`` for what such models say.

    People left out are likeliest under it to go where they go, and not some eighths of a turn to the side.

    Parameters
    ----------
    parts : log likelihoods (n, 8) of the classes by models that have not seen the person, of body and head
    angle : (n,) radians, where they go in the image frame
    person : (n,) numbers
    count : (n,) frames that each row stands for
    """
    turned = (CLASSES.index(angle)[:, None] + np.arange(len(CLASSES))) % len(CLASSES)
    said = [np.take_along_axis(np.exp(log_softmax(part, axis=1)), turned, axis=1) for part in parts]
    people, whose = np.unique(person, return_inverse=True)

    def loss(share: float) -> float:
        of_row = sum(np.log((1.0 - share) * p + share / len(CLASSES)) for p in said)
        of_person = np.zeros((len(people), len(CLASSES)))
        np.add.at(of_person, whose, of_row * count[:, None])
        return -float(log_softmax(of_person, axis=1)[:, 0].mean())

    # Where several do, the models are believed as far as they can be.
    losses = np.array([loss(share) for share in _SHARES.tolist()])
    return float(_SHARES[np.flatnonzero(losses <= losses.min() + _EQUAL)[0]])


def with_outliers(model: Model, share: float) -> Model:
    """The same graph, for which a share of class likelihoods says nothing."""
    parameters = model.parameters
    likelihood = replace(parameters.likelihood, class_outlier_probability=share)
    return model.with_parameters(replace(parameters, likelihood=likelihood))
