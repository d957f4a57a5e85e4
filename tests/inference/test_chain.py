"""The chain engine against GTSAM, finite differences and a grid, and on input that is hardly any."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from costs import cost_around, gradient, states_of
from kernels import rows_of
from random_tracks import contradicted, hard_models, lens_camera, random_parameters, random_track
from scipy import stats
from selection import others_slow
from walks import walk

from graphtrack.errors import InputError
from graphtrack.geometry.angles import class_centres, class_kappa, difference, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import Failure, Solution, SolverOptions, smooth_track
from graphtrack.inference.chain.initialisation import initial_states, pack
from graphtrack.inference.engines import engine_of
from graphtrack.inference.graph.batch import smooth_graph
from graphtrack.inference.graph.recording import recording_graph, recording_tracks
from graphtrack.inference.state import values_of
from graphtrack.model import LikelihoodParameters, Model, Parameters, States, Term, presets
from graphtrack.model.observation import chain
from graphtrack.model.terms.motion import Motion
from graphtrack.model.terms.orientation import ANCHOR_KAPPA
from graphtrack.smoothing import solve
from graphtrack.tracks.track import Track, TrackSet

EXACTLY = SolverOptions(max_iterations=2000, relative_tolerance=0.0, step_tolerance=1e-11)
PRESETS = ("position", "separate", "joint", "intentional", "joint-intentional")
EVERY_PRESET = pytest.mark.parametrize("preset", PRESETS)


def distance(one: Track, other: Track) -> float:
    """The most by which estimates differ: metres, m/s, radians."""
    apart = [np.abs(one.position - other.position).max(), np.abs(one.velocity - other.velocity).max()]
    for name in ("body", "head"):
        if getattr(one, name) is not None:
            apart.append(np.abs(difference(getattr(one, name), getattr(other, name))).max())
    return float(max(apart))


# Against GTSAM.


@pytest.mark.parametrize(
    ("seeds", "presets_each"),
    [(range(10), 1), pytest.param(range(1000, 1500), len(PRESETS), marks=pytest.mark.slow)],
    ids=["10 tracks", "500 tracks"],
)
def test_the_optimum_is_that_of_gtsams_graph(
    seeds: range, presets_each: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Random tracks with some of the presets, which take turns."""

    def from_here() -> tuple[Track, float]:
        with monkeypatch.context() as patch:
            begun = lambda track, model: states_of(found.track)  # noqa: E731
            patch.setattr("graphtrack.inference.graph.batch.initial_states", begun)
            return costed(smooth_graph(track, model, camera, EXACTLY).track)

    def anchors(estimates: Track) -> float:
        first, found = initial_states(track, model), states_of(estimates)
        turned = [getattr(found, name)[0] - getattr(first, name)[0] for name in ("body", "head")]
        return float(np.nansum(ANCHOR_KAPPA * (1.0 - np.cos(turned))))

    def costed(graph: Track) -> tuple[Track, float]:
        return graph, model.cost(states_of(graph), track, camera)

    same, compared = 0, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        camera = lens_camera() if seed % 4 == 0 else None
        track, parameters = random_track(rng, camera), random_parameters(rng)
        for preset in np.roll(PRESETS, -2 * seed)[:presets_each].tolist():
            model = Model(preset, parameters)
            found = smooth_track(track, model, camera, engine="chain")
            cost = model.cost(states_of(found.track), track, camera)
            where = f"track {seed}, {preset}"
            assert found.converged, where
            # The broad anchors of the first orientations are all that is not in the model's density.
            assert found.cost - anchors(found.track) == pytest.approx(cost, rel=1e-9, abs=1e-5), where
            graph, graph_cost = costed(smooth_graph(track, model, camera, EXACTLY).track)
            compared += 1
            if cost < graph_cost - 1e-8 * (1.0 + abs(graph_cost)):
                # GTSAM ended in another basin. In this one both must see the same optimum.
                graph, graph_cost = from_here()
            else:
                same += 1
                if distance(found.track, graph) > 1e-5:
                    # GTSAM crept along a flat direction, until it stopped. Here it must stay.
                    graph, graph_cost = from_here()
                    assert distance(found.track, graph) <= 1e-8, where
            assert cost == pytest.approx(graph_cost, rel=1e-8, abs=1e-8), where
            assert distance(found.track, graph) <= 1e-5, where
    assert same >= 0.9 * compared


