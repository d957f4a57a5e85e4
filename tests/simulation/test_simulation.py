"""Simulated tracks and courses of angles have the statistics of the model they are sampled from."""

import numpy as np
import pytest
from scipy import stats
from selection import others_slow

from graphtrack import InputError
from graphtrack.constant_velocity import process_noise, transition_matrix
from graphtrack.geometry.angles import difference, direction
from graphtrack.model import Model, MotionParameters, Parameters
from graphtrack.simulation.motion import sample_course, sample_positions, sample_velocity
from graphtrack.simulation.sampling import simulate
from graphtrack.simulation.scenario import party, scenario


def chi2_band(dof: float) -> tuple[float, float]:
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], dof)
    return float(low), float(high)


def test_motion_increments_have_the_covariance_of_the_model_at_uneven_steps() -> None:
    steps = np.array([0.04, 0.1, 0.1, 0.7, 2.0])
    t = np.concatenate([[0.0], np.cumsum(steps)])
    parameters = Parameters(MotionParameters(acceleration_density=0.3, initial_speed_std=0.8))
    rng = np.random.default_rng(1)
    velocity = sample_velocity(t, 4000, parameters.motion, rng)
    position = sample_positions(t, velocity, parameters.motion, rng)
    state = np.concatenate([position, velocity], axis=-1)
    for k, dt in enumerate(steps):
        residual = state[:, k + 1] - state[:, k] @ transition_matrix(dt).T
        noise = process_noise(dt, 0.3)
        squares = np.einsum("ni,ij,nj->", residual, np.linalg.inv(noise), residual)
        low, high = chi2_band(4 * 4000)
        assert low < squares < high
        # The χ² alone does not see a wrong correlation: whitened residuals must be white.
        white = np.linalg.solve(np.linalg.cholesky(noise), residual.T)
        assert np.abs(np.cov(white) - np.eye(4)).max() < 0.1
    low, high = chi2_band(2 * 4000)
    assert low < np.sum(velocity[:, 0] ** 2) / 0.8**2 < high


def test_without_couplings_head_and_body_know_nothing_of_each_other() -> None:
    def alignment(preset: str) -> float:
        tracks = simulate(preset, n_tracks=400, n_steps=3, rng=np.random.default_rng(3))
        return float(np.mean([np.cos(track.true_head[-1] - track.true_body[-1]) for track in tracks]))

    assert abs(alignment("separate")) < 4.0 / np.sqrt(2 * 400)
    assert alignment("joint") > 0.5


def test_presets_have_the_channels_of_their_model() -> None:
    rng = np.random.default_rng(7)
    assert all(track.body is None and track.true_head is None for track in simulate("position", rng=rng))
    model = Model("separate", Parameters(MotionParameters(initial_speed_std=0.01)))
    tracks = simulate(model, n_tracks=3, n_steps=7, fps=4.0, rng=rng)
    assert len(tracks) == 3 and all(len(track) == 7 and track.head is not None for track in tracks)
    np.testing.assert_allclose(tracks.by_id(0).t, np.arange(7) / 4.0)


@pytest.mark.slow
def test_missing_observations_come_at_their_rate_and_never_first() -> None:
    noise = {"position_std": 0.3, "body_kappa": 1.5, "head_kappa": 6.0}
    tracks = simulate("joint", n_tracks=50, rng=np.random.default_rng(8), missing=0.3, **noise)
    assert all((getattr(track, name)[0] == value).all() for track in tracks for name, value in noise.items())
    error = np.concatenate([track.position - track.true_position for track in tracks])
    assert np.nanstd(error) == pytest.approx(0.3, rel=0.03)
    for name in ("position", "body", "head"):
        values = np.stack([getattr(track, name).reshape(len(track), -1)[:, 0] for track in tracks])
        assert np.isfinite(values[:, 0]).all()
        rate, n = np.isnan(values[:, 1:]).mean(), values[:, 1:].size
        assert abs(rate - 0.3) < 4.0 * np.sqrt(0.3 * 0.7 / n)
    for name in ("true_position", "true_body", "true_head"):
        assert all(np.isfinite(getattr(track, name)).all() for track in tracks)


