"""Wrong arguments end with one line and status 2; nothing is written."""

import inspect
from functools import partial
from importlib import import_module
from typing import get_args

import command
import pytest
from selection import others_slow

run = partial(command.run, program="graphtrack")
ran = partial(command.ran, program="graphtrack")

ROWS = "track_id,frame,t,x,y\n" + "".join(f"1,{k},{k / 10},{k / 10},0\n" for k in range(20))

WRONG = {
    "no command of that name": "nonsense",
    "no input": "smooth",
    "no output": "smooth tracks.csv",
    "an option of no such name": "smooth tracks.csv -o out.csv --nonsense 1",
    "text for a number": "smooth tracks.csv -o out.csv --fps ten",
    "a rate of zero": "smooth tracks.csv -o out.csv --fps 0",
    "a missing input": "smooth missing.csv -o out.csv",
    "a folder for input": "info .",
    "an ending of no format": "smooth tracks.csv -o out.xyz",
    "a folder that is not there": "smooth tracks.csv -o missing/out.csv",
    "a report in no folder": "smooth tracks.csv -o out.csv --report missing/report.html",
    "no such preset": "smooth tracks.csv -o out.csv --model joynt",
    "no such model file": "smooth tracks.csv -o out.csv --model missing.toml",
    "no such format": "info tracks.csv --format docx",
    "another format": "info tracks.csv --format kitti",
    "a selection of nobody": "info tracks.csv --select nobody",
    "a missing homography": "info tracks.csv --homography missing.txt",
    "no jobs": "smooth tracks.csv -o out.csv --jobs 0",
    "track without output": "track tracks.csv",
    "no such engine": "track tracks.csv -o out.csv --engine steam",
    "an engine of what comes for whole tracks": "smooth tracks.csv -o out.csv --engine isam2",
    "a state for a file": "track tracks.csv -o out.csv --state state.json",
    "an output for a stream": "track - -o out.csv",
    "a rate of zero for a stream": "track - --fps 0",
    "a state in a folder's place": "track - --state .",
    "a lag that is none": "track - --lag soon",
    "no time between savings": "track - --state state --save-every 0",
    "a state that is none": "track - --state tracks.csv",
    "a state in no folder": "track - --state missing/state.json",
    "no such method": "compare tracks.csv --methods magic --position-noise 0.1",
    "no truth": "compare tracks.csv --methods kf",
    "negative noise": "compare tracks.csv --methods kf --position-noise -1",
    "a window longer than the track": "compare tracks.csv --methods kf --position-noise 0.1 --occlude 100",
    "JSON in no folder": "compare tracks.csv --methods kf --position-noise 0.1 --json missing/found.json",
    "figures in a file": "compare tracks.csv --methods kf --position-noise 0.1 --figures tracks.csv/figures",
    "a negative seed": "simulate -o out.csv --seed -1",
    "nobody to simulate": "simulate -o out.csv --tracks 0",
    "a rate below zero": "simulate -o out.csv --fps -5",
    "a scene too short": "simulate -o out.csv --scenario --steps 10",
    "no noise": "add-noise tracks.csv -o out.csv",
    "more missed than there is": "add-noise tracks.csv -o out.csv --missed 1.5",
    "a truth in the detections' place": "add-noise tracks.csv -o out.csv --missed 0.1 --truth-output out.csv",
    "no truth to judge trackers by": "compare tracks.csv --methods associate --position-noise 0.1",
    "a history longer than all tracks": "forecast tracks.csv -o out.csv --history 60",
    "forecasts as MOT": "forecast tracks.csv -o out.txt",
    "forecasts in the input's place": "forecast tracks.csv -o tracks.csv",
    "no parameters of forecasts": "forecast tracks.csv -o out.csv --parameters missing.toml",
    "forecasts of a file that is tracked": "track tracks.csv -o out.csv --forecast 2",
    "two things to learn": "fit tracks.csv -o out.toml --forecast --scene",
    "a column that is not there": "smooth tracks.csv -o out.csv --columns id=nobody",
    "a place of no kind": "info nonsense://tracks.csv",
    "columns of what is streamed": "smooth tracks.csv -o out.parquet --stream --columns id=track_id",
    "a suggestion and what it is to suggest": "info tracks.csv --suggest --columns id=track_id",
    "truth with columns that it has not": "score tracks.csv --truth tracks.csv --columns id=nobody",
    "names that a row alone cannot have": "track - --columns x=*_x",
    "places in degrees of a stream": "track - --columns lat=a,lon=b",
    "times as text in a stream": "track - --time-unit iso",
    "lengths of another unit in a stream": "track - --units cm",
    "a view in a file of another kind": "view - --save run.txt",
    "groups to find in a stream that is viewed": "view - --groups find",
    "a model that is written as a table": "fit tracks.csv -o learned.csv",
    "a model in no folder": "fit tracks.csv -o no/folder/learned.toml",
    "more held out than there is": "fit tracks.csv -o learned.toml --hold-out 1.5",
    "no such experiment": "reproduce chen --out x",
    "recordings in no folder": "reproduce chen-joint --out x --data nowhere",
    "arguments too many": "formats extra",
    "a demo in a file": "demo --out tracks.csv/demo",
    "a demo too short": "demo --seconds 1",
}


