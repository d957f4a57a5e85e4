"""Speeds that `info` reports, and the noise that `compare` assumes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import graphtrack as gt
from graphtrack.cli.commands import app
from graphtrack.tracks.track import Track, TrackSet


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
    result = CliRunner().invoke(app, ["info", str(tmp_path / "noisy.csv"), "--json", str(out)])
    assert result.exit_code == 0, result.output
    assert json.loads(out.read_text())[0]["speed_m_s"] == pytest.approx(speed, abs=0.15)


def test_info_knows_no_speed_of_a_single_frame(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("track_id,frame,t,x,y\n1,0,0.0,1.0,2.0\n", encoding="utf-8")
    out = tmp_path / "info.json"
    assert CliRunner().invoke(app, ["info", str(tmp_path / "one.csv"), "--json", str(out)]).exit_code == 0
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
        result = CliRunner().invoke(app, [*arguments, "--json", str(out)])
        assert result.exit_code == 0, result.output
        nees.append(json.loads(out.read_text())["calibration"][0]["nees"])
    assert nees[0] > 10.0 and nees[1] < 2.0


def test_compare_asks_for_a_model_where_the_noise_to_learn_is_the_model_s(tmp_path: Path) -> None:
    (track,) = walker(1.2, 0.5)
    truth = np.column_stack([1.2 * track.t, np.zeros(200)])
    gt.write(walker(1.2, 0.5, true_position=truth), tmp_path / "tracks.csv")
    arguments = ["compare", str(tmp_path / "tracks.csv"), "--methods", "kf,chain", "--trust", "learn"]
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, gt.InputError) and "--model" in str(result.exception)
    assert CliRunner().invoke(app, [*arguments, "--model", "position"]).exit_code == 0
