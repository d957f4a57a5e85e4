"""The comparison: the same input for every method, its report, and failures of a method."""

import json
from dataclasses import replace

import numpy as np
import pytest

from graphtrack import InputError, SolveError, Track, TrackSet
from graphtrack.evaluation import Comparison, Method, compare, make_method, registry
from graphtrack.evaluation.compare import scored_frames
from graphtrack.evaluation.metrics import chi_square_band
from graphtrack.model import Model
from graphtrack.simulation.degrade import add_noise, occlude
from graphtrack.simulation.sampling import simulate
from graphtrack.simulation.scenario import scenario


def echo(name: str = "echo", fails: tuple[int, ...] = (), gaps: tuple[int, ...] = ()) -> Method:
    """A method that returns its input; it fails on some tracks."""

    def run(track: Track, camera: object) -> Track:
        assert track.true_position is None and track.true_body is None and track.true_head is None
        if track.track_id in fails:
            raise SolveError(track.track_id, "no mood for it")
        position = track.position.copy()
        if track.track_id in gaps:
            position[5] = np.nan
        return replace(track, position=position, body=None, head=None)

    return Method(name, True, "positions; the present only", run)


@pytest.fixture(scope="module")
def tracks() -> TrackSet:
    return simulate("joint", n_tracks=12, n_steps=50, rng=np.random.default_rng(21))


@pytest.fixture(scope="module")
def comparison(tracks: TrackSet) -> Comparison:
    return compare(tracks.map(lambda track: track[:25]))


def value(found: Comparison, method: str, metric: str, column: str = "median") -> float:
    rows = [row for row in found.rows if (row["method"], row["metric"]) == (method, metric)]
    assert len(rows) == 1
    return float(rows[0][column])


@pytest.mark.slow
def test_knowing_the_future_helps(comparison: Comparison) -> None:
    assert not comparison.failures
    for metric in ("position RMSE", "velocity RMSE"):
        assert value(comparison, "rts", metric) < value(comparison, "kf", metric)
        assert value(comparison, "smoother", metric) < value(comparison, "isam2", metric)
    by_track = {(record.method, record.track_id): record.metrics for record in comparison.per_track}
    better = [
        by_track["rts", i]["position RMSE"] < by_track["kf", i]["position RMSE"]
        for method, i in by_track
        if method == "kf"
    ]
    assert np.mean(better) > 0.9


def test_methods_that_do_not_estimate_angles_have_no_rows_for_them(comparison: Comparison) -> None:
    metrics = {
        method: {row["metric"] for row in comparison.rows if row["method"] == method} for method in registry
    }
    assert metrics["kf"] == metrics["rts"] == {"position RMSE", "velocity RMSE", "time a step"}
    assert metrics["smoother"] == metrics["kf"] | {"body error", "head error"}
    quantities = {row["quantity"] for row in comparison.calibration if row["method"] == "kf"}
    assert quantities == {"position", "velocity"}
    assert all(
        np.isfinite(row["median"]) and row["low"] <= row["median"] <= row["high"] for row in comparison.rows
    )


def test_differences_are_paired_with_the_first_method_of_each_group(comparison: Comparison) -> None:
    by_track = {(record.method, record.track_id): record.metrics for record in comparison.per_track}
    assert {(row["group"], row["reference"]) for row in comparison.differences} == {
        ("online", "chain"),
        ("offline", "smoother"),
    }
    ids = sorted({i for _, i in by_track})
    for row in comparison.differences:
        assert row["method"] != row["reference"] and row["metric"] != "time a step"
        apart = [
            by_track[row["method"], i][row["metric"]] - by_track[row["reference"], i][row["metric"]]
            for i in ids
        ]
        assert row["difference"] == pytest.approx(np.mean(apart), abs=1e-12) and row["n"] == len(ids)
        assert row["low"] <= row["difference"] <= row["high"]
        assert min(apart) <= row["low"] and row["high"] <= max(apart)


def test_the_linear_methods_are_consistent_on_their_own_model(comparison: Comparison) -> None:
    nees = {row["method"]: row["nees"] for row in comparison.calibration if row["quantity"] == "position"}
    low, high = (bound / 2.0 for bound in chi_square_band(2, 12))
    assert low < nees["kf"] < high and low < nees["rts"] < high
    tight = replace(Model("joint").parameters.motion, acceleration_density=0.002)
    wrong = Model("joint", replace(Model("joint").parameters, motion=tight))
    overconfident = compare(
        simulate("position", n_tracks=12, n_steps=80, rng=np.random.default_rng(22)), ("kf",), wrong
    )
    assert overconfident.calibration[0]["nees"] > high


def test_everything_is_ready_for_json(comparison: Comparison) -> None:
    text = json.dumps(comparison.to_dict(), allow_nan=False)
    back = json.loads(text)
    assert back["caption"] == comparison.caption and len(back["rows"]) == len(comparison.rows)
    assert len(back["per_track"]) == 12 * len(comparison.information)


