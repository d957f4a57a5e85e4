"""Keypoint files: the formats agree, the assignment of points to people, and refused input."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from command import ran, run

from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from perception.detection.boxes import (
    FrameDetections,
    PersonBox,
    box_of,
    boxes_of,
    with_keypoints,
    write_boxes,
)
from perception.detection.keypoint_files import keypoints_by_box, read_keypoints, write_keypoints
from perception.pose.classes import PoseClasses
from perception.pose.keypoints import BY_NUMBER, N_POINTS, NAMES, USED, as_points
from perception.synthetic import Camera, Person
from perception.synthetic.people import Posture, random_appearance
from perception.synthetic.skeletons import joint_visibility, joints_of

STREET_SIZE = (320, 320)
STREET = Camera((0.0, -6.0, 2.5), np.pi / 2, -0.2, 500.0, STREET_SIZE)
BODY, HEAD = np.deg2rad([-60.0, -20.0])
FRAMES = 4


def skeleton(k: int, place: float = 0.0) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Points (17, 3) and box of a person who walks to the lower right and looks ahead, in frame k."""
    look = random_appearance(np.random.default_rng(1))
    person = Person(look, Posture((place + 0.1 * k, -0.05 * k), BODY, HEAD))
    points = np.zeros((N_POINTS, 3))
    points[list(USED), :2] = STREET.project(joints_of(look, person.posture))
    points[list(USED), 2] = 0.1 + 0.8 * joint_visibility(person, STREET)
    x, y = person.posture.position
    ankles = STREET.project(np.array([[x, y + s * 0.08, 0.08 * look.height / 1.72] for s in (1, -1)]))
    points[15:, :2], points[15:, 2] = ankles, 0.9
    ends = STREET.project(np.array([[x, y, 0.0], [x, y, look.height]]))
    height = ends[0, 1] - ends[1, 1]
    return points, (ends[0, 0] - 0.2 * height, ends[1, 1], 0.4 * height, height)


PEOPLE = {k: [skeleton(k), skeleton(k, 1.0)] for k in range(FRAMES)}


def numbered(points: np.ndarray, count: int) -> np.ndarray:
    """Points (17, 3) in another convention."""
    found = np.zeros((count, 3))
    found[list(BY_NUMBER[count])] = points
    return found


def as_coco(path: Path, count: int = 17) -> Path:
    entries = [
        {"image_id": k, "category_id": 1, "score": 0.9, "bbox": list(box),
         "keypoints": numbered(points, count).ravel().tolist()}
        for k, group in PEOPLE.items() for points, box in group
    ]  # fmt: skip
    path.write_text(json.dumps(entries))
    return path


def as_annotations(path: Path) -> Path:
    entries = json.loads(as_coco(path).read_text())
    data = {
        "images": [{"id": 100 + k, "file_name": f"images/{k:06d}.png"} for k in PEOPLE],
        "annotations": [entry | {"image_id": entry["image_id"] + 100} for entry in entries],
        "categories": [{"id": 1, "name": "person", "keypoints": list(NAMES)}],
    }
    path.write_text(json.dumps(data))
    return path


def as_openpose(folder: Path, count: int = 25) -> Path:
    folder.mkdir()
    for k, group in PEOPLE.items():
        people = [{"pose_keypoints_2d": numbered(points, count).ravel().tolist()} for points, _ in group]
        (folder / f"video_{k:012d}_keypoints.json").write_text(json.dumps({"version": 1.3, "people": people}))
    return folder


def instances(group: list[Any]) -> list[dict[str, Any]]:
    return [
        {
            "keypoints": points[:, :2].tolist(),
            "keypoint_scores": points[:, 2].tolist(),
            "bbox": [[box[0], box[1], box[0] + box[2], box[1] + box[3]]],
            "bbox_score": 0.9,
        }
        for points, box in group
    ]


def as_mmpose(path: Path, *, script: bool = False) -> Path:
    frames = [{"frame_id": k + script, "instances": instances(group)} for k, group in PEOPLE.items()]
    notes = {"keypoint_id2name": {str(k): name for k, name in enumerate(NAMES)}}
    path.write_text(json.dumps({"meta_info": notes, "instance_info": frames} if script else frames))
    return path


