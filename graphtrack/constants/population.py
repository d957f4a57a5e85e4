"""The population prior: shares of the values of each constant among the people of a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path
from graphtrack.io.source import read_toml

DENSITIES = np.geomspace(0.01, 10.0, 13)
"""Values of q, the spectral density of white-noise acceleration, m²/s³."""

DIFFUSIONS = np.radians(np.geomspace(2.5, 160.0, 13)) ** 2
"""Values of the rotational diffusion of body and head, rad²/s."""


@dataclass(frozen=True)
class CouplingAlternative:
    """A way in which orientations follow the motion.

    Attributes
    ----------
    name : in words
    motion_body, head_body : multiples of the model's κ₁ and κ₂; 0: free
    """

    name: str
    motion_body: float
    head_body: float


COUPLINGS = (
    CouplingAlternative("free", 0.0, 0.0),
    CouplingAlternative("head follows body", 0.0, 1.0),
    CouplingAlternative("body follows path", 1.0, 0.0),
    CouplingAlternative("body follows path, head follows body", 1.0, 1.0),
)


def log_normal(values: FloatArray, centre: float, width: float) -> tuple[float, ...]:
    """Return shares that are normal in the logarithm of the values."""
    found = np.exp(-0.5 * (np.log(values / centre) / width) ** 2)
    return tuple((found / found.sum()).tolist())


class Evidence(NamedTuple):
    """Log evidence of the values of a person's constants; of `COUPLINGS`, equal where they are alike."""

    acceleration_density: FloatArray
    body_diffusion: FloatArray
    head_diffusion: FloatArray
    coupling: FloatArray


_SHARES = Evidence._fields
_NUMBERS = (
    *("people", "gross_errors", "position_noise", "pixel_noise", "body_noise", "head_noise"),
    *("along", "across", "body_outliers", "head_outliers"),
)