@pytest.mark.parametrize("preset", others_slow(["separate", "joint"], ["joint"]))
@pytest.mark.parametrize("robust", ["none", "huber", "cauchy"])
@pytest.mark.parametrize("seen", ["angles", "classes", "pixels"])
def test_covariances_are_the_marginals_of_the_graph(preset: str, robust: str, seen: str) -> None:
    track, camera = walk(3, seed=3, uneven=True, noise=0.15, classes=seen == "classes", track_id=0), None
    parameters = Parameters(
        likelihood=LikelihoodParameters(
            robust=robust, body_outliers=0.1, head_outliers=0.1, robust_threshold=1.3
        )
    )
    if seen == "pixels":
        camera = lens_camera()
        track = replace(track, pixel=camera.ground_to_image(track.position))
    model = Model(preset, parameters)
    found = smooth_track(track, model, camera, EXACTLY, engine="chain").track
    alone = TrackSet((track,), camera=camera)
    graph, values = recording_graph(alone, [model])
    values.update(values_of(chain(track), rows_of(states_of(found)), model))
    (expected,) = recording_tracks(values, alone, [model], gtsam.Marginals(graph, values))
    assert found.covariance is not None and expected.covariance is not None
    scale = np.sqrt(np.einsum("nii->ni", expected.covariance))
    both = scale[:, :, None] * scale[:, None, :]
    np.testing.assert_allclose(found.covariance / both, expected.covariance / both, atol=5e-4)


# The global optimum.


def grid_course(states: States, track: Track, model: Model, bins: int = 72) -> States:
    """Viterbi over a grid of body and head directions, with the motion of ``states``, from definitions."""
    coupling, turning = model.parameters.coupling, model.parameters.orientation
    n, angles = len(track), 2.0 * np.pi * np.arange(bins) / bins
    dt = np.diff(track.t)
    weight = coupling.weights(track.dt)
    unary = {"body": np.zeros((n, bins)), "head": np.zeros((n, bins))}
    for name, cost in unary.items():
        seen, classes = getattr(track, name), getattr(track, f"{name}_likelihood")
        if seen is not None:
            kappa = getattr(track, f"{name}_kappa")[:, None]
            cost += kappa * (1.0 - np.cos(angles - seen[:, None]))
        if classes is not None:
            k = classes.shape[1]
            density = stats.vonmises.pdf(angles[:, None] - class_centres(k), class_kappa(k))
            outlier = model.parameters.likelihood.class_outlier_probability
            share = classes / classes.sum(axis=1, keepdims=True)
            cost -= np.log(outlier / (2 * np.pi) + (1.0 - outlier) * share @ density.T)
    pull = np.zeros(n)
    if model.preset == "joint":
        speed = np.linalg.norm(states.velocity, axis=1)
        strength = (
            coupling.motion_body_kappa * np.maximum(speed - coupling.speed_threshold, 0.0) ** 2 * weight
        )
        unary["body"] += strength[:, None] * (1.0 - np.cos(angles - direction(states.velocity)[:, None]))
        pull = coupling.head_body_kappa * weight
    apart = 1.0 - np.cos(angles[:, None] - angles)
    joint = unary["body"][:, :, None] + unary["head"][:, None, :] + pull[:, None, None] * apart
    by_body = [apart / (turning.body_diffusion * step) for step in dt.tolist()]
    by_head = [apart / (turning.head_diffusion * step) for step in dt.tolist()]
    # The cost of the cheapest course to each pair of directions.
    values = [joint[0]]
    for k in range(n - 1):
        turned = (by_body[k][:, :, None] + values[k]).min(axis=1)
        values.append((by_head[k] + turned[:, None, :]).min(axis=2) + joint[k + 1])
    b, h = np.unravel_index(values[-1].argmin(), values[-1].shape)
    course = [(b, h)]
    for k in range(n - 2, -1, -1):
        before = values[k] + by_body[k][b][:, None] + by_head[k][h]
        b, h = np.unravel_index(before.argmin(), before.shape)
        course.append((b, h))
    places = np.array(course[::-1])
    return replace(states, body=angles[places[:, 0]], head=angles[places[:, 1]])


