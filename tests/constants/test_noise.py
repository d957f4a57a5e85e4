"""Noise of observations: learned where none is declared, offsets, and declared noise against the data."""

import warnings
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest
from command import ran, run
from scipy import stats
from walks import rotation

import graphtrack as gt
from graphtrack.constants.declared import declared_noise
from graphtrack.constants.filters import OUTLIERS, PERSISTENCE, Persistent, motion_evidence
from graphtrack.constants.noise import undeclared, with_learned_noise, with_offset
from graphtrack.constants.population import DENSITIES, Population
from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import PersonalConstants
from graphtrack.model.parameters import LikelihoodParameters, Parameters
from graphtrack.tracks.track import Track, TrackSet

MODEL = gt.Model("joint")


def matern(apart: np.ndarray) -> np.ndarray:
    scaled = 2.0 / PERSISTENCE * np.abs(apart)
    return (1.0 + scaled) * np.exp(-scaled)


def walks(
    seed: int,
    white: float = 0.1,
    along: float = 0.0,
    across: float = 0.0,
    people: int = 30,
    rate: float = 5.0,
    way: float = 0.0,
) -> TrackSet:
    """Straight walks on which errors persist along and across a direction; no noise is declared."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 20.0, 1.0 / rate)
    root = np.linalg.cholesky(matern(np.subtract.outer(t, t)) + 1e-9 * np.eye(len(t)))
    tracks = []
    for k in range(people):
        heading = rng.uniform(-np.pi, np.pi)
        place = 1.3 * t[:, None] * [np.cos(heading), np.sin(heading)]
        error = np.column_stack(
            [along * root @ rng.normal(size=len(t)), across * root @ rng.normal(size=len(t))]
        )
        noisy = place + error @ rotation(way).T + white * rng.normal(size=(len(t), 2))
        tracks.append(Track(k, np.arange(len(t)), t, noisy, true_position=place))
    return TrackSet(tuple(tracks))


# -- evidence ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("std", "density"), [(0.0, 0.01), (0.0, 0.3), (0.0, 10.0), (0.3, 0.2)])
def test_evidence_is_the_exact_density_of_the_positions(std: float, density: float) -> None:
    (track,) = walks(0, along=std, across=std, people=1).tracks
    seen = np.arange(len(track)) % 7 != 3
    gaps, track = replace(track, position=np.where(seen[:, None], track.position, np.nan)), track[seen]
    t, parameters = track.t - track.t[0], Parameters()
    low, high = np.minimum.outer(t, t), np.maximum.outer(t, t)
    covariance = 0.01 * np.eye(len(t)) + parameters.motion.initial_speed_std**2 * np.outer(t, t)
    covariance += density * low**2 * (3.0 * high - low) / 6.0 + std**2 * matern(np.subtract.outer(t, t))
    # The place of the first position is known by that position alone.
    contrast = np.eye(len(t))[1:] - np.eye(len(t))[0]
    spread = contrast @ covariance @ contrast.T
    expected = sum(
        stats.multivariate_normal(np.zeros(len(t) - 1), spread).logpdf(contrast @ track.position[:, axis])
        for axis in range(2)
    )
    found, errors = motion_evidence([gaps], parameters, np.array([density]), None, Persistent(std, std))
    expected += (len(t) - 1) * np.log(1.0 - OUTLIERS)
    assert found[0, 0] == pytest.approx(expected, abs=0.05) and errors[0, 0] < 0.05


def test_evidence_of_ellipses_is_that_of_their_axes() -> None:
    (track,) = walks(0, people=1, white=0.0).tracks
    t, n, turn, density, parameters = track.t, len(track), rotation(0.7), 10.0, Parameters()
    errors = np.array([0.025, 0.004]) * np.random.default_rng(2).standard_normal((n, 2))
    covariance = np.tile(turn @ np.diag([0.025**2, 0.004**2]) @ turn.T, (n, 1, 1))
    place = track.true_position + errors @ turn.T
    observed = replace(track, position=place, position_covariance=covariance)
    low, high = np.minimum.outer(t, t), np.maximum.outer(t, t)
    motion = parameters.motion.initial_speed_std**2 * np.outer(t, t)
    motion = motion + density * low**2 * (3.0 * high - low) / 6.0
    contrast = np.eye(n)[1:] - np.eye(n)[0]
    expected = (n - 1) * np.log(1.0 - OUTLIERS)
    for axis, std in enumerate((0.025, 0.004)):
        spread = contrast @ (motion + std**2 * np.eye(n)) @ contrast.T
        mean = np.zeros(n - 1)
        expected += stats.multivariate_normal(mean, spread).logpdf(contrast @ (place @ turn)[:, axis])
    found, gross = motion_evidence([observed], parameters, np.array([density]))
    assert found[0, 0] == pytest.approx(expected, abs=0.05) and gross[0, 0] < 0.1


def test_persistent_errors_of_no_size_are_none() -> None:
    tracks = walks(1, people=3).tracks
    white = motion_evidence(tracks, Parameters(), DENSITIES, None, Persistent())[0]
    tiny = motion_evidence(tracks, Parameters(), DENSITIES, None, Persistent(1e-6, 1e-6))[0]
    np.testing.assert_allclose(tiny, white, atol=1e-3)


# -- learning ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [2.5, 10.0])
@pytest.mark.parametrize("white", [0.03, 0.1, 0.4])
def test_white_noise_is_found_and_nothing_that_persists(rate: float, white: float) -> None:
    tracks = walks(2, white, rate=rate)
    found = with_learned_noise(Population(), tracks, MODEL)
    assert 0.1 * found.position_noise == pytest.approx(white, rel=0.1)
    assert found.along == found.across == 0.0


@pytest.mark.slow
def test_turns_and_speeds_of_people_are_no_noise() -> None:
    """Simulated people whose q is that of runners who turn."""
    motion = replace(MODEL.parameters.motion, acceleration_density=2.0)
    lively = MODEL.with_parameters(replace(MODEL.parameters, motion=motion))
    truth = gt.simulate(lively, n_tracks=20, n_steps=150, fps=10.0, rng=np.random.default_rng(0))
    noisy = gt.add_noise(
        truth, position_std=0.1, body_kappa=4.0, head_kappa=4.0, rng=np.random.default_rng(1)
    )
    bare = noisy.map(lambda track: replace(track, position_std=None, body_kappa=None, head_kappa=None))
    found = with_learned_noise(Population(), bare, MODEL)
    assert found.position_noise == pytest.approx(1.0, rel=0.15) and found.along == found.across == 0.0
    assert found.body_noise == pytest.approx(1.0, rel=0.1) == found.head_noise


@pytest.mark.slow
@pytest.mark.parametrize("rate", [2.5, 10.0])
def test_persistent_errors_are_found_and_intervals_hold_the_truth(rate: float) -> None:
    tracks = walks(3, 0.1, 0.4, 0.4, rate=rate)
    found = with_learned_noise(Population(), tracks, MODEL)
    assert found.along == found.across == pytest.approx(0.4, rel=0.3)

    def offset(track: Track) -> Track:
        by = np.random.default_rng(track.track_id).normal(0.0, 0.4, 2)
        return replace(track, position=track.position + by)

    lasting = tracks.map(offset)
    held = []
    for one, true in zip(gt.smooth(lasting), lasting, strict=True):
        assert one.covariance is not None and true.true_position is not None
        std = np.sqrt(one.covariance[:, (0, 1), (0, 1)])
        held.append(np.abs(one.position - true.true_position) < 1.96 * std)
    assert 0.85 < np.concatenate(held).mean() < 0.99


def test_errors_along_the_ray_are_told_from_those_across_it() -> None:
    way = 0.6
    tracks = walks(4, 0.1, 0.5, 0.0, way=way)
    far = GroundCamera.from_scale(0.01, nadir=[-1e6 * np.cos(way), 1e6 * np.sin(way)])
    found = with_learned_noise(Population(), replace(tracks, camera=far), MODEL)
    assert found.along == pytest.approx(0.5, rel=0.3) and found.across < 0.15
    one = tracks.tracks[0]
    covariance = np.tile(1e-4 * np.eye(6), (len(one), 1, 1))
    wide = with_offset(replace(one, covariance=covariance), Persistent(0.5, 0.1), far)
    assert wide.covariance is not None
    ray = np.array([np.cos(way), np.sin(way)])
    np.testing.assert_allclose(
        wide.covariance[:, :2, :2] @ ray, np.tile(0.2501 * ray, (len(one), 1)), rtol=1e-2
    )


def test_the_noise_does_not_depend_on_order_origin_or_direction() -> None:
    tracks = walks(5, 0.15, 0.3, 0.3, people=12)
    first = with_learned_noise(Population(), tracks, MODEL)
    turn = rotation(1.1)
    moved = tracks.map(
        lambda one: replace(one, position=one.position @ turn.T + [500.0, -80.0], t=one.t + 1e6)
    )
    for other in (tracks.with_tracks(tracks.tracks[::-1]), moved):
        again = with_learned_noise(Population(), other, MODEL)
        assert again.position_noise == pytest.approx(first.position_noise, rel=1e-4)
        assert again.along == pytest.approx(first.along, rel=1e-3)


def test_few_observations_leave_the_noise_of_the_model() -> None:
    (track,) = walks(6, 0.4, people=1)
    few = TrackSet((track[:60],))
    assert with_learned_noise(Population(), few, MODEL) == Population()


# -- declarations --------------------------------------------------------------------------------------------


def test_what_is_declared_stays() -> None:
    tracks = walks(7, 0.4)
    declared = tracks.map(lambda one: replace(one, position_std=np.full(len(one), 0.2)))
    assert undeclared(tracks, MODEL) == ("position", "body", "head")
    assert "position" not in undeclared(declared, MODEL)
    likelihood = replace(MODEL.parameters.likelihood, position_std=0.3)
    own = MODEL.with_parameters(replace(MODEL.parameters, likelihood=likelihood))
    assert "position" not in undeclared(tracks, own)
    assert "position_std" not in gt.solve(declared)[0].constants.noise
    assert gt.solve(tracks)[0].constants.noise["position_std"] == pytest.approx(0.4, rel=0.1)
    assert gt.solve(tracks, constants="default")[0].constants is None


def test_a_known_population_brings_its_noise() -> None:
    tracks = walks(8, 0.3, 0.4, 0.4)
    population, _ = gt.smoothing.learn_constants(tracks)
    first, again = gt.smooth(tracks), gt.smooth(tracks, constants=population)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-6)
    assert Population.from_dict(population.to_dict()) == population


# -- offsets -------------------------------------------------------------------------------------------------


def test_an_offset_is_a_variable_of_the_graph() -> None:
    """Marginals of a graph with a walk and a shared offset are the walk's and the offset's prior together."""
    t, q, white, offset = 0.4 * np.arange(8), 0.2, 0.1, 0.35
    rng = np.random.default_rng(0)
    seen = np.cumsum(rng.normal(0.5, 0.1, 8))

    def marginals(has_offset: bool) -> np.ndarray:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()

        def place(k: int):
            def error(factor, at, jacobians):
                x, sign = at.atVector(k), 1.0 if has_offset else 0.0
                if jacobians is not None:
                    jacobians[0] = np.array([[1.0, 0.0]])
                    jacobians[1] = np.array([[sign]])
                return np.array([x[0] + sign * at.atVector(99)[0] - seen[k]])

            return error

        def step(k: int, dt: float):
            def error(factor, at, jacobians):
                move = np.array([[1.0, dt], [0.0, 1.0]])
                if jacobians is not None:
                    jacobians[0], jacobians[1] = -move, np.eye(2)
                return at.atVector(k + 1) - move @ at.atVector(k)

            return error

        one = gtsam.noiseModel.Isotropic.Sigma(1, white)
        for k in range(len(t)):
            values.insert(k, np.array([seen[k], 1.0]))
            graph.add(gtsam.CustomFactor(one, [k, 99], place(k)))
        for k, dt in enumerate(np.diff(t).tolist()):
            spread = q * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
            graph.add(
                gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(spread), [k, k + 1], step(k, dt))
            )
        values.insert(99, np.zeros(1))
        graph.add(gtsam.PriorFactorVector(99, np.zeros(1), gtsam.noiseModel.Isotropic.Sigma(1, offset)))
        solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        found = gtsam.Marginals(graph, solved)
        return np.array([[solved.atVector(k)[0], found.marginalCovariance(k)[0, 0]] for k in range(len(t))])

    plain, with_variable = marginals(False), marginals(True)
    np.testing.assert_allclose(with_variable[:, 0], plain[:, 0], atol=1e-6)
    np.testing.assert_allclose(with_variable[:, 1], plain[:, 1] + offset**2, rtol=1e-6)
    track = Track(0, np.arange(8), t, np.column_stack([seen, seen]), covariance=np.zeros((8, 6, 6)))
    added = with_offset(track, Persistent(offset, offset), None).covariance
    assert added is not None
    np.testing.assert_allclose(added[:, 0, 0], with_variable[:, 1] - plain[:, 1], rtol=1e-6)


def test_smooth_says_the_noise_that_it_learned(tmp_path: Path) -> None:
    gt.write(walks(9, 0.2, 0.4, 0.4), tmp_path / "found.csv")
    done = ran("smooth", tmp_path / "found.csv", "-o", tmp_path / "out.csv", program="graphtrack")
    (line,) = (one for one in done.stderr.splitlines() if "noise, learned" in one)
    white, along = (float(part.split(" m")[0].split()[-1]) for part in line.split(",")[1:3])
    assert white == pytest.approx(0.2, rel=0.15) and along == pytest.approx(np.hypot(0.2, 0.4), rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [3, 20])
def test_noise_that_could_not_be_learned_is_named(seconds: int, tmp_path: Path) -> None:
    """Of takes of a few seconds the noise is the model's, which the command and the report say."""
    tracks = walks(9, 0.2, people=2 if seconds == 3 else 4).map(lambda one: one[: 5 * seconds])
    gt.write(tracks, tmp_path / "found.csv")
    options = ("-o", tmp_path / "out.csv", "--report", tmp_path / "report.html")
    done = ran("smooth", tmp_path / "found.csv", *options, program="graphtrack")
    (line,) = (one for one in done.stderr.splitlines() if "  noise, " in one)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    (one, *_) = gt.solve(tracks)
    assert isinstance(one, gt.Solution) and one.constants is not None
    too_few = seconds == 3
    assert ("too few observations" in line) == too_few == ("noise of the model was used" in page)
    assert one.constants.assumed == (("position_std",) if too_few else ())
    assert ("positions 0.1 m" in line) == too_few and f"N{line.strip()[1:]}." in page