@dataclass(frozen=True)
class Population:
    """Shares of people for whom each value of a constant holds; the default is a broad prior.

    The prior's centres and widths are those of motion capture, crowds, a crossing and a party together, of
    people and minutes that `graphtrack reproduce unseen-people` leaves out.

    Attributes
    ----------
    acceleration_density : of `DENSITIES`
    body_diffusion, head_diffusion : of `DIFFUSIONS`
    coupling : of `COUPLINGS`
    people : people that the shares count for, when those of a recording are learned
    gross_errors : share of positions that are gross errors
    position_noise, pixel_noise, body_noise, head_noise : 1-σ of observations where none is declared,
        multiples of the model's; pixel_noise 0: positions of the image are judged on the ground
    along, across : persistent errors of such positions, as in `Persistent`
    body_outliers, head_outliers : share of observed angles that are outliers
    """

    acceleration_density: tuple[float, ...] = log_normal(DENSITIES, 0.04, 1.4)
    body_diffusion: tuple[float, ...] = log_normal(DIFFUSIONS, math.radians(14.0) ** 2, 2.3)
    head_diffusion: tuple[float, ...] = log_normal(DIFFUSIONS, math.radians(14.0) ** 2, 2.3)
    coupling: tuple[float, ...] = (0.1, 0.1, 0.1, 0.7)
    people: float = 2.0
    gross_errors: float = 0.0
    position_noise: float = 1.0
    pixel_noise: float = 1.0
    body_noise: float = 1.0
    head_noise: float = 1.0
    along: float = 0.0
    across: float = 0.0
    body_outliers: float = 0.0
    head_outliers: float = 0.0

    def __post_init__(self) -> None:
        sizes = {"acceleration_density": len(DENSITIES), "coupling": len(COUPLINGS)}
        for name, shares in asdict(self).items():
            if name in _NUMBERS:
                continue
            size = sizes.get(name, len(DIFFUSIONS))
            numbers = [one for one in shares if isinstance(one, float) and 0.0 < one <= 1.0]
            if (
                len(shares) != size
                or len(numbers) != size
                or not math.isclose(sum(numbers), 1.0, abs_tol=1e-6)
            ):
                raise InputError(f"{name} = {shares!r}"[:80], f"{size} positive shares with the sum 1")
        for name in _NUMBERS:
            number = getattr(self, name)
            if not (isinstance(number, float) and 0.0 <= number < math.inf):
                raise InputError(f"{name} = {number!r}", "a number that is not negative")

    def coupling_of(self, alternatives: Sequence[CouplingAlternative]) -> FloatArray:
        """Return the probabilities (k,) of some couplings, given that it is one of them."""
        found = np.array(self.coupling)[[COUPLINGS.index(one) for one in alternatives]]
        return np.asarray(found / found.sum())

    def with_coupling(self, alternatives: Sequence[CouplingAlternative], learned: FloatArray) -> Population:
        """Return the population with probabilities (k,) of some couplings; the others keep their shares."""
        found = np.array(self.coupling)
        places = [COUPLINGS.index(one) for one in alternatives]
        found[places] = learned * found[places].sum()
        return replace(self, coupling=tuple((found / found.sum()).tolist()))

    def with_people(self, evidence: Sequence[Evidence], prior: Population) -> Population:
        """Return the population with more people; each counts as far as a posterior is not the prior.

        Parameters
        ----------
        evidence : of each person
        prior : the population by which the evidence is judged
        """
        if not evidence:
            return self
        own = {
            name: posterior(
                np.array([getattr(one, name) for one in evidence]), np.array(getattr(prior, name))
            )
            for name in _SHARES
        }
        # A person counts alike for all constants, so that the order of people does not matter.
        apart = [np.abs(found - getattr(prior, name)).sum(axis=1) for name, found in own.items()]
        weight = 0.5 * np.max(apart, axis=0)
        shares: dict[str, tuple[float, ...]] = {}
        for name, found in own.items():
            grid = None if name == "coupling" else DENSITIES if name == "acceleration_density" else DIFFUSIONS
            added = weight @ (found if grid is None else found @ blur_of(grid))
            mean = self.people * np.array(getattr(self, name)) + added
            shares[name] = tuple((mean / mean.sum()).tolist())
        grown = replace(self, people=self.people + float(weight.sum()))
        return grown.with_shares(shares)

    def with_shares(self, shares: Mapping[str, tuple[float, ...]]) -> Population:
        """Return the population with other shares of the values of some constants."""
        changed: dict[str, Any] = dict(shares)
        return replace(self, **changed)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of a file."""
        return {name: list(one) if isinstance(one, tuple) else one for name, one in asdict(self).items()}

    def save(self, path: str | Path) -> None:
        """Write a file (TOML), whole or not at all."""
        with atomic_path(path) as temporary:
            Path(temporary).write_text(tomli_w.dumps(self.to_dict()), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Population:
        """Read a file of `save`; InputError names the file and the key."""
        content = read_toml(path, "a file of constants")
        try:
            return cls.from_dict(content)
        except InputError as error:
            raise InputError(error.found, error.expected, path=path) from error

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Population:
        """Return the population of the contents of a file; InputError for what they do not fit."""
        known = set(cls.__dataclass_fields__)
        for name, value in content.items():
            if name not in known:
                raise InputError(f"the unknown key {name!r}", f"one of {', '.join(sorted(known))}")
            if name not in _NUMBERS and not isinstance(value, list):
                raise InputError(f"{name} = {value!r}"[:80], "a list of shares")
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in content.items()
        }
        return cls(**values)


ROUNDS = 50
"""Rounds of expectation maximisation; the shares change by less than 1 % after some twenty."""

_SPREAD = 0.6
"""Width over which the shares of neighbouring values are smoothed, in the logarithm: about one value."""


def learned(
    evidence: FloatArray,
    start: tuple[float, ...],
    people: float,
    values: FloatArray | None,
    rounds: int = ROUNDS,
) -> FloatArray:
    """Return the shares (k,) of a population, by expectation maximisation from the evidence of each person.

    The result does not depend on the order of the people.

    Parameters
    ----------
    evidence : (m, k) log evidence of each value for each person; equal values say nothing
    start : (k,) the prior, which counts for so many ``people``
    values : (k,) of the constant, over whose logarithm shares are smooth; None: they have no order
    """
    ordered, prior = evidence[np.lexsort(evidence.T)], np.array(start)
    blur = None if values is None else blur_of(values)
    for _ in range(rounds if len(evidence) else 0):
        prior = posterior(ordered, prior).sum(axis=0) + people * np.array(start)
        prior = prior if blur is None else prior @ blur
        prior = prior / prior.sum()
    return prior


def blur_of(values: FloatArray) -> FloatArray:
    """Return the matrix (k, k) that spreads shares of values over their neighbours."""
    logs = np.log(values)
    blur = np.exp(-0.5 * ((logs[:, None] - logs) / _SPREAD) ** 2)
    return np.asarray(blur / blur.sum(axis=1, keepdims=True))


def posterior(evidence: FloatArray, prior: FloatArray) -> FloatArray:
    """Return the probabilities (m, k) of values by their log evidence (m, k) and prior (k,)."""
    total = evidence + np.log(prior)
    found = np.exp(total - total.max(axis=1, keepdims=True))
    return np.asarray(found / found.sum(axis=1, keepdims=True))
