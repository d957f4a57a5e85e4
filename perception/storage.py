"""Model files: arrays and a card in one NumPy archive, which loads without executing code.

Also records of runs: dataclasses with arrays as lines of JSON.
"""

from __future__ import annotations

import base64
import hashlib
import json
import struct
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

import numpy as np
import orjson
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.io import atomic_path
from graphtrack.limits import MemoryLimit

_CARD = "card"
_DAMAGES = (
    *(KeyError, IndexError, TypeError, ValueError, ArithmeticError, RecursionError, MemoryError),
    *(OSError, EOFError, NotImplementedError, RuntimeError, struct.error, zlib.error, zipfile.BadZipFile),
)
"""Exceptions that a damaged model file raises."""


@dataclass(frozen=True)
class ModelCard:
    """Kind, training data, figures and failures of a model.

    Attributes
    ----------
    kind : name of the classifier or detector
    trained_on, fails_when : in words
    images : number of training images
    parameters : settings of the training
    figures : measured on held-out images; the names carry the units
    """

    kind: str
    trained_on: str = ""
    fails_when: str = ""
    images: int = 0
    parameters: Mapping[str, Any] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)

    def text(self) -> str:
        """Return the card as lines of text."""
        lines = [f"{self.kind}: trained on {self.images} images", f"  trained on: {self.trained_on}"]
        lines += [f"  fails when: {self.fails_when}"] if self.fails_when else []
        lines += [f"  {name} = {value}" for name, value in self.parameters.items()]
        lines += [f"  {name}: {value:.4g}" for name, value in self.figures.items()]
        return "\n".join(lines)


def save_model(path: str | Path, card: ModelCard, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a model file (.npz) atomically.

    Raises
    ------
    InputError
        If the path cannot be written to.
    """
    text = json.dumps(asdict(card), sort_keys=True)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **{_CARD: np.array(text)}, **arrays)


def load_model(path: str | Path, kind: str | None = None) -> tuple[ModelCard, dict[str, NDArray[Any]]]:
    """Read card and arrays of a model file.

    Parameters
    ----------
    kind : required kind; None: any

    Raises
    ------
    InputError
        If the file is no model file, damaged, or of another kind.
    """
    expected = "a model file (.npz) of this program"
    try:
        with zipfile.ZipFile(path) as packed:
            size = sum(entry.file_size for entry in packed.infolist())
        MemoryLimit(Path(path), Path(path).stat().st_size).check(size, "arrays")
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        card = ModelCard(**json.loads(str(arrays.pop(_CARD))))
        _check_card(card)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError("no such file", expected, path=path) from error
    except (*_DAMAGES, AttributeError) as error:
        raise InputError("something else", expected, path=path) from error
    if kind is not None and card.kind != kind:
        raise InputError(f"a model of kind {card.kind!r}", f"kind {kind!r}", path=path)
    return card, arrays


def _check_card(card: ModelCard) -> None:
    """Raise TypeError or ValueError for fields of other types, and for parameters of many levels."""
    for one in (card.kind, card.trained_on, card.fails_when):
        if not isinstance(one, str):
            raise TypeError("a text that is none")
    if not isinstance(card.images, int) or not isinstance(card.parameters, dict):
        raise TypeError("other types than those of a card")
    for value in card.figures.values():
        float(value)
    _check_levels(card.parameters)


def _check_levels(value: object, most: int = 20) -> None:
    """Raise ValueError for lists and dictionaries within each other on more levels."""
    if most == 0:
        raise ValueError("brackets within brackets")
    for one in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_levels(one, most - 1)


class Stored(ABC):
    """Model that is written to and read from a file; ``card`` describes its training."""

    kind: ClassVar[str]
    card: ModelCard

    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """Return the numbers and words that the card stores."""

    @abstractmethod
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the learned arrays, for the file."""

    @classmethod
    @abstractmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the model with the `parameters` of the card and the `arrays`.

        Raises ``KeyError``, ``TypeError`` or ``ValueError`` for missing values.
        """

    def save(self, path: str | Path) -> None:
        """Write a model file (.npz) that `load` reads.

        Raises
        ------
        InputError
            If the model is not fitted, or the path cannot be written to.
        """
        arrays = self.arrays()
        parameters = {**self.card.parameters, **self.parameters()}
        save_model(path, replace(self.card, kind=self.kind, parameters=parameters), arrays)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a model file.

        Raises
        ------
        InputError
            If it is no model file, or one of another kind.
        """
        card, arrays = load_model(path, cls.kind)
        try:
            return cls.restored(card, arrays)
        except _DAMAGES as error:
            raise InputError("an incomplete model", f"a model of kind {cls.kind!r}", path=path) from error


def key_of(*asked: object) -> str:
    """Return the key of a run, from all that its result depends on."""
    return hashlib.sha256(repr(asked).encode()).hexdigest()


def encoded(record: object) -> bytes:
    """Encode a dataclass of numbers, text, arrays, lists and other such dataclasses as a line of JSON."""
    return orjson.dumps(record, default=_of_array)


def _of_array(values: Any) -> object:
    if isinstance(values, np.generic):
        return values.item()
    data = base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
    return {"dtype": values.dtype.str, "shape": values.shape, "data": data}


def decoded(kind: Any, values: Any) -> Any:
    """Restore a record of a kind; ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
    parts = get_args(kind)
    if NoneType in parts:
        return None if values is None else decoded(parts[0], values)
    if is_dataclass(kind):
        return _restored(kind, values)
    origin = get_origin(kind)
    if origin is np.ndarray:
        data = base64.b64decode(values["data"], validate=True)
        return np.frombuffer(data, values["dtype"]).reshape(values["shape"]).copy()
    if origin in (list, tuple):
        return origin(decoded(parts[0], part) for part in values)
    return kind(values)


def _restored(kind: Any, values: Any) -> Any:
    hints = _hints(kind)
    return kind(**{name: decoded(hints[name], part) for name, part in dict(values).items()})


@lru_cache(maxsize=16)
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)