def as_mmpose_images(folder: Path) -> Path:
    folder.mkdir()
    for k, group in PEOPLE.items():
        (folder / f"{k:04d}.json").write_text(json.dumps(instances(group)))
    return folder


def as_mediapipe(path: Path, form: str) -> Path:
    """Landmarks in fractions of an image of 320 × 320, as programs dump them."""
    columns, rows = STREET_SIZE
    frames: list[Any] = []
    for k, group in PEOPLE.items():
        people, spaces = [], []
        for points, _ in group:
            scaled = numbered(points, 33) / [columns, rows, 1.0]
            rows_of = [{"x": x, "y": y, "z": 0.01 * x, "visibility": c} for x, y, c in scaled.tolist()]
            in_space = [{"x": y, "y": x, "z": 1.0, "visibility": c} for x, y, c in scaled.tolist()]
            people.append([list(one.values()) for one in rows_of] if form == "lists" else rows_of)
            spaces.append({"landmark": in_space})
        entry: Any = people
        if form == "objects":
            buffers = [{"landmark": one} for one in people]
            entry = {"frame": k, "pose_landmarks": buffers, "pose_world_landmarks": spaces}
        frames.append(entry)
    path.write_text(json.dumps(frames[::-1] if form == "objects" else frames))
    return path


WRITERS = {
    "coco": lambda folder: as_coco(folder / "k.json"),
    "annotations": lambda folder: as_annotations(folder / "k.json"),
    "wholebody": lambda folder: as_coco(folder / "k.json", 133),
    "openpose": lambda folder: as_openpose(folder / "k"),
    "openpose coco": lambda folder: as_openpose(folder / "k", 18),
    "mmpose": lambda folder: as_mmpose(folder / "k.json"),
    "mmpose script": lambda folder: as_mmpose(folder / "k.json", script=True),
    "mmpose images": lambda folder: as_mmpose_images(folder / "k"),
    "mediapipe": lambda folder: as_mediapipe(folder / "k.json", "plain"),
    "mediapipe lists": lambda folder: as_mediapipe(folder / "k.json", "lists"),
    "mediapipe objects": lambda folder: as_mediapipe(folder / "k.json", "objects"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_says_the_same(tmp_path: Path, name: str) -> None:
    found = read_keypoints(WRITERS[name](tmp_path), size=lambda: STREET_SIZE)
    assert list(found) == list(PEOPLE)
    for frame, people in found.items():
        points, boxes = zip(*PEOPLE[frame], strict=True)
        np.testing.assert_allclose(people.points, points, atol=1e-6)
        if "mediapipe" in name:
            assert np.isnan(people.boxes).all()
            assert people.joints is not None
            place = np.array(points) / [*STREET_SIZE, 1.0]
            if "objects" in name:  # in metres
                np.testing.assert_allclose(people.joints, place[..., [1, 0, 2]] * [1, 1, 0] + [0, 0, 1])
            else:
                np.testing.assert_allclose(people.joints[..., :2], np.array(points)[..., :2], atol=1e-6)
                np.testing.assert_allclose(people.joints[..., 2], 0.01 * np.array(points)[..., 0], atol=1e-6)
        elif "openpose" not in name:
            np.testing.assert_allclose(people.boxes, boxes, atol=1e-6)
            np.testing.assert_allclose(people.scores, 0.9)
        else:
            assert np.isnan(people.boxes).all()
            assert ((people.scores > 0.5) & (people.scores < 0.9)).all()


def test_names_of_images_say_their_frames(tmp_path: Path) -> None:
    path = as_annotations(tmp_path / "k.json")
    frames = {f"{k:06d}": 50 - k for k in PEOPLE}
    assert list(read_keypoints(path, frames.get)) == [47, 48, 49, 50]


def test_annotated_visibilities_are_no_confidences_of_2(tmp_path: Path) -> None:
    path = tmp_path / "k.json"
    points = np.zeros((17, 3))
    points[:, :2], points[:3, 2] = 5.0, (2, 1, 0)
    path.write_text(json.dumps([{"image_id": 3, "keypoints": points.ravel().tolist()}]))
    np.testing.assert_allclose(read_keypoints(path)[3].points[0, :3, 2], [1.0, 0.5, 0.0])
    points[:2, 2] = 3.7, 0.4  # scores as of heat maps
    path.write_text(json.dumps([{"image_id": 3, "keypoints": points.ravel().tolist()}]))
    np.testing.assert_allclose(read_keypoints(path)[3].points[0, :3, 2], [1.0, 0.4, 0.0])


def test_frames_without_people_count_in_lists_of_landmarks(tmp_path: Path) -> None:
    """A list of frames begins with the recording's first; an entry may be one person's landmarks."""
    person = [{"x": 0.5, "y": 0.25, "z": 0.0, "visibility": 0.75}] * 33
    path = tmp_path / "k.json"
    path.write_text(json.dumps([None, [], person, {"pose_landmarks": None}, [person, person]]))
    found = read_keypoints(path, size=lambda: (200, 100), first=10)
    assert {frame: len(people) for frame, people in found.items()} == {12: 1, 14: 2}
    assert found[12].points is not None
    np.testing.assert_allclose(found[12].points[0], [[100.0, 25.0, 0.75]] * 17)
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "0007.json").write_text(json.dumps(person))
    assert list(read_keypoints(folder, size=lambda: (200, 100))) == [7]
    with pytest.raises(InputError, match="images have a size"):
        read_keypoints(path)


LANDMARK = {"x": 0.5, "y": 0.5, "z": 0.0, "visibility": 1.0}


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ([[LANDMARK] * 21], "frame 0, person 0: 21 landmarks, expected 33"),
        ([[LANDMARK] * 33, [{"x": "left", "y": 0}] * 33], "frame 1, person 0: something else"),
        ([[LANDMARK] * 33, {"score": 1}], "frame 1 without landmarks"),
        ([[LANDMARK | {"x": 250.0, "y": 90.0}] * 33], "landmarks in pixels"),
        ([{"frame": -1, "landmarks": [LANDMARK] * 33}], "frame -1"),
        ([{"landmarks": [LANDMARK] * 33, "world_landmarks": [[LANDMARK] * 33] * 2}], "2 of 1 people"),
        ([[LANDMARK] * 32 + [None]], "something else"),
    ],
)
def test_other_landmarks_are_refused(tmp_path: Path, entries: Any, told: str) -> None:
    path = tmp_path / "k.json"
    path.write_text(json.dumps(entries))
    with pytest.raises(InputError, match=told) as error:
        read_keypoints(path, size=lambda: (200, 100))
    assert "k.json" in str(error.value) and "\n" not in str(error.value)


