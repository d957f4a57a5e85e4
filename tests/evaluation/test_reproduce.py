import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from scipy import stats
from typer.testing import CliRunner
from walks import walk, without

from graphtrack.baselines.intentional import IntentionalParameters, intentional_filter
from graphtrack.baselines.kalman import filter_states, kalman_filter
from graphtrack.cli.commands import program
from graphtrack.errors import InputError
from graphtrack.evaluation.metrics import bootstrap, deviation, mean_difference, reduction
from graphtrack.experiments import Settings, Table, all_experiments
from graphtrack.experiments.baxter_occlusion import ONLINE, Case, WindowErrors, error_of, trajectories
from graphtrack.experiments.chen_joint import PAPER, concentration_of
from graphtrack.experiments.harness import (
    Panel,
    evenly,
    fit,
    from_the_past,
    one_step_ahead,
    page,
    squared_error,
    thinned,
    with_coupling,
    with_density,
)
from graphtrack.model import Model, MotionParameters, Parameters
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour
from graphtrack.tracking import track_online
from graphtrack.tracks.track import TrackSet


@pytest.mark.parametrize("behaviour", range(7))
@pytest.mark.parametrize("rate", [1.0, 0.8, 0.6])
def test_the_consistent_tracker_beats_the_kalman_filter_on_every_behaviour(
    behaviour: int, rate: float
) -> None:
    # A pedestrian's pace, Baxter et al.'s noise and its parameters for both.
    corpus = simulate_behaviour(
        behaviour, CorpusParameters(tracks=60), rng=np.random.default_rng(behaviour)
    ).detected(rate, np.random.default_rng(100 + behaviour))
    plain = intentional_filter(corpus.position, None)
    steered = intentional_filter(corpus.position, corpus.head, IntentionalParameters())
    gain = squared_error(plain.predicted_mean[..., :2], corpus.truth) / squared_error(
        steered.predicted_mean[..., :2], corpus.truth
    )
    likelihood = np.nansum(plain.log_likelihood, axis=1) / np.nansum(steered.log_likelihood, axis=1)
    assert np.median(gain) > 1.5
    assert np.median(likelihood) > 1.15
    assert np.mean(gain > 1.0) > 0.9


def test_the_bootstrap_covers_what_it_should() -> None:
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(200):
        before = rng.normal(10.0, 4.0, 30)
        after = before - 1.0 + rng.normal(0.0, 1.0, 30)
        found = bootstrap(mean_difference, after, before, rng=rng)
        inside += found.low <= -1.0 <= found.high
        # Paired: people differ by 4, but the difference is known to about 1/√30.
        assert found.high - found.low < 1.2
    assert 0.88 < inside / 200 <= 1.0


