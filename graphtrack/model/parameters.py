"""Parameters of the model, with their units.

The defaults of motion, orientation and coupling were fitted to motion capture (30 Hz; 0.1 m of noise on
positions, body κ = 1.2, head κ = 2.3, as in Chen et al.'s Table 2); see docs/model.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.validation import check_numbers, with_table

Robust = Literal["none", "huber", "cauchy"]


Scale = Literal["log", "log odds"]
"""Scale on which a parameter is learned: its logarithm or, for a probability, its log odds."""


def _number(
    default: float, low: float, high: float, unit: str = "", *, scale: Scale = "log", learned: bool = True
) -> Any:
    """A field with its range, within which estimates are finite, its unit, and its learning scale."""
    metadata = {"range": (low, high), "unit": unit, "scale": scale, "learned": learned}
    return field(default=default, metadata=metadata)


def _share(default: float, high: float = 1.0) -> Any:
    """A field of a probability or a share."""
    return _number(default, 0.0, high, scale="log odds")


class _Group:
    """Parameters that are checked against their ranges."""

    def __post_init__(self) -> None:
        check_numbers(self)


def range_of(group: Any, name: str) -> tuple[float, float] | None:
    """Lowest and highest value of a parameter of a group, in its unit; None if it is not a number."""
    limits: tuple[float, float] | None = group.__dataclass_fields__[name].metadata.get("range")
    return limits


def scale_of(group: Any, name: str) -> Scale | None:
    """Scale on which a parameter of a group is learned; None if it is not learned."""
    metadata = group.__dataclass_fields__[name].metadata
    scale: Scale | None = metadata["scale"] if metadata.get("learned") else None
    return scale


@dataclass(frozen=True)
class MotionParameters(_Group):
    """White-noise acceleration and intentional motion (docs/model/motion.md).

    Attributes
    ----------
    acceleration_density : spectral density q of white-noise acceleration, m²/s³
    initial_speed_std : 1-σ s of each axis of the first velocity, m/s
    head_rate : rate λ at which the velocity turns to the direction of the head, 1/s; presets that have it
    """

    acceleration_density: float = _number(0.15, 1e-5, 1e4, "m²/s³")
    initial_speed_std: float = _number(1.5, 1e-3, 1e3, "m/s")
    head_rate: float = _number(1.3, 0.0, 100.0, "1/s")


@dataclass(frozen=True)
class OrientationParameters(_Group):
    """Rotational diffusion of body and head (docs/model/orientation.md): κ of a step is 1/(diffusion·Δt).

    Attributes
    ----------
    body_diffusion : rotational diffusion D_body of the body, rad²/s
    head_diffusion : rotational diffusion D_head of the head, rad²/s
    """

    body_diffusion: float = _number(0.24, 1e-6, 1e4, "rad²/s")
    head_diffusion: float = _number(0.11, 1e-6, 1e4, "rad²/s")


@dataclass(frozen=True)
class CouplingParameters(_Group):
    """Body follows motion and head follows body (docs/model/orientation.md; Chen et al. 2011, eq. 8–10).

    Attributes
    ----------
    motion_body_kappa : κ₁ of the coupling of body to motion, (m/s)⁻²; κ(v) = κ₁·max(0, ‖v‖ − τ)²
    speed_threshold : speed τ below which the body is not coupled to the motion, m/s
    head_body_kappa : κ₂ of the coupling of head to body
    correlation_time : time T over which deviations from a coupling persist, s: a step of Δt counts
        min(1, Δt/T) times; 0: each frame counts once, as in Chen et al. 2011
    """

    motion_body_kappa: float = _number(38.0, 0.0, 1e6, "(m/s)⁻²")
    speed_threshold: float = _number(0.13, 0.0, 100.0, "m/s")
    head_body_kappa: float = _number(4.5, 0.0, 1e6)
    # At one frame rate only the ratio of κ to this time is identifiable: it is not learned with κ.
    correlation_time: float = _number(0.38, 0.0, 1e3, "s", learned=False)

    def weights(self, dt: FloatArray | float | None) -> FloatArray:
        """Return a coupling's weight at frames ``dt`` seconds after the previous (0, None: the first)."""
        dt = np.asarray(0.0 if dt is None else dt, dtype=float)
        short = (dt > 0.0) & (dt < self.correlation_time)
        return np.divide(dt, self.correlation_time, out=np.ones_like(dt), where=short)


