"""Forecasts: no leak of the future, calibrated circles, and rotation equivariance."""

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.evaluation.forecasts import judge_forecasts
from graphtrack.forecasting.forecaster import Forecaster, mean_turn
from graphtrack.forecasting.motion import BELIEFS, ForecastParameters, MotionFilters
from graphtrack.forecasting.paths import kernel_sums
from graphtrack.forecasting.recorded import COLUMNS, is_forecast, read_forecasts
from graphtrack.forecasting.spread import log_density, offsets, radius

STEP = 0.4


def track(track_id, position, first=0, head=None):
    position = np.asarray(position, float)
    frame = first + np.arange(len(position))
    return gt.Track(track_id, frame, STEP * frame, position, head=head)


def wanderers(count, rng, steps=40, apart=200.0):
    """People whose velocity is a random walk (0.1 m/s a step), too far apart to meet."""
    people = []
    for k in range(count):
        speeds = rng.normal(0, 0.8, 2) + np.cumsum(rng.normal(0, 0.1, (steps, 2)), axis=0)
        where = rng.uniform(-apart, apart, 2) + np.cumsum(STEP * speeds, axis=0)
        people.append(track(k, where, first=int(rng.integers(0, 60))))
    return gt.TrackSet(tuple(people))


def test_nothing_of_the_future_leaks():
    scene = wanderers(12, np.random.default_rng(1), apart=5.0)
    whole = gt.forecast(scene, history=1.2).to_table()
    end = 20.0
    seen = scene.with_tracks(one[one.t <= end] for one in scene if one.t[0] <= end)
    part = gt.forecast(seen, history=1.2).to_table()
    whole = whole[whole["t"] <= end + 1e-9]
    assert len(part) == len(whole) > 1000
    for name in part:
        np.testing.assert_array_equal(part[name], whole[name])


@pytest.mark.slow
def test_circles_hold_what_they_say_of_people_who_wander():
    scene = wanderers(120, np.random.default_rng(4))
    table = gt.forecast(scene, history=3.2)
    found = judge_forecasts(table.columns, scene)
    assert found.forecasts > 500
    own = found.methods["forecast"]
    assert 0.45 <= own.inside_50 <= 0.55
    assert 0.86 <= own.inside_90 <= 0.94
    assert own.ade <= 1.1 * found.methods["constant velocity"].ade


@pytest.mark.parametrize("level", [0.5, 0.9])
@pytest.mark.parametrize("ratio", [0.2, 1.0])
def test_a_circle_has_its_share_of_the_samples(level, ratio):
    parameters = ForecastParameters()
    along, across = np.full((40_000, 1), 2.0), np.full((40_000, 1), 2.0 * ratio)
    direction = np.full(40_000, np.exp(0.5j))
    drawn = offsets(1, along, across, direction, parameters, np.random.default_rng(5))
    size = radius(level, along[:1], across[:1], parameters)
    assert np.mean(np.abs(drawn[:, 0]) <= size) == pytest.approx(level, abs=0.01)


def test_the_density_of_the_mixture_holds_one_within_and_its_share_in_a_circle():
    parameters = ForecastParameters()
    along, across = np.meshgrid(*[np.linspace(-30.0, 30.0, 1201)] * 2)
    one = np.ones_like(along)
    mass = np.exp(log_density(along, across, 1.5 * one, one, parameters)) * 0.05**2
    assert mass.sum() == pytest.approx(1.0, abs=1e-3)
    size = radius(0.9, np.array([1.5]), np.array([1.0]), parameters)[0]
    assert mass[np.hypot(along, across) <= size].sum() == pytest.approx(0.9, abs=5e-3)


def test_samples_are_paths_about_the_mean():
    forecaster = Forecaster()
    for k in range(10):
        forecaster.update(STEP * k, [1], [(0.5 * k, 0.2 * k)])
    told = forecaster.forecast([0.4, 4.8], samples=4000, random=np.random.default_rng(6))
    paths, spread = told.samples[0], told.covariance[0]
    np.testing.assert_allclose(paths.mean(axis=0), told.position[0], atol=0.1)
    np.testing.assert_allclose(np.cov(paths[:, 1].T), spread[1], rtol=0.3, atol=0.05)
    assert np.corrcoef(paths[:, 0, 0], paths[:, 1, 0])[0, 1] > 0.9


