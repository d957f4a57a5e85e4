"""`graphtrack fit` from file to file."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.cli import main


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
