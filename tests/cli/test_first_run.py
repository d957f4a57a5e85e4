"""The first run on a machine: it reports compilation, and its results equal those of any other run."""

import io
import json
import logging
import os
import re
import subprocess
import sys
import time
from itertools import count

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.association import offline
from graphtrack.cli import main
from graphtrack.inference import engines
from graphtrack.kernels import compilation

ROW = '{"track_id": 1, "frame": 0, "t": 0.0, "x": 0.0, "y": 0.0}\n'
SAID = "compiling, once on this machine"


@pytest.fixture
def cold(tmp_path, monkeypatch):
    """A folder with tracks, on a machine where the first run of an engine compiles it."""
    monkeypatch.chdir(tmp_path)
    gt.write(gt.simulate("joint", n_tracks=2, n_steps=5, rng=np.random.default_rng(0)), "tracks.csv")
    gt.write(gt.read("tracks.csv"), "tracks.parquet")
    table = gt.read("tracks.csv").to_table()[["frame", "t", "x", "y"]]
    table.sort_values("frame").to_csv("detections.csv", index=False)
    clock, known = [0.0], set()

    def make_ready(what, *rehearsals):
        names = {one.name for one in rehearsals}
        if not names <= known:
            known.update(names)
            clock[0] += 60.0
            logging.getLogger("graphtrack").warning(SAID)

    for module in (compilation, engines, offline):
        monkeypatch.setattr(module, "make_ready", make_ready)
    ticks = count()
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0] + 1e-6 * next(ticks))
    return tmp_path


def run(monkeypatch, capsys, line, stdin=""):
    monkeypatch.setattr(sys, "stdin", io.StringIO(stdin))
    monkeypatch.setattr(sys, "argv", ["graphtrack", *line.split()])
    with pytest.raises(SystemExit) as ended:
        main()
    output = capsys.readouterr()
    assert ended.value.code == 0, output.err
    assert SAID not in output.out
    return output


@pytest.mark.parametrize(
    ("line", "seconds"),
    [
        ("smooth tracks.csv -o out.csv", r"in ([\d.]+) s"),
        ("smooth tracks.parquet -o out.parquet --stream", r"in ([\d.]+) s"),
        ("smooth tracks.csv -o out.csv --engine gtsam --model position", r"in ([\d.]+) s"),
        ("track tracks.csv -o out.csv", r"\(([\d.]+) ms each"),
    ],
)
def test_compiling_is_told_and_counts_as_nobodys_time(cold, monkeypatch, capsys, line, seconds):
    said = run(monkeypatch, capsys, line).err
    assert said.count(SAID) == 1
    assert float(re.search(seconds, said)[1]) < 0.1
    assert SAID not in run(monkeypatch, capsys, line).err


@pytest.mark.parametrize("line", ["smooth detections.csv -o out.csv", "track detections.csv -o out.csv"])
def test_association_and_solver_are_compiled_and_reported_each(cold, monkeypatch, capsys, line):
    assert run(monkeypatch, capsys, line).err.count(SAID) == 2
    assert SAID not in run(monkeypatch, capsys, line).err


@pytest.mark.slow
def test_a_stream_compiles_before_its_first_row_and_answers_in_json_alone(cold, monkeypatch, capsys):
    output = run(monkeypatch, capsys, "track -", ROW)
    assert output.err.count(SAID) == 1
    assert [json.loads(line)["status"] for line in output.out.splitlines()] == ["new"]
    assert run(monkeypatch, capsys, "track -").err == ""


def test_no_method_is_slow_for_being_compiled(cold, monkeypatch, capsys):
    said = run(monkeypatch, capsys, "compare tracks.csv --methods kf,chain,smoother --json found.json").err
    assert said.count(SAID) == 2
    times = [
        row["low"] for row in json.loads((cold / "found.json").read_text())["rows"] if row["unit"] == "ms"
    ]
    assert len(times) == 3 and max(times) < 0.1


def test_bad_options_are_refused_before_anything_is_compiled(cold, monkeypatch, capsys):
    for line in ("track tracks.csv -o out.csv --lag 0", "track - --state missing/state.json"):
        monkeypatch.setattr(sys, "argv", ["graphtrack", *line.split()])
        with pytest.raises(SystemExit, match="2"):
            main()
        assert SAID not in capsys.readouterr().err


@pytest.mark.slow
def test_groups_and_looks_report_that_they_compile(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    table, program = tmp_path / "tracks.csv", [sys.executable, "-m", "graphtrack"]
    subprocess.run([*program, "simulate", "-o", table, "--tracks", "2", "--steps", "20"], check=True)
    for command in ("attention", "groups"):
        found = subprocess.run(
            [*program, command, table, "-o", tmp_path / "out.csv"],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert ("compiling groups and looks" in found.stderr) == (command == "attention")