@pytest.mark.slow
def test_who_goes_straight_is_expected_straight_on_however_noisy_the_positions_are():
    rng = np.random.default_rng(7)
    errors, last_step = [], []
    for _ in range(30):
        where = np.stack([0.5 * np.arange(12), np.zeros(12)], axis=1)
        seen = where + rng.normal(0, 0.1, where.shape)
        forecaster = Forecaster()
        for k in range(12):
            forecaster.update(STEP * k, [1], seen[k : k + 1])
        errors.append(np.linalg.norm(forecaster.forecast([4.8]).position[0, 0] - (11.5, 0.0)))
        last_step.append(np.linalg.norm(seen[-1] + 12 * (seen[-1] - seen[-2]) - (11.5, 0.0)))
    assert np.mean(errors) < 0.5 * np.mean(last_step)


def test_motion_has_the_moments_of_the_mixture_of_kalman_filters():
    rng, dt, noise = np.random.default_rng(3), 0.4, 0.1
    seen = np.cumsum(rng.normal(0.4, 0.15, 12)) + 1j * rng.normal(0.0, 0.1, 12)
    filters, at = MotionFilters(1), np.array([0])
    filters.begin(at, seen[:1], np.array([noise]))
    for position in seen[1:]:
        filters.update(at, np.array([dt]), np.array([position]), np.array([noise]))
    logs, states, covariances = [], [], []
    step, observed = np.array([[1.0, dt], [0.0, 1.0]]), np.array([1.0, 0.0])
    for std, density in BELIEFS:
        variance = std**2 + noise**2
        state, covariance, log = np.array([seen[0], 0.0]), np.diag([variance, 1.0]), 0.0
        process = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        for position in seen[1:]:
            state, covariance = step @ state, step @ covariance @ step.T + process
            error, expected = position - state[0], covariance[0, 0] + variance
            # The evidence of a person is forgotten within 10 seconds.
            log = log * np.exp(-dt / 10.0) - 0.5 * abs(error) ** 2 / expected - np.log(expected)
            gain = covariance @ observed / expected
            state, covariance = state + gain * error, covariance - np.outer(gain, gain) * expected
        logs, states = [*logs, log], [*states, step @ state]
        covariances.append(step @ covariance @ step.T + process)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    assert weights.max() < 0.9
    mean = weights @ np.array(states)
    off = np.array(states) - mean
    # On each axis half of the spread between the filters, whose states are complex.
    between = np.einsum("k,ki,kj->ij", weights, off.conj(), off).real / 2
    total = np.tensordot(weights, covariances, 1) + between
    found = filters.motion(at, np.array([dt]))
    np.testing.assert_allclose([found.position[0], found.velocity[0]], mean, rtol=1e-9)
    np.testing.assert_allclose(found.variance[0].tolist(), [total[0, 0], total[0, 1], total[1, 1]], rtol=1e-9)


def test_the_mean_turn_is_the_mean_of_the_turns_so_far():
    parameters = ForecastParameters(head_seconds=0.7)
    for end in (0.1, 1.0, 10.0):
        turns = 1.0 - np.exp(-np.linspace(0.0, end, 100_001) / 0.7)
        assert mean_turn(np.array([end]), parameters) == pytest.approx(turns.mean(), rel=1e-3)


def test_the_head_leads_to_its_side():
    def end(head):
        forecaster = Forecaster()
        for k in range(20):
            forecaster.update(0.1 * k, [1], [(0.12 * k, 0.0)], head=np.array([head]))
        return forecaster.forecast([1.0]).position[0, 0]

    straight = end(np.nan)
    assert straight[1] == pytest.approx(0.0, abs=1e-9)
    assert end(0.5)[1] > 0.1 and end(-0.5)[1] < -0.1
    np.testing.assert_allclose(end(0.0), straight)
    assert abs(end(3.0)[1]) < 0.1  # a person who walks backwards does not turn round