def test_units_are_drawn_with_all_of_their_numbers() -> None:
    rng = np.random.default_rng(4)
    of_unit = rng.normal(0.0, 1.0, 12)
    values = np.repeat(of_unit, 9) + rng.normal(0.0, 0.05, 108)
    zeros = np.zeros(108)

    def width(units: list[str] | None) -> float:
        found = bootstrap(mean_difference, values, zeros, rng=np.random.default_rng(5), units=units)
        assert found.value == pytest.approx(values.mean())
        return found.high - found.low

    by_unit = width([str(k // 9) for k in range(108)])
    # As wide as the standard error of twelve units; nine numbers of each tell nothing new.
    assert by_unit == pytest.approx(2.0 * 1.96 * of_unit.std() / np.sqrt(12.0), rel=0.15)
    assert width(None) < 0.5 * by_unit
    assert width([str(k) for k in range(108)]) == pytest.approx(width(None), rel=0.1)
    few = bootstrap(mean_difference, values, zeros, rng=rng, units=["one"] * 54 + ["other"] * 54)
    assert np.isnan(few.low) and np.isfinite(few.value)


def test_the_bootstrap_of_few() -> None:
    rng = np.random.default_rng(0)
    none = bootstrap(mean_difference, np.array([np.nan]), np.array([1.0]), rng=rng)
    assert math.isnan(none.value)
    one = bootstrap(mean_difference, np.array([3.0, np.nan]), np.array([1.0, 1.0]), rng=rng)
    assert one.value == 2.0
    assert math.isnan(one.low)
    for count in (4, 5):
        few = bootstrap(mean_difference, np.arange(count), np.zeros(count), rng=rng)
        assert few.value == (count - 1) / 2.0 and math.isnan(few.low) == (count < 5)
    assert math.isnan(deviation(np.array([3.0])))
    assert deviation(np.array([1.0, 3.0])) == 1.0
    assert reduction(np.array([1.0, 1.0]), np.array([4.0, 4.0])) == pytest.approx(0.75)


def test_fitting_finds_the_least() -> None:
    found = fit(
        lambda a, b: (math.log(a / 0.02)) ** 2 + (math.log(b / 7.0)) ** 2, [1.0, 1.0], evaluations=120
    )
    np.testing.assert_allclose(found, [0.02, 7.0], rtol=0.1)
    assert 30.0 < fit(lambda a: -a, [2.0], evaluations=60)[0] <= 200.0
    assert fit(lambda a: math.nan if a > 2.0 else -a, [1.0], evaluations=40)[0] == pytest.approx(2.0, rel=0.1)


def test_coupling_and_density_change_only_what_they_name() -> None:
    base = Parameters()
    same = with_coupling(with_coupling(base, 4.0), 0.25)
    assert same.coupling.head_body_kappa == pytest.approx(base.coupling.head_body_kappa)
    assert same.orientation.body_diffusion == pytest.approx(base.orientation.body_diffusion)
    assert with_density(base, 0.3) == replace(base, motion=replace(base.motion, acceleration_density=0.3))


def test_one_step_ahead_is_the_kalman_filters_own_prediction() -> None:
    track, parameters = without(walk(25, uneven=True), "position", [7, 8]), Parameters()
    _, expected = filter_states(track, parameters)
    predicted, logs = one_step_ahead(kalman_filter(track, parameters), track, Model("position", parameters))
    np.testing.assert_allclose(predicted, expected.mean[:, :2], atol=1e-9)
    assert np.isnan(predicted[0]).all()
    assert np.isnan(logs[[0, 7, 8]]).all()
    assert np.isfinite(np.delete(logs, [0, 7, 8])).all()


def test_one_step_ahead_is_steered_by_the_estimated_head() -> None:
    motion = MotionParameters(acceleration_density=0.5, head_rate=1.5)
    model, rng, dt = Model("joint-intentional", Parameters(motion=motion)), np.random.default_rng(1), 0.4
    spread = rng.normal(0.0, 0.1, (6, 6))
    spread = spread @ spread.T
    observed = replace(walk(2, dt=dt), position_std=np.full(2, 0.2))
    estimate = replace(
        observed,
        velocity=np.tile([0.8, -0.5], (2, 1)),
        head=np.full(2, 0.9),
        covariance=np.stack([spread, spread]),
    )

    def ahead(state: np.ndarray) -> np.ndarray:
        place, velocity, n = state[:2].copy(), state[2:4].copy(), 4000
        aim = np.linalg.norm(velocity) * np.array([np.cos(state[5]), np.sin(state[5])])
        for _ in range(n):
            place, velocity = place + velocity * dt / n, velocity + 1.5 * (aim - velocity) * dt / n
        return place

    origin = np.array([*estimate.position[0], 0.8, -0.5, 0.0, 0.9])
    slope = np.stack([(ahead(origin + d) - ahead(origin - d)) / 2e-4 for d in 1e-4 * np.eye(6)], axis=1)
    # ∫ 0.5·((1 − e^−λs)/λ)² ds: the contribution of the velocity noise to each axis of the position.
    s = np.linspace(0.0, dt, 2001)
    noise = np.trapezoid(0.5 * ((1.0 - np.exp(-1.5 * s)) / 1.5) ** 2, s) + 0.2**2
    predicted, logs = one_step_ahead(estimate, observed, model)
    np.testing.assert_allclose(predicted[1], ahead(origin), atol=0.01)
    law = stats.multivariate_normal(ahead(origin), slope @ spread @ slope.T + noise * np.eye(2))
    assert logs[1] == pytest.approx(law.logpdf(observed.position[1]), abs=0.02)


def test_estimates_from_the_past_are_those_of_the_online_tracker() -> None:
    track = without(walk(25), "position", [9, 10, 11])
    frames = np.array([5, 10, 24])
    found = from_the_past(track, Model("joint"), frames)
    online = track_online(track, "joint", lag=60.0, constants="default")
    np.testing.assert_allclose(found.position[frames], online.position[frames], atol=0.01)
    assert found.head is not None and online.head is not None
    np.testing.assert_allclose(found.head[frames], online.head[frames], atol=0.01)
    assert np.isnan(found.position[6]).all()
    assert np.isnan(found.head[6])
    linear = from_the_past(track, Model("position"), frames)
    np.testing.assert_allclose(linear.position[frames], kalman_filter(track).position[frames], atol=1e-6)


def test_the_error_counts_in_the_window_and_nobody_sees_the_truth() -> None:
    track, window = walk(20), np.zeros(20, dtype=bool)
    window[5:9] = True

    def estimator(seen: object) -> np.ndarray:
        assert seen.true_position is None and seen.true_head is None  # type: ignore[attr-defined]
        off = np.zeros((20, 2))
        off[window, 0], off[~window] = 0.3, 99.0
        return track.true_position + off  # type: ignore[operator]

    assert error_of(estimator, [(track, window)])[0] == pytest.approx(0.09)


@pytest.mark.parametrize("degrees", [41.7, 30.3, 5.0])
def test_noise_has_the_mean_error_that_was_asked_for(degrees: float) -> None:
    kappa = concentration_of(np.radians(degrees))
    drawn = np.abs(np.random.default_rng(0).vonmises(0.0, kappa, 200_000))
    assert np.degrees(drawn.mean()) == pytest.approx(degrees, rel=0.01)
    assert PAPER["observation"] == (41.7, 30.3)


def test_thinning_and_choosing() -> None:
    track = walk(31)
    assert len(thinned(track)) == 11
    np.testing.assert_array_equal(thinned(track).t, track.t[::3])
    many = TrackSet(tuple(walk(10 + i, track_id=i) for i in range(30)))
    assert [t.track_id for t in evenly(many, 4)] == [0, 10, 19, 29]
    assert len(evenly(many, 100)) == 30
    assert len(evenly(many, 5, least_seconds=100.0)) == 0


def test_the_sharpest_turns_stand_beside_the_papers_trajectories() -> None:
    judged = []
    for k, degrees in enumerate([10.0, 80.0, 40.0, 5.0, 60.0, 20.0, 30.0, 70.0]):
        track, window = walk(41, dt=0.1, track_id=k), np.zeros(41, dtype=bool)
        course = np.where(np.arange(41) < 20, 0.0, np.radians(degrees))
        path = np.cumsum(0.1 * np.column_stack([np.cos(course), np.sin(course)]), axis=0)
        window[15:25] = True
        judged.append((replace(track, position=path, true_position=path, label=f"{degrees:g}"), window))
    errors = {method: np.full(8, 1.0) for method in ONLINE} | {"kf": np.full(8, 4.0)}
    errors |= {"kf fitted": np.full(8, 2.0), "printed": np.arange(1.0, 9.0)}
    found = WindowErrors(Case("turns", [([], judged)], "kf fitted"), "visible", errors)
    rows = trajectories([found]).records()
    assert [row["ours"] for row in rows[:7]] == ["80", "70", "60", "40", "30", "20", "10"]
    assert [row["paper: reduction (%)"] for row in rows[:7]] == [64.0, 75.5, 84.5, 12.9, 73.2, 62.0, 68.3]
    assert rows[0]["turn (°)"] == pytest.approx(80.0, abs=1.0)
    # Baxter et al.'s trackers against its Kalman filter, the others against the case's.
    assert rows[0]["printed"] == pytest.approx(50.0) and rows[1]["printed"] == pytest.approx(-100.0)
    assert rows[0]["intentional"] == pytest.approx(50.0)
    mean, share = rows[7:]
    assert mean["consistent"] == pytest.approx(75.0)
    assert mean["paper: reduction (%)"] == pytest.approx(62.9, abs=0.05)
    assert share["printed"] == pytest.approx(100.0 * 3 / 8)


def test_a_table_is_rectangular_and_ready_for_json() -> None:
    table = Table.of("t", [{"a": np.float64(1.5), "b": float("nan")}, {"a": np.int64(2), "b": "x"}])
    back = json.loads(json.dumps(table.to_dict(), allow_nan=False))
    assert back == {"title": "t", "columns": ["a", "b"], "rows": [[1.5, None], [2, "x"]]}
    assert table.records()[1] == {"a": 2, "b": "x"}
    with pytest.raises(InputError, match="a row of 1"):
        Table("t", ("a", "b"), ((1,),))


@pytest.mark.parametrize("count", [1, 4])
def test_titles_and_dots_of_a_page_are_within_their_panels(count: int) -> None:
    names = [f"a category with a long name {k}" for k in range(6)]
    rows = [{"name": name, "%": 98.0 if k else 65.0, "of": "x"} for k, name in enumerate(names)]
    panel = Panel(
        "A long title of a panel, which says what is shown of which sequences (%)", rows, "name", "%", "of"
    )
    figure = page([panel] * count)
    figure.draw_without_rendering()
    shown = figure.findobj(lambda one: isinstance(one, Text) and one.get_text().startswith("A long title"))
    titles = [one.get_window_extent() for one in shown]
    assert len(titles) == count
    for k, title in enumerate(titles):
        assert figure.bbox.x0 <= title.x0 and title.x1 <= figure.bbox.x1
        assert not any(title.overlaps(other) for other in titles[:k])
    for axes in figure.axes:
        assert axes.get_ylim() == pytest.approx((0.0, 1.05 * 98.0))


@pytest.mark.slow
def test_statistics_on_the_command_line(cwd: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GRAPHTRACK_DATA", raising=False)
    tables = []
    for name in ("first", "again"):
        arguments = ["reproduce", "baxter-statistics", "--quick", "--seed", "3"]
        arguments += ["--out", name, "--json", f"{name}/tables.json"]
        result = CliRunner().invoke(program(), arguments)
        assert result.exit_code == 0, result.output
        assert (cwd / name / "baxter-statistics.png").stat().st_size > 10_000
        tables.append(json.loads((cwd / name / "tables.json").read_text(encoding="utf-8")))
    assert tables[0] == tables[1]
    detail, beside = tables[0]
    assert detail["columns"][0] == "data"
    assert all(len(row) == len(detail["columns"]) for row in detail["rows"])
    assert beside["title"].startswith("Paper / ours")
    row = dict(zip(detail["columns"], detail["rows"][0], strict=True))
    # Baxter et al.'s noise of the head: μ = 4°, σ = 20°; the head is ahead of the smoothed travel, so a
    # little more.
    assert row["mean (°)"] == pytest.approx(-4.0, abs=1.0)
    assert 20.0 < row["std (°)"] < 28.0


@pytest.mark.slow
@pytest.mark.parametrize("name", list(all_experiments()))
def test_every_experiment_runs(name: str, data_dir: Path) -> None:
    experiment, done, expected = all_experiments()[name], [0], [0]
    found = experiment.run(Settings(quick=True, seed=1, data=data_dir), done.append, expected.append)
    assert found.name == name
    if not experiment.source.startswith("no paper's"):
        assert found.tables[-1].title.startswith("Paper / ours")
    assert all(table.rows for table in found.tables)
    json.dumps([table.to_dict() for table in found.tables], allow_nan=False)
    # A search may end before its last evaluation.
    assert 0.5 * sum(expected) < sum(done) <= 1.5 * sum(expected)
