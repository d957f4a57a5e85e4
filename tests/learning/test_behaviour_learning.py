"""Learning of gaze from labels and of forecasts: training data, recovery, and held-out people."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import ran
from command import run as run_program

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.forecasting.forecaster import Forecaster, mean_turn, turn_to_head
from graphtrack.forecasting.motion import ForecastParameters
from graphtrack.interaction.attention import AttentionParameters, attention
from graphtrack.interaction.parameters import GroupParameters
from graphtrack.interaction.scores import score_gaze
from graphtrack.interaction.tables import NOBODY, LookLabels
from graphtrack.learning import forecasts as learning
from graphtrack.learning.forecasts import forecasts, recording
from graphtrack.learning.interaction import fit_attention
from graphtrack.simulation.scenario import Party, party


def labels_of(made: Party) -> LookLabels:
    columns = made.look_columns()
    return LookLabels(columns["frame"], columns["track_id"], columns["target"], Path("looks.csv"))


@pytest.mark.slow
def test_what_is_learned_is_calibrated_in_a_scene_that_was_not_learned_from() -> None:
    def scene(seed: int) -> Party:
        return party(np.random.default_rng(seed), people=10, steps=200, fps=2.0)

    wrong = AttentionParameters(look_std=0.05, nothing=0.05, fellows=200.0, switching=0.05)
    made, other = scene(5), scene(6)
    found = fit_attention(made.tracks, labels_of(made), wrong, hold_out=0.2)
    assert found.held_out is not None and found.held_out.frames < found.learned_from.frames
    before, after = (
        score_gaze(attention(other.tracks, parameters=parameters), labels_of(other))
        for parameters in (wrong, found.parameters)
    )
    assert after.log_score > before.log_score + 0.1
    assert after.target_calibration_error < 0.02
    assert after.calibration_error < min(0.09, 0.5 * before.calibration_error)


def test_labels_that_are_sure_of_the_truth_score_best() -> None:
    made = party(np.random.default_rng(3), people=5, steps=30)
    labels = labels_of(made)
    sure = []
    for one in attention(made.tracks):
        target = labels.of(one.track_id, one.frame)
        true = target[:, None] == np.array([*one.people, NOBODY])
        sure.append(replace(one, probability=true.astype(float)))
    score = score_gaze(sure, labels)
    assert (score.right, score.log_score, score.calibration_error) == (1.0, 0.0, 0.0)
    half = score_gaze(sure, labels, (7.0, np.inf))
    assert 0 < half.frames < score.frames


def test_labels_of_others_and_of_no_look_are_told() -> None:
    made = party(np.random.default_rng(3), people=4, steps=10)
    labels = labels_of(made)
    for wrong, message in (
        (replace(labels, target=np.full(len(labels.target), 9)), "found target 9"),
        (replace(labels, track_id=labels.track_id + 7), "found track"),
        (replace(labels, target=np.full(len(labels.target), NOBODY)), "no look at anybody"),
        (replace(labels, frame=labels.frame + 1000), "no frame with labelled looks"),
    ):
        with pytest.raises(InputError) as told:
            fit_attention(made.tracks, wrong)
        assert message in str(told.value)


LEARNED = [
    (AttentionParameters(look_std=0.21, nothing=0.4), "attention", "look_std = 9.0"),
    (gt.ForecastParameters(place_distance=2.5, tail_share=0.4), "forecast", "place_distance = -1.0"),
    (GroupParameters(stride=0.6), "groups", "stride = -1.0"),
]


@pytest.mark.parametrize(("parameters", "table", "wrong"), LEARNED)
def test_parameters_come_back_from_their_file(
    parameters: Any, table: str, wrong: str, tmp_path: Path
) -> None:
    path, load = tmp_path / "learned.toml", type(parameters).load
    parameters.save(path)
    assert load(path) == parameters
    model = "[motion]\nacceleration_density = 1\n"
    for text, told in ((f"[{table}]\n{wrong}\n", wrong), ("", f"no table [{table}]"), (model, "model file")):
        path.write_text(text)
        with pytest.raises(InputError, match=re.escape(told)):
            load(path)


def test_the_commands_learn_and_judge(tmp_path: Path) -> None:
    made = party(np.random.default_rng(4), people=4, steps=40)
    gt.write(made.tracks, tmp_path / "party.csv")
    rows = zip(*made.look_columns().values(), strict=True)
    lines = ["frame,t,track_id,target", *(",".join(map(str, row)) for row in rows)]
    (tmp_path / "looks.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "groups.csv").write_text("frame,track_id,group\n0,0,1\n0,1,1\n")
    scene, looks, learned = (tmp_path / name for name in ("party.csv", "looks.csv", "learned.toml"))
    ran("fit", scene, "--attention", looks, "-o", learned, program="graphtrack")
    assert AttentionParameters.load(learned) != AttentionParameters()
    judged = run_program(
        *("attention", scene, "-o", tmp_path / "attention.csv"),
        *("--parameters", learned, "--truth", looks),
        program="graphtrack",
    )
    assert judged.returncode == 0 and "calibration error" in judged.stdout + judged.stderr
    both = run_program(
        *("fit", scene, "-o", learned, "--attention", looks, "--groups", tmp_path / "groups.csv"),
        program="graphtrack",
    )
    assert (
        both.returncode == 2 and "several of --constants, --forecast, --groups and --attention" in both.stderr
    )


STEP = 0.4


def crowd(count=15, seed=1, steps=30):
    """People who meet, turn and come at different times."""
    rng = np.random.default_rng(seed)
    people = []
    for k in range(count):
        speeds = rng.normal(0, 0.8, 2) + np.cumsum(rng.normal(0, 0.1, (steps, 2)), axis=0)
        where = rng.uniform(-4, 4, 2) + np.cumsum(STEP * speeds, axis=0)
        frame = int(rng.integers(0, 30)) + np.arange(steps)
        people.append(gt.Track(k, frame, STEP * frame, where))
    return gt.TrackSet(tuple(people))


def test_what_came_of_people_is_where_they_were_and_unknown_when_they_had_left():
    scene = crowd(count=1)
    position = scene[0].position[:, 0] + 1j * scene[0].position[:, 1]
    for k, (_, people, actual, straight) in enumerate(forecasts(recording(scene), ForecastParameters())):
        now = k + 1  # the first forecast is made in the second frame
        assert people.tolist() == [0]
        later = position[now + 1 : now + 13]
        np.testing.assert_allclose(actual[0, : len(later)], later)
        assert np.isnan(actual[0, len(later) :]).all()
        going = position[now] + 3 * (position[now] - position[now - 1])
        assert straight[0, 2] == pytest.approx(going)


def test_the_search_finds_the_least_of_a_valley_and_stays_there():
    def cost(one):
        return abs(one.stop_speed - 0.3) + abs(np.log(one.place_prior / 3.0)) + one.companion_weight

    found = learning._search(learning.START, learning.PLACE_STEPS, cost, lambda what: None)
    assert (found.stop_speed, found.place_prior, found.companion_weight) == (0.3, 3.0, 0.0)


def test_how_far_the_head_leads_is_found():
    rng, truth = np.random.default_rng(2), replace(ForecastParameters(), head_share=0.6, head_limit=1.2)
    angle, velocity = rng.uniform(-2, 2, 500), rng.normal(0, 1, 500) + 1j * rng.normal(0, 1, 500)
    turned = turn_to_head(angle, np.ones(500), truth)[:, None] * mean_turn(learning._HEAD_TIMES, truth)
    moved = velocity[:, None] * learning._HEAD_TIMES * np.exp(1j * turned)
    heads = learning.Heads(velocity, angle, np.ones(500), moved)
    found = learning._search(learning.START, learning.HEAD_STEPS, heads.error, lambda what: None)
    assert heads.error(found) <= heads.error(replace(truth, head_share=0.0)) / 10
    assert found.head_share == pytest.approx(0.6, abs=0.11)


@pytest.mark.slow
def test_circles_err_least_where_their_spread_is_that_of_the_people():
    scene = recording(crowd(count=25))
    fitted = learning._fit_spread([learning.outcomes(scene, ForecastParameters())], ForecastParameters())
    losses = [
        learning.calibration_error(
            scene,
            replace(
                fitted,
                scene_prior=1e6,
                spread_standing=fitted.spread_standing * factor,
                spread_walking=fitted.spread_walking * factor,
            ),
        )
        for factor in (0.3, 1.0, 3.0)
    ]
    assert losses[1] == min(losses)


def test_a_forecaster_goes_on_where_its_state_was_taken():
    scene, whole, broken = recording(crowd()), Forecaster(), Forecaster()
    for seen in scene.frames:
        for one in (whole, broken):
            one.update(seen.t, seen.track_id, seen.position, seen.std, seen.head)
        told = [one.forecast([0.4, 2.0, 6.0]) for one in (whole, broken)]
        for name in ("track_id", "position", "covariance", "radius_50", "radius_90"):
            np.testing.assert_array_equal(getattr(told[0], name), getattr(told[1], name))
        broken = Forecaster.from_state(broken.state())


def test_recordings_that_nothing_can_be_learned_from_are_told():
    with pytest.raises(InputError, match="at least one"):
        learning.fit_forecast({})
    with pytest.raises(InputError, match="no person observed"):
        learning.fit_forecast({"short": crowd(count=3, steps=2)})
