import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special, stats
from von_mises import von_mises_product
from walks import walk, without

from graphtrack.baselines.kalman import filter_states, rauch_tung_striebel
from graphtrack.baselines.particle_filter import (
    ParticleOptions,
    draw_orientations,
    particle_filter,
    particle_smoother,
    recover,
)
from graphtrack.baselines.particle_kernels import (
    Used,
    backward,
    draw_angles,
    draw_motion,
    generator,
    summarise,
    summarise_motion,
    systematic_ancestors,
)
from graphtrack.baselines.particle_model import (
    add_pose_log_density,
    add_position_log_density,
    prepare,
    sample_von_mises,
)
from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import (
    class_centres,
    class_kappa,
    difference,
    mixture_log_density,
    von_mises_log_density,
    wrap,
)
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.arithmetic import log_i0e
from graphtrack.model import LikelihoodParameters, Model, MotionParameters, Parameters, States, Step, Term
from graphtrack.tracks.track import Track

PARAMETERS = Parameters(
    motion=MotionParameters(acceleration_density=0.7, initial_speed_std=1.2),
    likelihood=LikelihoodParameters(position_std=0.1),
)
LINEAR = Model("position", PARAMETERS)


def options(particles: int, **others: object) -> ParticleOptions:
    return ParticleOptions(particles=particles, **others)


# -- resampling --------------------------------------------------------------------------------------------


@given(
    raw=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40).filter(lambda w: sum(w) > 1e-3),
    offset=st.floats(0.0, 1.0, exclude_max=True),
    count=st.integers(1, 60),
)
def test_descendants_are_the_expected_number_rounded(raw: list[float], offset: float, count: int) -> None:
    weights = np.array(raw) / sum(raw)
    ancestors = np.empty(count, dtype=np.int64)
    systematic_ancestors(weights, offset, ancestors)
    descendants = np.bincount(ancestors, minlength=len(weights))
    assert np.all(np.diff(ancestors) >= 0)
    assert np.all(np.abs(descendants - count * weights) < 1.0 + 1e-9)
    assert np.all(descendants[weights == 0.0] == 0)


def test_seeds() -> None:
    assert generator(3).random() == np.random.default_rng(3).random()
    rng = np.random.default_rng(0)
    assert generator(rng) is rng
    for wrong in (-1, 1.5, "x", True):
        with pytest.raises(InputError, match="seed"):
            generator(wrong)


# -- densities ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kappa", [0.0, 1e-6, 0.3, 3.0, 60.0, 1e4, 1e7])
def test_von_mises_variates_follow_the_distribution(kappa: float) -> None:
    rng = np.random.default_rng(5)
    drawn = np.array([sample_von_mises(rng, 2.9, kappa) for _ in range(4000)])
    assert np.all((drawn > -np.pi) & (drawn <= np.pi))
    # Beyond SciPy's reach the limit is normal.
    law = stats.vonmises(kappa) if 1e-3 < kappa < 1e6 else stats.norm(0.0, 1.0 / math.sqrt(max(kappa, 1e-9)))
    if kappa < 1e-3:
        law = stats.uniform(-np.pi, 2.0 * np.pi)
    assert stats.kstest(difference(drawn, 2.9), law.cdf).pvalue > 0.01


def test_the_bessel_function_is_scipys() -> None:
    x = np.r_[0.0, np.geomspace(1e-4, 1e7, 400)]
    np.testing.assert_allclose([log_i0e(v) for v in x], np.log(special.i0e(x)), atol=3e-7)


def camera(mirrored: bool = False) -> GroundCamera:
    """Two and a half metres up, looking down by 30° along +y."""
    tilt = np.radians(30.0)
    right, forward = np.array([1.0, 0.0, 0.0]), np.array([0.0, np.cos(tilt), -np.sin(tilt)])
    rotation = np.stack([right, np.cross(forward, right), forward])
    intrinsics = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    found = GroundCamera.from_calibration(rotation, -rotation @ np.array([0.0, -3.0, 2.5]), intrinsics)
    return GroundCamera(np.diag([-1.0, 1.0, 1.0]) @ found.homography) if mirrored else found


