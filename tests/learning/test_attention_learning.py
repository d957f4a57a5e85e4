"""Attention parameters are learned from labelled gaze, and hold on held-out people."""

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
from graphtrack.interaction.attention import AttentionParameters, attention
from graphtrack.interaction.parameters import GroupParameters
from graphtrack.interaction.scores import score_gaze
from graphtrack.interaction.tables import NOBODY, LookLabels
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
