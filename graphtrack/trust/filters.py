"""How probable observations are, each after those before it, whatever their noise is said to be.

Two filters in which people move, and turn, by themselves: positions by white-noise acceleration, angles by
rotational diffusion. Each observation is an outlier with a probability of its own, so that a few gross ones
say nothing of the noise of the others. All stretches and all candidates are filtered side by side.
"""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray, concentration_from_resultant, mean_resultant_length
from graphtrack.later import special
from graphtrack.trust.pieces import Pieces

WIDER = 10.0
"""Of a position that is an outlier, the standard deviation over that of the others."""

TWO_PI = 2.0 * math.pi


def position_log_density(
    pieces: Pieces,
    default: float,
    speed_std: float,
    scale: FloatArray,
    wander: FloatArray,
    outliers: FloatArray,
) -> FloatArray:
    """Log density (G, P) of the positions of each piece, by each of G candidates.

    Parameters
    ----------
    pieces : positions (T, P, 2) in metres with the declared σ
    default : metres, where none is declared
    speed_std : m/s, 1-σ of each axis of the velocity where a piece begins
    scale : (G,) multiples of the declared σ
    wander : (G,) q in m²/s³
    outliers : (G,) probability of an outlier
    """
    shape = (len(scale), pieces.dt.shape[1])
    x, y, vx, vy, pp, pv, vv, total = np.zeros((8, *shape))
    begun = np.zeros(shape[1], bool)
    q, rate = wander[:, None], outliers[:, None]
    declared = np.where(np.isfinite(pieces.spread), pieces.spread, default)
    seen = pieces.seen
    for k in range(len(pieces.dt)):
        dt = pieces.dt[k]
        x, y = x + dt * vx, y + dt * vy
        pp = pp + dt * (2.0 * pv + dt * vv) + q * dt**3 / 3.0
        pv = pv + dt * vv + 0.5 * q * dt**2
        vv = vv + q * dt
        noise = (scale[:, None] * declared[k]) ** 2
        here, first = seen[k] & begun, seen[k] & ~begun
        zx, zy = np.where(seen[k], pieces.value[k].T, 0.0)
        dx, dy = zx - x, zy - y
        square, spread = dx * dx + dy * dy, pp + noise
        wide = pp + WIDER**2 * noise
        inlier = (1.0 - rate) * np.exp(-0.5 * square / spread) / (TWO_PI * spread)
        outlier = rate * np.exp(-0.5 * square / wide) / (TWO_PI * wide) + 1e-300
        share = np.where(here, inlier / (inlier + outlier), 0.0)
        total += np.where(here, np.log(inlier + outlier), 0.0)
        # What an outlier leaves is what was known before; both together, by their moments.
        gain_p, gain_v = share * pp / spread, share * pv / spread
        doubt = 0.5 * share * (1.0 - share) * square / spread**2
        x, y, vx, vy = x + gain_p * dx, y + gain_p * dy, vx + gain_v * dx, vy + gain_v * dy
        pp, pv, vv = (
            pp - gain_p * pp + doubt * pp * pp,
            pv - gain_p * pv + doubt * pp * pv,
            vv - gain_v * pv + doubt * pv * pv,
        )
        if first.any():
            x, y = np.where(first, zx, x), np.where(first, zy, y)
            vx, vy = np.where(first, 0.0, vx), np.where(first, 0.0, vy)
            pp, pv, vv = (
                np.where(first, noise, pp),
                np.where(first, 0.0, pv),
                np.where(first, speed_std**2, vv),
            )
            begun = begun | first
    return total


def angle_log_density(
    pieces: Pieces, default: float, scale: FloatArray, wander: FloatArray, outliers: FloatArray
) -> FloatArray:
    """Log density (G, P) of the angles of each piece, by each of G candidates.

    What is known is a von Mises density throughout; of a mixture that of the same mean resultant.

    Parameters
    ----------
    pieces : angles (T, P, 1) in radians with the declared κ
    default : κ where none is declared
    scale : (G,) multiples of the declared 1-σ; κ is divided by their square
    wander : (G,) diffusion in rad²/s
    outliers : (G,) probability of an outlier
    """
    shape = (len(scale), pieces.dt.shape[1])
    # Mean resultant vectors.
    along, across, total = np.zeros((3, *shape))
    declared = np.where(np.isfinite(pieces.spread), pieces.spread, default)
    rate, seen = outliers[:, None], pieces.seen & (declared > 0.0)
    for k in range(len(pieces.dt)):
        kept = np.exp(-0.5 * wander[:, None] * pieces.dt[k])
        along, across = kept * along, kept * across
        here = seen[k]
        if not here.any():
            continue
        angle = np.where(here, pieces.value[k, :, 0], 0.0)
        cos, sin = np.cos(angle), np.sin(angle)
        noise = np.where(here, declared[k], 0.0) / scale[:, None] ** 2
        length = np.hypot(along, across) + 1e-12
        known = concentration_from_resultant(length)
        one, two = known * along / length + noise * cos, known * across / length + noise * sin
        both = np.hypot(one, two) + 1e-12
        inlier = special.i0e(both) / (special.i0e(known) * special.i0e(noise)) * np.exp(both - known - noise)
        density = (1.0 - rate) * inlier + rate
        total += np.where(here, np.log(density / TWO_PI), 0.0)
        share = np.where(here, (1.0 - rate) * inlier / density, 0.0)
        after = mean_resultant_length(both) / both
        along, across = (
            share * after * one + (1.0 - share) * along,
            share * after * two + (1.0 - share) * across,
        )
    return total