@pytest.mark.parametrize("robust", ["none", "huber", "cauchy"])
@pytest.mark.parametrize("pixels", [False, True])
def test_the_position_likelihood_is_the_models(robust: str, pixels: bool) -> None:
    parameters = Parameters(likelihood=LikelihoodParameters(position_std=0.2, robust=robust, pixel_std=4.0))
    model, view = Model("position", parameters), camera()
    rng = np.random.default_rng(0)
    position = rng.uniform(-1.0, 1.0, (4, 2))
    track = Track(1, np.arange(4), np.arange(4.0), position, pixel=view.ground_to_image(position))
    job = prepare(track, model, view if pixels else None, "smooth", False)
    particles = np.zeros((50, 6))
    particles[:, :2] = rng.uniform(-1.5, 1.5, (50, 2))
    found = np.zeros(50)
    add_position_log_density(particles, 2, job.position, job.camera, found)
    term = next(t for t in model.terms if type(t).__name__ == "PositionLikelihood")
    alone = replace(track, position=np.where(np.arange(4)[:, None] == 2, position, np.nan))
    alone = replace(alone, pixel=np.where(np.arange(4)[:, None] == 2, track.pixel, np.nan))
    peak = math.log(2.0 * math.pi * (4.0 if pixels else 0.2) ** 2)
    for row, value in zip(particles, found, strict=True):
        states = States(np.tile(row[:2], (4, 1)), np.zeros((4, 2)), np.zeros(4), np.zeros(4))
        assert -value == pytest.approx(term.cost(states, alone, view if pixels else None) + peak)


@pytest.mark.parametrize("outliers", [0.0, 0.1])
@pytest.mark.parametrize("classes", [False, True])
def test_the_pose_likelihood_is_the_models(outliers: float, classes: bool) -> None:
    likelihood = LikelihoodParameters(
        body_outliers=outliers, head_outliers=outliers, class_outlier_probability=outliers, head_kappa=6.0
    )
    track = walk(5, classes=classes)
    job = prepare(track, Model("joint", Parameters(likelihood=likelihood)), None, "smooth", False)
    particles = np.zeros((60, 6))
    particles[:, 5] = np.linspace(-np.pi, np.pi, 60)
    found = np.zeros(60)
    add_pose_log_density(particles, 5, 3, job.head, job.camera, found)
    if classes:
        means, weights, kappa = class_centres(12), track.head_likelihood[3], class_kappa(12)
    else:
        means, weights, kappa = track.head[3:4], np.ones(1), 6.0
    expected = mixture_log_density(particles[:, 5], means, np.tile(weights, (60, 1)), kappa, outliers)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.trapezoid(np.exp(found), particles[:, 5]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("view", [camera(), camera(mirrored=True), GroundCamera(camera().homography)])
def test_poses_in_the_image_are_judged_at_the_particles_position(view: GroundCamera) -> None:
    track = walk(5, classes=True)
    job = prepare(track, Model("joint"), view, "closest", True)
    rng = np.random.default_rng(1)
    particles = np.zeros((300, 6))
    particles[:, :2] = rng.uniform(-2.0, 2.0, (300, 2))
    particles[:, 4] = rng.uniform(-np.pi, np.pi, 300)
    found = np.zeros(300)
    add_pose_log_density(particles, 4, 2, job.body, job.camera, found)
    in_image = view.image_angle(particles[:, 4], particles[:, :2])
    nearest = np.argmin(np.abs(difference(in_image[:, None], class_centres(8))), axis=1)
    scores = track.body_likelihood[2] / track.body_likelihood[2].sum()
    expected = np.log((0.05 + 0.95 * 8 * scores) / (2.0 * np.pi))[nearest]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert len(np.unique(nearest)) == 8


@pytest.mark.parametrize("speed", [0.1, 1.5])
def test_angles_are_drawn_from_the_normalised_product(speed: float) -> None:
    model = Model("joint")
    job = prepare(walk(3, dt=0.3), model, None, "smooth", False)
    rng = np.random.default_rng(2)
    before, after = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -2.0]), np.zeros((3000, 6))
    after[:, 2:4] = speed * np.array([math.cos(2.0), math.sin(2.0)])
    for row in after:
        draw_angles(rng, 1, False, before, row, job.motion)
    turning, coupling = model.parameters.orientation, model.parameters.coupling
    weight = coupling.weights(0.3)
    pull = weight * coupling.motion_body_kappa * max(speed - coupling.speed_threshold, 0.0) ** 2
    mean, kappa = von_mises_product(1.0, 1.0 / (turning.body_diffusion * 0.3), 2.0, pull)
    assert stats.kstest(difference(after[:, 4], mean), stats.vonmises(kappa).cdf).pvalue > 0.01
    mean, kappa = von_mises_product(
        -2.0, 1.0 / (turning.head_diffusion * 0.3), after[:, 4], weight * coupling.head_body_kappa
    )
    # Each head has its own law, given its body: their probabilities must be uniform.
    levels = stats.vonmises.cdf(difference(after[:, 5], mean), kappa)
    assert stats.kstest(levels, stats.uniform().cdf).pvalue > 0.01


