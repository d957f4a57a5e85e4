"""The README's Python and commands run as printed, in an empty folder."""

import json
import re
from pathlib import Path

import pytest
from documents import ROOT, blocks, commands, run

import graphtrack as gt
from graphtrack.cli.commands import app as graphtrack_app
from perception.cli.commands import app as perception_app

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = blocks("README.md")
OF_VIDEO = [block for block in BLOCKS if block.heading == "From video"]
OF_TRACKS = [block for block in BLOCKS if block not in OF_VIDEO]


def follow(slow):
    """Run all blocks about tracks; return names, outputs, and the files that Python wrote."""
    names, outputs, of_python = {}, {}, set()
    for block in OF_TRACKS:
        before = set(Path().iterdir())
        outputs |= run([block], names, slow=slow)
        if block.kind == "python":
            of_python |= {path.name for path in set(Path().iterdir()) - before}
    names["written"] = of_python
    names["outputs"], names["files"] = outputs, {path.name for path in Path().iterdir()}
    names["of_demo"] = {path.name for path in Path("demo").iterdir()}
    names["model_file"] = gt.Model.load("model.toml")
    return names


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("readme"))
        return follow(slow=False)


def test_the_python_blocks_run_and_do_what_they_say(names):
    assert names["written"] == {"smoothed.csv", "model.toml"}
    assert names["model_file"].parameters == names["parameters"]
    assert names["ahead"].covariance[0, 0] > names["estimate"].covariance[0, 0]


def check_tracks(names):
    (answer,) = (text for line, text in names["outputs"].items() if "|" in line)
    assert [json.loads(line)["status"] for line in answer.splitlines()] == ["new"]
    assert {"smoothed.csv", "report.html", "scores.json", "learned.toml"} <= names["files"]
    assert {"report.html", "tracks.png", "errors.png", "reliability.png", "estimates.csv"} <= names["of_demo"]


def test_everything_about_tracks_runs_from_top_to_bottom(names):
    check_tracks(names)


@pytest.mark.slow
def test_everything_about_tracks_runs_with_what_takes_minutes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    check_tracks(follow(slow=True))


@pytest.mark.slow
def test_everything_from_video_runs_from_top_to_bottom(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run(OF_VIDEO, {}, slow=False)
    assert "skipped: 0" not in capsys.readouterr().err
    people, truth = gt.read("observations.csv"), gt.read("clip/truth.csv")
    assert {track.track_id for track in people} == {track.track_id for track in truth}
    assert Path("seen.mp4").stat().st_size > 10_000 and Path("mine.npz").exists()
    (target,) = gt.read("boxes.csv")
    assert len(target) == 12


def test_every_command_is_shown():
    programs = {
        "graphtrack": (graphtrack_app, ("README.md",)),
        "perception": (perception_app, ("README.md", "docs/perception.md")),
    }
    for name, (app, paths) in programs.items():
        known = {command.name for command in app.registered_commands}
        assert {words[0] for words in commands(name, *paths)} == known


def test_links_and_pictures_are_there():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert links and not missing
