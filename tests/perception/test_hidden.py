"""Hidden people: shares of their pictures, and likelihoods that say less of them."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from command import run
from hypothesis import given
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.model.parameters import LikelihoodParameters, Parameters
from graphtrack.model.terms.classes import class_evidence
from graphtrack.simulation.degrade import add_class_likelihoods
from graphtrack.simulation.sampling import simulate
from perception.detection.boxes import PersonBox
from perception.detection.keypoint_files import write_keypoints
from perception.observation.hidden import are_upright, cut_shares, full_box, hidden_shares, is_too_wide
from perception.pose.keypoints import ANKLES, FACE, HIPS, KNEES, SHOULDERS, as_points

MODEL = gt.Model("joint", Parameters().with_values({"likelihood.hidden_outliers": 1.0}))
SIZE = (640, 480)
ALONE = (100.0, 100.0, 40.0, 120.0)


def test_who_stands_alone_in_the_image_is_not_hidden() -> None:
    assert (hidden_shares([ALONE, (300.0, 100.0, 40.0, 120.0)], SIZE) == 0.0).all()
    assert hidden_shares([], SIZE).shape == (0, 2)


def test_the_nearer_person_hides_the_other_as_far_as_the_boxes_overlap() -> None:
    left, top, width, height = ALONE
    nearer = (left + width / 2.0, top + height / 4.0, width, height)
    (body, head), (in_front, own_head) = hidden_shares([ALONE, nearer], SIZE)
    assert body == pytest.approx(0.5 * 0.75, abs=0.05) and head == 0.0
    assert in_front == own_head == 0.0
    assert (hidden_shares([nearer, ALONE], SIZE)[::-1] == [[body, head], [0.0, 0.0]]).all()


HEIGHTS = ((FACE, 0.93), (SHOULDERS, 0.815), (HIPS, 0.53), (KNEES, 0.285), (ANKLES, 0.04))


def standing(
    middle: float, foot: float, tall: float, border: float, *, nearer: float = 0.0
) -> tuple[tuple[float, float, float, float], np.ndarray]:
    """The visible box and the points of a person, of whom a pose network reports all, in the image or not.

    ``nearer``: share by which the head is nearer to the camera than the feet
    """
    points = np.zeros((17, 3))

    def row(at: float) -> float:
        return foot - tall * at * (1.0 - nearer) / (1.0 - nearer * at)

    for pair, at in HEIGHTS:
        points[list(pair)] = middle, row(at), 0.9
        points[list(pair)[1:], 0] += 0.1 * tall
        points[list(pair)[:1], 0] -= 0.1 * tall
    left, right = max(middle - 0.2 * tall, 0.0), min(middle + 0.2 * tall, float(SIZE[0]))
    return (left, foot - tall, right - left, min(foot, border) - foot + tall), points


@pytest.mark.parametrize("nearer", [0.0, 0.15, 0.4])
@pytest.mark.parametrize("foot", [500.0, 560.0, 620.0])
@pytest.mark.parametrize("reported", [True, False])
def test_feet_below_the_border_follow_from_the_points_above(
    nearer: float, foot: float, reported: bool
) -> None:
    """By perspective, and by points that the network reports below the border."""
    tall = 300.0
    box, points = standing(300.0, foot, tall, SIZE[1], nearer=nearer)
    if not reported:
        points[points[:, 1] >= SIZE[1]] = 0.0
    full = full_box(box, points, SIZE)
    assert full is not None and full[:3] == (box[0], box[1], box[2])
    error = abs(full[1] + full[3] - foot) / tall
    # A head that is nearer by .4 is beyond the 1-σ of the prior.
    assert error < (0.03 if reported else 0.1 if nearer < 0.3 else 0.31)
    assert foot < 550.0 or error < (foot - SIZE[1]) / tall
    np.testing.assert_allclose(cut_shares([full], SIZE), 1.0 - box[3] / full[3])
    assert foot < 550.0 or hidden_shares([full], SIZE)[0, 0] > 0.5 * (1.0 - box[3] / full[3])
    points[:, 2] = np.minimum(points[:, 2], 0.1)
    points[points[:, 1] >= SIZE[1], 2] = 0.0
    assert full_box(box, points, SIZE) is None


def test_people_without_a_top_need_two_levels() -> None:
    box, points = standing(300.0, 600.0, 640.0, SIZE[1])
    points[points[:, 1] >= SIZE[1]] = 0.0
    full = full_box((box[0], 0.0, box[2], 480.0), points, SIZE)
    assert full is not None and abs(full[1] + full[3] - 600.0) < 0.1 * 640.0
    points[list(SHOULDERS)] = points[list(KNEES)] = 0.0
    assert full_box((box[0], 0.0, box[2], 480.0), points, SIZE) is None


def test_whole_people_keep_their_box() -> None:
    for foot in (300.0, 479.5):  # also with the feet at the border
        box, points = standing(300.0, foot, 200.0, SIZE[1])
        assert full_box(box, points, SIZE) is None
        assert full_box(box, np.zeros((17, 3)), SIZE) is None
        np.testing.assert_array_equal(cut_shares([box], SIZE), 0.0)
    assert cut_shares([], SIZE).shape == (0,)
    within = np.random.default_rng(0).uniform(0.01, 0.4, (200, 4)) * [*SIZE, *SIZE]
    assert not cut_shares(within, SIZE).any()


@pytest.mark.parametrize("width", [130.0, 180.0])
def test_feet_below_the_border_follow_from_a_box_that_is_too_wide(width: float) -> None:
    tall = width / 0.41
    box = (200.0, 480.0 - 0.6 * tall, width, 0.6 * tall)
    full = full_box(box, np.zeros((17, 3)), SIZE, by_shape=True)
    assert full is not None and is_too_wide(box)
    np.testing.assert_allclose(full, (200.0, box[1], width, tall))
    above = (200.0, 100.0, width, 0.6 * tall)  # who sits is as wide, and in the picture
    assert is_too_wide(above) and full_box(above, np.zeros((17, 3)), SIZE, by_shape=True) is None
    narrow = [(50.0 * k, 50.0, 30.0, 100.0) for k in range(4)]
    assert are_upright([box]) and are_upright([box, *narrow])
    assert not are_upright([box, above, above])  # as from above


def test_no_direction_of_a_body_is_taken_from_a_part_of_it(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    rng = np.random.default_rng(0)
    cv2.imwrite(str(folder / "0.png"), rng.integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8))
    lines = ["1,1,100,100,60,150,1,-1,-1,-1", "1,2,300,300,120,180,1,-1,-1,-1"]
    (tmp_path / "boxes.txt").write_text("\n".join(lines) + "\n")
    out = tmp_path / "o.csv"
    done = run("observe", folder, "--boxes", tmp_path / "boxes.txt", "-o", out, "--fps", 10)
    assert done.returncode == 0 and "1 of 2 boxes are too wide for a standing person" in done.stderr
    rows = pd.read_csv(out).sort_values("u")
    body = rows[[f"body_p{k}" for k in range(8)]].to_numpy()
    assert np.ptp(body[0]) > 0.01 and np.ptp(body[1]) < 1e-6
    assert rows["v"].iloc[1] == pytest.approx(300.0 + 120.0 / 0.41, abs=2.0)


def test_the_middle_of_people_at_the_side_is_that_of_the_trunk() -> None:
    box, points = standing(20.0, 300.0, 200.0, SIZE[1])
    full = full_box(box, points, SIZE)
    assert full is None or full[0] + full[2] / 2.0 == pytest.approx(20.0)
    points[:, 0] += 15.0  # both sides of the trunk are visible
    box = (0.0, box[1], 75.0, box[3])
    full = full_box(box, points, SIZE)
    assert full is not None
    np.testing.assert_allclose(full, (-5.0, 100.0, 80.0, 200.0))
    np.testing.assert_allclose(cut_shares([full], SIZE), 5.0 / 80.0)


def test_rows_name_the_people_whom_the_border_cuts(tmp_path: Path) -> None:
    """Their feet are below the border, and a note counts them."""
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    people = [standing(150.0, 400.0, 200.0, SIZE[1]), standing(400.0, 560.0, 200.0, SIZE[1])]
    boxes = [PersonBox(0, k, box, keypoints=as_points(points)) for k, (box, points) in enumerate(people)]
    write_keypoints(boxes, tmp_path / "k.json")
    folder = tmp_path / "frames"
    folder.mkdir()
    (tmp_path / "0.png").rename(folder / "0.png")
    done = run("observe", folder, "--keypoints", tmp_path / "k.json", "-o", tmp_path / "o.csv")
    assert done.returncode == 0 and "1 of 2 boxes are cut by the border" in done.stderr
    rows = pd.read_csv(tmp_path / "o.csv").sort_values("u")
    np.testing.assert_allclose(rows["input_body_cut"], [0.0, 0.4], atol=0.02)
    np.testing.assert_allclose(rows["v"], [400.0, 560.0], atol=6.0)
    assert rows["input_body_hidden"].iloc[1] > 0.3


def test_what_is_cut_by_the_border_is_hidden() -> None:
    below = (100.0, 480.0 - 60.0, 40.0, 120.0)  # the lower half is outside: the head is there
    above = (100.0, -60.0, 40.0, 120.0)
    aside = (-10.0, 100.0, 40.0, 120.0)
    body, head = hidden_shares([below], SIZE)[0]
    assert body == pytest.approx(0.5) and head == 0.0
    assert hidden_shares([above], SIZE)[0] == pytest.approx([0.5, 1.0])
    assert hidden_shares([aside], SIZE)[0] == pytest.approx([0.25, 0.0], abs=0.1)


@given(st.lists(st.tuples(*[st.floats(-50, 600)] * 2, *[st.floats(5, 300)] * 2), max_size=8))
def test_shares_are_shares_and_grow_with_each_further_person(boxes) -> None:  # type: ignore[no-untyped-def]
    found = hidden_shares(boxes, SIZE)
    assert found.shape == (len(boxes), 2) and ((found >= 0.0) & (found <= 1.0)).all()
    more = hidden_shares([*boxes, (0.0, 0.0, 640.0, 2000.0)], SIZE)
    assert (more[:-1] >= found).all()


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.001, 0.5))
def test_a_hidden_share_is_an_outlier_share(share: float, gain: float, outliers: float) -> None:
    """Mixing twice with the uniform is mixing once, with 1 − (1 − ε)·(1 − g·h)."""
    classes = np.array([[0.7, 0.2, 0.05, 0.05]])
    likelihood = LikelihoodParameters(hidden_outliers=gain)
    unknown, once = np.array([np.nan]), np.ones(1)
    doubtful = class_evidence(classes, np.array([share]), once, outliers, likelihood)
    total = 1.0 - (1.0 - outliers) * (1.0 - gain * share)
    np.testing.assert_allclose(
        (1.0 - outliers) * doubtful + outliers / 4.0, (1.0 - total) * classes + total / 4.0, atol=1e-12
    )
    assert class_evidence(classes, unknown, once, outliers, likelihood) is classes


def test_a_share_outside_of_0_to_1_is_one_error() -> None:
    with pytest.raises(gt.InputError, match=r"hidden share of 1\.3"):
        class_evidence(np.ones((1, 8)), np.array([1.3]), np.ones(1), 0.05, LikelihoodParameters())


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["chain", "gtsam"])
def test_hidden_frames_with_wrong_classes_harm_less_where_they_are_said(engine: str) -> None:
    """Nobody's class of a hidden frame is right; both engines read the same share."""
    people = simulate("joint", n_tracks=6, n_steps=60, rng=np.random.default_rng(3))
    rng = np.random.default_rng(4)
    observed = add_class_likelihoods(people, rng=rng)
    found = []
    for known in (False, True):
        tracks = []
        for track in observed:
            hidden = np.zeros(len(track))
            hidden[15:35] = 0.95
            classes = track.head_likelihood.copy()
            classes[15:35] = np.roll(classes[15:35], 3, axis=1)
            inputs = {"head_hidden": hidden} if known else {}
            tracks.append(replace(track, head_likelihood=classes, inputs=inputs))
        estimates = gt.smooth(people.with_tracks(tracks), MODEL, constants="default", engine=engine)
        off = [np.abs(of_heads(e, t)) for e, t in zip(estimates, observed, strict=True)]
        found.append(float(np.degrees(np.mean(off))))
    assert found[1] < 0.8 * found[0]


def of_heads(estimate: gt.Track, truth: gt.Track) -> np.ndarray:
    """Difference of the heads (n,), radians."""
    assert estimate.head is not None and truth.true_head is not None
    return np.angle(np.exp(1j * (estimate.head - truth.true_head)))