def steered(rate: float, preset: str = "intentional") -> Model:
    return Model(preset, Parameters(motion=MotionParameters(acceleration_density=0.7, head_rate=rate)))


@pytest.mark.parametrize("rate", [0.0, 0.5, 4.0])
def test_the_head_steers_the_drawn_velocity(rate: float) -> None:
    track = walk(3, dt=0.4)
    job = prepare(track, steered(rate), None, "smooth", False)
    before, after = np.tile([1.0, -2.0, 0.6, 0.8, np.nan, 2.5], (40_000, 1)), np.zeros((40_000, 6))
    draw_motion(np.random.default_rng(3), 1, job.motion, before, np.arange(40_000), after)
    # The integral of the drift dv = λ(s·u − v) dt, and of the noise, in 4,000 short steps.
    dt, n = float(track.t[1] - track.t[0]), 4000
    place, velocity, spread = np.array([1.0, -2.0]), np.array([0.6, 0.8]), np.zeros((2, 2))
    goal, drift = np.array([math.cos(2.5), math.sin(2.5)]), np.array([[0.0, 1.0], [0.0, -rate]])
    for _ in range(n):
        place, velocity = place + velocity * dt / n, velocity + rate * (goal - velocity) * dt / n
        step = np.eye(2) + drift * dt / n
        spread = step @ spread @ step.T + np.diag([0.0, 0.7 * dt / n])
    np.testing.assert_allclose(after[:, :2].mean(axis=0), place, atol=0.01)
    np.testing.assert_allclose(after[:, 2:4].mean(axis=0), velocity, atol=0.02)
    for axis in range(2):
        np.testing.assert_allclose(np.cov(after[:, axis], after[:, 2 + axis]), spread, rtol=0.05, atol=1e-4)


@pytest.mark.parametrize("rate", [0.0, 3.0])
def test_backward_weights_are_the_models_densities(rate: float) -> None:
    model, track = steered(rate), replace(walk(2, dt=0.5), body=None)
    job = prepare(track, model, None, "smooth", False)
    rng = np.random.default_rng(4)
    history = np.zeros((2, 6, 6))
    history[0, :, :4] = 0.1 * rng.standard_normal((6, 4)) + [0.0, 0.0, 1.0, 0.0]
    history[0, :, 5] = rng.uniform(-0.2, 0.2, 6)
    history[1, :] = [0.5, 0.1, 0.9, 0.3, 0.0, 0.1]
    paths = np.empty((2, 20_000, 6))
    backward(rng, 0, history, np.full((2, 6), -math.log(6.0)), job.motion, paths)
    costs = []
    for particle in history[0]:
        pair = np.stack([particle, history[1, 0]])
        states = States(pair[:, :2], pair[:, 2:4], pair[:, 4], pair[:, 5])
        step = [term for term in model.terms if type(term).__name__ in ("IntentionalMotion", "HeadDynamics")]
        # Without the prior on the first velocity, which is no part of the step.
        first = 0.5 * np.sum(particle[2:4] ** 2) / model.parameters.motion.initial_speed_std**2
        costs.append(sum(term.cost(states, track) for term in step) - first)
    drawn = [np.mean(paths[0, :, 0] == particle[0]) for particle in history[0]]
    np.testing.assert_allclose(drawn, special.softmax(-np.array(costs)), atol=0.015)
    assert max(drawn) < 0.9


def test_mean_and_covariance_of_particles() -> None:
    rng = np.random.default_rng(0)
    particles, weights = rng.normal(0.0, 1.0, (400, 6)), rng.dirichlet(np.ones(400))
    particles[:, 4:] = wrap(3.0 + 0.3 * particles[:, 4:])
    job = prepare(walk(3), Model("joint"), None, "smooth", False)
    mean, covariance = np.full(6, np.nan), np.full((6, 6), np.nan)
    summarise(particles, weights, job.motion, mean, covariance)
    expected = np.append(weights @ particles[:, :4], np.angle(weights @ np.exp(1j * particles[:, 4:])))
    np.testing.assert_allclose(mean, expected, atol=1e-12)
    deviation = particles - mean
    deviation[:, 4:] = wrap(deviation[:, 4:])
    np.testing.assert_allclose(covariance, np.einsum("n,ni,nj", weights, deviation, deviation), atol=1e-12)


