import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import observed, scene, walker
from page_scripts import delta_decode, in_node

from graphtrack.geometry.angles import difference, wrap
from graphtrack.report.lives import pair_tracks
from graphtrack.report.replay import ANGLE_STEP, LENGTH_STEP, TIME_STEP, delta_code, replay_data, thin
from graphtrack.report.style import probability_ellipse
from graphtrack.tracks.track import TrackSet

numbers = st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=40)


@given(numbers)
def test_codes_bring_back_every_value_to_half_a_step(values):
    values = np.array(values)
    back = delta_decode(delta_code(values, LENGTH_STEP), LENGTH_STEP, len(values))
    assert np.array_equal(np.isnan(back), np.isnan(values))
    known = np.isfinite(values)
    assert np.all(np.abs(back - values)[known] <= LENGTH_STEP / 2 + 1e-9)


def decoded(person, name, step):
    return delta_decode(person[name], step, len(person["t"]))


def test_the_data_survive_json_within_a_millimetre_and_a_tenth_of_a_degree():
    estimates, observations = scene(people=3, n=80)
    data = json.loads(
        json.dumps(replay_data(pair_tracks(estimates, observations), max_rate=100.0), allow_nan=False)
    )
    assert data["every"] == 1 and data["kept"] == data["of"] == 240
    for person, estimate, observation in zip(data["people"], estimates, observations, strict=True):
        assert decoded(person, "t", TIME_STEP) == pytest.approx(estimate.t, abs=1e-3)
        for i, axis in enumerate("xy"):
            assert decoded(person, axis, LENGTH_STEP) == pytest.approx(estimate.position[:, i], abs=1e-3)
            seen, true = (
                decoded(person, f"seen_{axis}", LENGTH_STEP),
                decoded(person, f"true_{axis}", LENGTH_STEP),
            )
            assert seen == pytest.approx(observation.position[:, i], abs=1e-3, nan_ok=True)
            assert true == pytest.approx(observation.true_position[:, i], abs=1e-3)
        for name in ("body", "head"):
            error = difference(decoded(person, name, ANGLE_STEP), getattr(estimate, name))
            assert np.abs(error).max() <= ANGLE_STEP
            std = decoded(person, f"{name}_std", ANGLE_STEP)
            assert std == pytest.approx(estimate.std(name), abs=ANGLE_STEP)
        seen_body = decoded(person, "seen_body", ANGLE_STEP)
        assert np.isfinite(seen_body).tolist() == np.isfinite(observation.body).tolist()
        assert np.nanmax(np.abs(difference(seen_body, observation.body))) <= ANGLE_STEP
        ellipse = probability_ellipse(estimate.covariance[:, :2, :2])
        assert decoded(person, "major", LENGTH_STEP) == pytest.approx(ellipse.semi_major, abs=1e-3)
        assert [flag == "1" for flag in person["seen"]] == np.isfinite(observation.position[:, 0]).tolist()


@given(st.lists(st.floats(0.001, 0.5), min_size=1, max_size=60), st.floats(1.0, 40.0))
def test_thinning_keeps_both_ends_and_the_rate(steps, rate):
    t = np.cumsum(steps)
    at = thin(t, rate)
    assert at[0] == 0
    assert at[-1] == len(t) - 1
    assert np.all(np.diff(at) > 0)
    intervals = np.floor(t[at[:-1]] * rate + 1e-6)
    assert len(np.unique(intervals)) == len(intervals)


def test_of_too_many_samples_one_of_every_few_frames_is_kept():
    estimates, observations = scene(people=10, n=500)
    data = replay_data(pair_tracks(estimates, observations), max_samples=1000)
    kept = sum(len(person["t"]) for person in data["people"])
    assert data["kept"] == kept <= 1000 and data["of"] == 5000
    # The last frame is always among them: every sixth leaves room for it, every fifth would not.
    assert data["every"] == 6 and data["frame"] == pytest.approx(6 / 25)
    assert set(np.diff(decoded(data["people"][0], "t", TIME_STEP))[:-1].round(3)) == {0.24}


def test_absent_channels_and_people_are_absent():
    nowhere = walker(2, position=np.full((60, 2), np.nan))
    bare = walker(1, body=None, head=None, covariance=None, velocity=None)
    data = replay_data(pair_tracks(TrackSet((nowhere, bare))))
    (person,) = data["people"]
    assert person["id"] == "1"
    missing = (
        "body",
        "head",
        "body_std",
        "major",
        "vx",
        "seen",
        "seen_x",
        "seen_head",
        "true_x",
        "true_body",
    )
    assert all(person[name] is None for name in missing)


def test_the_page_shows_people_where_they_are():
    estimate = walker(4, n=60)
    jump = replace(estimate, t=np.where(np.arange(60) < 30, estimate.t, estimate.t + 10.0))
    seen = replace(observed(estimate), t=jump.t)
    data = replay_data(pair_tracks(TrackSet((jump,)), TrackSet((seen,))), max_rate=100.0)
    between = (jump.t[:-1] + jump.t[1:]) / 2.0
    code = f"""
    const data = {json.dumps(data)};
    const person = decodePerson(data.people[0], data.steps);
    const ask = (times) => times.map((t) => stateAt(person, t));
    return [ask({jump.t.tolist()}), ask({between.tolist()}), ask([-1, 99])];
    """
    at, halfway, outside = in_node(("replay_data.js",), code)
    assert outside == [None, None]
    for i, state in enumerate(at):
        assert [state["x"], state["y"]] == pytest.approx(jump.position[i], abs=2e-3)
        assert abs(difference(state["body"], jump.body[i])) < 0.01
        assert state["seen"] == (not 20 <= i < 35)
    for i, state in enumerate(halfway):
        if i == 29:
            assert state is None  # the hole of ten seconds
            continue
        assert [state["x"], state["y"]] == pytest.approx(jump.position[i : i + 2].mean(axis=0), abs=2e-3)
        middle = wrap(jump.body[i] + difference(jump.body[i + 1], jump.body[i]) / 2.0)
        assert abs(difference(state["body"], middle)) < 0.01
