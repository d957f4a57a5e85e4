"""`graphtrack smooth --trust`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import run

import graphtrack as gt


@pytest.fixture
def overconfident(tmp_path: Path) -> Path:
    """Tracks whose file declares a third of the noise that they have."""
    people = gt.simulate("position", n_tracks=8, n_steps=60, fps=10.0, rng=np.random.default_rng(0))
    path = tmp_path / "people.csv"
    gt.write(people.map(lambda track: replace(track, position_std=np.full(len(track), 0.1 / 3.0))), path)
    return path


def test_smooth_tells_of_a_wrong_sigma_and_corrects_it_where_it_is_told_to(
    overconfident: Path, tmp_path: Path
) -> None:
    stds = {}
    for trust in (None, "check", "declared", "learn"):
        output = tmp_path / f"{trust}.csv"
        given = [] if trust is None else ["--trust", trust]
        done = run("smooth", overconfident, "-o", output, "--model", "position", *given, program="graphtrack")
        assert done.returncode == 0
        said = [line for line in done.stderr.splitlines() if "position: the noise is" in line]
        assert len(said) == (trust != "declared")
        assert all(("corrected" in line) == (trust == "learn") and "pos_std" in line for line in said)
        std = gt.read(output).tracks[0].std("x")
        stds[trust] = float(np.median(std))
    assert stds[None] == stds["check"] == stds["declared"] < 0.6 * stds["learn"]


def test_what_is_streamed_cannot_be_corrected(tmp_path: Path) -> None:
    people = gt.simulate("position", n_tracks=2, n_steps=5, rng=np.random.default_rng(0))
    gt.write(people, tmp_path / "people.parquet")
    files = (tmp_path / "people.parquet", "-o", tmp_path / "out.parquet")
    done = run("smooth", *files, "--stream", "--trust", "learn", program="graphtrack")
    assert done.returncode == 2
    assert "--trust" in done.stderr