@dataclass(frozen=True)
class LikelihoodParameters(_Group):
    """Position and orientation likelihoods (docs/model/pose.md).

    Attributes
    ----------
    position_std : 1-σ of each axis of a position without a declared one, m
    velocity_std : 1-σ of each axis of an observed velocity without a declared one, m/s
    pixel_std : 1-σ of each axis of the foot point in the image, pixels
    image_frame : judge positions in the image (Chen et al. 2011, eq. 12) where the track has pixels and a
        camera
    robust : loss of positions: "none" (square), "huber" or "cauchy"
    robust_threshold : threshold k of the loss, standard deviations
    body_kappa, head_kappa : von Mises concentration of an observed angle without a declared one, and of an
        axis of the body about either end
    position_scale : multiple of the declared 1-σ of positions
    body_scale, head_scale : multiple of the declared 1-σ of angles; κ is divided by its square
    body_outliers, head_outliers : outlier share ε of observed angles
    class_outlier_probability : outlier share ε of class likelihoods; a larger one of angles counts
    class_correlation_time : time T over which errors of a classifier persist, s, where rows declare none
        (inputs ``body_persistence``, ``head_persistence``): class likelihoods Δt seconds after those before
        count min(1, Δt/T) times; 0: each counts once, as in Chen et al. 2011
    hidden_outliers : outlier share of class likelihoods of a body or head that is hidden as a whole (inputs
        ``body_hidden``, ``head_hidden``): 1 − (1 − ε)·(1 − share · hidden)
    """

    position_std: float = _number(0.1, 1e-6, 100.0, "m")
    velocity_std: float = _number(0.3, 1e-6, 100.0, "m/s", learned=False)
    pixel_std: float = _number(3.0, 1e-3, 1e4, "pixels")
    image_frame: bool = True
    robust: Robust = "none"
    robust_threshold: float = _number(3.0, 0.01, 1e3, "standard deviations")
    body_kappa: float = _number(4.0, 0.0, 1e6)
    head_kappa: float = _number(4.0, 0.0, 1e6)
    position_scale: float = _number(1.0, 0.01, 100.0)
    body_scale: float = _number(1.0, 0.01, 100.0)
    head_scale: float = _number(1.0, 0.01, 100.0)
    body_outliers: float = _share(0.0, 0.999)
    head_outliers: float = _share(0.0, 0.999)
    class_outlier_probability: float = _share(0.05, 0.999)
    class_correlation_time: float = _number(0.0, 0.0, 1e3, "s", learned=False)
    hidden_outliers: float = _share(0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.robust not in ("none", "huber", "cauchy"):
            raise InputError(f"robust = {self.robust!r}", "'none', 'huber' or 'cauchy'")
        if not isinstance(self.image_frame, bool):
            raise InputError(f"image_frame = {self.image_frame!r}", "true or false")

    @property
    def has_outliers(self) -> bool:
        """Return whether observed angles may be outliers."""
        return self.body_outliers > 0.0 or self.head_outliers > 0.0

    def outliers(self, name: str, *, by_class: bool = False) -> float:
        """Outlier share ε of observed angles, or of class likelihoods, of body or head."""
        own: float = getattr(self, f"{name}_outliers")
        return max(own, self.class_outlier_probability) if by_class else own

    def position_stds(self, given: FloatArray | float | None, n: int) -> FloatArray:
        """1-σ (n,) in metres of positions; ``given``: the declared values, NaN or None where missing."""
        if given is None:
            return np.full(n, self.position_std, dtype=float)
        declared = np.full(n, given, dtype=float)
        return np.where(np.isfinite(declared), self.position_scale * declared, self.position_std)

    def kappas(self, name: Literal["body", "head"], given: FloatArray | float | None, n: int) -> FloatArray:
        """Concentrations (n,) of observed angles, in the same way."""
        declared = np.full(n, np.nan if given is None else given, dtype=float)
        default, scale = getattr(self, f"{name}_kappa"), getattr(self, f"{name}_scale")
        return np.where(np.isfinite(declared), declared / scale**2, default)


@dataclass(frozen=True)
class SocialParameters(_Group):
    """Members of a conversation face its o-space and seldom turn, in the presets that have groups.

    Learned from SALSA's rows up to t = 1000 s; see docs/behaviour.md.

    Attributes
    ----------
    body_kappa, head_kappa : concentration of bodies and of heads about the bearing of the o-space
    outliers : share ε of members who face elsewhere
    correlation_time : time over which deviations from the bearing persist, s: a new bearing counts fully, and
        later frames dt/correlation_time times
    body_hold, head_hold : cost λ of a turn, 1/rad: turns are rare and large
    """

    body_kappa: float = _number(5.1, 0.0, 1e4)
    head_kappa: float = _number(3.7, 0.0, 1e4)
    outliers: float = _share(0.05, 0.999)
    correlation_time: float = _number(60.0, 0.0, 1e4, "s", learned=False)
    body_hold: float = _number(1.0, 0.0, 1e3, "1/rad")
    head_hold: float = _number(3.0, 0.0, 1e3, "1/rad")


@dataclass(frozen=True)
class Parameters:
    """All parameters of the model."""

    motion: MotionParameters = field(default_factory=MotionParameters)
    orientation: OrientationParameters = field(default_factory=OrientationParameters)
    coupling: CouplingParameters = field(default_factory=CouplingParameters)
    likelihood: LikelihoodParameters = field(default_factory=LikelihoodParameters)
    social: SocialParameters = field(default_factory=SocialParameters)

    @classmethod
    def from_dict(cls, tables: dict[str, Any], defaults: Parameters | None = None) -> Parameters:
        """Parameters from nested tables over ``defaults``; InputError for unknown or wrong values."""
        start = cls() if defaults is None else defaults
        known = [f.name for f in fields(cls)]
        parts = {}
        for table, values in tables.items():
            if table not in known:
                kind = "table" if isinstance(values, dict) else "key"
                expected = f"preset, or a table of {', '.join(known)}, scene"
                raise InputError(f"the unknown {kind} {table!r}", expected)
            parts[table] = with_table(getattr(start, table), table, values)
        return replace(start, **parts)

    def value(self, name: str) -> float:
        """Number of a name such as "motion.head_rate"."""
        group, key = name.split(".")
        return float(getattr(getattr(self, group), key))

    def with_values(self, values: Mapping[str, float]) -> Parameters:
        """The same with other numbers, by names such as "motion.head_rate"."""
        groups: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            group, key = name.split(".")
            groups.setdefault(group, {})[key] = value
        changed = {group: replace(getattr(self, group), **own) for group, own in groups.items()}
        return replace(self, **changed)