def people(
    seed: int, n: int = 12, steps: int = 120, fps: float = 10.0, preset: str = "joint", std: float = 0.1
) -> TrackSet:
    simulated = gt.simulate(preset, n_tracks=n, n_steps=steps, fps=fps, rng=np.random.default_rng(seed))
    return gt.add_noise(
        simulated, position_std=std, body_kappa=3.0, head_kappa=5.0, rng=np.random.default_rng(seed)
    )


def misdeclared(tracks: TrackSet, position: float, body: float, head: float) -> TrackSet:
    """The same observations, declared that many times as noisy (1-σ) as they are."""

    def changed(track: Track) -> Track:
        return replace(
            track,
            position_std=position * track.position_std,
            body_kappa=track.body_kappa / body**2,
            head_kappa=track.head_kappa / head**2,
        )

    return tracks.map(changed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_what_is_declared_rightly_is_not_contradicted(seed: int) -> None:
    setting = [(6, 60, 30.0), (12, 120, 10.0), (30, 30, 2.5)][seed % 3]
    preset = ["separate", "joint"][seed % 2]
    assert declared_noise(people(seed, *setting, preset), MODEL).lines() == []
    few = misdeclared(people(4, 1, 30), 0.1, 1.0, 1.0)
    assert declared_noise(few, MODEL).lines() == []


@pytest.mark.parametrize("factor", [1 / 3, 3.0])
def test_what_is_declared_wrongly_is_found_and_corrected(factor: float) -> None:
    tracks = misdeclared(people(1), factor, 0.5, 2.0)
    noise = declared_noise(tracks, MODEL)
    found = {one.name: one.multiplier for one in noise.channels}
    for name, wrong in (("position", factor), ("body", 0.5), ("head", 2.0)):
        one = found[name]
        assert one.low < one.value < one.high
        assert one.value == pytest.approx(1.0 / wrong, rel=0.12), name
    assert [line.split(":")[0] for line in noise.lines()] == ["position", "body", "head"]
    assert all("--trust learn" in line for line in noise.lines())
    _, model = noise.corrected(tracks, MODEL)
    assert model.parameters.likelihood.position_scale == pytest.approx(1.0 / factor, rel=0.12)
    assert declared_noise(tracks, model).lines() == []


@pytest.mark.slow
def test_what_the_model_declares_is_looked_at_where_the_data_declare_nothing() -> None:
    tracks = people(2, std=0.3).map(lambda track: replace(track, position_std=None))
    (line,) = declared_noise(tracks, MODEL).lines()
    assert "likelihood.position_std" in line
    _, model = declared_noise(tracks, MODEL).corrected(tracks, MODEL)
    assert model.parameters.likelihood.position_std == pytest.approx(0.3, rel=0.1)


def test_gross_errors_do_not_count_as_noise() -> None:
    def spoilt(track: Track) -> Track:
        rng = np.random.default_rng(track.track_id)
        off = rng.random(len(track)) < 0.1
        return replace(track, position=track.position + off[:, None] * rng.normal(0.0, 2.0, (len(track), 2)))

    assert declared_noise(people(3).map(spoilt), MODEL).lines() == []


@pytest.mark.slow
def test_smoothing_warns_or_corrects_as_it_is_told() -> None:
    tracks = misdeclared(people(6, preset="separate"), 1 / 3, 1.0, 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = gt.smooth(tracks, "separate", trust="declared")
    with pytest.warns(InputWarning, match="position: the noise is 3"):
        checked = gt.smooth(tracks, "separate")
    with pytest.warns(InputWarning, match="corrected"):
        learned = gt.smooth(tracks, "separate", trust="learn")

    def honesty(estimates: TrackSet) -> float:
        squares = []
        for track, one in zip(tracks, estimates, strict=True):
            error = one.position - track.true_position
            squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(one.covariance[:, :2, :2]), error))
        return float(np.concatenate(squares).mean() / 2.0)

    assert honesty(checked) == honesty(plain) > 3.0 and 0.8 < honesty(learned) < 1.3
    with pytest.raises(InputError, match="declared, check or learn"):
        gt.smooth(tracks, "separate", trust="blindly")