def test_points_in_space_go_with_the_boxes_through_a_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points, joints = as_points(rng.uniform(0, 1, (17, 3))), as_points(rng.normal(size=(17, 3)))
    boxes = [
        PersonBox(3, 1, (0.0, 0.0, 20.0, 50.0), keypoints=points, joints=joints),
        PersonBox(3, 2, (30.0, 0.0, 20.0, 50.0), keypoints=points),
    ]
    write_keypoints(boxes, tmp_path / "k.json")
    found = keypoints_by_box(
        [replace(box, keypoints=None, joints=None) for box in boxes], tmp_path / "k.json"
    )
    assert [item.joints for item in found] == [joints, None]
    assert all(item.keypoints is not None for item in found)


ENTRY = {"image_id": 1, "keypoints": [1.0] * 51}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("frame,id\n1,2\n", "JSON"),
        (json.dumps([ENTRY] * 9)[:400], "truncated"),
        ({"type": "FeatureCollection", "features": []}, "'type', 'features'"),
        ([], "a list without entries"),
        ([{"image_id": 1, "bbox": [1, 2, 3, 4]}], "entry 0 without keypoints"),
        (3, "a single value"),
        ([ENTRY, {"image_id": 1, "keypoints": [1.0] * 63}], "entry 1: 21 points, expected 17"),
        ([{"image_id": 1, "keypoints": [1.0] * 50}], "50 numbers"),
        ([{"image_id": 1, "keypoints": [[1.0, 2.0, 1.0]] * 17}], "51 numbers"),
        ([{"image_id": 1, "keypoints": "many"}], "expected numbers"),
        ([{"image_id": -4, "keypoints": [1.0] * 51}], "frame -4"),
        ([{"image_id": "street", "keypoints": [1.0] * 51}], "'street'"),
        ([ENTRY | {"bbox": [1, 2]}], "a bbox of 2 numbers"),
        ([ENTRY | {"score": "high"}], "expected numbers"),
        ([ENTRY | {"keypoints_3d": [1.0] * 50}], "keypoints_3d of 50 numbers"),
        ({"people": []}, "without a frame's number"),
        ([{"frame_id": 0, "instances": [{"keypoints": [[1, 2]] * 17}]}], "without keypoints and"),
        ([{"frame_id": 0, "instances": [{"keypoints": [[1, 2]], "keypoint_scores": [1, 2]}]}], "a score"),
        ({"instance_info": [{"frame_id": 0, "instances": None}]}, "instances"),
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path: Path, content: Any, told: str) -> None:
    path = tmp_path / "found.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(InputError, match=told) as error:
        read_keypoints(path)
    assert "found.json" in str(error.value) and "\n" not in str(error.value)


