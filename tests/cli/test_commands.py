"""The commands, as a user runs them: files, help, printed text, errors, progress, speeds and noise."""

import json
import subprocess
import sys
import time
import unicodedata
import warnings
from functools import partial
from importlib import import_module
from inspect import signature
from pathlib import Path

import command
import numpy as np
import pandas as pd
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import graphtrack as gt
from graphtrack.cli import console
from graphtrack.cli.commands import program
from graphtrack.cli.console import (
    WIDE,
    column_widths,
    print_table,
    printable,
    progress_bar,
    run_app,
    shown_number,
)
from graphtrack.cli.options import command_of
from graphtrack.errors import InputWarning
from graphtrack.tracks.track import Track, TrackSet

run = partial(command.run, program="graphtrack")
ran = partial(command.ran, program="graphtrack")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "simulated.csv"
    assert run("simulate", "-o", path, "--tracks", 2, "--steps", 40).returncode == 0
    return path


@pytest.mark.slow
def test_smooth_writes_every_person_frame_with_uncertainty(simulated, tmp_path):
    program = [sys.executable, "-m", "graphtrack", "smooth", simulated, "-o", tmp_path / "out.parquet"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "out.parquet")
    assert len(table) == 80
    assert (table[["x_std", "vx_std", "body_std_deg", "head_std_deg"]] > 0).all().all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "engine"),
    [("smooth", "auto"), ("smooth", "gtsam"), ("track", "chain"), ("track", "fixed-lag"), ("track", "isam2")],
)
def test_every_engine_takes_the_best_model(simulated, tmp_path, name, engine):
    done = ran(name, simulated, "-o", tmp_path / "out.csv", "--engine", engine)
    assert "model joint" in " ".join((done.stdout + done.stderr).split())


def test_a_track_without_positions_is_named_and_the_others_come_out(tmp_path):
    rows = [{"track_id": 1, "frame": k, "t": k / 10, "x": k / 10, "y": 0.0} for k in range(20)]
    rows += [{"track_id": 2, "frame": k, "t": k / 10, "head_deg": 10.0} for k in range(5)]
    pd.DataFrame(rows).to_csv(tmp_path / "in.csv", index=False)
    done = run("smooth", tmp_path / "in.csv", "-o", tmp_path / "out.csv")
    assert done.returncode == 2 and "track 2" in done.stderr
    assert set(pd.read_csv(tmp_path / "out.csv").track_id) == {1}


@pytest.mark.parametrize("program", ["graphtrack", "perception"])
def test_every_option_has_a_text_in_the_help(program):
    group = typer.main.get_command(import_module(f"{program}.cli.commands").program())
    without = {
        f"{name} {one.name}"
        for name, each in group.commands.items()
        for one in each.params
        if not getattr(one, "help", None)
    }
    assert len(group.commands) > 5 and not without


def test_a_docstring_becomes_the_help_and_its_sections_groups_of_options():
    def walk(far: float, *, fast: bool = False, slowly: bool | None = None) -> None:
        """Walk.

        Parameters
        ----------
        far : Metres to
            walk.

        Pace
        ----
        fast : Run.
        slowly : Stroll.
        """

    options = {
        name: one.annotation.__metadata__[0] for name, one in signature(command_of(walk)).parameters.items()
    }
    assert command_of(walk).__doc__ == "Walk."
    assert {name: (one.help, one.rich_help_panel) for name, one in options.items()} == {
        "far": ("Metres to walk.", None),
        "fast": ("Run.", "Pace"),
        "slowly": ("Stroll.", "Pace"),
    }
    assert options["slowly"].param_decls == ("--slowly/--no-slowly",)


def walker(speed: float, noise: float, **channels: object) -> TrackSet:
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(200)
    position = np.column_stack([speed * t, np.zeros(200)]) + noise * rng.standard_normal((200, 2))
    return TrackSet((Track(1, np.arange(200), t, position, **channels),))  # type: ignore[arg-type]


