"""The commands, as a user runs them."""

import subprocess
import sys
from functools import partial
from importlib import import_module
from inspect import signature

import command
import pandas as pd
import pytest
import typer

from graphtrack.cli.options import command_of

run = partial(command.run, program="graphtrack")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "simulated.csv"
    assert run("simulate", "-o", path, "--tracks", 2, "--steps", 40).returncode == 0
    return path


def test_smooth_writes_every_person_frame_with_uncertainty(simulated, tmp_path):
    program = [sys.executable, "-m", "graphtrack", "smooth", simulated, "-o", tmp_path / "out.parquet"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "out.parquet")
    assert len(table) == 80
    assert (table[["x_std", "vx_std", "body_std_deg", "head_std_deg"]] > 0).all().all()


@pytest.mark.parametrize(
    ("name", "engine"),
    [("smooth", "auto"), ("smooth", "gtsam"), ("track", "chain"), ("track", "fixed-lag"), ("track", "isam2")],
)
def test_every_engine_takes_the_best_model(simulated, tmp_path, name, engine):
    done = run(name, simulated, "-o", tmp_path / "out.csv", "--engine", engine)
    assert done.returncode == 0, done.stderr
    assert "model full" in " ".join((done.stdout + done.stderr).split())
    assert "aligned_p" in pd.read_csv(tmp_path / "out.csv")


def test_a_track_without_positions_is_named_and_the_others_come_out(tmp_path):
    rows = [{"track_id": 1, "frame": k, "t": k / 10, "x": k / 10, "y": 0.0} for k in range(20)]
    rows += [{"track_id": 2, "frame": k, "t": k / 10, "head_deg": 10.0} for k in range(5)]
    pd.DataFrame(rows).to_csv(tmp_path / "in.csv", index=False)
    done = run("smooth", tmp_path / "in.csv", "-o", tmp_path / "out.csv")
    assert done.returncode == 2 and "track 2" in done.stderr
    assert set(pd.read_csv(tmp_path / "out.csv").track_id) == {1}


def test_simulate_says_what_it_simulates(tmp_path):
    for model, said in (("joint", "model joint\n"), ("full", "model full\n")):
        output = tmp_path / "out.csv"
        done = run("simulate", "-o", output, "--tracks", 1, "--steps", 3, "--model", model)
        assert done.returncode == 0 and done.stderr.endswith(said)


@pytest.mark.parametrize("program", ["graphtrack", "perception"])
def test_every_option_has_a_text_in_the_help(program):
    group = typer.main.get_command(import_module(f"{program}.cli.commands").app)
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