@pytest.fixture
def here(cwd):
    (cwd / "tracks.csv").write_text(ROWS)
    return cwd


@pytest.mark.parametrize("arguments", WRONG.values(), ids=WRONG)
def test_wrong_use_is_one_line_with_status_2(arguments, here):
    done = run(*arguments.split())
    lines = done.stderr.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    assert done.returncode == 2
    assert len(errors) == 1 and len(errors[0]) > len("error: ")
    # In addition to the error there is at most the summary of the input.
    assert all(line.startswith(("tracks.csv: ", "  ")) for line in lines if line not in errors)
    assert "Traceback" not in done.stderr + done.stdout
    assert {path.name for path in here.iterdir()} <= {"tracks.csv", "demo"}


def test_an_online_engine_for_whole_tracks_names_what_to_take(here):
    told = run(*WRONG["an engine of what comes for whole tracks"].split()).stderr
    assert "expected gtsam" in told and "graphtrack track with --engine isam2 --lag none" in told


def test_without_arguments_the_help_is_shown_and_the_status_is_2(here):
    done = run()
    assert done.returncode == 2 and "smooth" in done.stdout


def test_a_full_disk_is_one_line(here, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device", "out.csv")

    monkeypatch.setattr("graphtrack.io.read_write.write", full)
    done = run("simulate", "-o", "out.csv", "--tracks", "1", "--steps", "5")
    assert (done.returncode, done.stderr.strip()) == (2, "error: out.csv: No space left on device")


def test_a_selection_and_an_unused_camera_are_told(here):
    (here / "plane.txt").write_text("1 0 0\n0 1 0\n0 0 1\n")
    done = ran("info", "tracks.csv", "--select", "1", "--homography", "plane.txt")
    assert "selected 1 of 1 track" in done.stderr and "--homography not used" in done.stderr


def test_tables_for_a_pipe_are_not_cut(here):
    label = "a label of some length that a narrow table would have to fold or to cut"
    rows = "".join(f"1,{k},{k / 10},0,0,{label}\n" for k in range(3))
    (here / "named.csv").write_text(f"track_id,frame,t,x,y,label\n{rows}")
    done = run("info", "named.csv")
    assert done.returncode == 0 and label in done.stdout


def numeric_options():
    """Return the program, command and name of every option that takes a number with a fraction."""
    for program in ("graphtrack", "perception"):
        app = import_module(f"{program}.cli.commands").program()
        for one in app.registered_commands:
            for parameter in inspect.signature(one.callback).parameters.values():
                kind, info, *_ = get_args(parameter.annotation)
                if kind is float or float in get_args(kind):
                    yield program, one.name, (*info.param_decls, info.default)[0]


@pytest.mark.slow
@pytest.mark.parametrize("value", others_slow(["1e999", "nan"], ["nan"]))
def test_no_number_is_infinite_or_nan(value):
    given = list(numeric_options())
    assert len(given) > 30 and ("graphtrack", "serve", "--patience") in given
    for program, name, option in given:
        done = command.run(name, f"{option}={value}", program=program)
        assert done.returncode == 2 and done.stderr.count("\n") == 1, (name, option, done.stderr)
        assert f"Invalid value for '{option}'" in done.stderr, (name, option, done.stderr)
    # A number among words, or where the name of a file may be.
    for line in (f"track - --lag {value}", f"view tracks.csv --forecast {value}"):
        assert ran_badly(line)


def ran_badly(line):
    """Return whether a command ends with one line and status 2."""
    done = run(*line.split(), rows=[])
    return done.returncode == 2 and done.stderr.count("\n") == 1 and done.stderr.startswith("error: ")
