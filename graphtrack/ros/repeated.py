"""Messages that differ in numbers alone, by the thousand.

To build and serialise a message object by object takes a millisecond for twenty people. But where the same
people are told of with the same quantities, the bytes differ in known places alone. Where these are is found
out by serialising one message with marks in the place of its numbers; the others are copies of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.ros.estimates import Person, Quantities
from graphtrack.ros.messages import SECOND

_HEADER = 4
"""Bytes before the contents of a message, from which its numbers are aligned."""

_MARK = 0xB7E1_5162_8A00_0000
"""Bits of a double that is none of a drawing; the last 24 number the marks. UTF-8 text has no such bytes."""

_SECONDS, _NANOSECONDS = 0x6AE1_5162, 0xB7E1_5163

_MOST = 2**24 // len(Quantities._fields)
"""People of whom a message can be repeated."""


class Repeated:
    """Serialised messages of people who are known in the same way.

    Parameters
    ----------
    serialise : (stamp in ns, people) → bytes, little endian
    people : as they are; their numbers do not matter
    """

    def __init__(self, serialise: Callable[[int, list[Person]], Any], people: Sequence[Person]) -> None:
        if len(people) > _MOST:
            raise InputError(f"{len(people)} people at a time", f"{_MOST} at most")
        size = len(Quantities._fields)
        marks = (np.uint64(_MARK) + np.arange(len(people) * size, dtype=np.uint64)).view(float)
        marked = [
            one._replace(of=Quantities(*marks[k * size : (k + 1) * size].tolist()))
            for k, one in enumerate(people)
        ]
        raw = bytes(serialise(_SECONDS * SECOND + _NANOSECONDS % SECOND, marked))
        self._head, self._size = raw[:_HEADER], len(raw)
        padded = raw[_HEADER:].ljust(-(-(len(raw) - _HEADER) // 8) * 8, b"\0")
        self._words = np.frombuffer(padded, dtype="<u8")
        number = self._words - np.uint64(_MARK)  # what is no mark wraps round to another number
        self._places = np.flatnonzero(number < len(marks))
        self._which = number[self._places].astype(np.int64)
        halves = self._words.view("<u4")
        self._seconds = np.flatnonzero(halves == _SECONDS)
        self._nanoseconds = np.flatnonzero(halves == _NANOSECONDS % SECOND)

    def messages(self, stamps: NDArray[np.int64], quantities: FloatArray) -> list[bytes]:
        """The messages of m times.

        Parameters
        ----------
        stamps : (m,) nanoseconds
        quantities : (m, people, 23) in the order of `Quantities`
        """
        words = np.tile(self._words, (len(stamps), 1))
        values = np.ascontiguousarray(quantities, dtype="<f8").reshape(len(stamps), -1)
        words[:, self._places] = values[:, self._which].view("<u8")
        halves = words.view("<u4")
        halves[:, self._seconds] = (stamps // SECOND)[:, None]
        halves[:, self._nanoseconds] = (stamps % SECOND)[:, None]
        end = self._size - _HEADER
        return [self._head + row[:end].tobytes() for row in words.view("u1")]
