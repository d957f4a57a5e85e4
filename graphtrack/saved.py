"""Serialisation of states: objects, arrays and records as JSON-able data, restored to the last bit."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, Self, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import GraphtrackError, InputError
from graphtrack.geometry.angles import FloatArray

DAMAGES = (KeyError, TypeError, ValueError, IndexError, AttributeError, GraphtrackError)
"""Exceptions that a damaged state raises."""


class OtherSettings(InputError):
    """Error for a state of an object with other arguments."""


def damaged(
    error: Exception, expected: str = "what a smoother saved", path: str | Path | None = None
) -> InputError:
    """Return the error for a state that raised an exception, such as one of `DAMAGES`."""
    return InputError(f"a damaged state ({error!r})", expected, path=path)


def real(value: Any) -> float:
    """Return a finite number of a saved state; TypeError for other values."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise TypeError(f"{str(value)[:40]!r} in place of a finite number")
    return float(value)


def integer(value: Any) -> int:
    """Return a whole number of a saved state; TypeError for other values."""
    if type(value) is not int:
        raise TypeError(f"{str(value)[:40]!r} in place of a whole number")
    return value


def count(value: Any) -> int:
    """Return a whole number from 0 on of a saved state; TypeError or ValueError for other values."""
    if integer(value) < 0:
        raise ValueError(f"{value} in place of a count")
    return int(value)


def check_numbers(value: Any) -> None:
    """Raise TypeError for a boolean among saved numbers, at any depth."""
    if isinstance(value, list | tuple | dict):
        for one in value.values() if isinstance(value, dict) else value:
            check_numbers(one)
    elif isinstance(value, bool):
        raise TypeError(f"{value} in place of a number")


def to_text(values: FloatArray) -> str:
    """Return an array of numbers as Base64 of their bytes, without its shape."""
    return base64.b64encode(values.astype("<f8").tobytes()).decode()


def from_text(text: str) -> FloatArray:
    """Invert `to_text`; the array is flat."""
    return np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").astype(float)


def packed(values: NDArray[Any]) -> list[Any]:
    """Return an array as JSON-able data: its shape, its kind and its numbers."""
    kind = values.dtype.kind
    numbers = np.ascontiguousarray(values, complex).view(float) if kind == "c" else values
    return [list(values.shape), kind, to_text(numbers)]


def unpacked(saved: list[Any]) -> NDArray[Any]:
    """Invert `packed`."""
    shape, kind, text = saved
    if kind not in ("f", "i", "b", "c"):
        raise TypeError(f"{str(kind)[:40]!r} in place of a kind of numbers")
    numbers: NDArray[Any] = from_text(text)
    if kind == "c":
        return numbers.view(complex).reshape(shape)
    # Whole numbers up to this size are exact doubles.
    return numbers.reshape(shape).astype(np.int64 if kind == "i" else float)


