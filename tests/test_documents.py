"""README and the pages of docs: their Python and commands run as printed, and the README is short."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from costs import build_graph
from documents import RECORDING, ROOT, blocks, commands, is_about_recording, run

import graphtrack as gt
from graphtrack.cli.commands import program as graphtrack_program
from graphtrack.inference.chain.initialisation import initial_states
from graphtrack.model.observation import chain
from perception.cli.commands import program as perception_program

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = blocks("README.md")
DOCUMENTS = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))
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


@pytest.mark.slow
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
        found = {words[0] for words in commands(name, "README.md", *DOCUMENTS)}
        mentioned = {one for one in known if any(f"`{name} {one}" in text(page) for page in DOCUMENTS)}
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


PAGES = ["docs/start.md", *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("docs/how-to/*.md"))]


def test_there_is_a_page_for_each_task():
    names = {page.rpartition("/")[2].removesuffix(".md") for page in PAGES}
    tasks = {
        "smooth-tracks",
        "detections-to-tracks",
        "video",
        "live",
        "view",
        "groups",
        "forecasts",
        "own-format",
    }
    assert tasks | {"own-term", "own-method", "robots"} <= names


@pytest.mark.parametrize("page", [page for page in PAGES if not page.endswith(("own-term.md", "start.md"))])
def test_a_page_runs(page, cwd):
    run(blocks(page), {}, slow=False)


def test_the_tutorial_ends_with_estimates_in_the_gap_and_a_picture(cwd):
    names = {}
    run(blocks("docs/start.md"), names, slow=False)
    assert len(names["walks"]) == 2 * 110 and [len(person) for person in names["smoothed"]] == [120, 120]
    person = names["smoothed"][1]
    inside, outside = person.std("x")[55], person.std("x")[30]
    assert inside > 1.4 * outside
    assert (cwd / "walks.png").stat().st_size > 10_000
    assert (cwd / "report.html").exists() and (cwd / "smoothed.csv").exists()


@pytest.mark.slow
def test_the_term_of_ones_own_has_factors_of_its_density(cwd):
    names = {}
    run(blocks("docs/how-to/own-term.md"), names, slow=False)
    assert names["solution"].converged and names["solution"].engine == "gtsam"
    track = names["noisy"][1]
    with_term, without = names["model"], gt.Model("joint")
    states = initial_states(track, without)

    def graph_cost(model):
        graph, values = build_graph(chain(track), model, states)
        return graph.error(values)

    density = with_term.cost(states, track) - without.cost(states, track)
    assert density > 0.0 and graph_cost(with_term) - graph_cost(without) == pytest.approx(density)
    assert names["errors"]["both"] < 0.8 * names["errors"]["positions"] < 0.25


HOW_TO = ROOT / "docs" / "how-to"  # of test_howto
OTHERS = sorted(
    str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md") if path.parent != HOW_TO
)
WITH_COMMANDS = [page for page in OTHERS if any(block.kind == "sh" for block in blocks(page))]


def test_commands_stand_where_they_are_run():
    assert {"docs/perception.md", "docs/trackers.md"} <= set(WITH_COMMANDS)
    for page in OTHERS:  # and not in blocks of another kind
        text = (ROOT / page).read_text(encoding="utf-8")
        assert not re.findall(r"^    (?:graphtrack|perception) .*", text, flags=re.M), page


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_commands_of_a_page_run(page, cwd):
    run(blocks(page), {}, slow=True)


@pytest.mark.slow
def test_the_commands_about_a_recording_run(data_dir, cwd):
    street = data_dir / "towncentre"
    (cwd / RECORDING).symlink_to(street / "frames_001_150" / "img1")
    for name in ("frames_001_150/det.txt", "calibration.ci"):
        shutil.copyfile(street / name, cwd / Path(name).name)
    about = [block for block in blocks("docs/perception.md") if is_about_recording(block)]
    assert len(about) >= 4
    run(about, {}, slow=True)
