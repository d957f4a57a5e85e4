"""`graphtrack fit` from file to file."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import command
import numpy as np
import pytest

import graphtrack as gt
from graphtrack.learning.fit import _split as split_tracks
from graphtrack.model import MotionParameters

run = partial(command.run, program="graphtrack")


@pytest.fixture
def people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    gt.write(gt.simulate("position", n_tracks=5, n_steps=40, rng=np.random.default_rng(0)), "people.csv")
    return tmp_path


def test_a_model_file_a_report_and_the_numbers_come_out(people: Path) -> None:
    options = ["--model", "position", "--report", "learned.html", "--json", "learned.json"]
    done = run("fit", "people.csv", "-o", "learned.toml", *options)
    printed = done.stdout
    assert done.returncode == 0, done.stderr
    assert "motion.acceleration_density" in printed and "held out" in printed
    told = json.loads((people / "learned.json").read_text(encoding="utf-8"))
    model = gt.Model.load("learned.toml")
    assert model.to_dict() == told["model"]
    assert model.parameters.motion != gt.Parameters().motion
    assert "What it bought" in (people / "learned.html").read_text(encoding="utf-8")
    assert not (people / "learned.toml.progress").exists()


@pytest.mark.parametrize(
    "wrong",
    [
        ["-o", "learned.csv"],
        ["-o", "learned.toml", "--criterion", "error"],
        ["-o", "no/folder/learned.toml"],
        ["-o", "learned.toml", "--hold-out", "1.5"],
        ["-o", "learned.toml", "--model", "joint", "--criterion", "evidence"],
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(people: Path, wrong: list[str]) -> None:
    done = run("fit", "people.csv", *wrong)
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1].startswith("error: ")
    assert not (people / "learned.toml").exists()


def test_what_the_data_do_not_show_keeps_its_prior_and_is_said(people: Path) -> None:
    # The file says how noisy it is, so that its positions tell nothing of the default noise.
    options = ["--model", "position", "--json", "learned.json"]
    done = run("fit", "people.csv", "-o", "learned.toml", *options)
    assert done.returncode == 0 and "not identified" in done.stdout
    told = json.loads((people / "learned.json").read_text(encoding="utf-8"))
    notes = {one["name"]: one for one in told["learned"]}
    kept = notes["likelihood.position_std"]
    assert "kept" in kept["note"] and kept["value"] == kept["start"]
    assert not notes["motion.acceleration_density"]["note"]


def start(people: Path, output: Path) -> subprocess.Popen[bytes]:
    program = [sys.executable, "-m", "graphtrack", "fit", people, "-o", output, "--model", "position"]
    # A shell that runs the tests in the background lets them ignore interrupts.
    return subprocess.Popen(
        program,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.fixture(scope="module")
def people_and_whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """People, and the model that is learned of them when nothing comes between."""
    folder = tmp_path_factory.mktemp("fit")
    rng = np.random.default_rng(0)
    gt.write(gt.simulate("position", n_tracks=20, n_steps=400, rng=rng), folder / "people.csv")
    whole = start(folder / "people.csv", folder / "whole.toml")
    whole.communicate()
    assert whole.returncode == 0
    return folder / "people.csv", folder / "whole.toml"


@pytest.mark.slow
def test_a_fit_that_is_interrupted_and_then_killed_is_resumed_to_the_same_result(
    people_and_whole: tuple[Path, Path], tmp_path: Path
) -> None:
    people, whole = people_and_whole
    learned, progress = tmp_path / "learned.toml", tmp_path / "learned.toml.progress"
    for how, evaluations in ((signal.SIGINT, 5), (signal.SIGKILL, 10)):
        interrupted = start(people, learned)
        while interrupted.poll() is None:
            if progress.is_file() and progress.read_bytes().count(b"\n") > evaluations:
                interrupted.send_signal(how)
                break
            time.sleep(0.01)
        _, said = interrupted.communicate()
        assert interrupted.returncode == (130 if how is signal.SIGINT else -signal.SIGKILL)
        assert b"Traceback" not in said
        assert progress.is_file() and not learned.exists()
    resumed = start(people, learned)
    _, said = resumed.communicate()
    assert resumed.returncode == 0 and b"going on from" in said
    assert learned.read_bytes() == whole.read_bytes()
    assert not progress.exists()


def test_learning_that_does_harm_is_said_in_the_terminal_and_in_the_report(people: Path) -> None:
    # Those learned from hardly move, those held out do: whatever is learned, it is wrong for them.
    calm = gt.Parameters(motion=MotionParameters(acceleration_density=1e-3))
    rng = np.random.default_rng(0)
    slow = gt.simulate(gt.Model("position", calm), n_tracks=4, n_steps=40, rng=rng, pace=None)
    _, held = split_tracks(list(slow), 0.25, 0, 20_000)
    lively = replace(next(iter(gt.read("people.csv"))), track_id=held[0].track_id)
    mixed = slow.with_tracks(lively if track.track_id == lively.track_id else track for track in slow)
    gt.write(mixed, "mixed.csv")
    options = ["--model", "position", "--report", "learned.html"]
    done = run("fit", "mixed.csv", "-o", "learned.toml", *options)
    worse = "keep the model that it started from (position)"
    assert done.returncode == 0 and worse in " ".join(done.stderr.split())
    assert worse in (people / "learned.html").read_text(encoding="utf-8")
