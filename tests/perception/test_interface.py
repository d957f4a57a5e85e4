"""The Python interface: the same results and defaults as those of the commands."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pandas as pd
import pytest
from command import ran

import graphtrack as gt
import perception
from graphtrack.errors import InputError
from perception.cli.follow import follow
from perception.cli.observe import observe
from perception.cli.report import report

OF_THE_SHELL = {"showing", "view", "network", "model", "reconnect", "live", "record_seconds"}
"""Options of the commands alone, and those that both take as one object."""
OTHER_NAMES = {"source": "video", "write_boxes_to": "write_boxes"}


def defaults(function: Callable[..., object]) -> dict[str, object]:
    """The options of a command or function by name, with their defaults."""
    hints, found = get_type_hints(function), {}
    for name, one in inspect.signature(function).parameters.items():
        kind = hints[name]
        if is_dataclass(kind) and name not in OF_THE_SHELL:
            found |= {field.name: field.default for field in fields(kind)}
        elif name not in OF_THE_SHELL:
            found[OTHER_NAMES.get(name, name)] = one.default
    return found


@pytest.mark.parametrize(
    ("function", "command"),
    [(perception.observe, observe), (perception.follow, follow), (perception.report, report)],
)
def test_options_and_defaults_are_those_of_the_command(
    function: Callable[..., object], command: Callable[..., object]
) -> None:
    own, of_command = defaults(function), defaults(command)
    assert own.keys() == of_command.keys()
    differ = {name for name in own if own[name] != of_command[name]}
    assert differ <= {"output", "background"}  # a file is not needed; no images are an empty sequence


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clip") / "clip"
    ran("simulate", "-o", folder, "--frames", 6, "--seed", 12)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("identified", [True, False])
def test_observe_returns_what_the_command_writes(clip: Path, tmp_path: Path, identified: bool) -> None:
    boxes, homography = tmp_path / "boxes.txt", clip / "homography.txt"
    lines = [line.split(",") for line in (clip / "boxes.txt").read_text().splitlines()]
    boxes.write_text("".join(",".join([a, b if identified else "-1", *c]) + "\n" for a, b, *c in lines))
    video, given, camera = clip / "video.mp4", ["--boxes", boxes], ["--homography", homography]
    ran("observe", video, *given, *camera, "-o", tmp_path / "command.csv")
    found = perception.observe(str(video), tmp_path / "own.csv", boxes=boxes, homography=str(homography))
    assert (tmp_path / "own.csv").read_bytes() == (tmp_path / "command.csv").read_bytes()
    again = perception.observe(video, boxes=boxes, homography=homography)
    table = pd.read_csv(tmp_path / "command.csv")
    for name in table:
        np.testing.assert_array_equal(again[name], found[name])
        np.testing.assert_allclose(again[name], table[name], atol=1e-6)
    assert again.summary.rows_used == len(table) and "rows, columns track_id" in repr(again)
    if identified:
        assert len(gt.smooth(again)) == table["track_id"].nunique()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["boxes.txt", "command.csv", "own.csv"]


@pytest.mark.slow
def test_follow_returns_what_the_command_writes(clip: Path, tmp_path: Path) -> None:
    box = 452.0, 200.0, 39.0, 120.0
    options = ["--tracker", "color", "--init", ",".join(map(str, box)), "--seed", 3]
    ran("follow", clip / "video.mp4", *options, "-o", tmp_path / "command.csv")
    found = perception.follow(clip / "video.mp4", tracker="color", init=box, seed=3)
    table = pd.read_csv(tmp_path / "command.csv")
    assert list(found) == list(table)
    assert found["state"].tolist() == table["state"].tolist()
    for name in table.columns.drop("state"):
        np.testing.assert_allclose(found[name], table[name], atol=1e-6)


def test_nothing_is_printed_and_inputs_that_cannot_be_used_are_errors(
    clip: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    perception.observe(clip / "video.mp4", boxes=clip / "boxes.txt")
    assert capfd.readouterr() == ("", "")
    with pytest.raises(InputError, match="one of them"):
        perception.observe(clip / "video.mp4", homography="a.txt", calibration="b.ci")


def test_files_of_options_may_be_text(clip: Path) -> None:
    """Keypoints of a clip give likelihoods that are not flat, and a missing model is an error."""
    network = perception.NetworkOptions(keypoints=str(clip / "keypoints.json"))
    found = perception.observe(clip / "video.mp4", network=network)
    assert np.ptp([found[f"body_p{k}"] for k in range(8)], axis=0).max() > 0.5
    with pytest.raises(InputError, match=r"none\.npz"):
        model = perception.ModelOptions(camera_models=str(clip / "none.npz"))
        perception.observe(clip / "video.mp4", boxes=clip / "boxes.txt", model=model)


@pytest.mark.slow
def test_report_returns_the_tracks_of_its_folder(clip: Path, tmp_path: Path) -> None:
    given = {"boxes": clip / "boxes.txt", "homography": clip / "homography.txt"}
    found = perception.report(clip / "video.mp4", tmp_path / "found", **given)
    read = gt.read(tmp_path / "found" / "tracks.csv")
    assert [one.track_id for one in found] == [one.track_id for one in read]
    np.testing.assert_array_equal(found[0].position, read[0].position)