def test_scales_are_of_what_the_data_declare_alone() -> None:
    likelihood = LikelihoodParameters(position_scale=2.0, body_scale=3.0)
    given = np.array([0.2, np.nan])
    np.testing.assert_allclose(likelihood.position_stds(given, 2), [0.4, 0.1])
    assert replace(likelihood, position_std=1).position_stds(None, 2).dtype == float
    np.testing.assert_allclose(likelihood.kappas("body", np.array([9.0, np.nan]), 2), [1.0, 4.0])
    np.testing.assert_allclose(likelihood.kappas("head", None, 2), [4.0, 4.0])


def test_smooth_tells_of_a_wrong_sigma_and_corrects_it_where_it_is_told_to(tmp_path: Path) -> None:
    people = gt.simulate("position", n_tracks=8, n_steps=60, fps=10.0, rng=np.random.default_rng(0))
    overconfident, stds = tmp_path / "people.parquet", {}
    declared = people.map(lambda track: replace(track, position_std=np.full(len(track), 0.1 / 3.0)))
    gt.write(declared, overconfident)
    for trust in (None, "check", "declared", "learn"):
        output = tmp_path / f"{trust}.csv"
        given = [] if trust is None else ["--trust", trust]
        done = ran("smooth", overconfident, "-o", output, "--model", "position", *given, program="graphtrack")
        said = [line for line in done.stderr.splitlines() if "position: the noise is" in line]
        assert len(said) == (trust != "declared")
        assert all(("corrected" in line) == (trust == "learn") and "pos_std" in line for line in said)
        std = gt.read(output).tracks[0].std("x")
        stds[trust] = float(np.median(std))
    assert stds[None] == stds["check"] == stds["declared"] < 0.6 * stds["learn"]
    files = (overconfident, "-o", tmp_path / "out.parquet")
    done = run("smooth", *files, "--stream", "--trust", "learn", program="graphtrack")
    assert done.returncode == 2 and "--trust" in done.stderr