def test_people_are_expected_to_turn_where_others_turned():
    k = 0.5 * np.arange(40)
    corner = np.stack([np.minimum(k, 9.5), np.maximum(k - 9.5, 0.0)], 1)
    people = [track(k, corner, first=15 * k) for k in range(10)]
    table = gt.forecast(gt.TrackSet(tuple(people))).to_table()
    at_corner = table[
        (table["ahead"] == table["ahead"].max()) & (table["frame"] == 15 * table["track_id"] + 18)
    ]
    truth = corner[30]
    error = np.hypot(at_corner["x"] - truth[0], at_corner["y"] - truth[1]).to_numpy()
    assert error[0] > 5.0
    assert error[-1] < 0.5 * error[0]


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"horizon": 0.0}, "horizon = 0"),
        ({"horizon": np.nan}, "horizon = nan"),
        ({"horizon": 86400.0}, "60 at most"),
        ({"horizon": 0.4, "step": 0.8}, "no more than the horizon"),
        ({"step": 0.0}, "step = 0"),
        ({"horizon": 60.0, "step": 0.001}, "1000 at most"),
        ({"every": 0.0}, "every"),
        ({"history": np.nan}, "history = nan"),
        ({"history": 86400.0}, "86400 s, the history"),
        ({"samples": 5000}, "samples"),
        *(({"samples": wrong}, "samples") for wrong in (1.5, "x", True, -1)),
        *(({"seed": wrong}, "seed") for wrong in (-1, "x", 0.5)),
        *(({name: wrong}, name) for name in ("step", "horizon") for wrong in ("a", None)),
        ({"history": "a"}, "history"),
        ({"parameters": {}}, "parameters"),
    ],
)
def test_settings_that_make_no_sense_are_told(wrong, told):
    with pytest.raises(InputError, match=told):
        gt.forecast(wanderers(2, np.random.default_rng(10)), **wrong)


def test_who_was_not_seen_for_long_enough_is_left_out_and_counted():
    short, long = track(1, [(0, 0), (1, 1)]), track(2, np.stack([np.arange(20), np.arange(20)], 1))
    found = gt.forecast(gt.TrackSet((short, long)), history=3.2)
    assert found.too_short == (1,) and found.people == 1
    # Eight frames are 3.2 s: the first forecast is made in the eighth.
    assert found.columns["frame"].min() == 7
    assert gt.forecast(long).columns["frame"].min() == 1


def test_frames_that_cannot_be_used_change_nothing():
    forecaster = Forecaster()
    forecaster.update(0.0, [1], [(0, 0)])
    for t, ids, position in ((0.0, [1], [(0, 0)]), (1.0, [1, 1], [(0, 0)] * 2), (1.0, [1], [(np.nan, 0)])):
        with pytest.raises(InputError):
            forecaster.update(t, ids, position)
    forecaster.update(0.4, [1], [(0.4, 0)])
    assert forecaster.people().tolist() == [1]


def test_somebody_who_jumps_does_not_fly_off():
    forecaster = Forecaster()
    for k in range(20):
        forecaster.update(0.1 * k, [1], [(0.1 * k, 0.0)])
    forecaster.update(2.0, [1], [(30.0, 0.0)])
    assert np.linalg.norm(forecaster.forecast([1.0]).position[0, 0] - (30.0, 0.0)) < 5.0


@pytest.mark.parametrize("ending", ["csv", "csv.gz", "parquet", "ndjson"])
def test_tables_come_back(ending, tmp_path):
    path = tmp_path / f"forecast.{ending}"
    found = gt.forecast(wanderers(3, np.random.default_rng(13)), samples=2)
    found.write(path)
    assert is_forecast(path)
    read = read_forecasts(path)
    assert set(read) == set(found.columns)
    for name, values in found.columns.items():
        np.testing.assert_allclose(read[name], values)


def test_what_is_no_table_of_forecasts_is_told(tmp_path):
    path = tmp_path / "forecast.csv"
    found = gt.forecast(wanderers(3, np.random.default_rng(14)))
    found.write(path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[1].replace(lines[1].split(",")[4], "far")]))
    with pytest.raises(InputError, match="line 2, column x"):
        read_forecasts(path)
    path.write_text("track_id,frame,x,y\n1,0,0,0\n")
    assert not is_forecast(path)


