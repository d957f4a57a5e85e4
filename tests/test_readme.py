"""The README's Python and commands run as printed, in an empty folder; it is short, and its links hold."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from documents import ROOT, blocks, commands, run

from graphtrack.cli.commands import program as graphtrack_program
from perception.cli.commands import program as perception_program

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = blocks("README.md")
GUIDE = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))
LONGEST = 150


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("readme"))
        names = {}
        names["outputs"] = run(BLOCKS, names, slow=False)
        names["files"] = {str(path) for path in Path().rglob("*")}
        return names


def test_it_fits_on_a_page():
    assert len(README.splitlines()) <= LONGEST


def test_the_python_block_runs_and_writes_what_it_says(names):
    assert len(names["smoothed"]) == 3 and np.isfinite(names["smoothed"][0].std("x")).all()
    assert "smoothed.csv" in names["files"]


def test_the_commands_run_from_top_to_bottom(names):
    (answer,) = (text for line, text in names["outputs"].items() if "|" in line)
    assert [json.loads(line)["status"] for line in answer.splitlines()] == ["new"]
    assert {"tracks.csv", "report.html", "online.csv", "forecast.csv", "groups.csv"} <= names["files"]
    assert {"clip/video.mp4", "found/report.html"} <= names["files"]


def test_every_command_is_shown_in_readme_or_documentation():
    programs = {"graphtrack": graphtrack_program(), "perception": perception_program()}
    for name, app in programs.items():
        known = {command.name for command in app.registered_commands}
        found = {words[0] for words in commands(name, "README.md", *GUIDE)}
        mentioned = {one for one in known if any(f"`{name} {one}" in text(page) for page in GUIDE)}
        assert known <= found | mentioned
        assert found <= known | {group.name for group in app.registered_groups}


def text(page):
    return (ROOT / page).read_text(encoding="utf-8")


def test_links_and_pictures_are_there():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert links and not missing


def test_the_picture_is_an_animation_that_a_page_can_hold():
    picture = ROOT / "docs" / "images" / "replay.gif"
    assert "docs/images/replay.gif" in README
    assert picture.stat().st_size < 2_000_000
    assert picture.read_bytes().count(b"\x21\xf9\x04") > 50  # graphic control blocks: a frame each


def test_nothing_leads_to_an_address_that_does_not_exist_yet():
    """No public address exists: all links are relative, but for GTSAM's."""
    outside = [link for link in re.findall(r"\]\((\w+://[^)]+)\)", README) if link != "https://gtsam.org"]
    assert not outside
