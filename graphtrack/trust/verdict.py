"""Whether the data contradict what is declared of their noise, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.parameters import Parameters, range_of
from graphtrack.tracks import Track, TrackSet
from graphtrack.trust.bias import SHARED, Bias, bias_of, turned
from graphtrack.trust.filters import angle_log_density, position_log_density
from graphtrack.trust.multiplier import Multiplier, multiplier_of
from graphtrack.trust.pieces import Pieces, pieces_of

if TYPE_CHECKING:
    from graphtrack.model import Model

Trust = Literal["declared", "check", "learn"]
"""The declared noise is taken as it is; or checked, to say where data contradict it; or corrected there."""

TOO_FAR, SURELY = 1.25, 1.1
"""A declared σ is contradicted if it is off by such a factor, and by at least the second with 99.9 %."""

BIASED, SURELY_BIASED = math.radians(10.0), math.radians(4.0)
"""The same of a bias."""


@dataclass(frozen=True)
class ChannelNoise:
    """What the data say of the declared noise of a channel.

    Attributes
    ----------
    name : "position", "body" or "head"
    multiplier : of the declared 1-σ; None: too few observations to tell
    bias : of angles; None: too few people who move
    column : the file's column that declares the noise, or the model's parameter where it does not
    """

    name: str
    multiplier: Multiplier | None
    bias: Bias | None
    column: str

    @property
    def scale(self) -> float:
        """What to multiply the declared σ with: 1 where it is not contradicted."""
        found = self.multiplier
        if found is None or 1.0 / TOO_FAR < found.value < TOO_FAR:
            return 1.0
        return found.value if found.low > SURELY or found.high < 1.0 / SURELY else 1.0

    @property
    def turn(self) -> float:
        """Radians by which everybody is seen turned; 0 where the data do not say so."""
        found = self.bias
        if found is None or abs(found.value) < BIASED or found.share < SHARED:
            return 0.0
        sure = min(abs(found.low), abs(found.high)) > SURELY_BIASED and found.low * found.high > 0.0
        return found.value if sure else 0.0

    def line(self, corrected: bool) -> str | None:
        """What there is to be said, in one line; None if nothing is."""
        said: list[str] = []
        if self.scale != 1.0 and self.multiplier is not None:
            found = self.multiplier
            said.append(
                f"the noise is {found.value:.2g} times ({found.low:.2g} to {found.high:.2g}) what "
                f"{self.column} says" + ("" if self.name == "position" else " (as a 1-σ)")
            )
        if self.turn and self.bias is not None:
            degrees = math.degrees(self.turn)
            side = "left" if degrees > 0.0 else "right"
            said.append(f"people are seen turned {abs(degrees):.0f}° to the {side} of where they go")
        if not said:
            return None
        end = "corrected" if corrected else "graphtrack smooth --trust learn corrects it"
        return f"{self.name}: {' and '.join(said)}; {end}"


@dataclass(frozen=True)
class Noise:
    """What the data say of the declared noise of all channels that a model reads."""

    channels: tuple[ChannelNoise, ...]

    def lines(self, corrected: bool = False) -> list[str]:
        """What contradicts the declarations, a line for each channel."""
        return [line for one in self.channels if (line := one.line(corrected)) is not None]

    def corrected(self, tracks: TrackSet, model: Model) -> tuple[TrackSet, Model]:
        """Tracks without the biases, and the model with the noise, that the data do not contradict."""
        likelihood, changes = model.parameters.likelihood, {}
        for one in self.channels:
            if one.scale != 1.0:
                default, power = _DECLARED[one.name]
                for name, factor in ((f"{one.name}_scale", one.scale), (default, one.scale**power)):
                    low, high = range_of(likelihood, name) or (0.0, math.inf)
                    changes[name] = min(max(getattr(likelihood, name) * factor, low), high)
        if changes:
            parameters = replace(model.parameters, likelihood=replace(likelihood, **changes))
            model = model.with_parameters(parameters)
        turns = {one.name: -one.turn for one in self.channels if one.turn}
        return (tracks.map(lambda track: _turned(track, turns)) if turns else tracks), model


def _turned(track: Track, turns: dict[str, float]) -> Track:
    changes: dict[str, Any] = {}
    for name, by in turns.items():
        changes |= turned(track, name, by)
    return replace(track, **changes)


def trusted(tracks: TrackSet, model: Model, trust: Trust) -> tuple[TrackSet, Model, list[str]]:
    """Tracks and model as they are to be solved, and what is to be said of their declared noise.

    Raises
    ------
    InputError
        For what is none of `Trust`.
    """
    if trust not in ("declared", "check", "learn"):
        raise InputError(f"trust {trust!r}", "declared, check or learn")
    if trust == "declared":
        return tracks, model, []
    noise = declared_noise(tracks.tracks, model)
    if trust == "check":
        return tracks, model, noise.lines()
    return *noise.corrected(tracks, model), noise.lines(corrected=True)


_DECLARED = {"position": ("position_std", 1.0), "body": ("body_kappa", -2.0), "head": ("head_kappa", -2.0)}
"""The channel and parameter of the noise, and the power of a multiple of σ in it."""


def declared_noise(tracks: Sequence[Track], model: Model) -> Noise:
    """What the data say of the noise that a file, or else the model, declares.

    The multipliers of σ are those that make each observation most probable after those before it, of people
    who move by white-noise acceleration and turn by diffusion, how much being learned beside. They are found
    on some stretches of the tracks, the same ones each time. A bias is an angle at which everybody is seen to
    the direction in which they go. Positions that are judged in the image, and class likelihoods but for
    their bias, are not looked at.
    """
    found, parameters = [], model.parameters
    for name in ("position", "body", "head"):
        if name != "position" and not getattr(model, f"has_{name}"):
            continue
        rng = np.random.default_rng(0)
        multiplier = _multiplier(tracks, name, parameters, rng)
        bias = None if name == "position" else bias_of(tracks, name, rng)
        if multiplier is None and bias is None:
            continue
        key, _ = _DECLARED[name]
        given = any(getattr(track, key) is not None for track in tracks)
        column = {"position_std": "pos_std"}.get(key, key) if given else f"likelihood.{key}"
        found.append(ChannelNoise(name, multiplier, bias, column))
    return Noise(tuple(found))


def _multiplier(
    tracks: Sequence[Track], name: str, parameters: Parameters, rng: np.random.Generator
) -> Multiplier | None:
    key, _ = _DECLARED[name]
    likelihood = parameters.likelihood
    default, stated = float(getattr(likelihood, key)), float(getattr(likelihood, f"{name}_scale"))

    def channel(track: Track) -> tuple[FloatArray | None, FloatArray | None]:
        in_image = name == "position" and likelihood.image_frame and track.pixel is not None
        given = getattr(track, key)
        spread = None if given is None else given * stated ** _DECLARED[name][1]
        return None if in_image else getattr(track, name), spread

    def density(some: Pieces, scale: FloatArray, wander: FloatArray, outliers: FloatArray) -> FloatArray:
        if name == "position":
            motion = parameters.motion
            q = motion.acceleration_density * wander
            return position_log_density(some, default, motion.initial_speed_std, scale, q, outliers)
        diffusion = getattr(parameters.orientation, f"{name}_diffusion")
        return angle_log_density(some, default, scale, diffusion * wander, outliers)

    pieces = pieces_of(tracks, channel, rng)
    return None if pieces is None else multiplier_of(pieces, density)