def test_scores_of_forecasts_that_are_exactly_as_sure_as_they_should_be():
    rng = np.random.default_rng(15)
    people, ahead = 400, np.array([0.4, 0.8])
    tracks, rows = [], []
    for k in range(people):
        where = rng.uniform(-9, 9, 2) + np.cumsum(rng.normal(0, 1, (4, 2)), axis=0)
        tracks.append(track(k, where))
        for i, h in enumerate(ahead):
            mean = where[2 + i] + rng.normal(0, 1, 2)
            r50, r90 = np.sqrt(-2 * np.log([0.5, 0.1]))
            rows.append((k, 1, STEP, h, *mean, 1.0, 1.0, 0.0, r50, r90))
    table = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    found = judge_forecasts(table, gt.TrackSet(tuple(tracks)))
    own = found.methods["forecast"]
    assert own.ade == pytest.approx(np.sqrt(np.pi / 2), rel=0.05)
    assert own.log_likelihood == pytest.approx(-1.0 - np.log(2 * np.pi), abs=0.06)
    assert found.forecasts == people and found.left_out == 0
    for level, held in found.reliability.items():
        assert held == pytest.approx(level, abs=0.05)
    assert own.min_ade < own.ade


def test_misses_and_collisions_are_counted():
    """Two people meet in a forecast, one of them 2.1 m from the truth; a third is alone at another time."""
    ahead, rows = np.array([0.4, 0.8]), []
    still = [track(k, np.tile([4.0 * k, 0.0], (6, 1))) for k in range(3)]
    for k, frame, last in ((0, 1, (2.1, 0.0)), (1, 1, (2.1, 0.1)), (2, 2, (8.0, 0.5))):
        for h, place in zip(ahead, (still[k].position[0], last), strict=True):
            rows.append((k, frame, frame * STEP, h, *place, 1e-3, 1e-3, 0.0, 1.0, 2.0))
    found = judge_forecasts(dict(zip(COLUMNS, np.array(rows).T, strict=True)), gt.TrackSet(tuple(still)))
    assert found.methods["forecast"].miss_rate == pytest.approx(1 / 3)
    assert found.methods["forecast"].collision_rate == 1.0
    assert found.methods["constant velocity"].collision_rate == 0.0
    assert found.methods["Kalman filter"].miss_rate == 0.0


def test_forecasts_whose_outcome_is_not_known_are_left_out():
    scene = wanderers(3, np.random.default_rng(16), steps=15)
    found = judge_forecasts(gt.forecast(scene).columns, scene)
    # 15 frames: forecasts in frames 1 and 2 alone have all twelve outcomes.
    assert found.forecasts == 6 and found.left_out == 3 * 14 - 6
    with pytest.raises(InputError, match="outcome"):
        judge_forecasts(gt.forecast(scene).columns, wanderers(3, np.random.default_rng(17), steps=5))


def test_companions_keep_together():
    def speed(companion):
        forecaster = Forecaster()
        for k in range(10):
            where = [(0.4 * k, 0.0), (0.4 * k, companion)]
            if k == 9:  # a step that one alone of them makes
                where[0] = (0.4 * k, 0.05)
            forecaster.update(STEP * k, [1, 2], where)
        position = forecaster.forecast([4.8]).position[:, 0]
        return abs(position[0, 1] - 0.05)

    assert speed(0.8) < 0.8 * speed(50.0)


@pytest.mark.slow
def test_sums_over_what_is_near_are_those_of_all_weights():
    rng = np.random.default_rng(5)
    here, there = rng.normal(0, 2, (4, 30)).astype(np.float32), rng.normal(0, 2, (4, 200)).astype(np.float32)
    values = rng.normal(0, 1, (200, 7)).astype(np.float32)
    count = 150
    square = ((here[:, :, None] - there[:, None, :count]) ** 2).sum(axis=0)
    expected = np.exp(-0.5 * square) @ values[:count]
    found = kernel_sums(here, there, values, count)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_array_equal(kernel_sums(here[:, 3:4].copy(), there, values, count)[0], found[3])


