"""Diagnosis of the declared noise and of the convention of angles.

The noise is compared by its multiple of maximum likelihood, angles with the direction of motion. An angle to
the motion common to all people is attributed to the detector or to the file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from graphtrack.constants.directions import FEWEST_TRACKS, AngleFit, angle_fit, relation_of
from graphtrack.constants.noise import (
    SPREADS,
    NoiseEvidence,
    any_in_image,
    noise_evidence,
    scaled,
    undeclared,
    with_outlier_share,
)
from graphtrack.constants.personal import Constants, is_learned
from graphtrack.errors import InputError
from graphtrack.model.given import notes_on
from graphtrack.packages import special
from graphtrack.tracks.given import with_position_noise
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.model import Model


SURE = 0.999  # Probability of the intervals against which a declaration is tested

BLOCKS = 20
"""Blocks of people that the jackknife leaves out, one at a time."""


_WIDEST = 10.0
"""Largest half width of an interval, in the logarithm of the multiplier."""


@dataclass(frozen=True)
class Multiplier:
    """Factor for a declared 1-σ, and its interval of probability `SURE`.

    Attributes
    ----------
    value, low, high : of independent errors
    persistent : 1-σ of errors that persist, metres; 0: none
    """

    value: float
    low: float
    high: float
    persistent: float = 0.0


def multiplier_of(found: NoiseEvidence) -> Multiplier:
    """Return the multiplier of the declared noise.

    The variance is the larger one of the jackknife's, if people differ, and the curvature's, if they are few.
    """
    names, own = np.unique(found.tracks, return_inverse=True)
    block = (own if len(names) >= FEWEST_TRACKS else np.arange(len(own))) % BLOCKS
    known = np.unique(block).tolist()
    left_out = np.array([found.peak((block != one).astype(float))[0] for one in known])
    value, variance = found.peak()
    jackknife = float(np.sum((left_out - left_out.mean()) ** 2)) * (len(known) - 1) / len(known)
    reach = float(special.stdtrit(len(known) - 1, 0.5 + 0.5 * SURE))
    half = min(reach * math.sqrt(max(jackknife, variance)), _WIDEST)
    low, high = math.exp(value - half), math.exp(value + half)
    return Multiplier(math.exp(value), low, high, max(found.persistent.along, found.persistent.across))


Trust = Literal["declared", "check", "learn"]
"""Use of the declared noise: unchanged; checked, with reports of contradictions; or corrected there."""

MANY = 0.1
"""Share of outliers among angles that is reported."""

TOO_FAR, SURELY = 1.25, 1.1
"""A declared σ is contradicted if wrong by the first factor, and by the second with 99.9 % probability."""


@dataclass(frozen=True)
class ChannelNoise:
    """The evidence about the declared noise of a channel.

    Attributes
    ----------
    name : "position", "body" or "head"
    multiplier : factor of the declared 1-σ; None: too few observations
    angles : angles against the motion; None: too few people in motion
    column : the file's column that declares the noise, else the model's parameter
    outliers : share of outliers among observed angles, if the model has none of its own or learned
    """

    name: str
    multiplier: Multiplier | None
    angles: AngleFit | None
    column: str
    outliers: float

    @property
    def scale(self) -> float:
        """Factor for the declared σ: 1 if it is not contradicted."""
        found = self.multiplier
        if found is None or 1.0 / TOO_FAR < found.value < TOO_FAR:
            return 1.0
        return found.value if found.low > SURELY or found.high < 1.0 / SURELY else 1.0

    @property
    def wrong_angles(self) -> AngleFit | None:
        """The fit of angles that are rotated or mirrored; None if the data do not show it."""
        return self.angles if self.angles is not None and self.angles.is_wrong else None

    def line(self, corrected: bool) -> str | None:
        """Return a report in one line; None if there is nothing to report."""
        lines: list[str] = []
        if self.scale != 1.0 and self.multiplier is not None:
            found = self.multiplier
            lines.append(
                f"the noise is {found.value:.2g} times ({found.low:.2g} to {found.high:.2g}) what "
                f"{self.column} says" + ("" if self.name == "position" else " (as a 1-σ)")
            )
            if found.persistent:
                lines.append(f"errors of {found.persistent:.2g} m persist")
        if self.outliers >= MANY:
            lines.append(
                f"{100.0 * self.outliers:.0f} % of the angles are outliers (likelihood.{self.name}_outliers)"
            )
        if self.wrong_angles is not None:
            lines.append(self.wrong_angles.described())
        if not lines:
            return None
        end = "corrected" if corrected else "graphtrack smooth --trust learn corrects it"
        angles = self.wrong_angles
        if angles is not None and angles.is_gross and not angles.is_mirrored:
            end += "; --trust declared keeps angles of people who do not face their motion"
        return f"{self.name}: {' and '.join(lines)}; {end}"


@dataclass(frozen=True)
class DeclaredNoise:
    """Evidence about the declared noise of all channels that a model reads.

    ``relation`` is that of heads to bodies, where the motion shows no wrong angles; None: too few of both
    """

    channels: tuple[ChannelNoise, ...]
    relation: AngleFit | None = None

    def lines(self, corrected: bool = False) -> list[str]:
        """Return contradictions of the declarations, a line for each channel."""
        lines = [line for one in self.channels if (line := one.line(corrected)) is not None]
        found = self.relation
        if found is not None and found.is_wrong and found.is_gross:
            lines.append(
                f"head, body: the angles of heads are {found.relation} against those of bodies: one of the "
                "two columns has another convention, and nobody's motion shows which"
            )
        return lines

    def corrected(self, tracks: TrackSet, model: Model) -> tuple[TrackSet, Model]:
        """Return tracks without biases, and the model with noise consistent with the data."""
        parameters = model.parameters
        for one in self.channels:
            if one.scale != 1.0:
                parameters = scaled(parameters, one.name, one.scale)
            if one.outliers >= MANY:
                parameters = with_outlier_share(parameters, one.name, one.outliers)
        if parameters is not model.parameters:
            model = model.with_parameters(parameters)
        wrong = [(one.name, one.wrong_angles) for one in self.channels if one.wrong_angles is not None]

        def corrected(track: Track) -> Track:
            changes: dict[str, Any] = {}
            for name, found in wrong:
                changes |= found.corrected(track, name, tracks.camera)
            return replace(track, **changes)

        return (tracks.map(corrected) if wrong else tracks), model


def trusted(
    tracks: TrackSet, model: Model, trust: Trust, constants: Constants | None = None
) -> tuple[TrackSet, Model, list[str]]:
    """Return tracks and model to solve, and notes on the noise and on channels that the model does not use.

    Raise InputError for an unknown `Trust`.

    Parameters
    ----------
    constants : where they are learned, noise that is not declared is learned too, and not checked
    """
    if trust not in ("declared", "check", "learn"):
        raise InputError(f"trust {trust!r}", "declared, check or learn")
    notes = notes_on(tracks.tracks, model, tracks.camera)
    tracks = tracks.map(with_position_noise)
    if trust == "declared":
        return tracks, model, notes
    learns = is_learned(constants, model)
    noise = declared_noise(tracks, model, undeclared(tracks, model) if learns else (), outliers=not learns)
    if trust == "check":
        return tracks, model, [*notes, *noise.lines()]
    return *noise.corrected(tracks, model), [*notes, *noise.lines(corrected=True)]


def declared_noise(
    tracks: TrackSet, model: Model, left_out: Sequence[str] = (), *, outliers: bool = True
) -> DeclaredNoise:
    """Test the noise that a file, or else the model, declares against the data.

    Multipliers maximise the one-step predictive likelihood, always on the same stretches. Angles are compared
    with people's motion, and heads with bodies where the motion shows nothing. The noise of class likelihoods
    is not tested, but their direction.

    Parameters
    ----------
    left_out : channels whose noise is not tested
    outliers : whether shares of outliers among angles are reported
    """
    found = []
    for name, spread in SPREADS.items():
        if name != "position" and not getattr(model, f"has_{name}"):
            continue
        evidence = None
        classes = any(getattr(track, f"{name}_likelihood", None) is not None for track in tracks)
        if name not in left_out and not classes:
            evidence = noise_evidence(tracks.tracks, name, model.parameters, tracks.camera)
        angles = None if name == "position" else angle_fit(tracks, name)
        if evidence is None and angles is None:
            continue
        given = any(getattr(track, spread) is not None for track in tracks)
        column = {"position_std": "pos_std"}.get(spread, spread) if given else f"likelihood.{spread}"
        if name == "position" and any_in_image(tracks, model.parameters):
            column = "likelihood.pixel_std"
        multiplier = None if evidence is None else multiplier_of(evidence)
        own = getattr(model.parameters.likelihood, f"{name}_outliers", 0.0)
        share = evidence.outliers if outliers and evidence is not None and not own else 0.0
        found.append(ChannelNoise(name, multiplier, angles, column, share))
    has_both = model.has_body and model.has_head and all(one.wrong_angles is None for one in found)
    return DeclaredNoise(tuple(found), relation_of(tracks) if has_both else None)
