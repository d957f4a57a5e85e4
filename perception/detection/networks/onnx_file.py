"""What an ONNX file says of itself: its inputs, its notes, and which step is made of what.

A reader of the few fields of the format (onnx.proto3) that are needed, for OpenCV runs networks but tells
neither their inputs nor their notes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.io.source import Source

_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
_GRAPH, _NOTES = 7, 14
_NODE, _INITIALIZER, _INPUT, _OUTPUT, _KNOWN = 1, 5, 11, 12, 13
_TENSOR_NAME = 8
_EXPECTED = "an ONNX file"

Shape = tuple[int | None, ...]
"""Sizes of a tensor; None: any."""


@dataclass(frozen=True)
class Step:
    """One step of a network: what it does, out of what, and what comes out."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    data: bytes


@dataclass(frozen=True, eq=False)
class OnnxFile:
    """A network.

    Attributes
    ----------
    path : of the file
    data : its content
    inputs : shapes by name, without the weights
    notes : what the exporter wrote down, such as the classes' names
    steps : in their order
    """

    path: str
    data: bytes
    inputs: dict[str, Shape]
    notes: dict[str, str]
    steps: tuple[Step, ...]

    @classmethod
    def read(cls, path: str | Path) -> OnnxFile:
        """Read a file.

        Raises
        ------
        InputError
            If it is none, is broken off, or has no inputs.
        """
        source = Source.open(path)
        try:
            model = list(_fields(source.data))
            graphs = [value for number, value in model if number == _GRAPH and isinstance(value, bytes)]
            notes = [_text_pair(value) for number, value in model if number == _NOTES]
            graph = list(_fields(graphs[0])) if graphs else []
            weights = {
                _text(_first(value, _TENSOR_NAME)) for number, value in graph if number == _INITIALIZER
            }
            inputs = dict(_named_shape(value) for number, value in graph if number == _INPUT)
            steps = tuple(_step(value) for number, value in graph if number == _NODE)
        except (ValueError, IndexError, TypeError) as error:
            raise InputError("something else, or a file that is broken off", _EXPECTED, path=path) from error
        inputs = {name: shape for name, shape in inputs.items() if name not in weights}
        if len(graphs) != 1 or not inputs or not steps:
            raise InputError("something else, without a network's inputs and steps", _EXPECTED, path=path)
        return cls(str(path), source.data, inputs, dict(notes), steps)

    def of_size(self, columns: int, rows: int) -> bytes:
        """The file with one image of this size as the input; OpenCV takes no other than fixed sizes."""
        return self._rewritten(self._fixed((1, 3, rows, columns)))

    def before_selection(self, columns: int, rows: int) -> bytes | None:
        """The same without the last part, which selects the best few (TopK); None if there is none.

        What comes out then is all that is selected from, in rows (1, n, k). OpenCV lacks layers for the part.
        """
        maker = {name: step for step in self.steps for name in step.outputs}
        selects = next((step for step in self.steps if step.kind == "TopK"), None)
        if selects is None:
            return None
        step: Step | None = selects
        for _ in self.steps:
            if step is None or step.kind in ("Split", "Slice"):
                break
            step = maker.get(step.inputs[0]) if step.inputs else None
        if step is None or step.kind not in ("Split", "Slice"):
            return None
        needed, kept = {step.inputs[0]}, []
        for one in reversed(self.steps):
            if needed & set(one.outputs):
                needed |= set(one.inputs)
                kept.append((_NODE, one.data))
        shape = self._fixed((1, 3, rows, columns))
        graph = [*reversed(kept), *(field for field in shape if field[0] not in (_NODE, _OUTPUT, _KNOWN))]
        return self._rewritten([*graph, (_OUTPUT, _tensor(step.inputs[0], (None, None, None)))])

    def _fixed(self, shape: Shape) -> list[tuple[int, int | bytes]]:
        """The fields of the graph with inputs of this shape."""
        (graph,) = [value for number, value in _fields(self.data) if number == _GRAPH]
        found = []
        for number, value in _fields(graph):
            if number == _INPUT and _named_shape(value)[0] in self.inputs:
                value = _tensor(_named_shape(value)[0], shape)
            found.append((number, value))
        return found

    def _rewritten(self, graph: Sequence[tuple[int, int | bytes]]) -> bytes:
        """The file with another graph."""
        packed = b"".join(_packed(*field) for field in graph)
        rest = [_packed(*field) for field in _fields(self.data) if field[0] != _GRAPH]
        return b"".join([*rest, _packed(_GRAPH, packed)])


def _fields(data: object) -> Iterator[tuple[int, int | bytes]]:
    """Number and value of each field of a message; ``ValueError`` where it breaks off."""
    if not isinstance(data, bytes):
        raise TypeError("no message")
    place, end = 0, len(data)
    while place < end:
        tag, place = _varint(data, place)
        number, kind = tag >> 3, tag & 7
        if number == 0:
            raise ValueError("no field")
        if kind == _VARINT:
            value, place = _varint(data, place)
            yield number, value
            continue
        length = {_EIGHT: 8, _FOUR: 4}.get(kind, 0)
        if kind == _BYTES:
            length, place = _varint(data, place)
        elif not length:
            raise ValueError("no kind of field")
        if place + length > end:
            raise ValueError("broken off")
        if kind == _BYTES:
            yield number, data[place : place + length]
        place += length


def _varint(data: bytes, place: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if place >= len(data):
            raise ValueError("broken off")
        byte = data[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
    raise ValueError("no number")


def _packed(number: int, value: int | bytes) -> bytes:
    if isinstance(value, bytes):
        return _as_varint(number << 3 | _BYTES) + _as_varint(len(value)) + value
    return _as_varint(number << 3 | _VARINT) + _as_varint(value)


def _as_varint(value: int) -> bytes:
    found = bytearray()
    while value > 0x7F:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*found, value])


def _tensor(name: str, shape: Shape) -> bytes:
    """What is said of an input or output of numbers."""
    sizes = b"".join(_packed(1, _packed(2, b"n") if size is None else _packed(1, size)) for size in shape)
    return _packed(1, name.encode()) + _packed(2, _packed(1, _packed(1, 1) + _packed(2, sizes)))


def _first(data: object, number: int) -> int | bytes:
    """The first field of that number; empty if there is none."""
    return next((value for found, value in _fields(data) if found == number), b"")


def _text(value: int | bytes) -> str:
    if not isinstance(value, bytes):
        raise ValueError("no text")
    return value.decode("utf-8")


def _text_pair(data: object) -> tuple[str, str]:
    return _text(_first(data, 1)), _text(_first(data, 2))


def _named_shape(data: object) -> tuple[str, Shape]:
    shape: Sequence[object] = []
    tensor = _first(_first(data, 2), 1)
    if tensor:
        shape = [value for number, value in _fields(_first(tensor, 2)) if number == 1]
    sizes = [next((value for number, value in _fields(one) if number == 1), None) for one in shape]
    return _text(_first(data, 1)), tuple(
        size if isinstance(size, int) and size > 0 else None for size in sizes
    )


def _step(data: object) -> Step:
    assert isinstance(data, bytes)
    names: dict[int, list[str]] = {1: [], 2: [], 4: []}
    for number, value in _fields(data):
        if number in names:
            names[number].append(_text(value))
    return Step("".join(names[4]), tuple(names[1]), tuple(names[2]), data)