# -- the filter against exact ones -------------------------------------------------------------------------


def kalman_log_evidence(track: Track) -> np.ndarray:
    _, predicted = filter_states(track, PARAMETERS)
    found = np.full(len(track), np.nan)
    for k in range(1, len(track)):
        if np.isfinite(track.position[k]).all():
            spread = predicted.covariance[k][:2, :2] + 0.1**2 * np.eye(2)
            found[k] = stats.multivariate_normal(predicted.mean[k][:2], spread).logpdf(track.position[k])
    return found


def test_the_mean_tends_to_the_kalman_filters_at_the_rate_of_monte_carlo() -> None:
    track = without(walk(25, noise=0.1, uneven=True), "position", [8, 9, 17])
    exact = filter_states(track, PARAMETERS)[0].mean[:, :2]
    errors = []
    for count in (1000, 16_000):
        runs = [particle_filter(track, LINEAR, options=options(count), seed=s) for s in range(12)]
        errors.append(np.sqrt(np.mean([(r.track.position - exact) ** 2 for r in runs])))
    # Sixteen times the particles: a quarter of the error.
    assert 2.8 < errors[0] / errors[1] < 5.6
    assert errors[1] < 0.01


def test_the_evidence_is_the_kalman_filters_within_its_standard_error() -> None:
    track = walk(12, noise=0.1)
    exact = np.nansum(kalman_log_evidence(track))
    # The estimate of the evidence itself, not of its logarithm, is unbiased.
    ratios = [
        math.exp(
            np.nansum(particle_filter(track, LINEAR, options=options(2000), seed=s).log_evidence) - exact
        )
        for s in range(80)
    ]
    error = np.std(ratios, ddof=1) / math.sqrt(len(ratios))
    assert error < 0.1
    assert abs(np.mean(ratios) - 1.0) < 3.0 * error


def angle_on_a_grid(track: Track, model: Model, size: int = 720) -> tuple[np.ndarray, np.ndarray, float]:
    """Filtered and smoothed densities (n, size) of the body alone, and the log evidence, by quadrature."""
    grid = wrap(2.0 * np.pi * np.arange(size) / size)
    width = 2.0 * np.pi / size
    diffusion = model.parameters.orientation.body_diffusion
    ahead, steps, logs = np.full(size, 1.0 / (2.0 * np.pi)), [], []
    filtered, likelihoods = [], []
    for k in range(len(track)):
        if k:
            kappa = 1.0 / (diffusion * (track.t[k] - track.t[k - 1]))
            step = np.exp(von_mises_log_density(grid[:, None], grid, kappa)) * width
            steps.append(step)
            ahead = step @ filtered[-1]
        likelihood = np.ones(size)
        if np.isfinite(track.body_likelihood[k]).all():
            scores = np.tile(track.body_likelihood[k], (size, 1))
            likelihood = np.exp(mixture_log_density(grid, class_centres(8), scores, class_kappa(8), 0.05))
        logs.append(math.log(np.sum(ahead * likelihood) * width))
        filtered.append(ahead * likelihood / math.exp(logs[-1]))
        likelihoods.append(likelihood)
    backward, smoothed = np.ones(size), [filtered[-1]]
    for k in range(len(track) - 1, 0, -1):
        backward = steps[k - 1].T @ (backward * likelihoods[k])
        backward /= backward.max()
        density = filtered[k - 1] * backward
        smoothed.append(density / (density.sum() * width))
    return np.array(filtered), np.array(smoothed[::-1]), sum(logs)


def resultants(densities: np.ndarray) -> np.ndarray:
    size = densities.shape[1]
    return densities @ np.exp(2j * np.pi * np.arange(size) / size) * 2.0 * np.pi / size


def one_angle() -> tuple[Track, Model]:
    track = replace(walk(15, classes=True, uneven=True, angle_kappa=3.0, dt=0.4), head_likelihood=None)
    return without(track, "body_likelihood", [4, 5, 10]), Model("separate")


