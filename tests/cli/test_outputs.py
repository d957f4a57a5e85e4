"""No output takes the place of an input or of another output, whatever the paths look like."""

import os
from pathlib import Path

import command
import numpy as np
import pytest
from walks import walk

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.scale import smooth_dataset

ROWS = "track_id,frame,t,x,y\n" + "".join(f"1,{k},{k / 10},{k / 10},0\n" for k in range(20))

COINCIDING = {
    # arguments → the names of both
    "smooth a.csv -o x.csv --report x.csv": ("--output", "--report"),
    "smooth a.csv -o x.csv --report a.csv": ("--report", "the input"),
    "smooth a.csv -o a.csv": ("--output", "the input"),
    "smooth b.csv a.csv -o ./full/../a.csv": ("--output", "the input"),
    "smooth a.csv -o link.csv": ("--output", "the input"),
    "smooth link.csv -o hard.csv": ("--output", "the input"),
    "smooth a.csv -o to-x.csv --report x.csv": ("--output", "--report"),
    "smooth a.csv -o H.txt --homography H.txt": ("--output", "--homography"),
    "smooth a.csv -o H.txt --point-pairs H.txt": ("--output", "--point-pairs"),
    "smooth a.csv -o x.csv --report m.toml --model m.toml": ("--report", "--model"),
    "smooth a.vsp -o H.txt": ("--output", "a companion file of the input"),
    "smooth parts -o parts/x.parquet": ("--output", "the input"),
    "smooth parts -o parts/a=1/x.parquet": ("--output", "the input"),
    "smooth one.parquet -o one.parquet --stream": ("--output", "the input"),
    "track a.csv -o a.csv": ("--output", "the input"),
    "track - --state m.toml --model m.toml": ("--state", "--model"),
    "track - --state H.txt --homography H.txt": ("--state", "--homography"),
    "compare a.csv --methods kf --position-noise 0.1 --json a.csv": ("--json", "the input"),
    "compare a.csv --methods kf --position-noise 0.1 --figures full": ("--figures", "the input"),
    "compare a.csv --methods kf --position-noise 0.1 --figures empty --json empty/reliability.png": (
        "--figures",
        "--json",
    ),
    "simulate -o to-m.csv --model m.toml": ("--output", "--model"),
    "add-noise a.csv -o a.csv --position-noise 0.1": ("--output", "the input"),
    "info a.csv --json a.csv": ("--json", "the input"),
    "info a.csv --calibration H.txt --json H.txt": ("--json", "--calibration"),
    "fit a.csv -o m.toml --model m.toml": ("--output", "--model"),
    "fit a.csv -o new.toml --report x --json x": ("--report", "--json"),
    "reproduce baxter-statistics --out . --json baxter-statistics.json": ("--json", "--out"),
    "reproduce chen-joint --out new --json new/chen-joint.json": ("--json", "--out"),
    "reproduce chen-joint --out full --data data --json data/salsa/features.txt": ("--json", "--data"),
    "demo --out full --model m.toml": ("--out", "--model"),
    "perception observe frames -o a.csv --boxes a.csv": ("--output", "--boxes"),
    "perception observe frames -o x.csv --write-boxes x.csv": ("--output", "--write-boxes"),
    "perception observe frames -o x.csv --write-boxes x.csv.journal": ("the journals", "--write-boxes"),
    "perception observe frames -o x.csv --write-boxes frames/1.png": ("--write-boxes", "the input"),
    "perception observe frames/1.png -o x.csv --render film.avi": ("--render", "the input"),
    "perception observe frames -o empty/x.csv --render empty": ("--output", "--render"),
    "perception follow frames/1.png -o x.csv --render film.avi": ("--render", "the input"),
    "perception follow frames -o H.csv --homography H.txt": ("--output", "--homography"),
    "perception follow frames -o empty/x.csv --render empty": ("--output", "--render"),
    "perception train templates -o a.csv --images frames --labels a.csv": ("--output", "--labels"),
}


@pytest.fixture
def here(cwd: Path) -> Path:
    for folder in ("full", "empty", "frames", "data/salsa", "parts/a=1"):
        Path(folder).mkdir(parents=True)
    for name in ("a.csv", "b.csv"):
        Path(name).write_text(ROWS)
    Path("H.txt").write_text("1 0 0\n0 1 0\n0 0 1\n")
    Path("a.vsp").write_text("1 - the number of splines\n1 - Num of control points\n0 0 0 0\n")
    Path("m.toml").write_text('preset = "position"\n')
    for name in ("data/salsa/features.txt", "frames/1.png", "parts/a.parquet", "one.parquet"):
        Path(name).write_text("something")
    os.link("a.csv", "hard.csv")
    links = {
        "link.csv": "a.csv",
        "to-x.csv": "x.csv",
        "to-m.csv": "m.toml",
        "H.csv": "H.txt",
        "film.avi": "frames/1.png",
        "full/errors.png": "../a.csv",
        "full/tracks.png": "../m.toml",
    }
    for link, target in links.items():
        Path(link).symlink_to(target)
    return cwd


def run(arguments: str) -> command.Done:
    words = arguments.split()
    program = words.pop(0) if words[0] == "perception" else "graphtrack"
    return command.run(*words, program=program)


@pytest.mark.parametrize("arguments", COINCIDING)
def test_outputs_that_coincide_are_refused_before_anything_is_read(
    here: Path, monkeypatch: pytest.MonkeyPatch, arguments: str
) -> None:
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    # A read in spite of it is detected.
    monkeypatch.setattr("graphtrack.io.source.Source.open", lambda path: pytest.fail(f"{path} was read"))
    done = run(arguments)
    said = done.stderr.splitlines()
    assert (done.returncode, len(said)) == (2, 1)
    assert all(name in said[0] for name in COINCIDING[arguments])
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


def test_files_beside_each_other_are_written(here: Path) -> None:
    assert run("add-noise a.csv -o to-x.csv --position-noise 0.1").returncode == 0
    assert run("info a.csv --json full/a.csv").returncode == 0
    assert Path("a.csv").read_text() == ROWS
    assert Path("to-x.csv").is_symlink() and gt.read("x.csv").n_frames == 20


def test_a_data_set_is_not_written_into_by_a_program_either(tmp_path: Path) -> None:
    folder = tmp_path / "parts"
    folder.mkdir()
    people = gt.TrackSet((walk(20, seed=1, track_id=1),))
    gt.write(people, tmp_path / "linked.parquet")
    gt.write(people, folder / "one.parquet")
    for output in (folder / "out.parquet", folder / "one.parquet"):
        with pytest.raises(InputError, match="the data set"):
            smooth_dataset(folder, output, "position")
    (folder / "two.parquet").symlink_to(tmp_path / "linked.parquet")
    (folder / "one.parquet").unlink()
    with pytest.raises(InputError, match="the data set"):
        smooth_dataset(folder, tmp_path / "linked.parquet", "position")
    np.testing.assert_array_equal(
        gt.read(tmp_path / "linked.parquet").by_id(1).position, people.by_id(1).position
    )