@pytest.mark.parametrize(
    "bad",
    [
        {"n_tracks": 0},
        {"n_steps": 0},
        {"fps": 0.0},
        {"missing": 1.0},
        {"position_std": 0.0},
        {"body_kappa": -1.0},
        {"head_kappa": float("nan")},
        {"pace": 0.0},
        {"glances": -1.0},
        {"model": "nonsense"},
    ],
)
def test_bad_numbers_are_named(bad: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(bad))):
        simulate(**{"model": "joint", "rng": np.random.default_rng(0), **bad})  # type: ignore[arg-type]


def test_scenario_does_what_the_labels_say() -> None:
    tracks = list(scenario(np.random.default_rng(9)))
    left, right, stopping, turning, aside, hidden = tracks
    assert np.linalg.norm(left.true_position - right.true_position, axis=1).min() < 1.0
    # Crossing: each is later where the other was before.
    assert np.sign(left.true_position[0, 0] - right.true_position[0, 0]) == -np.sign(
        left.true_position[-1, 0] - right.true_position[-1, 0]
    )

    speed = np.linalg.norm(np.diff(stopping.true_position, axis=0), axis=1) * 10.0
    stands = np.flatnonzero(speed < 0.02)
    assert len(stands) > 40 and speed[: stands[0]].max() > 1.0 and speed[stands[-1] :].max() > 1.0

    course = np.unwrap(direction(np.diff(turning.true_position, axis=0)))
    assert np.degrees(np.ptp(course[130:170])) > 90.0
    body, head = np.unwrap(turning.true_body), np.unwrap(turning.true_head)
    half = 0.5 * (course[120] + course[180])
    times = [int(np.argmax(angle < half)) for angle in (head, course, body)]
    assert times[0] < times[1] < times[2], "the head leads a turn and the body follows"

    gaze = np.degrees(difference(aside.true_head, aside.true_body))
    assert gaze.max() > 60.0 and gaze.min() < -60.0

    lost = np.isnan(hidden.position[:, 0])
    assert lost.sum() == 20 and np.array_equal(lost, np.isnan(hidden.body))
    assert np.array_equal(lost, np.isnan(hidden.head)), "a hidden person shows no head"
    assert np.isfinite(hidden.true_position).all() and np.isfinite(hidden.true_head).all()
    assert all(np.isfinite(track.position).all() for track in tracks[:-1])


def test_scenario_refuses_what_it_cannot_play() -> None:
    for bad in ({"fps": -1.0}, {"seconds": 3.0}, {"occlusion": 9.0}, {"position_std": -0.1}):
        with pytest.raises(InputError, match=next(iter(bad))):
            scenario(np.random.default_rng(0), **bad)
    assert all(np.isfinite(t.position).all() for t in scenario(np.random.default_rng(0), occlusion=0.0))


def test_those_alone_at_a_party_keep_facing_where_they_came_from_or_stood() -> None:
    turns, facing = [], []
    for seed in range(4):
        made = party(np.random.default_rng(seed), people=12, steps=240, fps=2.0)
        for group, track in zip(made.group, made.tracks, strict=True):
            assert track.body is not None
            step = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
            rests = (step[1:] < 1e-9) & (step[:-1] < 1e-9) & (group[1:-1] < 0) & (group[2:] < 0)
            turns.append(difference(track.body[2:], track.body[1:-1])[rests])
            facing.append(track.body[2:][rests])
    assert np.sqrt(np.mean(np.concatenate(turns) ** 2)) < 0.5
    assert np.abs(np.mean(np.exp(1j * np.concatenate(facing)))) < 0.5, "not all in one direction"


DRAWS = 20_000


def by_quadrature(t: np.ndarray, diffusion: float, pull: np.ndarray, bins: int = 72) -> np.ndarray:
    """Probabilities (bins, bins, bins) of three angles."""
    angle = 2.0 * np.pi * np.arange(bins) / bins
    log = np.zeros((bins,) * 3)
    for k, one in enumerate(pull):
        shape = tuple(bins if axis == k else 1 for axis in range(3))
        log = log + np.reshape((np.conj(one) * np.exp(1j * angle)).real, shape)
    turn = np.cos(angle[:, None] - angle[None]) / diffusion
    log = log + (turn / (t[1] - t[0]))[:, :, None] + (turn / (t[2] - t[1]))[None]
    density = np.exp(log - log.max())
    return density / density.sum()


