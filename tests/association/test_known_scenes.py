"""Known parameters of a scene are kept, and the others learned: offline, online, on the command line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import ran
from crossing_people import idf1, run_online, street

import graphtrack as gt
from graphtrack.association.offline import associate_detections
from graphtrack.association.online import OnlineAssociation
from graphtrack.tracks.detections import Detections

KNOWN = {"detection_probability": 0.6, "position_std": 0.2, "duplicate_rate": 0.3, "body_turn": 1.5}


def crowded(seed: int) -> tuple[Detections, np.ndarray]:
    return street(np.random.default_rng(seed), people=14, frames=80, miss=0.15, false=1.0)


def test_what_is_known_is_kept_and_the_rest_is_learned() -> None:
    detections, _ = crowded(0)
    free = associate_detections(detections).scene
    association = OnlineAssociation(KNOWN)
    run_online(detections, association)
    for found in (associate_detections(detections, KNOWN).scene, association.scene):
        assert {name: getattr(found, name) for name in KNOWN} == KNOWN
        assert found.clutter_density == pytest.approx(free.clutter_density, rel=0.5)
        assert found.occlusion_probability != gt.SceneParameters().occlusion_probability


def test_online_a_known_scene_is_used_from_the_first_frame_on() -> None:
    """Ten seconds of further recordings of a place, with and without parameters learned from one of them."""
    taught = associate_detections(crowded(10)[0]).scene
    scores = []
    for seed in range(11, 17):
        whole, owner = crowded(seed)
        first = np.flatnonzero(whole.t < whole.t[0] + 10.0)
        begun = Detections(whole.frame[first], whole.t[first], whole.position[first])
        both = OnlineAssociation(), OnlineAssociation(taught)
        scores.append([idf1(run_online(begun, one)[0], owner[first]) for one in both])
        assert both[1].scene == taught
    without, given = np.mean(scores, axis=0)
    assert given >= without


def test_a_model_file_says_it_to_every_command(tmp_path: Path) -> None:
    detections, _ = street(np.random.default_rng(1), people=8, frames=40, miss=0.1)
    x, y = detections.position.T
    table = pd.DataFrame({"frame": detections.frame, "t": detections.t, "x": x, "y": y})
    source, file = tmp_path / "seen.csv", tmp_path / "model.toml"
    table.to_csv(source, index=False)
    # A missed detection is a death: tracks end at each gap.
    known = {"longest_gap": 0.5, "longest_filled": 0.0, "position_std": 0.23}
    gt.Model("position", scene=known).save(file)
    free = gt.associate(table)
    expected = gt.associate(table, scene=known)
    assert len(expected) > len(free)
    assert all(np.diff(track.frame).max(initial=1) == 1 for track in expected)
    std = {value for track in expected for value in track.position_std.tolist()}
    assert std == {0.23}
    for found in (
        gt.associate(source, model=file),
        gt.associate(source, {"position_std": 0.23}, model=gt.Model("joint", scene=known)),
        gt.read(source, scene=known),
        gt.smooth(source, file),
    ):
        assert [track.frame.tolist() for track in found] == [track.frame.tolist() for track in expected]
    out = ("-o", tmp_path / "out.csv")
    for command, *more in (("info",), ("smooth", *out), ("track", *out)):
        done = ran(command, source, "--model", file, *more, program="graphtrack")
        assert command == "track" or f"{len(expected)} people" in " ".join(done.stderr.split())
    assert len(gt.read(tmp_path / "out.csv")) > len(free)
    tracker = gt.OnlineTracker(file, scene={"longest_gap": 0.7})
    assert (tracker.scene.longest_gap, tracker.scene.position_std) == (0.7, 0.23)