UPDATES = {
    "ids": [([1.7],), (["a"],), ([True],), ([2**63],), ([None],), ([[1]],), ([2**53],)],
    "position": [([1], [(np.nan, 0.0)]), ([1], [(1e300, 0.0)]), ([1], [(0.0, 0.0, 0.0)]), ([1, 2],)],
    "std": [([1], [(0.0, 0.0)], wrong) for wrong in ([1.0, 2.0], [-1.0], ["x"], [np.inf])],
    "head": [([1], [(0.0, 0.0)], None, wrong) for wrong in ([1.0, 2.0], [np.inf], ["x"])],
}


@pytest.mark.parametrize(
    ("named", "given"), [(name, given) for name, some in UPDATES.items() for given in some], ids=str
)
def test_an_update_that_cannot_be_used_is_refused_and_changes_nothing(named, given):
    forecaster = Forecaster()
    for k in range(3):
        forecaster.update(0.4 * k, [1], [(0.5 * k, 0.0)])
    before = forecaster.forecast([0.4]).position
    ids, position, *rest = (*given, [(0.0, 0.0)])[: max(len(given), 2)]
    with pytest.raises(InputError, match=named):
        forecaster.update(1.2, ids, position, *rest)
    np.testing.assert_array_equal(forecaster.forecast([0.4]).position, before)
    for t in (np.nan, None, "2", 1e300):
        with pytest.raises(InputError, match="t = "):
            forecaster.update(t, [1], [(0.0, 0.0)])


@pytest.mark.parametrize("ahead", [np.nan, 5.0, None, [np.nan], [-1.0], [0.0], ["x"], [1e300], [[1.0, 2.0]]])
def test_times_ahead_that_are_no_future_are_refused(ahead):
    forecaster = Forecaster()
    for k in range(3):
        forecaster.update(0.4 * k, [1], [(0.5 * k, 0.0)])
    with pytest.raises(InputError, match="ahead"):
        forecaster.forecast(ahead)


@pytest.mark.parametrize("apart", [1e-9, 1e-6, 1e-5, 1e-4])
def test_rows_of_two_sensors_at_one_time_are_merged(apart):
    rng, n = np.random.default_rng(0), 30
    t = (STEP * np.arange(n)[:, None] + np.array([0.0, apart])).ravel()
    position = np.column_stack([1.2 * t, np.zeros(2 * n)]) + rng.normal(0.0, 0.1, (2 * n, 2))
    std = np.full(2 * n, 0.1)
    both = gt.Track(1, np.arange(2 * n), t, position, position_std=std)
    mean = position.reshape(n, 2, 2).mean(axis=1)
    one = gt.Track(1, 2 * np.arange(n), t[::2], mean, position_std=std[::2] / 2**0.5)
    found, expected = gt.forecast(both).to_table(), gt.forecast(one).to_table()
    np.testing.assert_allclose(found.to_numpy(), expected.to_numpy(), rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_people_who_wait_are_not_on_their_way_where_others_start():
    """Each waits for twenty seconds and goes; on average they would be on their way."""
    forecaster, rng = gt.Forecaster(), np.random.default_rng(0)
    off, started = [], []
    for k in range(700):
        t = 0.4 * k
        ids = [p for p in range(60) if 4.0 * p <= t < 4.0 * p + 30.0]
        gone = np.array([max(t - 4.0 * p - 20.0, 0.0) for p in ids])
        place = np.column_stack([1.3 * gone, np.zeros(len(ids))]) + rng.normal(0.0, 0.01, (len(ids), 2))
        forecaster.update(t, ids, place)
        if t > 120.0 and k % 5 == 0:
            found = forecaster.forecast([4.8])
            for one, position in zip(found.track_id.tolist(), found.position[:, 0], strict=True):
                waits = t - 4.0 * one
                if 3.0 < waits < 15.0:
                    off.append(np.hypot(*position))
                elif 23.0 < waits < 25.0:
                    started.append(np.hypot(*(position - (1.3 * (waits + 4.8 - 20.0), 0.0))))
    assert np.mean(off) < 0.1 and np.mean(started) < 0.5
