"""Identities of a stream that are text: a number for each, from half the largest on."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, ClassVar

from graphtrack.errors import InputError
from graphtrack.saved import Saved
from graphtrack.tracks.schema import INTEGERS

Identity = int | str

_SPARE = 64
"""Texts that are remembered beyond those of the people."""


class TextIdentities(Saved):
    """Numbers of identities that are text; whole numbers are their own."""

    _saved: ClassVar = {"_numbers": dict[str, int], "_next": int}

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._texts: dict[int, str] = {}
        self._next = INTEGERS["track_id"] // 2 + 1

    def number(self, identity: Identity, known: Collection[Any]) -> int:
        """Return the number of an identity, a new one for a text that is not remembered.

        ``known``: numbers of the people; of many texts those of others are forgotten

        Raises
        ------
        InputError
            For a number that a text has.
        """
        if isinstance(identity, int):
            if identity in self._texts:
                raise InputError(str(identity), "a smaller number next to identities that are text")
            return identity
        if identity not in self._numbers:
            if len(self._numbers) > 2 * len(known) + _SPARE:
                self._numbers = {text: one for text, one in self._numbers.items() if one in known}
                self._texts = {one: text for text, one in self._numbers.items()}
            while self._next in known:
                self._next += 1
            self._numbers[identity], self._texts[self._next] = self._next, identity
            self._next += 1
        return self._numbers[identity]

    def restored(self, row: dict[str, Any]) -> dict[str, Any]:
        """Return an answer with texts for the numbers of people, of gaze targets too."""
        if not self._texts:
            return row
        found = {**row, "track_id": self._texts.get(row["track_id"], row["track_id"])}
        if "attention" in row:
            found["attention"] = [
                {**one, "target": self._texts.get(one["target"], one["target"])} for one in row["attention"]
            ]
        return found

    def restore(self, state: Any) -> None:
        """Take over a `state`."""
        super().restore(state)
        self._texts = {one: text for text, one in self._numbers.items()}
