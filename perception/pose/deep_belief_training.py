"""Training of the deep belief network with PyTorch (Baxter et al. 2014, §III-C; Nair & Hinton 2010 for
rectified units)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

_BATCH = 256
_RATE, _DECAY = 2e-3, 0.05
_PRETRAINING_RATE, _MOMENTUM = 2e-3, 0.9
_START_DEVIATION = 0.02


@dataclass(frozen=True)
class Training:
    """Parameters of the training.

    Attributes
    ----------
    epochs, pretraining_epochs : passes over the images, of all layers together and of each Boltzmann machine
    dropout : share of the first layer's units that is dropped
    seed : of all random numbers
    """

    epochs: int
    pretraining_epochs: int
    dropout: float
    seed: int


def trained_network(
    inputs: NDArray[np.float32], labels: NDArray[np.int64], units: tuple[int, ...], training: Training
) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Train the network; return weights (inputs, units) and biases (units,) of every layer.

    Parameters
    ----------
    inputs : (n, d)
    labels : (n,) classes
    units : of every layer; the last are the classes
    """
    mean, deviation = inputs.mean(axis=0), max(float(inputs.std()), 1e-6)
    with torch.random.fork_rng(devices=[]):  # keeps the caller's random state
        torch.manual_seed(training.seed)
        x = torch.from_numpy((inputs - mean) / np.float32(deviation))
        layers = _pretrained(x, units, training)
        _fine_tune(layers, x, torch.from_numpy(labels), training)
    found = [(w.detach().numpy(), b.detach().numpy()) for w, b in layers]
    # Inputs at inference are raw pixels, so the first layer includes the standardisation.
    first, bias = found[0]
    found[0] = (first / np.float32(deviation), bias - mean @ first / np.float32(deviation))
    return found


def _pretrained(
    x: torch.Tensor, units: tuple[int, ...], training: Training
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    layers = []
    for count in units[:-1]:
        machine = boltzmann_machine(x, count, training.pretraining_epochs)
        x = torch.relu(x @ machine.weight + machine.hidden)
        spread = x.std() + 1e-6  # unit spread for the next machine
        layers.append((machine.weight / spread, machine.hidden / spread))
        x = x / spread
    last = torch.randn(units[-2] if len(units) > 1 else x.shape[1], units[-1]) * _START_DEVIATION
    return [*layers, (last, torch.zeros(units[-1]))]


@dataclass(frozen=True, eq=False)
class BoltzmannMachine:
    """``weight`` (d, units), and the biases of its hidden (units,) and visible (d,) units."""

    weight: torch.Tensor
    hidden: torch.Tensor
    visible: torch.Tensor


def boltzmann_machine(x: torch.Tensor, count: int, epochs: int) -> BoltzmannMachine:
    """Train a machine of ``count`` hidden units on inputs (n, d) of about unit spread.

    One step of contrastive divergence a batch; visible units are Gaussian, hidden ones noisy and rectified.
    """
    weight = torch.randn(x.shape[1], count) * (1.0 / x.shape[1]) ** 0.5
    hidden, visible = torch.zeros(count), torch.zeros(x.shape[1])
    moving = [torch.zeros_like(part) for part in (weight, hidden, visible)]
    for epoch in range(epochs):
        rate = _PRETRAINING_RATE * (1.0 - epoch / epochs)
        for chosen in torch.randperm(len(x)).split(_BATCH):
            batch = x[chosen]
            active = batch @ weight + hidden
            up = torch.relu(active)
            noisy = torch.relu(active + torch.randn_like(active) * torch.sigmoid(active).sqrt())
            again = noisy @ weight.T + visible
            down = torch.relu(again @ weight + hidden)
            n = len(batch)
            steps = (
                (batch.T @ up - again.T @ down) / n - 1e-3 * weight,
                (up - down).mean(dim=0),
                (batch - again).mean(dim=0),
            )
            for part, moved, step in zip((weight, hidden, visible), moving, steps, strict=True):
                moved.mul_(_MOMENTUM).add_(step, alpha=rate)
                part.add_(moved)
    return BoltzmannMachine(weight, hidden, visible)


def _fine_tune(
    layers: list[tuple[torch.Tensor, torch.Tensor]],
    x: torch.Tensor,
    labels: torch.Tensor,
    training: Training,
) -> None:
    parameters = [part.requires_grad_() for layer in layers for part in layer]
    optimiser = torch.optim.AdamW(parameters, lr=_RATE, weight_decay=_DECAY)
    steps = training.epochs * -(-len(x) // _BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _RATE, total_steps=steps)
    for _ in range(training.epochs):
        for chosen in torch.randperm(len(x)).split(_BATCH):
            values = x[chosen]
            for k, (weight, bias) in enumerate(layers[:-1]):
                values = torch.relu(values @ weight + bias)
                if k == 0:
                    values = functional.dropout(values, training.dropout)
            weight, bias = layers[-1]
            loss = functional.cross_entropy(values @ weight + bias, labels[chosen])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
