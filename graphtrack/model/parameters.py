"""Parameters of the model, with their units. They are what a model file holds.

The defaults of motion, orientation and coupling were fitted to motion capture of people who walk, turn and
run (30 Hz; 0.1 m of noise on positions, body κ = 1.2, head κ = 2.3, as in 002's Table 2), on every other
clip: q by the likelihood of the true positions under the smoother's covariance, the others by the mean
angular errors of `separate` and `joint`. docs/model.md has the errors on the clips that were left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

from graphtrack.errors import InputError

Robust = Literal["none", "huber", "cauchy"]


def _check(owner: object, name: str, low: float, high: float, *, open_low: bool = False) -> None:
    value = getattr(owner, name)
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not number or not (low < value if open_low else low <= value) or value > high:
        bracket = "(" if open_low else "["
        raise InputError(f"{name} = {value!r}", f"a number in {bracket}{low:g}, {high:g}]")


@dataclass(frozen=True)
class MotionParameters:
    """White-noise acceleration and intentional motion (MODEL terms 1 and 5).

    Attributes
    ----------
    acceleration_density : q in m²/s³; Q(Δt) = q·[[Δt³/3, Δt²/2], [Δt²/2, Δt]] on each axis
    initial_speed_std : m/s, 1-σ of each axis of the velocity where the track begins
    head_rate : λ in 1/s at which the velocity turns to where the head points, in the presets that have it;
        0: it does not
    """

    acceleration_density: float = 0.15
    initial_speed_std: float = 1.5
    head_rate: float = 1.3

    def __post_init__(self) -> None:
        _check(self, "acceleration_density", 0.0, 1e6, open_low=True)
        _check(self, "initial_speed_std", 0.0, 1e3, open_low=True)
        _check(self, "head_rate", 0.0, 1e3)


@dataclass(frozen=True)
class OrientationParameters:
    """Rotational diffusion of body and head (MODEL term 2): κ of a step is 1/(diffusion·Δt).

    Attributes
    ----------
    body_diffusion, head_diffusion : rad²/s
    """

    body_diffusion: float = 0.24
    head_diffusion: float = 0.11

    def __post_init__(self) -> None:
        for name in ("body_diffusion", "head_diffusion"):
            _check(self, name, 0.0, 1e6, open_low=True)


@dataclass(frozen=True)
class CouplingParameters:
    """Body follows motion and head follows body (MODEL terms 3 and 4; 002 eq. 8–10).

    Attributes
    ----------
    motion_body_kappa : κ₁ in (m/s)⁻²; κ(v) = κ₁·max(0, ‖v‖ − τ)²
    speed_threshold : τ in m/s
    head_body_kappa : κ₂, dimensionless
    correlation_time : seconds over which deviations from a coupling persist. Frames closer than that carry
        the same evidence again, so a step of Δt counts min(1, Δt/correlation_time) times; 0: each frame
        counts once, as in 002.
    """

    motion_body_kappa: float = 38.0
    speed_threshold: float = 0.13
    head_body_kappa: float = 4.5
    correlation_time: float = 0.38

    def __post_init__(self) -> None:
        for name in ("motion_body_kappa", "speed_threshold", "head_body_kappa", "correlation_time"):
            _check(self, name, 0.0, 1e6)

    def weight(self, step: float | None) -> float:
        """How much a coupling counts at a frame ``step`` seconds after the one before (None: the first)."""
        if step is None or step >= self.correlation_time:
            return 1.0
        return step / self.correlation_time


@dataclass(frozen=True)
class GaitParameters:
    """Modes of the couplings (MODEL, "Where the papers need care"): aligned, or free with an offset.

    Attributes
    ----------
    body_aligned : probability, in the long run, that the body faces where the motion goes
    body_switching : 1/s, the sum of the rates at which the mode changes to and fro
    body_spread : radians, 1-σ of the offset that an aligned body has all the same
    body_drift : rad²/s by which an offset between motion and body diffuses
    body_strength, body_free_strength : κ₁ where the body is aligned, and about an offset, as multiples of
        ``motion_body_kappa``
    body_lead : seconds by which the body turns before the motion does
    head_evidence : how much the head counts, 0 to 1, when the body's mode is judged
    head_aligned, head_switching, head_spread, head_drift : the same of the head against the body
    head_strength, head_free_strength : κ₂, as multiples of ``head_body_kappa``
    head_lead : seconds by which the head turns before the body does
    body_offset_kappa, head_offset_kappa : concentration about 0 of an offset that is drawn for the free mode;
        0: any is as likely
    head_rate_seen : share of the motion's ``head_rate`` that holds where a position is seen, 0 to 1
    """

    body_aligned: float = 0.36
    body_switching: float = 0.013
    body_spread: float = 0.07
    body_drift: float = 0.003
    body_strength: float = 3.3
    body_free_strength: float = 0.63
    body_lead: float = 0.13
    head_evidence: float = 0.25
    head_aligned: float = 0.31
    head_switching: float = 0.011
    head_spread: float = 0.07
    head_drift: float = 0.003
    head_strength: float = 6.4
    head_free_strength: float = 7.8
    head_lead: float = 0.35
    body_offset_kappa: float = 0.2
    head_offset_kappa: float = 3.0
    head_rate_seen: float = 0.54

    def __post_init__(self) -> None:
        for name in ("body_aligned", "head_aligned", "head_evidence", "head_rate_seen"):
            _check(self, name, 0.0, 1.0)
        for name in ("body_lead", "head_lead"):
            _check(self, name, 0.0, 10.0)
        for side in ("body", "head"):
            for name in ("switching", "spread", "drift", "strength", "free_strength"):
                _check(self, f"{side}_{name}", 0.0, 1e6)
            _check(self, f"{side}_offset_kappa", 0.0, 100.0)


@dataclass(frozen=True)
class LikelihoodParameters:
    """Position and orientation likelihoods (MODEL terms 6 and 7).

    Attributes
    ----------
    position_std : metres, 1-σ of each axis where the data do not say
    pixel_std : pixels, 1-σ of each axis of the foot point, where the pixel likelihood is used
    image_frame : judge positions in the image (002 eq. 12) where the track has pixels and a camera
    robust : "none", "huber" or "cauchy" position likelihood
    robust_threshold : standard deviations beyond which a position counts less
    body_kappa, head_kappa : von Mises concentration of observed angles where the data do not say
    outlier_probability : ε of an observed angle
    class_outlier_probability : ε of class likelihoods
    """

    position_std: float = 0.1
    pixel_std: float = 3.0
    image_frame: bool = True
    robust: Robust = "none"
    robust_threshold: float = 3.0
    body_kappa: float = 4.0
    head_kappa: float = 4.0
    outlier_probability: float = 0.0
    class_outlier_probability: float = 0.05

    def __post_init__(self) -> None:
        for name in ("position_std", "pixel_std", "robust_threshold"):
            _check(self, name, 0.0, 1e6, open_low=True)
        for name in ("body_kappa", "head_kappa"):
            _check(self, name, 0.0, 1e6)
        for name in ("outlier_probability", "class_outlier_probability"):
            _check(self, name, 0.0, 0.999)
        if self.robust not in ("none", "huber", "cauchy"):
            raise InputError(f"robust = {self.robust!r}", "'none', 'huber' or 'cauchy'")
        if not isinstance(self.image_frame, bool):
            raise InputError(f"image_frame = {self.image_frame!r}", "true or false")


@dataclass(frozen=True)
class Parameters:
    """All parameters of the model."""

    motion: MotionParameters = field(default_factory=MotionParameters)
    orientation: OrientationParameters = field(default_factory=OrientationParameters)
    coupling: CouplingParameters = field(default_factory=CouplingParameters)
    gait: GaitParameters = field(default_factory=GaitParameters)
    likelihood: LikelihoodParameters = field(default_factory=LikelihoodParameters)

    @classmethod
    def from_dict(cls, tables: dict[str, Any], defaults: Parameters | None = None) -> Parameters:
        """Parameters from nested tables; what is not named keeps its value in ``defaults``.

        Raises
        ------
        InputError
            For an unknown table or key, and for a value outside its range.
        """
        start = cls() if defaults is None else defaults
        known = [f.name for f in fields(cls)]
        parts = {}
        for table, values in tables.items():
            if table not in known or not isinstance(values, dict):
                raise InputError(f"table {table!r}", f"one of {', '.join(known)}")
            part = getattr(start, table)
            names = [f.name for f in fields(part)]
            for name in values:
                if name not in names:
                    raise InputError(f"key {table}.{name}", f"one of {', '.join(names)}")
            try:
                parts[table] = replace(part, **values)
            except InputError as error:
                raise InputError(f"{table}.{error.found}", error.expected) from error
        return replace(start, **parts)
