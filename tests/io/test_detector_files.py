"""Boxes in named columns, JSON lists, YOLO's labels, SDD and MOT text with classes: one answer for all."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusals import refused

import graphtrack as gt
from graphtrack.errors import InputError

FRAMES = 9
SIZE = (1600, 800)
SCALE = 0.02
THINGS = {4: (100.0, 5.0, "person"), 9: (900.0, -5.0, "person"), 5: (50.0, 0.0, "car")}


def boxes(names: dict[str, str], *, frames: bool = True) -> pd.DataFrame:
    """Two people and a car as rows, with the columns of ``names`` (key → name)."""
    rows = []
    for k in range(FRAMES):
        for who, (left, step, kind) in {
            4: (100.0, 5.0, "person"),
            9: (900.0, -5.0, "person"),
            5: (50.0, 0.0, "car"),
        }.items():
            one: dict[str, Any] = {
                "left": left + step * k,
                "top": 200.0 + who,
                "width": 60.0,
                "height": 150.0,
            }
            one |= {
                "right": one["left"] + 60.0,
                "bottom": one["top"] + 150.0,
                "class": kind,
                "confidence": 0.75,
            }
            one |= {"center_x": one["left"] + 30.0, "center_y": one["top"] + 75.0, "id": who, "frame": k}
            one |= {"time": k / 10.0}
            rows.append({name: one[key] for key, name in names.items()})
    return pd.DataFrame(rows)


def check(tracks: gt.TrackSet, ids: tuple[int, ...] = (4, 9), rate: float = 10.0) -> None:
    assert [track.track_id for track in tracks] == list(ids)
    for track, (left, step, who) in zip(tracks, ((100.0, 5.0, 4), (900.0, -5.0, 9)), strict=True):
        foot = np.column_stack([left + 30.0 + step * track.frame, np.full(len(track), 350.0 + who)])
        np.testing.assert_allclose(track.position, SCALE * foot * [1.0, -1.0], atol=1e-9)
        np.testing.assert_allclose(track.t, track.frame / rate)


FORMS = {
    "left, top, width, height": {"left": "left", "top": "top", "width": "width", "height": "height"},
    "MOT": {"left": "bb_left", "top": "bb_top", "width": "bb_width", "height": "bb_height"},
    "corners": {"left": "x_min", "top": "y_min", "right": "x_max", "bottom": "y_max"},
    "numbered corners": {"left": "x1", "top": "y1", "right": "x2", "bottom": "y2"},
    "bbox": {"left": "bbox_x", "top": "bbox_y", "width": "bbox_w", "height": "bbox_h"},
    "middles": {"center_x": "xCenter", "center_y": "yCenter", "width": "w (px)", "height": "h (px)"},
}


@pytest.mark.parametrize("ending", ["csv", "parquet", "ndjson", "json", "memory"])
@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_named_columns(form: dict[str, str], ending: str, tmp_path: Path) -> None:
    table = boxes({"frame": "frame", "id": "track_id", **form, "confidence": "conf", "class": "class_name"})
    path = tmp_path / f"boxes.{ending}"
    if ending == "csv":
        table.to_csv(path, index=False)
    elif ending == "parquet":
        table.to_parquet(path)
    elif ending != "memory":
        table.to_json(path, orient="records", lines=ending == "ndjson")
    tracks = gt.read(table if ending == "memory" else path, fps=10, metres_per_pixel=SCALE)
    check(tracks)
    assert tracks.summary.refused == {"of class car": FRAMES}
    assert not [note for note in tracks.summary.notes if "ignored" in note]
    further = gt.read(table.assign(tracker="bytetrack"), fps=10, metres_per_pixel=SCALE)
    assert "ignored columns tracker" in further.summary.notes


def test_named_by_the_user_without_ids_and_without_camera(tmp_path: Path) -> None:
    names = {
        "time": "when",
        "left": "a",
        "top": "b",
        "right": "c",
        "bottom": "d",
        "class": "kind",
        "id": "who",
    }
    path = tmp_path / "boxes.csv"
    boxes(names).assign(label="text", observed="text").to_csv(path, index=False)
    columns = "t=when,left=a,top=b,right=c,bottom=d,class=kind"
    check(gt.read(path, columns=columns + ",id=who", metres_per_pixel=SCALE))
    detected = gt.read(path, columns=columns, metres_per_pixel=SCALE)  # identities are associated
    assert len(detected) == 2 and sum(len(track) for track in detected) == 2 * FRAMES
    (car,) = gt.read(path, columns=columns + ",id=who", classes="car", metres_per_pixel=SCALE)
    assert car.track_id == 5
    rough = gt.read(path, columns=columns + ",id=who")
    assert any("NO CAMERA IS KNOWN" in note for note in rough.summary.notes)
    np.testing.assert_allclose(rough[0].position[0], np.array([130.0, -354.0]) * 1.7 / 150.0)


def test_rows_without_identity_or_box_are_refused_and_counted(tmp_path: Path) -> None:
    table = boxes({"frame": "frame", "id": "tracker_id", **FORMS["corners"], "confidence": "confidence"})
    table = table[table.tracker_id != 5].astype({"tracker_id": object})
    table.loc[table.frame == 2, "tracker_id"] = ""  # a tracker that gave None
    table.loc[table.frame == 5, "tracker_id"] = -1
    table.loc[(table.frame == 7) & (table.tracker_id == 4), ["x_min", "y_min", "x_max", "y_max"]] = np.nan
    table.loc[(table.frame == 8) & (table.tracker_id == 4), "x_max"] = 0.0
    table.to_csv(tmp_path / "sink.csv", index=False)
    tracks = gt.read(tmp_path / "sink.csv", fps=10, metres_per_pixel=SCALE)
    check(tracks)
    followed, size = "not followed by the tracker (id −1)", "right or lower edge"
    assert [len(track) for track in tracks] == [FRAMES - 4, FRAMES - 2]
    assert tracks.summary.refused[followed] == 4 and tracks.summary.refused["without a box"] == 1
    assert any(size in reason for reason in tracks.summary.refused)
    kept = gt.read(tmp_path / "sink.csv", fps=10, metres_per_pixel=SCALE, associate="repair")
    assert sum(len(track) for track in kept) >= 2 * FRAMES - 2


@pytest.mark.parametrize("form", ["lists", "frames", "flat"])
def test_results_of_ultralytics_as_json(form: str, tmp_path: Path) -> None:
    """`json.loads(result.to_json())` of each frame."""
    table = boxes({"frame": "frame", "id": "track_id", **FORMS["numbered corners"], "class": "name"})
    results: list[list[dict[str, Any]]] = [[] for _ in range(FRAMES)]
    for row in table.to_dict(orient="records"):
        box = {name: row[name] for name in ("x1", "y1", "x2", "y2")}
        one = {
            "name": row["name"],
            "class": 0 if row["name"] == "person" else 2,
            "confidence": 0.75,
            "box": box,
        }
        results[row["frame"]].append(
            one | {"track_id": row["track_id"], "keypoints": {"x": [1.0], "y": [2.0]}}
        )
    content: Any = results
    if form == "frames":
        content = {f"walk_{k}.jpg": one for k, one in enumerate(results)}
    if form == "flat":
        content = [one | {"frame": k} for k, frame in enumerate(results) for one in frame]
    (tmp_path / "results.json").write_text(json.dumps(content, indent=2))
    tracks = gt.read(tmp_path / "results.json", fps=10, metres_per_pixel=SCALE)
    check(tracks)
    (tmp_path / "results.json").write_text(json.dumps([results[0], "x"]))
    assert "list of objects" in refused(tmp_path / "results.json").expected


@pytest.mark.parametrize("sink", ["CSVSink", "JSONSink"])
def test_sinks_of_supervision(sink: str, tmp_path: Path) -> None:
    sv = pytest.importorskip("supervision", reason="the extra supervision has it")
    path = tmp_path / f"sink.{sink[:-4].lower()}"
    table = boxes({"frame": "frame", "id": "id", **FORMS["corners"], "class": "class"})
    with getattr(sv, sink)(str(path)) as writer:
        for frame, rows in table.groupby("frame"):
            found = sv.Detections(
                xyxy=rows[["x_min", "y_min", "x_max", "y_max"]].to_numpy(),
                class_id=(rows["class"] == "car").to_numpy().astype(int) * 2,
                tracker_id=None if frame == 3 else rows["id"].to_numpy(),
                data={"class_name": rows["class"].to_numpy().astype(str)},
            )
            writer.append(found, custom_data={"frame_index": frame})
    tracks = gt.read(path, fps=10, metres_per_pixel=SCALE)
    check(tracks)
    assert tracks.summary.refused == {"of class car": FRAMES, "not followed by the tracker (id −1)": 2}


@pytest.mark.parametrize("tail", ["", "id", "confidence", "confidence id", "keypoints id"])
def test_labels_of_yolo(tail: str, tmp_path: Path) -> None:
    table = boxes(
        {"frame": "frame", "id": "id", "center_x": "x", "center_y": "y", "width": "w", "height": "h"}
    )
    (tmp_path / "run" / "labels").mkdir(parents=True)
    for row in table.to_dict(orient="records"):
        cells = [2 if row["id"] == 5 else 0, row["x"] / 1600, row["y"] / 800, row["w"] / 1600, row["h"] / 800]
        ends = {"": [], "id": [row["id"]], "confidence": [0.75], "confidence id": [0.75, row["id"]]}
        cells += ends[tail] if tail in ends else [0.5] * 51 + [row["id"]]
        if row["frame"] == 3 and tail.endswith("id"):
            cells.pop()  # a frame without ids
        with (tmp_path / "run" / "labels" / f"walk_{row['frame']}.txt").open("a") as stream:
            stream.write(" ".join(f"{cell:.9g}" for cell in cells) + "\n")
    for folder in (tmp_path / "run", tmp_path / "run" / "labels"):
        tracks = gt.read(folder, fps=10, metres_per_pixel=SCALE, image_size="1600x800")
        if tail.endswith("id"):
            check(tracks)
            assert [len(track) for track in tracks] == [FRAMES - 1] * 2
        else:
            assert len(tracks) == 2 and tracks.n_frames == 2 * FRAMES
            assert (tracks[0].score is not None) == (tail == "confidence")
    assert "image_size" in refused(tmp_path / "run", fps=10, image_size="wide").found
    assert "--image-size" in refused(tmp_path / "run", fps=10, metres_per_pixel=SCALE).expected
    notes = " ".join(gt.read(tmp_path / "run").summary.notes)
    assert "16:9" in notes and "25 Hz assumed" in notes
    assert "from_ultralytics" in refused(tmp_path / "run/labels/walk_2.txt", fps=10).expected
    (tmp_path / "run/labels/walk_2.txt").write_text("0 0.5 0.5 0.1\n")
    error = refused(tmp_path / "run", fps=10)
    assert error.line == 1 and str(error.path).endswith("walk_2.txt")


def test_the_drone_dataset_has_middles_of_boxes(tmp_path: Path) -> None:
    rows = [
        f'{who} {10 * k} {20 * who} {10 * k + 8} {20 * who + 4} {3 * k} {int(k == 4)} 0 1 "{kind}"'
        for who, kind in ((0, "Pedestrian"), (1, "Biker"))
        for k in range(FRAMES)
    ]
    path = tmp_path / "annotations.txt"
    path.write_text("\n".join(rows) + "\n")
    (track,) = gt.read(path, metres_per_pixel=SCALE)
    assert track.frame.tolist() == [3 * k for k in range(FRAMES) if k != 4]
    np.testing.assert_allclose(track.t, track.frame / 30.0)
    middle = np.column_stack([10.0 * track.frame / 3.0 + 4.0, np.full(len(track), 2.0)])
    np.testing.assert_allclose(track.position, SCALE * middle * [1.0, -1.0], atol=1e-12)
    assert len(gt.read(path, metres_per_pixel=SCALE, classes=("Biker", "Pedestrian"))) == 2
    assert "metres per pixel" in refused(path).expected


H = np.array([[SCALE, 0.0, 0.0], [0.0, -SCALE, 0.0], [0.0, 0.0, 1.0]])


def mot(path: Path, tail: str, confidence: str = "1") -> Path:
    """Text with ``tail`` after the confidence: ``{kind}`` is a number of a class, ``{x}`` metres."""
    table = boxes({"frame": "frame", "id": "id", **FORMS["left, top, width, height"], "class": "kind"})
    numbers = {"person": 1, "car": 4}
    path.write_text(
        "".join(
            f"{r.frame + 1},{r.id},{r.left},{r.top},{r.width},{r.height},{confidence},"
            + tail.format(kind=numbers[r.kind], zero=numbers[r.kind] - 1, x=0.1 * r.frame)
            + "\n"
            for r in table.itertuples()
        )
    )
    return path


@pytest.mark.parametrize("tail", ["{kind},0,1", "{kind},1,2", "{zero},-1,-1"])
@pytest.mark.parametrize("camera", [True, False])
def test_classes_in_ten_columns_are_no_metres(tail: str, camera: bool, tmp_path: Path) -> None:
    path = mot(tmp_path / "uav.txt", tail)
    options: dict[str, Any] = {"homography": H} if camera else {"metres_per_pixel": SCALE}
    tracks = gt.read(path, fps=10, **options)
    assert [track.track_id for track in tracks] == [4, 9]
    np.testing.assert_allclose(tracks[0].position[0], [SCALE * 130.0, -SCALE * 354.0])
    assert sum(tracks.summary.refused.values()) == FRAMES
    if "{kind}" in tail:
        assert len(gt.read(path, fps=10, classes=("Pedestrian", "Car"), **options)) == 3


def test_metres_are_read_unless_a_camera_is_given(tmp_path: Path) -> None:
    path = mot(tmp_path / "metres.txt", "{x:.2f},2.5,0")
    tracks = gt.read(path, fps=10)
    np.testing.assert_allclose(tracks[0].position[:, 0], 0.1 * np.arange(FRAMES))
    seen = gt.read(path, fps=10, homography=H)
    np.testing.assert_allclose(seen[0].position[0], [SCALE * 130.0, -SCALE * 354.0])
    assert any("columns 8 and 9 are not read" in note for note in seen.summary.notes)
    native = tmp_path / "native.csv"
    tracks.to_table().drop(columns=["u", "v"]).to_csv(native, index=False)
    assert "--homography not used: the input has no pixels" in gt.read(native, homography=H).summary.notes


def test_confidences_of_0_throughout_are_no_mark(tmp_path: Path) -> None:
    tracks = gt.read(mot(tmp_path / "det.txt", "-1,-1,-1", "0"), fps=10, metres_per_pixel=SCALE)
    assert len(tracks) == 3 and not tracks.summary.refused
    assert any("all confidences are 0" in note for note in tracks.summary.notes)


def test_boxes_of_tables_are_scored_in_the_image(tmp_path: Path) -> None:
    table = boxes({"frame": "frame", "id": "track_id", **FORMS["corners"]})
    table.to_csv(tmp_path / "boxes.csv", index=False)
    mot(tmp_path / "truth.txt", "-1,-1,-1")
    shifted = table.assign(frame=table.frame + 1)
    shifted.to_csv(tmp_path / "one.csv", index=False)
    found = gt.score(tmp_path / "one.csv", tmp_path / "truth.txt", iou=0.5)
    assert found.together.idf1 == 1.0
    assert not found.notes
    files = tmp_path / "boxes.csv", tmp_path / "truth.txt"
    with pytest.warns(gt.InputWarning, match="begin at 0 and those of the truth at 1.*frame_offset=1"):
        zero = gt.score(*files, iou=0.9)  # counted from 0
    assert zero.together.idf1 < 1.0 and zero.notes
    found = gt.score(*files, iou=0.9, frame_offset=1)
    assert found.together.idf1 == 1.0 and not found.notes


def test_what_is_left_of_nothing_names_its_reasons(tmp_path: Path) -> None:
    every = [{"image_id": k, "category_id": 0, "bbox": [5 * k, 200, 40, 100], "score": 0.9} for k in range(9)]
    (tmp_path / "results.json").write_text(json.dumps(every))
    with pytest.raises(InputError, match=r"no detections \(9 rows of category 0\).*--class NAME"):
        gt.associate(tmp_path / "results.json", fps=10.0, metres_per_pixel=SCALE)


def test_a_wrong_rate_of_detections_is_doubted(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    places = [np.column_stack([np.arange(60), *rng.uniform(0, 900, (2, 60))]) for _ in range(2)]
    person = np.column_stack([np.arange(60), 0.05 * np.arange(60), np.zeros(60)])
    table = pd.DataFrame(np.concatenate([*places, person]), columns=["frame", "x", "y"])
    notes = gt.associate(table, fps=25.0).summary.notes
    assert any("most detections are taken for false" in note for note in notes)
