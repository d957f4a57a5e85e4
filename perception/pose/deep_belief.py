"""Head pose by a deep belief network on equalised pixels (Baxter et al. 2014, §III-C).

PyTorch trains the network (`perception.pose.deep_belief_training`, extra ``train``); NumPy evaluates it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, grey_stack
from perception.pose.classes import PoseClasses
from perception.pose.classifier import FeatureClassifier

SIDE = 32
"""Side of the equalised head, pixels."""


class DeepBelief(FeatureClassifier):
    """softmax(W₃·max(0, W₂·max(0, W₁·z + b₁) + b₂) + b₃) of the 32 × 32 equalised pixels z in 0…1.

    The hidden layers are pre-trained as restricted Boltzmann machines, then all layers are trained together
    with dropout on the first.

    Parameters
    ----------
    classes : by default 8 pans
    units : of the hidden layers
    epochs : of the training of all layers
    pretraining_epochs : of each Boltzmann machine; 0 for none
    dropout : share of the first layer's units that is dropped in each training step
    """

    kind: ClassVar[str] = "deep_belief"
    options = ("units", "epochs", "pretraining_epochs", "dropout")

    def __init__(
        self,
        classes: PoseClasses | None = None,
        *,
        seed: int = 0,
        units: Sequence[int] = (1024, 400),
        epochs: int = 10,
        pretraining_epochs: int = 2,
        dropout: float = 0.2,
    ) -> None:
        super().__init__(classes or PoseClasses.circle(8), seed=seed)
        if not units or min(units) < 1:
            raise InputError(f"layers of {list(units)} units", "at least one layer of at least one unit")
        if epochs < 1 or pretraining_epochs < 0:
            raise InputError(f"{epochs} and {pretraining_epochs} epochs", "at least 1, and none below 0")
        if not 0.0 <= dropout < 1.0:
            raise InputError(f"dropout {dropout}", "a share from 0 to below 1")
        self.units, self.epochs = tuple(units), epochs
        self.pretraining_epochs, self.dropout = pretraining_epochs, dropout
        self._layers: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []  # weights and biases

    def features(self, images: Sequence[Image]) -> FloatArray:
        """Equalised pixels (n, 1024) in 0…1."""
        return grey_stack(images, SIDE, SIDE, equalise=True).reshape(len(images), -1) / 255.0

    @staticmethod
    def check_trainable() -> None:
        """Check that training is possible.

        Raises
        ------
        InputError
            If PyTorch is not installed.
        """
        if find_spec("torch") is None:
            raise InputError("no PyTorch", "the extra train: pip install -e '.[train]'")

    def fit_features(self, features: FloatArray, labels: NDArray[np.int64], rng: np.random.Generator) -> None:
        """Train the network.

        Raises
        ------
        InputError
            If PyTorch is not installed.
        """
        self.check_trainable()
        from perception.pose.deep_belief_training import Training, trained_network

        self._layers = trained_network(
            features.astype(np.float32),
            labels,
            (*self.units, len(self.classes)),
            Training(self.epochs, self.pretraining_epochs, self.dropout, int(rng.integers(2**31))),
        )

    def scores(self, features: FloatArray) -> FloatArray:
        """Inputs of the softmax (n, n_classes)."""
        weight, bias = self._layers[-1]
        return np.asarray(self.hidden(features) @ weight + bias, float)

    def hidden(self, features: FloatArray) -> NDArray[np.float32]:
        """Activations (n, units) of the last hidden layer for equalised pixels (n, 1024)."""
        values = np.asarray(features, np.float32)
        for weight, bias in self._layers[:-1]:
            values = np.maximum(values @ weight + bias, np.float32(0.0))
        return values

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return weights quantised per unit (without loss of accuracy), steps and biases."""
        arrays: dict[str, NDArray[Any]] = {}
        for k, (weight, bias) in enumerate(self._layers):
            step = np.maximum(np.abs(weight).max(axis=0), 1e-12) / 127.0
            arrays |= {
                f"weight_{k}": np.rint(weight / step).astype(np.int8),
                f"step_{k}": step.astype(np.float32),
                f"bias_{k}": bias,
            }
        return arrays

    def set_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state from `arrays`."""
        self._layers = [
            (arrays[f"weight_{k}"] * arrays[f"step_{k}"], arrays[f"bias_{k}"])
            for k in range(len(self.units) + 1)
        ]
