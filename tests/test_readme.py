"""What the README shows works: its Python runs, and so does every command line."""

import io
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.cli import main
from graphtrack.cli.main import app
from graphtrack.inference.batch import build_graph
from graphtrack.inference.initial import initial_states
from graphtrack.model.steps import chain

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, flags=re.M | re.S)


def command_lines():
    """Every ``graphtrack …`` of the shell blocks, without pipes and comments."""
    lines = [line for kind, text in BLOCKS if kind == "sh" for line in text.splitlines()]
    parts = [part.strip() for line in lines for part in line.split("#")[0].split("|")]
    return [part for part in parts if part.startswith("graphtrack ")]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    people = gt.simulate("joint", n_tracks=3, n_steps=60, rng=np.random.default_rng(0))
    gt.write(people, "tracks.csv")
    table = people.to_table()[["track_id", "frame", "x", "y"]].rename(columns={"x": "u", "y": "v"})
    table.to_csv("pixels.csv", index=False)
    Path("plane.txt").write_text("1 0 0\n0 1 0\n0 0 1\n")
    gt.Model("joint").save("model.toml")
    return tmp_path


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    """What the Python blocks leave behind, run one after the other as a reader would."""
    names = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("readme"))
        for kind, text in BLOCKS:
            if kind == "python":
                exec(compile(text, "README.md", "exec"), names)
        names["written"] = {path.name for path in Path().iterdir()}
        names["model_file"] = gt.Model.load("model.toml")
    return names


def test_the_python_blocks_run_and_do_what_they_say(names, capsys):
    assert names["written"] == {"smoothed.csv", "model.toml"}
    assert names["model_file"].parameters == names["parameters"]
    assert names["solution"].converged
    assert names["ahead"].covariance[0, 0] > names["estimate"].covariance[0, 0]


def test_the_term_of_ones_own_has_factors_of_its_density(names):
    track = names["noisy"][1]
    with_term, without = names["model"], gt.Model("joint")
    states = initial_states(track, without)

    def graph_cost(model):
        graph, values = build_graph(chain(track), model, states)
        return graph.error(values)

    near = with_term.terms[-1].near(track.position)
    assert near.any(), "nobody passes the window, so that nothing is tested"
    density = with_term.cost(states, track) - without.cost(states, track)
    assert density > 0.0
    assert graph_cost(with_term) - graph_cost(without) == pytest.approx(density)


def is_slow(line):
    return line.startswith("graphtrack reproduce")


@pytest.mark.parametrize(
    "line",
    [pytest.param(line, marks=[pytest.mark.slow] if is_slow(line) else []) for line in command_lines()],
)
def test_a_command_line_runs(line, here, monkeypatch, capsys):
    arguments = shlex.split(line)[1:]
    if arguments[0] == "demo":
        arguments += ["--seconds", "12"]
    if "-" in arguments:
        rows = [text for kind, block in BLOCKS if kind == "json" for text in block.splitlines()]
        monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(rows) + "\n"))
    monkeypatch.setattr(sys, "argv", ["graphtrack", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    output = capsys.readouterr()
    assert ended.value.code == 0, output.err
    if "-" in arguments:
        assert output.out.count('"status": "new"') == len(rows) > 0


def test_every_command_is_shown():
    commands = {command.name for command in app.registered_commands}
    assert {shlex.split(line)[1] for line in command_lines()} == commands


def test_links_and_pictures_are_there():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert links and not missing
