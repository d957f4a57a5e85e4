"""ONNX files run by ONNX Runtime (the extra ``networks``); the weights are the user's."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.io.source import Source
from graphtrack.packages import package

_SMALLEST, _LARGEST = 32, 8192


class OnnxNetwork:
    """Network of one image.

    Attributes
    ----------
    path : of the file
    notes : metadata of the file
    ranks : number of dimensions of each output; 0: not stated

    Raises
    ------
    InputError
        If ONNX Runtime is missing or cannot run the file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = str(path)
        runtime = package("onnxruntime", "networks")
        options = runtime.SessionOptions()
        options.log_severity_level = 4  # errors are raised, not printed
        data = Source.open(path).data
        try:
            self._session = runtime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no public base class
            expected = "an ONNX file that is whole"
            if Path(path).suffix.lower() in (".pt", ".pth"):
                expected = f"an ONNX file: yolo export model={Path(path).name} format=onnx writes one"
            raise InputError(_cannot_run(error), expected, path=path) from error
        self.notes: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        self.ranks = [len(output.shape or ()) for output in self._session.get_outputs()]

    def run(self, values: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Return the outputs for an input (1, 3, rows, columns)."""
        (given,) = self._session.get_inputs()
        kind = np.float16 if given.type == "tensor(float16)" else np.float32
        try:
            found: list[NDArray[np.float32]] = self._session.run(None, {given.name: values.astype(kind)})
        except Exception as error:
            raise InputError(_cannot_run(error), "a network of one image", path=self.path) from error
        return found

    def input_size(self, asked: tuple[int, int] | None) -> tuple[int, int]:
        """Return columns and rows of the input; ``asked`` are those for an input of any size.

        Raises
        ------
        InputError
            If the input is no image in colour, or has another size, or any and none is asked.
        """
        inputs, path = self._session.get_inputs(), self.path
        if len(inputs) != 1:
            raise InputError(f"a network of {len(inputs)} inputs", "one input, an image", path=path)
        shape = [size if isinstance(size, int) else None for size in inputs[0].shape]
        as_text = f"({', '.join('any' if size is None else str(size) for size in shape)})"
        if len(shape) != 4 or shape[1] not in (3, None) or shape[0] not in (1, None):
            expected = "(1, 3, rows, columns), an image in colour"
            raise InputError(f"an input of shape {as_text}", expected, path=path)
        rows, columns = shape[2:]
        fixed = None if rows is None or columns is None else (columns, rows)
        if fixed and asked and fixed != asked:
            found = f"an input of {fixed[0]} × {fixed[1]}"
            raise InputError(found, f"--input-size {asked[0]}x{asked[1]}", path=path)
        noted = literal(self.notes.get("imgsz"))
        if fixed is None and asked is None and isinstance(noted, (list, tuple)) and len(noted) == 2:
            asked = (int(noted[1]), int(noted[0]))
        size = fixed or asked
        if size is None:
            found = f"an input of any size, {as_text}"
            raise InputError(found, "--input-size, such as 640 or 1280x736", path=path)
        if not all(_SMALLEST <= side <= _LARGEST for side in size):
            found = f"an input of {size[0]} × {size[1]}"
            raise InputError(found, f"{_SMALLEST} to {_LARGEST} pixels", path=path)
        return size


def _cannot_run(error: Exception) -> str:
    return f"a network that ONNX Runtime cannot run ({' '.join(str(error).split())[:160]})"


def literal(text: str | None) -> object:
    """Return the value of a metadata entry; None if it cannot be parsed."""
    try:
        return None if text is None else ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        return None


class ScoreCheck:
    """Check that the scores of a network are not all 0, as those of a network that is badly quantised."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._largest: dict[str, float] = {}

    def add(self, name: str, scores: NDArray[np.floating]) -> None:
        """Add the scores of an image."""
        if scores.size:
            self._largest[name] = max(self._largest.get(name, 0.0), float(np.nanmax(scores)))

    def notes(self) -> list[str]:
        """Return a sentence for each kind of scores that were 0 in all images."""
        return [
            f"{self._path}: all {name} are 0, as of networks quantised to 8 bits with one scale for "
            "positions in pixels and scores up to 1: export it, or its last layers, in 32 or 16 bits"
            for name, largest in self._largest.items()
            if largest <= 0.0
        ]
