"""Published trackers on the first minute of Town Centre, judged as they are elsewhere."""

from dataclasses import asdict
from pathlib import Path

import pytest
from trackeval_scores import oracle, without_curves

import graphtrack as gt
from graphtrack.evaluation.matching import boxes, estimated_detections, true_detections
from graphtrack.io.read_write import read_boxes

NAMES = (
    "CNNTCM",
    "EAMTT",
    "JointMC",
    "KSP",
    "MDP",
    "MHT_DAM",
    "NOMTwSDP",
    "RNN",
    "SCEA",
    "SORT",
    "TDAM",
    "TSML_CDE",
)


@pytest.fixture(scope="module")
def recording(data_dir: Path) -> Path:
    folder = data_dir / "towncentre" / "frames_001_150"
    if not folder.is_dir():
        pytest.skip(f"no published tracks at {folder}")
    return folder


@pytest.mark.parametrize(("name", "idf1"), [("JointMC", 0.589), ("SORT", 0.440)])
def test_idf1_of_feet_through_the_calibration(name, idf1, recording, tmp_path):
    def on_ground(path):
        """The file without its positions, which are rounded to a grid, so that the camera makes them."""
        rows = [",".join([*line.split(",")[:7], "-1,-1,-1\n"]) for line in path.read_text().splitlines()]
        (tmp_path / path.name).write_text("".join(rows))
        return gt.read(tmp_path / path.name, calibration=recording.parent / "calibration.ci", fps=2.5)

    estimates, truth = on_ground(recording / "published" / f"{name}.txt"), on_ground(recording / "gt.txt")
    assert gt.score(estimates, truth).together.idf1 == pytest.approx(idf1, abs=5e-4)


@pytest.mark.parametrize("name", NAMES)
def test_all_figures_as_trackeval_has_them(name, recording):
    pytest.importorskip("trackeval", reason="pip install --no-deps trackeval==1.3.0 to compare with it")
    files = recording / "published" / f"{name}.txt", recording / "gt.txt"
    estimates, truth = (gt.read(path, fps=2.5) for path in files)
    check(gt.score(estimates, truth), [estimated_detections(estimates), true_detections(truth)], metres=1.0)
    check(gt.score(*files, iou=0.5), [boxes(read_boxes(path)) for path in files], iou=0.5)


def check(score, detections, **demand):
    theirs = oracle([tuple(detections)], **demand)
    ours = asdict(score.together)
    assert {key: ours[key] for key in without_curves(theirs)} == pytest.approx(
        without_curves(theirs), abs=1e-11
    )
    assert ours["curves"]["HOTA"] == pytest.approx(theirs["curves"]["HOTA"], abs=1e-11)
