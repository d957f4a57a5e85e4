"""Messages of rosbags, of some of their fields: the others are empty."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


class Made:
    """Makes messages of the types that a store knows; see `graphtrack.ros.estimates.Make`."""

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._empty: dict[str, dict[str, Any]] = {}

    def __call__(self, kind: str, **fields: Any) -> Any:
        """A message of a type, with these fields."""
        if kind not in self._empty:
            _, described = self._store.fielddefs[kind]
            self._empty[kind] = {name: self._nothing(of) for name, of in described}
        empty = self._empty[kind]
        # What is empty is shared, and nobody changes it.
        return self._store.types[kind](**(fields if len(fields) == len(empty) else {**empty, **fields}))

    def _nothing(self, described: Any) -> Any:
        """The empty value of a field, as rosbags describes it."""
        from rosbags.interfaces import Nodetype

        node, of = described
        if node == Nodetype.NAME:
            return self(of)
        if node == Nodetype.BASE:
            return {"string": "", "bool": False}.get(of[0], 0.0 if of[0].startswith("float") else 0)
        (inner, name), length = of
        if inner == Nodetype.BASE and name[0] != "string":
            kind = (
                "bool" if name[0] == "bool" else "uint8" if name[0] in ("octet", "char", "byte") else name[0]
            )
            return np.zeros(length if node == Nodetype.ARRAY else 0, dtype=kind)
        return [self._nothing((inner, name)) for _ in range(length if node == Nodetype.ARRAY else 0)]
