"""The commands, as a user runs them."""

import json
import subprocess
import sys

import pandas as pd
import pytest


def run(*arguments, stdin=None):
    command = [sys.executable, "-c", "from graphtrack.cli import main; main()", *map(str, arguments)]
    return subprocess.run(command, input=stdin, capture_output=True, text=True, timeout=120)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "simulated.csv"
    assert run("simulate", "-o", path, "--tracks", 2, "--steps", 40).returncode == 0
    return path


def test_smooth_writes_every_person_frame_with_uncertainty(simulated, tmp_path):
    done = run("smooth", simulated, "-o", tmp_path / "out.parquet")
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "out.parquet")
    assert len(table) == 80
    assert (table[["x_std", "vx_std", "body_std_deg", "head_std_deg"]] > 0).all().all()


@pytest.mark.parametrize(
    ("command", "engine", "model"),
    [
        ("smooth", "auto", "full"),
        ("smooth", "gtsam", "joint"),
        ("track", "chain", "full"),
        ("track", "fixed-lag", "joint"),
    ],
)
def test_the_model_is_the_best_that_the_engine_has(simulated, tmp_path, command, engine, model):
    done = run(command, simulated, "-o", tmp_path / "out.csv", "--engine", engine)
    assert done.returncode == 0, done.stderr
    assert f"model {model}" in " ".join((done.stdout + done.stderr).split())
    assert ("aligned_p" in pd.read_csv(tmp_path / "out.csv")) == (model == "full")


def test_bad_input_is_one_line_with_status_2_and_no_output(simulated, tmp_path):
    bad = tmp_path / "bad.csv"
    lines = simulated.read_text().splitlines()
    lines[3] = lines[3].replace(lines[3].split(",")[3], "twelve")
    bad.write_text("\n".join(lines))
    done = run("smooth", bad, "-o", tmp_path / "out.csv")
    assert done.returncode == 2
    assert "line 4" in done.stderr and "twelve" in done.stderr and "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out.csv").exists()


def test_a_track_without_positions_is_named_and_the_others_come_out(tmp_path):
    rows = [{"track_id": 1, "frame": k, "t": k / 10, "x": k / 10, "y": 0.0} for k in range(20)]
    rows += [{"track_id": 2, "frame": k, "t": k / 10, "head_deg": 10.0} for k in range(5)]
    pd.DataFrame(rows).to_csv(tmp_path / "in.csv", index=False)
    done = run("smooth", tmp_path / "in.csv", "-o", tmp_path / "out.csv")
    assert done.returncode == 2 and "track 2" in done.stderr
    assert set(pd.read_csv(tmp_path / "out.csv").track_id) == {1}


def rows_of(table):
    return [json.dumps({k: v for k, v in row.items() if v == v}) for row in table.to_dict("records")]


def test_stream_answers_each_row_and_resumes_after_a_stop(simulated, tmp_path):
    table = pd.read_csv(simulated).drop(columns="label", errors="ignore").sort_values(["frame", "track_id"])
    rows = rows_of(table)
    whole = run("track", "-", stdin="\n".join(rows) + "\n")
    assert whole.returncode == 0, whole.stderr
    expected = [json.loads(line) for line in whole.stdout.splitlines()]
    assert len(expected) == len(rows)
    state = tmp_path / "state.json"
    first = run("track", "-", "--state", state, stdin="\n".join(rows[:51]) + "\n")
    second = run("track", "-", "--state", state, stdin="\n".join(rows[51:]) + "\n")
    found = [json.loads(line) for line in (first.stdout + second.stdout).splitlines()]
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        assert a["status"] == b["status"]
        for name in ("x", "y", "vx", "vy", "body_deg", "head_deg", "x_std", "body_std_deg"):
            # A state begins without the last factorisation: it ends within the solver's tolerance.
            assert a[name] == pytest.approx(b[name], rel=1e-5, abs=1e-5), name


def test_a_bad_row_of_a_stream_is_answered_and_the_rest_goes_on():
    rows = [
        '{"track_id": 1, "frame": 0, "x": 0, "y": 0}',
        "junk",
        '{"track_id": 1, "frame": 1, "x": "a", "y": 0}',
    ]
    rows += ['{"track_id": 1, "frame": 2, "x": 0.1, "y": 0}']
    done = run("track", "-", "--fps", 10, stdin="\n".join(rows) + "\n")
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 2
    assert ["error" in answer for answer in answers] == [False, True, True, False]
    assert "line 2" in answers[1]["error"] and "column x" in answers[2]["error"]


def test_demo_writes_report_tables_and_figures(tmp_path):
    done = run("demo", "--out", tmp_path / "demo", "--seconds", 12)
    assert done.returncode == 0, done.stderr
    names = {path.name for path in (tmp_path / "demo").iterdir()}
    assert {"report.html", "tracks.png", "errors.png", "nees.png", "estimates.csv"} <= names