@pytest.mark.slow
def test_online_and_offline_stand_apart_and_the_caption_says_what_was_used(comparison: Comparison) -> None:
    groups = {name: {row["method"] for row in comparison.group(name)} for name in ("online", "offline")}
    online = {"chain", "isam2", "kf", "intentional", "intentional-printed", "particle"}
    assert groups == {"online": online, "offline": {"rts", "smoother"}}
    order = [row["group"] for row in comparison.rows]
    assert order == sorted(order, reverse=True), "online rows stand together, and first"
    for method, used in comparison.information.items():
        assert f"{method} ({used})" in comparison.caption
    assert comparison.information["kf"] == "positions; past only"
    assert comparison.information["smoother"] == "positions, body, head; past and future"


@pytest.mark.slow
def test_online_methods_do_not_see_the_future(tracks: TrackSet) -> None:
    track = next(iter(tracks))[:24]
    later = track.position.copy()
    later[16:] += 50.0
    changed = replace(track, position=later)
    for name in registry:
        method = make_method(name)
        same = np.allclose(method.run(track, None).position[:16], method.run(changed, None).position[:16])
        assert same is method.online, name


def test_inside_windows_only_the_withheld_frames_count() -> None:
    people = scenario(np.random.default_rng(23), seconds=14.0)
    found = compare(people, ("kf", "rts"), occlude_seconds=2.0)
    assert all(record.frames == 20 for record in found.per_track)
    hidden = occlude(people, 2.0)
    rts = make_method("rts")
    for record in found.per_track:
        if record.method == "rts":
            window = hidden.windows[record.track_id]
            estimate, truth = (
                rts.run(hidden.tracks.by_id(record.track_id), None),
                people.by_id(record.track_id),
            )
            squares = np.sum((estimate.position - truth.true_position)[window] ** 2, axis=1)
            assert record.metrics["position RMSE"] == pytest.approx(np.sqrt(squares.mean()))
    assert value(found, "kf", "position RMSE") > value(found, "rts", "position RMSE")
    assert "withheld for 2 s" in found.caption and found.occlude_seconds == 2.0


def test_short_tracks_are_left_out_of_windows_with_their_reason(tracks: TrackSet) -> None:
    short = replace(next(iter(tracks))[:10], track_id=99)
    found = compare(tracks.with_tracks([*tracks, short]), ("kf",), occlude_seconds=1.0)
    assert "too short" in found.left_out[99] and "left out" in found.caption
    with pytest.raises(InputError, match="shorter window"):
        compare(TrackSet((short,)), ("kf",), occlude_seconds=1.0)


def test_a_method_that_fails_is_reported_and_the_others_come_out(tracks: TrackSet) -> None:
    found = compare(tracks, ("kf", echo(fails=(3,), gaps=(5,))))
    assert {(f.method, f.track_id): f.failure for f in found.failures} == {
        ("echo", 3): "no mood for it",
        ("echo", 5): "no position at 1 of 50 scored frames",
    }
    # The tables pool the same tracks for both.
    assert value(found, "kf", "position RMSE", "n") == value(found, "echo", "position RMSE", "n") == 10
    assert "2 of 24 runs failed" in found.caption
    hopeless = compare(tracks, ("kf", echo(fails=tuple(range(12)))))
    assert value(hopeless, "kf", "position RMSE", "n") == 12
    assert {row["method"] for row in hopeless.rows} == {"kf"}


def test_frames_before_the_first_position_count_for_nobody(tracks: TrackSet) -> None:
    track = next(iter(tracks))
    position = track.position.copy()
    position[:7] = np.nan
    late = replace(track, position=position)
    assert scored_frames(late).tolist() == [False] * 7 + [True] * 43
    found = compare(TrackSet((late,)))
    assert not found.failures and {record.frames for record in found.per_track} == {43}


def test_progress_counts_frames(tracks: TrackSet) -> None:
    seen: list[int] = []
    compare(tracks.with_tracks(list(tracks)[:4]), ("kf",), progress=seen.append)
    assert seen == [50] * 4


def test_without_truth_there_is_advice(tracks: TrackSet) -> None:
    blind = tracks.map(lambda track: replace(track, true_position=None))
    with pytest.raises(InputError, match=r"true_x and true_y.*add noise"):
        compare(blind)
    noisy = add_noise(blind, position_std=0.1, rng=np.random.default_rng(24))
    assert not compare(noisy, ("kf",)).failures
    half = tracks.with_tracks([*blind][:5] + [*tracks][5:])
    assert set(compare(half, ("kf",)).left_out) == {0, 1, 2, 3, 4}


def test_a_track_without_an_observed_position_is_left_out_for_all(tracks: TrackSet) -> None:
    people = [*tracks][:3]
    lost = replace(people[1], position=np.full_like(people[1].position, np.nan))
    found = compare(tracks.with_tracks([people[0], lost, people[2]]), ("kf", "particle"))
    assert found.left_out == {lost.track_id: "no position was observed"} and not found.failures
    assert value(found, "kf", "position RMSE", "n") == 2
    with pytest.raises(InputError, match="no observed position in any track"):
        compare(TrackSet((lost,)), ("kf", "particle"))


def test_unknown_and_repeated_methods_are_refused(tracks: TrackSet) -> None:
    for methods in (("nonsense",), (), ("kf", "kf"), ("kf", echo(name="kf"))):
        with pytest.raises(InputError, match=r"method|kf"):
            compare(tracks, methods)
    own = echo()
    assert make_method(own) is own