@pytest.mark.slow
@pytest.mark.parametrize("reach", [1.0, 20.0])
def test_three_angles_have_the_moments_of_the_chain(reach: float) -> None:
    t, diffusion = np.array([0.0, 0.5, 2.0]), 0.4
    pull = reach * np.exp(1j * np.array([0.3, 1.5, -2.0])) * np.array([0.5, 0.0, 1.0])
    probability = by_quadrature(t, diffusion, pull)
    drawn = sample_course(t, diffusion, np.tile(pull, (DRAWS, 1)), np.random.default_rng(1))
    angle = 2.0 * np.pi * np.arange(72) / 72
    for order in (1, 2):
        waves = np.exp(1j * order * angle)
        for k in range(3):
            others = tuple(axis for axis in range(3) if axis != k)
            expected = np.sum(probability.sum(axis=others) * waves)
            assert abs(np.mean(np.exp(1j * order * drawn[:, k])) - expected) < 5.0 / np.sqrt(DRAWS)
        for a, b in ((0, 1), (1, 2), (0, 2)):
            both = probability.sum(axis=3 - a - b)
            expected = np.einsum("ab,a,b->", both, waves, waves.conj())
            found = np.mean(np.exp(1j * order * (drawn[:, a] - drawn[:, b])))
            assert abs(found - expected) < 5.0 / np.sqrt(DRAWS)


@pytest.mark.parametrize(
    ("fps", "diffusion"),
    others_slow(
        [(fps, diffusion) for fps in (10.0, 30.0, 100.0) for diffusion in (0.3, 1e-3)],
        [(10.0, 1e-3), (30.0, 0.3)],
    ),
)
def test_what_pulls_steadily_holds_an_angle_as_far_at_every_rate(fps: float, diffusion: float) -> None:
    # In continuous time the deviation is a ground state's: its variance is ½·√(diffusion/pull a second).
    rate, seconds = 40.0, 20.0
    t = np.arange(int(seconds * fps)) / fps
    drawn = sample_course(t, diffusion, np.full((40, len(t)), rate / fps, complex), np.random.default_rng(2))
    middle = drawn[:, (t > 5.0) & (t < 15.0)]
    expected = 0.5 * np.sqrt(diffusion / rate)
    # 40 courses of 10 s, in which the deviation is forgotten at the rate √(diffusion·pull).
    independent = 40 * 10.0 * np.sqrt(diffusion * rate)
    allowed = 4.0 * np.sqrt(2.0 / independent) + 0.5 * np.sqrt(diffusion * rate) / fps
    assert abs(np.mean(middle**2) / expected - 1.0) < allowed


def test_without_pulls_an_angle_diffuses_from_anywhere() -> None:
    t = np.array([0.0, 0.1, 0.6])
    drawn = sample_course(t, 0.2, np.zeros((DRAWS, 3), complex), np.random.default_rng(3))
    assert abs(np.mean(np.exp(1j * drawn[:, 0]))) < 5.0 / np.sqrt(DRAWS)
    turned = difference(drawn[:, 1:], drawn[:, :-1])
    np.testing.assert_allclose(np.mean(turned**2, axis=0), 0.2 * np.array([0.1, 0.5]), rtol=0.1)
    assert np.all(np.abs(drawn) <= np.pi)


def test_a_narrow_pull_is_resolved() -> None:
    t = np.array([0.0, 1.0])
    pull = np.full((DRAWS // 10, 2), 1e4 * np.exp(0.7j))
    drawn = sample_course(t, 0.5, pull, np.random.default_rng(4))
    np.testing.assert_allclose(np.mean((drawn - 0.7) ** 2, axis=0), 1e-4, rtol=0.1)


def test_many_tracks_are_drawn_in_parts_as_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    from graphtrack.simulation import motion

    t = np.arange(5) * 0.2
    pull = np.full((9, 5), 3.0 + 0.0j)
    monkeypatch.setattr(motion, "_MEMORY", 4 * 5 * 240 * 2)
    parts = sample_course(t, 0.2, pull, np.random.default_rng(5))
    assert parts.shape == (9, 5) and len(np.unique(parts[:, 0])) == 9
