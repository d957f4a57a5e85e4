"""`graphtrack fit` of a scene, from file to file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command import Done
from command import run as run_command
from crossing_people import street

import graphtrack as gt


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with detections, and with the same detections labelled; false ones have −1."""
    monkeypatch.chdir(tmp_path)
    detections, whose = street(np.random.default_rng(0), people=8, frames=50, miss=0.15, false=0.5)
    lines = zip(detections.frame, detections.t, *detections.position.T, whose, strict=True)
    rows = [f"{frame},{t:.9g},{x:.9g},{y:.9g},{who}" for frame, t, x, y, who in lines]
    Path("labelled.csv").write_text("\n".join(["frame,t,x,y,track_id", *rows]) + "\n")
    Path("seen.csv").write_text("\n".join(row.rpartition(",")[0] for row in ["frame,t,x,y,", *rows]) + "\n")
    return tmp_path


def fit(*arguments: str) -> Done:
    return run_command("fit", *arguments, program="graphtrack")


@pytest.mark.parametrize(("source", "how"), [("seen.csv", "found"), ("labelled.csv", "given")])
def test_a_scene_is_learned_told_written_and_used(here: Path, source: str, how: str) -> None:
    options = ["--scene"] if how == "given" else []
    done = fit(source, "-o", "place.toml", *options, "--json", "place.json", "--report", "place.html")
    assert done.returncode == 0
    assert "scene.detection_probability" in done.stdout and "held out" in done.stdout
    assert "no head observed: not learned" in done.stdout
    assert f"people {how}" in done.stderr and "wrote place.html" in done.stderr
    model = gt.Model.load("place.toml")
    assert model.preset == "full"
    assert model.to_dict() == json.loads((here / "place.json").read_text("utf-8"))["model"]
    assert 0.7 < model.scene["detection_probability"] < 0.95
    assert "Gain" in (here / "place.html").read_text("utf-8")
    found = gt.associate("seen.csv", model="place.toml")
    std = np.concatenate([track.position_std for track in found])
    assert set(std[np.isfinite(std)]) == {model.scene["position_std"]}
    used = run_command("info", "seen.csv", "--model", "place.toml", program="graphtrack")
    assert f"{len(found)} people" in used.stderr


def test_identities_are_forgotten_on_request(here: Path) -> None:
    assert fit("seen.csv", "-o", "one.toml").returncode == 0
    assert fit("labelled.csv", "-o", "other.toml", "--associate", "always").returncode == 0
    assert gt.Model.load("one.toml").scene == gt.Model.load("other.toml").scene


WRONG = {
    "seen.csv --criterion truth": "--criterion",
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