@pytest.mark.slow
def test_many_outliers_are_named_where_they_are_not_learned_and_corrected_on_request() -> None:
    rng = np.random.default_rng(0)

    def turned(track: gt.Track) -> gt.Track:
        wrong = rng.random(len(track)) < 0.3
        return replace(track, head=wrap(np.where(wrong, track.head + np.pi, track.head)))

    tracks = people(3).map(turned)
    (line,) = declared_noise(tracks, MODEL).lines()
    assert line.startswith("head: 30 % of the angles are outliers (likelihood.head_outliers)")
    assert declared_noise(tracks, MODEL, outliers=False).lines() == []
    _, model = declared_noise(tracks, MODEL).corrected(tracks, MODEL)
    assert model.parameters.likelihood.outliers("head") == 0.3
    assert declared_noise(tracks, model).lines() == []


@pytest.mark.parametrize(
    ("degrees", "assumed", "noted"), [(2.0, (), True), (9.0, (), False), (2.0, ("head_std",), False)]
)
def test_noise_of_angles_that_few_detectors_reach_is_named(
    degrees: float, assumed: tuple[str, ...], noted: bool
) -> None:
    noise = {"position_std": 0.1, "head_std": np.radians(degrees)}
    one = PersonalConstants(0.1, 0.1, 0.1, {"free": 1.0}, noise, assumed)
    assert (
        any("noise of head below 5°" in line and "head_kappa" in line for line in one.noise_lines()) == noted
    )