def test_points_of_other_names_and_empty_folders_are_refused(tmp_path: Path) -> None:
    path = as_mmpose(tmp_path / "k.json", script=True)
    data = json.loads(path.read_text())
    data["meta_info"]["keypoint_id2name"] = {str(k): f"joint {k}" for k in range(17)}  # as of H36M
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match="17 points named joint 0"):
        read_keypoints(path)
    with pytest.raises(InputError, match="without JSON files"):
        (tmp_path / "empty").mkdir()
        read_keypoints(tmp_path / "empty")


def test_everybody_has_their_own_points() -> None:
    """Boxes in any order; unmatched boxes have no keypoints, and no keypoints are used twice."""
    found = {
        k: FrameDetections(np.full((2, 4), np.nan), np.ones(2), np.array([points for points, _ in group]))
        for k, group in PEOPLE.items()
    }
    boxes = [
        PersonBox(k, which + 1, PEOPLE[k][which][1]) for k in reversed(range(FRAMES)) for which in (1, 0)
    ]
    boxes += [PersonBox(0, 8, (5.0, 5.0, 30.0, 70.0)), PersonBox(77, 1, PEOPLE[0][0][1])]
    shaken = PEOPLE[0][0][1]
    boxes.append(PersonBox(0, 9, (shaken[0] + 5.0, shaken[1], shaken[2], shaken[3] * 0.5)))
    for item in with_keypoints(boxes, found):
        if item.frame > 50 or item.track_id > 2:
            assert item.keypoints is None
        else:
            points = PEOPLE[item.frame][item.track_id - 1][0]
            np.testing.assert_allclose(item.keypoints, points, atol=0.01)


def test_boxes_of_points_enclose_people_whose_legs_are_hidden_too() -> None:
    for group in PEOPLE.values():
        for points, box in group:
            whole, cut = points.copy(), points.copy()
            cut[13:] = 0.0
            for given, most in ((whole, 0.06), (cut, 0.12)):
                found = box_of(given)
                assert found is not None
                assert abs(found[1] - box[1]) < most * box[3]
                assert abs(found[1] + found[3] - box[1] - box[3]) < most * box[3]
                assert abs(found[0] + found[2] / 2.0 - box[0] - box[2] / 2.0) < 0.1 * box[3]
            face = points.copy()
            face[5:] = 0.0
            assert box_of(face) is None and box_of(points * 0.0) is None
    told: list[str] = []
    alone = FrameDetections(np.full((1, 4), np.nan), np.ones(1), face[None])
    assert boxes_of({3: alone}, told.append) == [] and "1 people" in told[0]


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """Frames with nothing on them, boxes with identities, and the homography."""
    folder = tmp_path / "street"
    (folder / "frames").mkdir(parents=True)
    for k in range(FRAMES):
        cv2.imwrite(str(folder / "frames" / f"{k:04d}.png"), np.full((320, 320, 3), 90 + k, np.uint8))
    write_boxes(
        [PersonBox(k, which + 1, PEOPLE[k][which][1]) for k in range(FRAMES) for which in (0, 1)],
        folder / "boxes.txt",
    )
    np.savetxt(folder / "homography.txt", STREET.ground_camera().homography)
    return folder


