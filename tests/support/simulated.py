"""People whose parameters are known, for learning tests."""

from dataclasses import replace

import numpy as np
from graph_sampler import COUPLED, sample_graph

from graphtrack.learning import Fit
from graphtrack.model import LikelihoodParameters, Model, MotionParameters, OrientationParameters, Parameters
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.track import TrackSet

TRUE = Parameters(
    MotionParameters(0.4, 1.2, 1.0),
    OrientationParameters(0.3, 0.4),
    COUPLED,
    likelihood=LikelihoodParameters(position_std=0.07, body_kappa=5.0, head_kappa=6.0),
)

BRISK = replace(TRUE, motion=MotionParameters(0.1, 2.5, 1.0))
"""`TRUE` of people whose motion has a direction: the density of the couplings favours people who hardly move,
whose motion is not Gaussian."""

EVEN_SLOW = replace(BRISK, coupling=replace(COUPLED, speed_threshold=0.0))
"""`BRISK` of people whose bodies follow their motion however slow it is."""


def known(
    preset: str, seed: int, n_tracks: int = 8, n_steps: int = 50, true: Parameters | None = None
) -> TrackSet:
    """People with their truth, without declared noise.

    They are made with ``true``: by default `TRUE`, and `BRISK` for `joint`, whose people come from
    the graph's own density.
    """
    rng = np.random.default_rng(seed)
    if preset == "joint":
        tracks = sample_graph(true or BRISK, n_tracks=n_tracks, n_steps=n_steps, rng=rng)
    else:
        tracks = simulate(Model(preset, true or TRUE), n_tracks=n_tracks, n_steps=n_steps, rng=rng, pace=None)
    return tracks.map(lambda track: replace(track, position_std=None, body_kappa=None, head_kappa=None))


def inside(found: Fit, true: Parameters = TRUE) -> dict[str, bool]:
    """Parameter → True if its interval holds the simulated people's value."""
    return {one.name: one.low <= true.value(one.name) <= one.high for one in found.learned if not one.note}