@pytest.mark.parametrize("speed", [0.0, 1.4])
def test_info_s_speed_is_that_of_the_path_and_not_of_its_noise(speed: float, tmp_path: Path) -> None:
    """From frame to frame 10 cm of noise at 10 Hz are 1.8 m/s."""
    gt.write(walker(speed, 0.1), tmp_path / "noisy.csv")
    out = tmp_path / "info.json"
    result = CliRunner().invoke(program(), ["info", str(tmp_path / "noisy.csv"), "--json", str(out)])
    assert result.exit_code == 0, result.output
    assert json.loads(out.read_text())[0]["speed_m_s"] == pytest.approx(speed, abs=0.15)


def test_info_knows_no_speed_of_a_single_frame(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("track_id,frame,t,x,y\n1,0,0.0,1.0,2.0\n", encoding="utf-8")
    out = tmp_path / "info.json"
    assert (
        CliRunner().invoke(program(), ["info", str(tmp_path / "one.csv"), "--json", str(out)]).exit_code == 0
    )
    assert json.loads(out.read_text())[0]["speed_m_s"] is None


def test_compare_learns_the_noise_that_the_file_misstates(tmp_path: Path) -> None:
    (track,) = walker(1.2, 0.2)
    truth = np.column_stack([1.2 * track.t, np.zeros(200)])
    seen = walker(1.2, 0.2, true_position=truth, position_std=np.full(200, 0.02))
    gt.write(seen, tmp_path / "tracks.csv")
    nees = []
    for trust in ("declared", "learn"):
        out = tmp_path / f"{trust}.json"
        arguments = ["compare", str(tmp_path / "tracks.csv"), "--methods", "kf", "--model", "position"]
        arguments += ["--trust", trust]
        result = CliRunner().invoke(program(), [*arguments, "--json", str(out)])
        assert result.exit_code == 0, result.output
        nees.append(json.loads(out.read_text())["calibration"][0]["nees"])
    assert nees[0] > 10.0 and nees[1] < 2.0


def test_compare_asks_for_a_model_where_the_noise_to_learn_is_the_model_s(tmp_path: Path) -> None:
    (track,) = walker(1.2, 0.5)
    truth = np.column_stack([1.2 * track.t, np.zeros(200)])
    gt.write(walker(1.2, 0.5, true_position=truth), tmp_path / "tracks.csv")
    arguments = ["compare", str(tmp_path / "tracks.csv"), "--methods", "kf,chain", "--trust", "learn"]
    result = CliRunner().invoke(program(), arguments)
    assert isinstance(result.exception, gt.InputError) and "--model" in str(result.exception)
    assert CliRunner().invoke(program(), [*arguments, "--model", "position"]).exit_code == 0


LABEL = "\x1b[31mred\x1b[0m\x07 [bold]b[/x] :smile: \x1b]0;title\x9c"
SHOWN = "red [bold]b[/x] :smile: ]0;title"


@given(st.text(st.characters(exclude_categories=())))
def test_no_control_character_is_printable_and_all_else_is(text: str) -> None:
    shown = printable(text)
    assert all(c == "\n" or unicodedata.category(c) not in ("Cc", "Cs") for c in shown)
    assert printable(shown) == shown
    assert len(printable(text, one_line=True).splitlines()) <= 1


@pytest.fixture
def named(cwd: Path) -> str:
    name = "a\x1b[2J\nerror: b.csv"
    rows = "".join(f'1,{k},{k / 10},0,0,"{LABEL}"\n' for k in range(3))
    Path(name).write_text("track_id,frame,t,x,y,label\n" + rows)
    return name


def test_labels_and_file_names_are_shown_without_escape_sequences(named: str) -> None:
    done = run("info", named)
    assert done.returncode == 0 and SHOWN in done.stdout
    assert done.stderr.startswith("a error: b.csv: csv, rows read 3")
    assert not {"\x1b", "\x07", "\x9c"} & set(done.stdout + done.stderr)


def test_errors_are_one_line_whatever_the_names(named: str) -> None:
    done = run("info", named, "--format", "mot")
    said = done.stderr
    assert done.returncode == 2 and said.count("\n") == 1
    assert said.startswith("error: a error: b.csv, line 1: found 6 columns")
    assert "\x1b" not in said


def test_what_is_written_keeps_the_label(named: str) -> None:
    assert run("add-noise", named, "-o", "out.csv", "--position-noise", "0.1").returncode == 0
    assert gt.read("out.csv").by_id(1).label == LABEL


def test_a_table_has_a_row_for_each_and_a_dash_where_there_is_no_value(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_table("Errors", [{"method": "kf", "rmse": -0.1234}, {"method": LABEL, "rmse": float("nan")}])
    title, heading, _, *rows = [line.strip() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert (title, heading.split()) == ("Errors", ["method", "rmse"])
    assert [row.split() for row in rows] == [["kf", "-0.123"], [*SHOWN.split(), "–"]]


@given(
    st.lists(st.lists(st.text("ab ", max_size=60), min_size=2, max_size=2), min_size=1, max_size=12),
    st.integers(0, 200),
)
def test_columns_fit_where_their_words_do(columns: list[list[str]], available: int) -> None:
    widths = column_widths(columns, available)
    words = [max((len(word) for cell in cells for word in cell.split()), default=0) for cells in columns]
    natural = [max(map(len, cells)) for cells in columns]
    assert all(w <= width <= n for w, width, n in zip(words, widths, natural, strict=True))
    assert sum(widths) <= available or widths == words
    assert sum(widths) >= available or widths == natural


@pytest.mark.parametrize("narrow", [4, 40])
def test_no_column_of_a_wide_table_is_cut(narrow: int, capsys: pytest.CaptureFixture[str]) -> None:
    words = {f"heading of column {k}": "x" * (38 if k == 0 else narrow - 1) + "|" for k in range(8)}
    row = {"some words that can be wrapped": "one two three " * 5, **words}
    print_table("", [row, row])
    shown = capsys.readouterr().out
    assert shown.count("|") == 2 * 8 and "…" not in shown
    assert narrow == 40 or max(map(len, shown.splitlines())) <= WIDE


def test_large_numbers_are_shown_without_exponent() -> None:
    assert [shown_number(v) for v in (-31_812.0, 0.04884, 999.6, 1.0, 2.4e-5)] == [
        "-31,800",
        "0.0488",
        "1,000",
        "1",
        "2.4e-05",
    ]


def failing(error: BaseException) -> typer.Typer:
    """A program whose command raises an error."""
    app = typer.Typer()

    @app.command()
    def fail() -> None:
        raise error

    return app


@pytest.mark.parametrize("error", [EOFError("Ran out of input"), OSError("a broken cable"), MemoryError()])
def test_errors_of_files_and_of_the_machine_are_one_line(error, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["program"])
    with pytest.raises(SystemExit, match="2"):
        run_app(failing(error), "program")
    (line,) = capsys.readouterr().err.split()[:1]  # Typer ends the line after EOFError
    assert line == "error:"


def test_warnings_about_the_input_are_notes_without_a_place_in_the_source(monkeypatch, capsys) -> None:
    app = typer.Typer()

    @app.command()
    def warn() -> None:
        for category in (InputWarning, UserWarning):
            warnings.warn(f"a {category.__name__}", category, stacklevel=1)

    monkeypatch.setattr("sys.argv", ["program"])
    with pytest.warns(UserWarning, match="a UserWarning") as others, pytest.raises(SystemExit):
        run_app(app, "program")
    assert capsys.readouterr().err == "  note: a InputWarning\n" and len(others) == 1


def test_only_an_interrupt_is_an_interrupt(monkeypatch) -> None:
    monkeypatch.setattr("sys.argv", ["program"])
    with pytest.raises((KeyboardInterrupt, SystemExit), match=r"130|^$"):  # depends on Typer's version
        run_app(failing(KeyboardInterrupt()), "program")
    with pytest.raises(ZeroDivisionError):
        run_app(failing(ZeroDivisionError()), "program")


def test_progress_in_a_pipe_is_a_line_now_and_then(monkeypatch, capsys) -> None:
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    with progress_bar(3000) as advance:
        for _ in range(3):
            clock[0] += 0.6 * console._REPORTED_AFTER
            advance(1000)
    assert capsys.readouterr().err == "2,000 of 3,000 person-frames …\n"
    with progress_bar(None, "parts") as advance:
        advance(0, 4)
        clock[0] += console._REPORTED_AFTER
        advance(1)
    assert capsys.readouterr().err == "1 of 4 parts …\n"
