"""Public names of graphtrack, and the packages that imports and commands load."""

import subprocess
import sys

import pytest

import graphtrack as gt
import graphtrack.io
from graphtrack.evaluation.compare import compare
from graphtrack.simulation.sampling import simulate

HEAVY = ("gtsam", "matplotlib", "pandas", "scipy", "scipy.special")


def modules_after(code, *arguments):
    """The heavy modules that are loaded when a program ends; ``LOADED()`` within it are those by then."""
    program = f"""
import atexit, sys
LOADED = lambda: [name for name in {HEAVY!r} if name in sys.modules]
atexit.register(lambda: print("LOADED", *LOADED(), file=sys.stderr))
{code}"""
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stderr.split("LOADED")[-1].split()


def test_every_public_name_is_there_and_listed():
    for name in gt.__all__:
        assert getattr(gt, name) is not None, name
    assert dir(gt) == sorted([*gt.__all__, "__version__"])
    assert gt.write is graphtrack.io.write and gt.ReadOptions is graphtrack.io.ReadOptions
    assert gt.compare is compare and gt.simulate is simulate
    with pytest.raises(AttributeError, match="nonsense"):
        _ = gt.nonsense


def test_the_package_itself_and_commands_that_need_no_solver_load_none(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("track_id,frame,t,x,y\n1,0,0,0,0\n1,1,0.1,,\n1,2,0.2,0.2,0\n")
    code = "import graphtrack; graphtrack.read\nfrom graphtrack.cli import main\n"
    for line in ("--version", "--help", "smooth --help", "score --help", "formats", f"info {path}"):
        code += f"sys.argv[1:] = {line.split()}\n"
        code += "try: main()\nexcept SystemExit as ended: assert not ended.code\n"
    assert modules_after(code) == []


def test_gtsam_is_loaded_where_a_graph_is_built_alone():
    code = """
import numpy as np
import graphtrack as gt
from graphtrack import constants, inference, simulation
import graphtrack.cli.commands

graphtrack.cli.commands.program()
track = gt.Track(0, np.arange(4), np.arange(4) * 0.1, np.zeros((4, 2)))
gt.solve(track, "position", engine="chain")
# SciPy itself comes with numba, but its slow modules do not.
assert LOADED() == ["scipy"], LOADED()
import graphtrack.evaluation.compare, graphtrack.simulation.sampling
assert all(map(callable, (gt.compare, gt.simulate, gt.smooth, gt.read, gt.io.read_identified)))
assert "gtsam" not in LOADED()
gt.solve(track, "position", engine="gtsam")
"""
    assert "gtsam" in modules_after(code)


def test_reading_smoothing_tracking_and_scoring_need_no_package_for_pictures_or_learning(tmp_path):
    code = "sys.modules.update(dict.fromkeys(('matplotlib', 'PIL', 'sklearn')))\n"  # importing them fails
    code += "import graphtrack as gt, numpy as np\nfrom graphtrack.simulation.sampling import simulate\n"
    code += "people = simulate('position', n_tracks=2, n_steps=12, rng=np.random.default_rng(0))\n"
    code += "gt.write(people, sys.argv[1])\nread = gt.read(sys.argv[1])\n"
    code += "for found in (gt.smooth(read, 'position'), gt.track_online(read, 'position')):\n"
    code += "    gt.score(found, people), gt.score_states(found, people)\n"
    modules_after(code, tmp_path / "people.csv")


@pytest.mark.parametrize("module", ["json", "duckdb"])
def test_a_command_ends_without_looking_for_garbage_where_nobody_minds(module):
    pytest.importorskip(module)
    code = f"import atexit, gc, sys, {module}\nfrom graphtrack.cli import main\n"
    code += "atexit.register(lambda: print(gc.get_freeze_count() > 0))\n"
    code += "sys.argv[1:] = ['--version']\nmain()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.split()[-1] == str(module != "duckdb")
    assert done.stderr == ""  # nanobind, with which duckdb is bound, would speak of leaks