def test_one_angle_agrees_with_a_grid() -> None:
    track, model = one_angle()
    filtered, _, log_evidence = angle_on_a_grid(track, model)
    alone = replace(track, position=np.where(np.arange(15)[:, None] == 0, track.position, np.nan))
    found = particle_filter(alone, model, options=options(60_000))
    exact = resultants(filtered)
    np.testing.assert_allclose(difference(found.track.body, np.angle(exact)), 0.0, atol=np.radians(1.5))
    assert np.nansum(found.log_evidence) == pytest.approx(log_evidence, abs=0.1)
    grid = 2.0 * np.pi * np.arange(filtered.shape[1]) / filtered.shape[1]
    squared = difference(grid, np.angle(exact)[:, None]) ** 2
    variance = np.sum(filtered * squared, axis=1) * (grid[1] - grid[0])
    np.testing.assert_allclose(found.track.covariance[:, 4, 4], variance, rtol=0.05)


def test_backward_simulation_of_one_angle_agrees_with_a_grid() -> None:
    track, model = one_angle()
    _, smoothed, _ = angle_on_a_grid(track, model)
    alone = replace(track, position=np.where(np.arange(15)[:, None] == 0, track.position, np.nan))
    runs = [
        particle_smoother(alone, model, options=options(3000, paths=300), seed=s).track.body for s in range(4)
    ]
    mean = np.angle(np.mean(np.exp(1j * np.array(runs)), axis=0))
    exact = resultants(smoothed)
    firm = np.abs(exact) > 0.5
    assert firm.sum() > 8
    np.testing.assert_allclose(difference(mean, np.angle(exact))[firm], 0.0, atol=np.radians(5.0))


