"""Small ONNX files in the layouts of YOLO networks, whose outputs are known."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

SIDE = 64
CELLS = 64 + 16 + 4
"""Cells of strides 8, 16 and 32 in an input of 64 × 64."""


def written(
    path: Path,
    steps: Sequence[onnx.NodeProto],
    weights: Mapping[str, np.ndarray],
    output: Sequence[int],
    *,
    shape: Sequence[int | str] = (1, 3, SIDE, SIDE),
    notes: Mapping[str, str] | None = None,
    more: Mapping[str, Sequence[int]] | None = None,
) -> Path:
    """A network from "images" to "output0", and before it to ``more`` outputs by shape."""
    graph = helper.make_graph(
        list(steps),
        "network",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, list(shape))],
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, list(sides))
            for name, sides in {**(more or {}), "output0": output}.items()
        ],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 8
    helper.set_model_props(model, dict(notes or {}))
    path.write_bytes(model.SerializeToString())
    return path


def saying(name: str) -> list[onnx.NodeProto]:
    """Steps that return the weights "rows" for any image, as the tensor of that name."""
    return [
        helper.make_node("ReduceMean", ["images"], ["mean"], axes=[1, 2, 3], keepdims=1),
        helper.make_node("Mul", ["mean", "nought"], ["nothing"]),
        helper.make_node("Reshape", ["nothing", "flat"], ["nothing_flat"]),
        helper.make_node("Add", ["rows", "nothing_flat"], [name]),
    ]


def weights_of(rows: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "rows": rows.astype(np.float32),
        "nought": np.zeros(1, np.float32),
        "flat": np.array([-1], np.int64),
    }


def constant(path: Path, output: np.ndarray, **options: object) -> Path:
    """A network that returns the same (1, a, b) for every image."""
    return written(path, saying("output0"), weights_of(output), output.shape, **options)  # type: ignore[arg-type]


def output_of(kind: str, people: Sequence[Sequence[float]], classes: int, side: int = SIDE) -> np.ndarray:
    """An output of a layout with a row for each of the people, and unsure others.

    Parameters
    ----------
    kind : "anchors", "cells", "selected" or "unselected"
    people : left, top, right, bottom, score, class, and keypoints if there are any
    """
    cells = sum((side // stride) ** 2 for stride in (8, 16, 32))
    count = {"anchors": 3 * cells, "selected": 300}.get(kind, cells)
    before = {"anchors": 5 + classes, "selected": 6}.get(kind, 4 + classes)
    rows = np.zeros((count, before + max((len(one) - 6 for one in people), default=0)))
    for k, (left, top, right, bottom, score, of_class, *points) in enumerate(people):
        row = rows[7 * k]
        row[:4] = left, top, right, bottom
        if kind in ("anchors", "cells"):
            row[:4] = (left + right) / 2.0, (top + bottom) / 2.0, right - left, bottom - top
        if kind == "selected":
            row[4:6] = score, of_class
        elif kind == "anchors":
            row[4], row[5 + int(of_class)] = score**0.5, score**0.5
        else:
            row[4 + int(of_class)] = score
        row[before:] = points
    found: np.ndarray = rows.T[None] if kind == "cells" else rows[None]
    return found


def selecting(path: Path, rows: np.ndarray, classes: int, most: int = 5, **options: object) -> Path:
    """A network with the last part of v10 and v26: the best few are selected.

    Parameters
    ----------
    rows : (1, n, 4 + classes + k) corners, scores, keypoints
    """
    more = rows.shape[2] - 4 - classes
    parts = ["boxes", "scores", *(["points"] if more else [])]
    weights = weights_of(rows) | {
        "sizes": np.array([4, classes, *([more] if more else [])], np.int64),
        "most": np.array([most], np.int64),
        "last": np.array([-1], np.int64),
    }
    node = helper.make_node
    steps = [
        *saying("all"),
        node("Split", ["all", "sizes"], parts, axis=2),
        node("ReduceMax", ["scores"], ["best"], axes=[2], keepdims=0),
        node("ArgMax", ["scores"], ["class_number"], axis=2, keepdims=1),
        node("Cast", ["class_number"], ["class"], to=TensorProto.FLOAT),
        node("TopK", ["best", "most"], ["values", "best_places"], axis=-1),
        node("Reshape", ["best_places", "flat"], ["places"]),
        node("Unsqueeze", ["values", "last"], ["chosen_score"]),
    ]
    of_row = ["boxes", "class", *parts[2:]]
    steps += [node("Gather", [name, "places"], [f"chosen_{name}"], axis=1) for name in of_row]
    columns = ["chosen_boxes", "chosen_score", "chosen_class", *(f"chosen_{name}" for name in parts[2:])]
    steps += [node("Concat", columns, ["output0"], axis=2)]
    return written(path, steps, weights, (1, most, 6 + more), **options)  # type: ignore[arg-type]


def simcc(path: Path, columns: np.ndarray, rows: np.ndarray, **options: object) -> Path:
    """A network in RTMPose's layout that returns the same (1, k, columns) and (1, k, rows) always."""
    steps = [
        *saying("simcc_x"),
        helper.make_node("Add", ["of_rows", "nothing_flat"], ["output0"]),
    ]
    weights = weights_of(columns) | {"of_rows": rows.astype(np.float32)}
    return written(path, steps, weights, rows.shape, more={"simcc_x": columns.shape}, **options)  # type: ignore[arg-type]


