"""`graphtrack fit` of models and of scenes, from file to file."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import command
import numpy as np
import pytest
from command import Done
from command import run as run_command
from crossing_people import street

import graphtrack as gt
from graphtrack.constants.population import Population
from graphtrack.learning.fit import _split as split_tracks
from graphtrack.model import MotionParameters
from graphtrack.smoothing import learn_constants

run = partial(command.run, program="graphtrack")


@pytest.fixture
def people(cwd: Path) -> Path:
    gt.write(gt.simulate("position", n_tracks=5, n_steps=40, rng=np.random.default_rng(0)), "people.csv")
    return cwd


def test_what_is_learned_without_a_truth_is_what_smooth_learns(people: Path) -> None:
    seen = gt.read("people.csv").map(lambda track: replace(track, true_position=None))
    gt.write(seen, "seen.csv")
    done = run(
        "fit", "seen.csv", "-o", "constants.toml", "--report", "learned.html", "--json", "learned.json"
    )
    assert done.returncode == 0, done.stderr
    assert "observations of 5 tracks, not from a truth" in done.stderr
    assert "to use it: graphtrack smooth FILE -o OUTPUT --constants constants.toml" in done.stderr
    population, constants = learn_constants(seen)
    assert Population.load("constants.toml") == population
    told = json.loads((people / "learned.json").read_text(encoding="utf-8"))["people"]
    assert {int(one) for one in told} == set(constants)
    assert constants[0].described() in (people / "learned.html").read_text(encoding="utf-8")
    # The truth is used unless constants are asked for.
    assert run("fit", "people.csv", "-o", "again.toml", "--constants").returncode == 0
    assert Population.load("again.toml") == population
    given = [["--constants", "constants.toml"], ["--model", "position", "--constants", "constants.toml"]]
    for options in given:
        assert run("smooth", "seen.csv", "-o", "smoothed.csv", *options).returncode == 0


@pytest.mark.parametrize("option", ["--hold-out 0", "--max-frames 100", "--seed 0"])
def test_options_of_the_choice_of_tracks_need_a_truth(people: Path, option: str) -> None:
    done = run("fit", "people.csv", "-o", "constants.toml", "--constants", *option.split())
    assert done.returncode == 2 and option.split()[0] in done.stderr
    assert not (people / "constants.toml").exists()


def test_a_model_and_constants_in_each_others_place_are_one_error(people: Path) -> None:
    gt.Model().save("model.toml")
    Population().save("constants.toml")
    for option, file, right in (
        ("--model", "constants.toml", "a file of constants (for --constants)"),
        ("--constants", "model.toml", "a model file (for --model)"),
    ):
        done = run("smooth", "people.csv", "-o", "smoothed.csv", option, file)
        assert done.returncode == 2 and f"{file}: found {right}, expected" in done.stderr
        assert not (people / "smoothed.csv").exists()


def test_a_model_file_a_report_and_the_numbers_come_out(people: Path) -> None:
    options = ["--model", "position", "--report", "learned.html", "--json", "learned.json"]
    done = run("fit", "people.csv", "-o", "learned.toml", *options)
    printed = done.stdout
    assert done.returncode == 0, done.stderr
    assert "motion.acceleration_density" in printed and "held out" in printed
    assert "Fitted to the truth of 4 tracks" in done.stderr and "--model learned.toml" in done.stderr
    told = json.loads((people / "learned.json").read_text(encoding="utf-8"))
    model = gt.Model.load("learned.toml")
    assert model.to_dict() == told["model"]
    assert model.parameters.motion != gt.Parameters().motion
    assert "Gain" in (people / "learned.html").read_text(encoding="utf-8")


def test_learning_that_does_harm_is_said_in_the_terminal_and_in_the_report(people: Path) -> None:
    # Training people hardly move, held-out people do: any learned value is wrong for them.
    calm = gt.Parameters(motion=MotionParameters(acceleration_density=1e-3))
    rng = np.random.default_rng(0)
    slow = gt.simulate(gt.Model("position", calm), n_tracks=4, n_steps=40, rng=rng, pace=None)
    _, held = split_tracks(list(slow), 0.25, 0, 20_000)
    lively = replace(next(iter(gt.read("people.csv"))), track_id=held[0].track_id)
    mixed = slow.with_tracks(lively if track.track_id == lively.track_id else track for track in slow)
    gt.write(mixed, "mixed.csv")
    options = ["--model", "position", "--report", "learned.html"]
    done = run("fit", "mixed.csv", "-o", "learned.toml", *options)
    worse = "keep the initial model (position)"
    assert done.returncode == 0 and worse in " ".join(done.stderr.split())
    assert worse in (people / "learned.html").read_text(encoding="utf-8")


@pytest.fixture
def here(cwd: Path) -> Path:
    """A folder with detections, and with the same detections labelled; false ones have −1."""
    detections, whose = street(np.random.default_rng(0), people=8, frames=50, miss=0.15, false=0.5)
    lines = zip(detections.frame, detections.t, *detections.position.T, whose, strict=True)
    rows = [f"{frame},{t:.9g},{x:.9g},{y:.9g},{who}" for frame, t, x, y, who in lines]
    Path("labelled.csv").write_text("\n".join(["frame,t,x,y,track_id", *rows]) + "\n")
    Path("seen.csv").write_text("\n".join(row.rpartition(",")[0] for row in ["frame,t,x,y,", *rows]) + "\n")
    return cwd


def fit(*arguments: str) -> Done:
    return run_command("fit", *arguments, program="graphtrack")


@pytest.mark.slow
@pytest.mark.parametrize(("source", "how"), [("seen.csv", "found"), ("labelled.csv", "given")])
def test_a_scene_is_learned_told_written_and_used(here: Path, source: str, how: str) -> None:
    options = ["--scene"] if how == "given" else []
    done = fit(source, "-o", "place.toml", *options, "--json", "place.json", "--report", "place.html")
    assert done.returncode == 0
    assert "scene.detection_probability" in done.stdout and "held out" in done.stdout
    assert "no head observed: not learned" in done.stdout
    assert f"people {how}" in done.stderr and "wrote place.html" in done.stderr
    model = gt.Model.load("place.toml")
    assert model.preset == "joint"
    assert model.to_dict() == json.loads((here / "place.json").read_text("utf-8"))["model"]
    assert 0.7 < model.scene["detection_probability"] < 0.95
    assert "Gain" in (here / "place.html").read_text("utf-8")
    found = gt.associate("seen.csv", model="place.toml")
    std = np.concatenate([track.position_std for track in found])
    assert set(std[np.isfinite(std)]) == {model.scene["position_std"]}
    used = run_command("info", "seen.csv", "--model", "place.toml", program="graphtrack")
    assert f"{len(found)} people" in used.stderr


@pytest.mark.slow
def test_identities_are_forgotten_on_request(here: Path) -> None:
    assert fit("seen.csv", "-o", "one.toml").returncode == 0
    assert fit("labelled.csv", "-o", "other.toml", "--associate", "always").returncode == 0
    assert gt.Model.load("one.toml").scene == gt.Model.load("other.toml").scene


WRONG = {
    "seen.csv --max-frames 100": "--max-frames",
    "seen.csv --seed 0": "--seed",
    "labelled.csv --forecast --hold-out 0.1": "--hold-out",
    "seen.csv --select 1": "--select",
    "seen.csv seen.csv": "each file once",
    "seen.csv seen.csv --scene": "one recording at a time",
    "seen.csv --associate never": "rows without identities",
    "labelled.csv --scene --associate repair": "--associate repair",
    "seen.csv --model bad.toml": "bad.toml: found key scene.gap",
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_cannot_be_learned_is_one_error(here: Path, wrong: str) -> None:
    Path("bad.toml").write_text("[scene]\ngap = 1.0\n")
    done = fit(*wrong.split(), "-o", "place.toml")
    assert done.returncode == 2
    assert WRONG[wrong] in " ".join(done.stderr.split())
    assert not (here / "place.toml").exists()