def test_body_and_head_are_those_of_the_skeleton(street: Path, tmp_path: Path) -> None:
    """In the world, by the ray to each person, with boxes and without."""
    keypoints, out = as_openpose(tmp_path / "k"), tmp_path / "out.csv"
    common = "observe", street / "frames", "--homography", street / "homography.txt", "--fps", 5
    done = ran(*common, "--keypoints", keypoints, "--boxes", street / "boxes.txt", "-o", out)
    tracks = io.read_identified(out)
    assert len(tracks) == 2
    for track in tracks:
        for classes, p, angle in (
            (PoseClasses.circle(8), track.body_likelihood, BODY),
            (PoseClasses.circle(12), track.head_likelihood, HEAD),
        ):
            found = classes.mean_pan(np.log(p + 1e-9))
            assert np.abs(difference(found, angle)).max() < np.deg2rad(35.0)
            assert p.max() < 0.999
    alone = tmp_path / "alone.csv"
    done = ran(*common, "--keypoints", keypoints, "-o", alone, "--render", tmp_path / "drawn")
    assert "8 detections" in done.stderr and len(list((tmp_path / "drawn").iterdir())) == FRAMES
    table = pd.read_csv(alone)
    assert set(table["track_id"]) == {-1} and len(table) == 2 * FRAMES
    with_boxes = pd.read_csv(out)
    for name in ("x", "y"):
        distance = np.abs(np.sort(table[name]) - np.sort(with_boxes[name]))
        assert distance.max() < 0.5
    streamed = run(*common, "--keypoints", keypoints, "-o", "-")
    assert streamed.returncode == 0 and len(streamed.stdout.splitlines()) == 2 * FRAMES
    row = json.loads(streamed.stdout.splitlines()[0])
    assert row["body_p0"] == pytest.approx(table.sort_values(["frame", "u"])["body_p0"].iloc[0], abs=1e-3)


def test_boxes_without_keypoints_say_nothing_and_are_counted(street: Path, tmp_path: Path) -> None:
    path = as_coco(tmp_path / "k.json")
    path.write_text(json.dumps([entry for entry in json.loads(path.read_text()) if entry["image_id"] != 2]))
    arguments = "observe", street / "frames", "--boxes", street / "boxes.txt", "-o", tmp_path / "out.csv"
    done = ran(*arguments, "--keypoints", path)
    assert "2 of 8 boxes without keypoints" in done.stderr
    table = pd.read_csv(tmp_path / "out.csv")
    p = table[[f"head_p{k}" for k in range(12)]].to_numpy()
    np.testing.assert_allclose(p[table["frame"] == 2], 1.0 / 12.0, atol=1e-4)
    assert p[table["frame"] != 2].max(axis=1).min() > 0.2


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--models", "k.json"], "--keypoints with a model"),
        (["--body-pose-model", "k.json"], "--keypoints with a model"),
        (["--person-class", "0"], "--person-class without a network"),
        (["--input-size", "640"], "--input-size without a network"),
    ],
)
def test_options_that_do_not_go_together_are_one_line(
    street: Path, tmp_path: Path, options: list[str], told: str
) -> None:
    path = as_coco(tmp_path / "k.json")
    options = [str(path) if option == "k.json" else option for option in options]
    done = run("observe", street / "frames", "--keypoints", path, *options, "-o", tmp_path / "out.csv")
    assert done.returncode == 2 and told in done.stderr and done.stderr.count("\n") == 1
    assert sorted(one.name for one in tmp_path.iterdir()) == ["k.json", "street"]