def pack_tree(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested dictionaries of arrays, without lists, as JSON-able data."""
    found = {}
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value = packed(value)
        found[name] = pack_tree(value) if isinstance(value, Mapping) else value
    return found


def unpack_tree(saved: Mapping[str, Any]) -> dict[str, Any]:
    """Invert `pack_tree`."""
    found = {}
    for name, value in saved.items():
        if isinstance(value, list):
            value = unpacked(value)
        found[name] = unpack_tree(value) if isinstance(value, Mapping) else value
    return found


def pack_records(records: NDArray[np.void]) -> dict[str, list[Any]]:
    """Return records as JSON-able data, field by field."""
    return {name: packed(np.ascontiguousarray(records[name])) for name in records.dtype.names or ()}


def unpack_records(saved: Mapping[str, list[Any]], kind: np.dtype[np.void]) -> NDArray[np.void]:
    """Invert `pack_records`."""
    fields = {name: unpacked(saved[name]) for name in kind.names or ()}
    records = np.zeros(next(iter(fields.values())).shape, kind)
    for name, values in fields.items():
        records[name] = values
    return records


def pack(value: Any) -> Any:
    """Return a value as JSON-able data for `unpack`; mappings as pairs, infinities and NaN as text."""
    if isinstance(value, Saved):
        return value.state()
    if isinstance(value, np.ndarray):
        return pack_records(value) if value.dtype.names else packed(value)
    if is_dataclass(value) or hasattr(value, "_asdict"):
        names = [one.name for one in fields(value)] if is_dataclass(value) else value._fields
        return {name: pack(getattr(value, name)) for name in names}
    if isinstance(value, Mapping):
        return [[pack(key), pack(one)] for key, one in value.items()]
    if isinstance(value, list | tuple | frozenset):
        return [pack(one) for one in (sorted(value) if isinstance(value, frozenset) else value)]
    if isinstance(value, float) and not math.isfinite(value):
        return str(float(value))
    return value.item() if isinstance(value, np.generic) else value


def unpack(saved: Any, kind: Any, like: Any = None) -> Any:
    """Invert `pack` for a value of a type; an error of `DAMAGES` if it has another one.

    Parameters
    ----------
    kind : float, int, bool, str, an array, Any, a tuple, list, dict or frozenset of these, a dataclass or a
        named tuple with annotated fields, or one of them or None
    like : a value of the same type, whose arrays have the same kind and, except for 0, the same further sizes
    """
    origin, inner = get_origin(kind) or kind, get_args(kind)
    if origin in (Union, UnionType):
        return (
            None if saved is None else unpack(saved, next(one for one in inner if one is not NoneType), like)
        )
    if kind is Any:
        return saved
    if kind is float:
        return float(saved) if saved in ("nan", "inf", "-inf") else real(saved)
    if kind is int:
        return integer(saved)
    if kind in (bool, str):
        if type(saved) is not kind:
            expected = "text" if kind is str else "true or false"
            raise TypeError(f"{str(saved)[:40]!r} in place of {expected}")
        return saved
    if origin is np.ndarray:
        return _array(saved, like)
    if origin is dict:
        return {unpack(key, inner[0]): unpack(one, inner[1]) for key, one in saved}
    if origin is tuple and inner[-1] is not ...:
        return tuple(unpack(one, of) for one, of in zip(saved, inner, strict=True))
    if origin in (tuple, list, frozenset):
        return origin(unpack(one, inner[0]) for one in saved)
    hints = get_type_hints(kind)
    if not hints:
        raise TypeError(f"{kind} is no type that a state can hold")
    return kind(**{name: unpack(saved[name], of, getattr(like, name, None)) for name, of in hints.items()})


def _array(saved: Any, like: Any) -> NDArray[Any]:
    found = unpack_records(saved, like.dtype) if isinstance(saved, dict) else unpacked(saved)
    if like is not None:
        sizes = zip(found.shape[1:], like.shape[1:], strict=True)
        if found.dtype.kind != like.dtype.kind or any(size not in (one, 0) for one, size in sizes):
            raise ValueError(f"an array of {found.dtype} {found.shape}")
    return found


class Saved:
    """Object whose state can be saved, and restored in another one made with the same arguments.

    Attributes
    ----------
    _saved : name of each attribute of the state → its type as `unpack` takes it; `Saved` for one of these,
        or None
    """

    _saved: ClassVar[Mapping[str, Any]] = {}

    def state(self) -> dict[str, Any]:
        """Return the state to continue from, as JSON-able data; see `from_state`."""
        return {name: pack(getattr(self, name)) for name in self._saved}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`; an error of `DAMAGES` if it is damaged."""
        for name, kind in self._saved.items():
            own, saved = getattr(self, name), state[name]
            if kind is not Saved:
                setattr(self, name, unpack(saved, kind, own))
            elif own is not None and saved is not None:
                own.restore(saved)
            elif own is not saved:
                settings = (f"{'a' if one is not None else 'no'} {name.strip('_')}" for one in (saved, own))
                raise OtherSettings(*settings)

    @classmethod
    def from_state(cls, state: Mapping[str, Any], *arguments: Any, **options: Any) -> Self:
        """Return an object that continues from a `state`, bit for bit.

        Parameters
        ----------
        *arguments, **options : as those of the object whose state it is

        Raises
        ------
        InputError
            If the state is damaged, or of other arguments.
        """
        found = cls(*arguments, **options)
        try:
            found.restore(state)
        except OtherSettings:
            raise
        except DAMAGES as error:
            raise damaged(error) from error
        return found
