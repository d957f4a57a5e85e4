"""Stretches of tracks side by side, from which the noise of a file is judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.tracks import Track

LONGEST = 60
"""Frames of a piece at most: that many steps are taken, one after another."""

MOST = 2500
"""Frames of all pieces together, about."""

FEWEST = 4
"""Observations of a piece at least."""

Channel = Callable[[Track], tuple[FloatArray | None, FloatArray | None]]
"""What was observed in each frame, and the spread that was declared for it."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """P stretches of tracks of up to T frames, each a column.

    Attributes
    ----------
    dt : (T, P) seconds since the frame before
    value : (T, P, k) observed, from the first value of its piece; NaN where nothing was, and past the end
    spread : (T, P) what is declared of it; NaN: nothing
    track : (P,) place of the track that it is of
    """

    dt: FloatArray
    value: FloatArray
    spread: FloatArray
    track: NDArray[np.int64]

    @property
    def seen(self) -> BoolArray:
        """(T, P) where something was observed."""
        return np.asarray(np.isfinite(self.value[..., 0]))

    def part(self, count: int) -> Pieces:
        """The first so many."""
        return Pieces(self.dt[:, :count], self.value[:, :count], self.spread[:, :count], self.track[:count])


def pieces_of(tracks: Sequence[Track], channel: Channel, rng: np.random.Generator) -> Pieces | None:
    """Pieces of tracks in which a channel was observed, chosen at random; None where there are none."""
    places = [(m, a) for m, track in enumerate(tracks) for a in range(0, len(track), LONGEST)]
    chosen: list[tuple[int, FloatArray, FloatArray, FloatArray]] = []
    frames = 0
    for i in rng.permutation(len(places)).tolist():
        m, a = places[i]
        track, part = tracks[m], slice(a, a + LONGEST)
        values, declared = channel(track)
        if values is None:
            continue
        value = values[part].reshape(len(track.t[part]), -1)
        seen = np.flatnonzero(np.isfinite(value).all(axis=1))
        if len(seen) < FEWEST:
            continue
        spread = np.full(len(value), np.nan) if declared is None else declared[part]
        dt = np.diff(track.t[part], prepend=track.t[a])
        chosen.append((m, dt, value, spread))
        frames += len(value)
        if frames >= MOST:
            break
    if not chosen:
        return None
    longest = max(len(dt) for _, dt, _, _ in chosen)
    width = chosen[0][2].shape[1]
    dt, spread = np.zeros((longest, len(chosen))), np.full((longest, len(chosen)), np.nan)
    value = np.full((longest, len(chosen), width), np.nan)
    for p, (_, steps, values, declared) in enumerate(chosen):
        n = len(steps)
        dt[:n, p], value[:n, p], spread[:n, p] = steps, values, declared
    return Pieces(dt, value, spread, np.array([m for m, *_ in chosen]))
