"""Speed of the particle filter, alone and against Stone Soup's on the same linear task in the same run."""

import datetime
import statistics
import time

import numpy as np
import pytest
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater
from walks import walk

from graphtrack.baselines.particle_filter import ParticleOptions, particle_filter
from graphtrack.model import LikelihoodParameters, Model, MotionParameters, Parameters
from graphtrack.tracks.track import Track

pytestmark = pytest.mark.benchmark

PARTICLES, STEPS, ROUNDS = 1000, 200, 7
LINEAR = Model(
    "position",
    Parameters(
        motion=MotionParameters(acceleration_density=0.5, initial_speed_std=1.5),
        likelihood=LikelihoodParameters(position_std=0.1),
    ),
)


def stone_soup(track: Track) -> np.ndarray:
    """Positions (n, 2) of their bootstrap filter, which resamples at every step."""
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(0.5), ConstantVelocity(0.5)])
    measurement = LinearGaussian(4, (0, 2), 0.01 * np.eye(2))
    predictor = ParticlePredictor(motion)
    updater = ParticleUpdater(measurement, resampler=SystematicResampler())
    epoch = datetime.datetime(2024, 1, 1)
    times = [epoch + datetime.timedelta(seconds=float(t)) for t in track.t]
    rng = np.random.default_rng(0)
    first = rng.standard_normal((4, PARTICLES)) * np.array([[0.1], [1.5], [0.1], [1.5]])
    first[[0, 2]] += track.position[0][:, None]
    weight = np.full(PARTICLES, 1.0 / PARTICLES)
    state = ParticleState(StateVectors(first), weight=weight, timestamp=times[0])
    means = [track.position[0]]
    for k in range(1, len(track)):
        prediction = predictor.predict(state, timestamp=times[k])
        detection = Detection(track.position[k], timestamp=times[k], measurement_model=measurement)
        state = updater.update(SingleHypothesis(prediction, detection))
        means.append(np.asarray(state.mean, dtype=float).ravel()[[0, 2]])
    return np.array(means)


def ours(track: Track) -> np.ndarray:
    options = ParticleOptions(particles=PARTICLES, resample_below=1.0)
    return particle_filter(track, LINEAR, options=options).track.position


def seconds(run: object, track: Track) -> float:
    start = time.perf_counter()
    run(track)  # type: ignore[operator]
    return time.perf_counter() - start


def test_the_joint_filter_makes_400_steps_a_second() -> None:
    track = walk(STEPS, classes=True)
    particle_filter(track, "joint")
    took = [seconds(lambda t: particle_filter(t, "joint"), track) for _ in range(ROUNDS)]
    rate = STEPS / statistics.median(took)
    print(f"\njoint model, classes of body and head, {PARTICLES} particles: {rate:.0f} steps a second")
    assert rate >= 400.0


def test_twenty_times_the_speed_of_stone_soup() -> None:
    track = walk(STEPS, noise=0.1)
    mine, theirs = ours(track), stone_soup(track)
    # The same task: both are as near to the truth.
    assert track.true_position is not None
    errors = [np.sqrt(np.mean((found - track.true_position)[20:] ** 2)) for found in (mine, theirs)]
    assert errors[0] == pytest.approx(errors[1], rel=0.2)
    pairs = [(seconds(ours, track), seconds(stone_soup, track)) for _ in range(ROUNDS)]
    rate, other = (STEPS / statistics.median(took) for took in zip(*pairs, strict=True))
    ratio = statistics.median(b / a for a, b in pairs)
    print(
        f"\nlinear model, {PARTICLES} particles: {rate:.0f} and {other:.0f} steps a second, {ratio:.1f} times"
    )
    assert ratio >= 20.0
