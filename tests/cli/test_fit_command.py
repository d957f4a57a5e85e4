"""`graphtrack fit` from file to file."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.cli import main
from graphtrack.learning.fit import _split as split_tracks
from graphtrack.model import MotionParameters


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["graphtrack", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.fixture
def people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    gt.write(gt.simulate("position", n_tracks=5, n_steps=40, rng=np.random.default_rng(0)), "people.csv")
    return tmp_path


def test_a_model_file_a_report_and_the_numbers_come_out(
    people: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--model", "position", "--report", "learned.html", "--json", "learned.json"]
    assert run(monkeypatch, "fit", "people.csv", "-o", "learned.toml", *options) == 0
    printed = capsys.readouterr().out
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
def test_what_cannot_be_done_is_said_in_one_line(
    people: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], wrong: list[str]
) -> None:
    assert run(monkeypatch, "fit", "people.csv", *wrong) == 2
    assert capsys.readouterr().err.strip().splitlines()[-1].startswith("error: ")
    assert not (people / "learned.toml").exists()


def test_what_the_data_do_not_show_keeps_its_prior_and_is_said(
    people: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # The file says how noisy it is, so that its positions tell nothing of the default noise.
    options = ["--model", "position", "--json", "learned.json"]
    assert run(monkeypatch, "fit", "people.csv", "-o", "learned.toml", *options) == 0
    assert "not identified" in capsys.readouterr().out
    told = json.loads((people / "learned.json").read_text(encoding="utf-8"))
    notes = {one["name"]: one for one in told["learned"]}
    kept = notes["likelihood.position_std"]
    assert "kept" in kept["note"] and kept["value"] == kept["start"]
    assert not notes["motion.acceleration_density"]["note"]


def start(people: Path, output: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "graphtrack", "fit", people, "-o", output, "--model", "position"]
    # A shell that runs the tests in the background lets them ignore interrupts.
    return subprocess.Popen(
        command,
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


def test_learning_that_does_harm_is_said_in_the_terminal_and_in_the_report(
    people: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Those learned from hardly move, those held out do: whatever is learned, it is wrong for them.
    calm = gt.Parameters(motion=MotionParameters(acceleration_density=1e-3))
    rng = np.random.default_rng(0)
    slow = gt.simulate(gt.Model("position", calm), n_tracks=4, n_steps=40, rng=rng, pace=None)
    _, held = split_tracks(list(slow), 0.25, 0, 20_000)
    lively = replace(next(iter(gt.read("people.csv"))), track_id=held[0].track_id)
    mixed = slow.with_tracks(lively if track.track_id == lively.track_id else track for track in slow)
    gt.write(mixed, "mixed.csv")
    options = ["--model", "position", "--report", "learned.html"]
    assert run(monkeypatch, "fit", "mixed.csv", "-o", "learned.toml", *options) == 0
    worse = "keep the model that it started from (position)"
    assert worse in " ".join(capsys.readouterr().err.split())
    assert worse in (people / "learned.html").read_text(encoding="utf-8")
