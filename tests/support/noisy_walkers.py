"""People who walk and turn, observed with noise, some of them sideways."""

import numpy as np

from graphtrack.geometry.angles import unit, wrap
from graphtrack.tracks.track import Track


def walker(
    seed: int, *, n: int = 60, hz: float = 10.0, turn: float = 0.2, aside: float = 0.0, track_id: int = 0
) -> Track:
    """Somebody who walks and turns (rad/√s), the body ``aside`` of the path, observed with noise."""
    rng = np.random.default_rng(seed)
    course = np.cumsum(turn * rng.normal(0.0, np.sqrt(1.0 / hz), n))
    path = np.cumsum(1.2 / hz * unit(course), axis=0)
    body = wrap(course + aside)
    position = path + rng.normal(0.0, 0.1, (n, 2))
    position[rng.random(n) < 0.15] = np.nan
    return Track(
        track_id,
        np.arange(n),
        np.arange(n) / hz,
        position,
        position_std=np.full(n, 0.1),
        body=wrap(body + rng.normal(0.0, 0.5, n)),
        body_kappa=np.full(n, 4.0),
        head=wrap(body + rng.normal(0.0, 0.35, n)),
        head_kappa=np.full(n, 8.0),
        true_position=path,
        true_body=body,
        true_head=body,
    )


def sideways(seed: int, *, n: int = 60, track_id: int = 0) -> Track:
    """Somebody who walks sideways and turns a lot."""
    return walker(seed, n=n, turn=1.0, aside=1.4, track_id=track_id)