@pytest.mark.slow
@pytest.mark.parametrize("tracks", [8, pytest.param(300, marks=pytest.mark.slow)])
def test_contradictions_do_not_keep_it_from_the_best_course(tracks: int) -> None:
    """At most one in a hundred hard tracks costs more than the best course on a grid."""
    worse, models = [0, 0], list(hard_models().values())
    for seed in range(tracks):
        model, kind = models[seed % len(models)], ("opposed", "flipped")[seed // len(models) % 2]
        track = contradicted(np.random.default_rng(seed), kind)
        ways = SolverOptions(), SolverOptions(basin_search=False)
        found = [states_of(smooth_track(track, model, options=one, engine="chain").track) for one in ways]
        on_grid = model.cost(grid_course(found[0], track, model), track)
        for k, states in enumerate(found):
            worse[k] += model.cost(states, track) > on_grid + 1e-6 * (1.0 + abs(on_grid))
    assert worse[0] <= 0.01 * tracks
    assert worse[1] > 0.2 * tracks, "they are not hard"


# Hardly any input, and wrong input.


@EVERY_PRESET
def test_far_from_the_origin_estimates_are_as_exact_as_near_it(preset: str) -> None:
    far, model = np.array([1e7, -1e7]), Model(preset)
    # The resolution of a double at 1e7 m is 2e-9 m.
    track = walk(40, seed=2, uneven=True)
    distant = replace(track, position=track.position + far)
    near = replace(track, position=distant.position - far)
    here, there = smooth_track(near, model, engine="chain"), smooth_track(distant, model, engine="chain")
    np.testing.assert_allclose(there.track.position - far, here.track.position, atol=5e-9)
    np.testing.assert_allclose(there.track.velocity, here.track.velocity, atol=1e-9)
    np.testing.assert_allclose(there.track.covariance, here.track.covariance, rtol=1e-6)
    assert there.cost == pytest.approx(here.cost, rel=1e-9)


def test_a_track_of_numbers_too_great_to_square_fails_alone() -> None:
    position = np.where(np.arange(12).reshape(6, 2) == 4, 1e8, 0.0)
    huge = replace(walk(6, track_id=2), position=position, position_std=np.full(6, 1e-153))
    first, failed, last = solve(TrackSet((walk(6, track_id=1), huge, walk(6, track_id=3))), engine="chain")
    assert isinstance(first, Solution) and isinstance(failed, Failure)
    assert "not finite" in failed.reason and isinstance(last, Solution)


class Homesick(Term):
    """A term of a user's own: people tend to the origin. It has no compiled kernel."""

    def factors(self, step):
        from gtsam import PriorFactorPoint2, noiseModel

        return [PriorFactorPoint2(step.position_key, np.zeros(2), noiseModel.Isotropic.Sigma(2, 1.0))]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        return 0.5 * float(np.sum(states.position**2))


def test_a_term_without_a_kernel_is_gtsams_work() -> None:
    model = Model("position", terms=[Homesick])
    assert engine_of(model) == "gtsam" and engine_of(Model("position")) == "chain"
    track = walk(10)
    found = smooth_track(track, model)
    assert found.engine == "gtsam"
    assert np.abs(gradient(cost_around(states_of(found.track), track, model), 40)).max() < 1e-4
    with pytest.raises(InputError, match="Homesick"):
        smooth_track(track, model, engine="chain")
    with pytest.raises(InputError, match="Homesick"):
        solve(TrackSet((track,)), model, engine="chain")


def test_a_term_is_linear_only_if_its_own_class_says_so() -> None:
    class Steered(Motion):
        """A parent's declaration does not hold for a child that may have changed it."""

    def is_linear(model: Model) -> bool:
        return model.is_linear(pack([walk()], model))

    assert is_linear(Model("position")) and not is_linear(Model("position", terms=[Steered]))
    assert [name for name in presets if is_linear(Model(name))] == ["position"]
    assert not is_linear(Model("position", Parameters(likelihood=LikelihoodParameters(robust="huber"))))