@pytest.mark.slow
def test_backward_simulation_is_rauch_tung_striebel_on_the_linear_model() -> None:
    track = without(walk(20, noise=0.1, dt=0.3), "position", [6, 7, 8, 9])
    exact = rauch_tung_striebel(track, PARAMETERS)
    runs = [
        particle_smoother(track, LINEAR, options=options(4000, paths=200), seed=s).track for s in range(4)
    ]
    mean = np.mean([r.position for r in runs], axis=0)
    online = np.mean(
        [particle_filter(track, LINEAR, options=options(4000), seed=s).track.position for s in range(4)],
        axis=0,
    )
    off = np.linalg.norm(mean - exact.position, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert np.linalg.norm(online - exact.position, axis=1)[6:10].max() > 5.0 * off[6:10].max()
    variance = np.mean([r.covariance[:, 0, 0] for r in runs], axis=0)
    np.testing.assert_allclose(variance, exact.covariance[:, 0, 0], rtol=0.5)


# -- behaviour ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", [particle_filter, particle_smoother])
def test_a_seed_decides_everything(estimator: object) -> None:
    track = walk(15)

    def run(seed: int | np.random.Generator) -> np.ndarray:
        return estimator(track, "joint", options=options(50, paths=9), seed=seed).track.position

    np.testing.assert_array_equal(run(1), run(1))
    np.testing.assert_array_equal(run(1), run(np.random.default_rng(1)))
    assert not np.array_equal(run(1), run(2))


def test_a_jump_out_of_reach_is_recovered_from_and_said() -> None:
    track = walk(20)
    position = track.position.copy()
    position[12:] += 500.0
    track = replace(track, position=position)
    with pytest.warns(InputWarning, match=r"track 1: .*frame 22"):
        found = particle_filter(track, "joint", options=options(300))
    assert found.recovered == (12,)
    assert np.linalg.norm(found.track.position[12:] - position[12:], axis=1).max() < 0.5
    assert found.log_evidence[12] < -700.0
    with pytest.warns(InputWarning):
        smoothed = particle_smoother(track, "joint", options=options(300))
    assert np.linalg.norm(smoothed.track.position - position, axis=1).max() < 0.5


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("preset", ["separate", "joint", "joint-intentional"])
def test_a_head_out_of_reach_is_recovered_from_alone(preset: str, gap: bool) -> None:
    n = 30
    truth = np.stack([0.12 * np.arange(n), np.zeros(n)], axis=1)
    seen = np.where((np.arange(n)[:, None] >= 12) & (np.arange(n)[:, None] < 20) & gap, np.nan, truth)
    head, t = np.where(np.arange(n) < 15, 0.0, np.pi / 2.0), 0.1 * np.arange(n)
    certain = {"position_std": np.full(n, 0.05), "head_kappa": np.full(n, 1e4)}
    track = Track(1, np.arange(n), t, seen, head=head, **certain)
    with pytest.warns(InputWarning, match="frame 15"):
        found = particle_filter(track, preset)
    assert found.recovered == (15,)
    assert np.abs(difference(found.track.head, head)).max() < np.radians(4.0)
    # The position is not given up for the head: a prior on the velocity would be off by a metre at once.
    assert np.linalg.norm(found.track.position - truth, axis=1).max() < 0.5
    with pytest.warns(InputWarning):
        smoothed = particle_smoother(track, preset, options=options(300, paths=30)).track.head
    assert np.abs(difference(smoothed, head)).max() < np.radians(6.0)


@pytest.mark.parametrize("kind", ["angle", "smooth", "closest", "image"])
def test_orientations_are_drawn_from_what_was_observed(kind: str) -> None:
    track, view = walk(5, classes=kind != "angle"), camera(mirrored=True) if kind == "image" else None
    pose = "closest" if kind == "closest" else "smooth"
    likelihood = LikelihoodParameters(class_outlier_probability=0.0)
    job = prepare(track, Model("joint", Parameters(likelihood=likelihood)), view, pose, kind == "image")
    place, n = np.array([0.7, 0.4]), 6000
    drawn = draw_orientations(job.head, job.camera, 3, np.tile(place, (n, 1)), np.random.default_rng(6))
    grid = np.zeros((4001, 6))
    grid[:, :2], grid[:, 5] = place, np.linspace(-np.pi, np.pi, 4001)
    density = np.zeros(4001)
    add_pose_log_density(grid, 5, 3, job.head, job.camera, density)
    mass = np.cumsum(np.exp(density))
    levels = np.interp(drawn, grid[:, 5], mass / mass[-1])
    assert stats.kstest(levels, stats.uniform().cdf).pvalue > 0.01


def test_what_is_out_of_reach_together_is_drawn_anew_together() -> None:
    track = replace(walk(5), position_std=np.full(5, 0.01), head_kappa=np.full(5, 2e3))
    job = prepare(track, Model("joint"), None, "smooth", False)
    particles = np.zeros((400, 6))
    particles[:, :2], particles[:, 5] = track.position[2] + 9.0, track.head[2]
    # The position alone is lost; then everything, one half here and the other half there.
    assert recover(job, 2, particles, 1.0, np.random.default_rng(0)) == Used(
        position=True, body=False, head=False
    )
    assert np.linalg.norm(particles[:, :2] - track.position[2], axis=1).max() < 0.06
    particles[:200, :2] += 9.0
    particles[200:, 5] += 1.5
    assert recover(job, 2, particles, 1.0, np.random.default_rng(0)) == Used(
        position=True, body=True, head=True
    )
    assert np.linalg.norm(particles[:, :2] - track.position[2], axis=1).max() < 0.06
    assert np.abs(difference(particles[:, 5], track.head[2])).max() < 0.12


def test_before_the_first_position_nothing_is_known() -> None:
    track = without(walk(12), "position", slice(0, 4))
    for estimator in (particle_filter, particle_smoother):
        found = estimator(track, "joint", options=options(100, paths=20))
        assert np.isnan(found.track.position[:4]).all()
        assert np.isfinite(found.track.position[4:]).all()
        assert np.isfinite(found.track.body[4:]).all()
        assert np.isnan(found.log_evidence[:4]).all()


class _Other(Term):
    uses: ClassVar[frozenset[str]] = frozenset()

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        return []

    def cost(self, states: object, track: Track, camera: GroundCamera | None = None) -> float:
        return 0.0


def test_what_cannot_be_run_is_refused() -> None:
    with pytest.raises(InputError, match="_Other"):
        particle_filter(walk(5), Model("joint", terms=[_Other]))
    with pytest.raises(InputError, match="camera"):
        particle_filter(walk(5), "joint", options=options(10, image_pose=True))


def test_variances_are_not_below_zero_where_the_first_particle_is_far_from_all_of_the_weight() -> None:
    rng = np.random.default_rng(0)
    mean, covariance = np.zeros(6), np.zeros((6, 6))
    for _ in range(200):
        particles = rng.normal(0.0, 10.0, 6) + 1e-9 * rng.normal(size=(50, 6))
        particles[0] += 10.0  # far from where all the weight is
        weights = rng.random(50)
        weights[0] = 1e-30
        weights /= weights.sum()
        summarise_motion(particles, weights, mean, covariance)
        assert (np.diag(covariance)[:4] >= 0.0).all()
        exact = np.cov(particles[:, :4].T, aweights=weights, ddof=0)
        np.testing.assert_allclose(covariance[:4, :4], exact, atol=1e-9)
