"""Poses of a moving sensor on the ground plane over time, interpolated with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray, wrap

_TOLERANCE = 1e-5
"""Seconds by which times may be rounded."""

_RATE_WINDOW = 0.2
"""Seconds before and after a time over which velocity and turn rate are differences, unless steps are longer.

A turn at 1 rad/s at 1 m/s biases the velocity by 7 mm/s; poses with independent errors of 3 cm give it a
standard deviation of 0.11 m/s."""

_FEWEST = 12
"""Fewest poses from which the independence of their errors is learned."""

_LONGEST_CORRELATION = 1.0
"""Seconds up to which errors of poses count as correlated: about the time over which people are smoothed."""

_MEDIAN = 0.4549364
"""Median of the square of a standard normal variable."""


@dataclass(frozen=True, eq=False)
class PosePath:
    """Poses of a sensor in the world: position and heading of its x axis, at n ≥ 2 times.

    Attributes
    ----------
    t : (n,) seconds, strictly increasing
    x, y : (n,) metres
    yaw : (n,) radians, counter-clockwise from the world's x axis
    covariance : (n, 3, 3) of x, y and yaw, in m and rad; by default 0: the poses are exact

    Raises
    ------
    InputError
        For other shapes, missing values, times that do not increase, or a matrix that is no covariance.
    """

    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.t))
        if n < 2:
            raise InputError(f"{n} pose", "two poses at least")
        shapes = {"t": (n,), "x": (n,), "y": (n,), "yaw": (n,), "covariance": (n, 3, 3)}
        for name, shape in shapes.items():
            given = getattr(self, name)
            value = np.zeros(shape) if given is None else np.array(given, dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise InputError(
                    f"{name} of poses of shape {value.shape}", f"finite numbers of shape {shape}"
                )
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        back = np.flatnonzero(np.diff(self.t) <= 0.0)
        if len(back):
            found = f"a pose at t = {self.t[back[0] + 1]:.15g} after t = {self.t[back[0]]:.15g}"
            raise InputError(found, "poses in the order of time")
        spread = self._covariance
        lowest = np.linalg.eigvalsh(spread)[:, 0]
        symmetric = np.allclose(spread, spread.transpose(0, 2, 1), rtol=1e-9, atol=0.0)
        if not symmetric or (lowest < -1e-9 * np.trace(spread, axis1=1, axis2=2)).any():
            expected = "symmetric matrices without negative eigenvalues"
            raise InputError("a covariance of a pose that is none", expected)

    def __len__(self) -> int:
        return len(self.t)

    @property
    def is_exact(self) -> bool:
        """Return whether no pose has an uncertainty."""
        return not self._covariance.any()

    @cached_property
    def usual_step(self) -> float:
        """Median of the seconds between poses; as far a pose is extrapolated."""
        return float(np.median(np.diff(self.t)))

    def shifted(self, seconds: float) -> PosePath:
        """Return the path with later times."""
        return replace(self, t=self.t + seconds) if seconds else self

    def covers(self, t: FloatArray) -> BoolArray:
        """Return whether times (m,) are within the path, or up to one usual step outside."""
        reach = self.usual_step + _TOLERANCE
        return np.asarray((t >= self.t[0] - reach) & (t <= self.t[-1] + reach))

    def at(self, t: FloatArray, repeats: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the poses (m, 3), x, y and yaw, at times (m,), and their covariances (m, 3, 3).

        Positions are interpolated linearly and yaw the short way. At the share w of a step from pose 0 to
        pose 1 the covariance is (1 − w)·Σ₀ + w·Σ₁ − λ·w·(1 − w)·(Σ₀ + Σ₁): λ = 0 is for errors that both
        poses share, as those of a localisation filter, λ = 1 for independent ones. λ is learned from the
        path: how much more poses scatter about their neighbours than motion explains. Added is the error of a
        straight line under the acceleration found there, ½·a·s·(Δ − s) after s of Δ seconds. Outside the path
        the last two poses are extrapolated, with λ = 1.

        Observations at times nearer than `correlation_time` share errors of the poses. Where a smoother takes
        them as independent, each has to count for its part: with ``repeats`` (m,), the number of such times,
        covariances within the path have λ = 0 and are multiplied by it.

        Raises
        ------
        InputError
            For a time that is not covered.
        """
        t = np.atleast_1d(np.asarray(t, dtype=float))
        outside = ~self.covers(t)
        if outside.any():
            found = f"t = {t[outside.argmax()]:.15g}"
            raise InputError(found, f"a time from {self.t[0]:.15g} to {self.t[-1]:.15g} s, with poses")
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self) - 2)
        step = self.t[k + 1] - self.t[k]
        since = t - self.t[k]
        w = (since / step)[:, None]
        poses = (1.0 - w) * self._values[k] + w * self._values[k + 1]
        poses[:, 2] = wrap(poses[:, 2])
        independent, acceleration = self._scatter
        share = np.where((w >= 0.0) & (w <= 1.0), independent if repeats is None else 0.0, 1.0)[:, :, None]
        w = w[:, :, None]
        first, second = self._covariance[k], self._covariance[k + 1]
        covariance = (1.0 - w) * first + w * second - share * w * (1.0 - w) * (first + second)
        bent = (0.5 * since * (step - since))[:, None] ** 2 * acceleration[k]
        covariance[:, [0, 1, 2], [0, 1, 2]] += bent
        return poses, covariance if repeats is None else repeats[:, None, None] * covariance

    def rates(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return velocity and turn rate (m, 3), in m/s and rad/s, at times (m,), and covariances (m, 3, 3).

        They are differences over 0.2 s, or a step if that is longer, before and after, within the path; the
        errors of both poses count as independent.
        """
        t = np.clip(np.atleast_1d(np.asarray(t, dtype=float)), self.t[0], self.t[-1])
        half = max(_RATE_WINDOW, self.usual_step)
        begin, end = np.maximum(t - half, self.t[0]), np.minimum(t + half, self.t[-1])
        (first, first_spread), (second, second_spread) = self.at(begin), self.at(end)
        apart = second - first
        apart[:, 2] = np.diff(np.interp([begin, end], self.t, self._values[:, 2]), axis=0)  # of any turn
        over = (end - begin)[:, None]
        return apart / over, (first_spread + second_spread) / over[:, :, None] ** 2

    @property
    def _covariance(self) -> FloatArray:
        assert self.covariance is not None
        return self.covariance

    @cached_property
    def correlation_time(self) -> float:
        """Seconds (integral of the autocorrelation) for which errors of poses last, from a step to 1 s.

        They are taken as first-order Markov with the λ of the path.
        """
        rho = np.linspace(0.0, 0.999, 1000)
        scatter = 1.0 - 1.5 * rho + 0.6 * rho**2 - 0.1 * rho**3  # λ of such errors, which falls with ρ
        found = float(rho[np.argmin(np.abs(scatter - self._scatter[0]))])
        lasting = self.usual_step * (1.0 + found) / (1.0 - found)
        return min(lasting, max(self.usual_step, _LONGEST_CORRELATION))

    @cached_property
    def _values(self) -> FloatArray:
        """Poses (n, 3), with a yaw that does not jump."""
        return np.column_stack([self.x, self.y, np.unwrap(self.yaw)])

    @cached_property
    def _scatter(self) -> tuple[float, FloatArray]:
        """Share λ of the variance that is independent from pose to pose; squared accelerations (n − 1, 3).

        A pose deviates from the straight line between its neighbours by its independent errors, which change
        sign from pose to pose, and by acceleration, which lasts.
        """
        n, values, steps = len(self), self._values, np.diff(self.t)[:, None]
        if n < 3:
            return 0.0, np.zeros((n - 1, 3))
        before, after = steps[:-1], steps[1:]
        u = before / (before + after)
        off = values[1:-1] - (1.0 - u) * values[:-2] - u * values[2:]
        variance = np.diagonal(self._covariance, axis1=1, axis2=2)
        expected = variance[1:-1] + (1.0 - u) ** 2 * variance[:-2] + u**2 * variance[2:]
        known = variance.any(axis=0)
        share = 0.0
        if n >= _FEWEST and known.any():
            mixed = u[:-1] * variance[2:-1] + (1.0 - u[1:]) * variance[1:-2]
            of_noise = expected[1:] + expected[:-1] + 2.0 * mixed
            found = np.median(np.diff(off, axis=0) ** 2, axis=0)[known] / _MEDIAN
            usual = np.median(of_noise, axis=0)[known]
            share = float(np.clip(np.mean(found / np.maximum(usual, np.finfo(float).tiny)), 0.0, 1.0))
        of_pose = (off**2 - share * expected) * (2.0 / (before * after)) ** 2
        of_pose = np.concatenate([of_pose[:1], of_pose, of_pose[-1:]])
        return share, np.maximum(0.5 * (of_pose[:-1] + of_pose[1:]), 0.0)