def brightest_point(path: Path, points: int = 17, columns: int = 48, rows: int = 64) -> Path:
    """In RTMPose's layout: all points are at the brightest red column and row, in steps of half a pixel."""
    node = helper.make_node
    steps = [
        node("Conv", ["images", "red"], ["brightness"]),
        node("ReduceMax", ["brightness"], ["of_columns"], axes=[1, 2], keepdims=0),
        node("ReduceMax", ["brightness"], ["of_rows"], axes=[1, 3], keepdims=0),
    ]
    for name, output in (("of_columns", "simcc_x"), ("of_rows", "output0")):
        steps += [
            node("Unsqueeze", [name, "last"], [f"{name}_1"]),
            node("Mul", [f"{name}_1", "halves"], [f"{name}_2"]),  # (1, side, 2)
            node("Reshape", [f"{name}_2", "flat"], [f"{name}_3"]),
            node("Mul", [f"{name}_3", "of_points"], [f"{name}_4"]),
            node("Unsqueeze", [f"{name}_4", "first"], [output]),
        ]
    weights = {
        "red": np.array([[[[1.0]], [[0.0]], [[0.0]]]], np.float32),
        "halves": np.array([1.0, 0.5], np.float32),
        "of_points": np.full((points, 1), 0.25, np.float32),
        "last": np.array([-1], np.int64),
        "first": np.array([0], np.int64),
        "flat": np.array([1, -1], np.int64),
    }
    more = {"simcc_x": (1, points, 2 * columns)}
    return written(path, steps, weights, (1, points, 2 * rows), shape=(1, 3, rows, columns), more=more)


def brightest(path: Path, **options: object) -> Path:
    """In v8's layout, of one class: each bright cell of 8 × 8 pixels is a person of 16 × 32.

    The score is the brightness of red, so that a picture whose colours are exchanged has others.
    """
    side = SIDE // 8
    where = (np.arange(side) + 0.5) * 8.0
    x, y = np.meshgrid(where, where)
    small = np.zeros((1, 5, CELLS - side * side), np.float32)
    box = np.stack([x, y, np.full_like(x, 16.0), np.full_like(x, 32.0)])[None].astype(np.float32)
    weights = {
        "red": np.array([[[[1.0]], [[0.0]], [[0.0]]]], np.float32),
        "boxes": box.reshape(1, 4, -1),
        "flat_shape": np.array([1, 1, side * side], np.int64),
        "nought": np.zeros(1, np.float32),
        "small": small,
    }
    steps = [
        helper.make_node("Conv", ["images", "red"], ["brightness"]),
        helper.make_node("AveragePool", ["brightness"], ["cells"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("Reshape", ["cells", "flat_shape"], ["scores"]),
        helper.make_node("Mul", ["scores", "nought"], ["nothing"]),
        helper.make_node("Add", ["boxes", "nothing"], ["places"]),
        helper.make_node("Concat", ["places", "scores"], ["first"], axis=1),
        helper.make_node("Concat", ["first", "small"], ["output0"], axis=2),
    ]
    return written(path, steps, weights, (1, 5, CELLS), **options)  # type: ignore[arg-type]
