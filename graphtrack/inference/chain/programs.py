"""The frame program of a model: that of the package's terms, or one generated for terms of a user's own."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Hashable, Iterable, Iterator
from functools import cache
from types import CodeType

import numpy as np

from graphtrack.errors import InputError
from graphtrack.model import Model, Term
from graphtrack.model.kernels.frame_program import OF_PRESETS, FrameProgram
from graphtrack.model.kernels.generator import Program
from graphtrack.model.kernels.kernel import Function
from graphtrack.model.kernels.layout import Field
from graphtrack.model.model import every_term


def program_of(model: Model) -> FrameProgram:
    """The frame program of a model's compiled terms."""
    return _program_of(tuple(dict.fromkeys(type(term) for term in model.compiled_terms)))


@cache
def _program_of(kinds: tuple[type[Term], ...]) -> FrameProgram:
    """The program of some terms: the presets' where they bring nothing new, else one of their own."""
    if _brought(kinds) <= _brought(every_term()):
        return OF_PRESETS
    functions = list(_functions(kinds))
    for function in functions:
        _check(function)
    title = ", ".join(kind.__name__ for kind in kinds)
    name = f"program_{_digest(functions)}"
    # The solver's machine code on disk is told apart by the names of the record's fields.
    source = Program(kinds, title, every_term(), Field(name, "of which program the record is")).source
    return FrameProgram.from_source(source, name)


def _brought(kinds: Iterable[type[Term]]) -> set[Hashable]:
    """The kernels and fields of some terms."""
    return {
        one
        for kind in kinds
        for one in (*kind.fields, *kind.shared, *(id(kernel) for kernel in kind.kernels))
    }


def _functions(kinds: Iterable[type[Term]]) -> Iterator[Function]:
    """All functions of the kernels of some terms."""
    for kind in kinds:
        for kernel in kind.kernels:
            yield kernel.function
            if kernel.add_quarter_turns is not None:
                yield kernel.add_quarter_turns


def _check(function: Function) -> None:
    """Raise InputError for a function that the program could not import."""
    name = getattr(function, "py_func", function).__name__
    if getattr(sys.modules.get(function.__module__), name, None) is not function:
        raise InputError(
            f"the kernel {name}, which no module has under that name",
            "a function at the top of a module, a script or a notebook",
        )


def _digest(functions: Iterable[Function]) -> str:
    """A digest of all that the machine code of some functions depends on."""
    digest, waiting, known = hashlib.sha256(), list(functions), set[int]()
    while waiting:
        function = getattr(waiting.pop(), "py_func", None)
        if function is None or id(function) in known:
            continue
        known.add(id(function))
        code, used = function.__code__, inspect.getclosurevars(function)
        digest.update(f"{function.__module__}.{function.__qualname__}".encode() + code.co_code)
        digest.update(repr([one for one in code.co_consts if not isinstance(one, CodeType)]).encode())
        for name, value in sorted({**used.globals, **used.nonlocals}.items()):
            if hasattr(value, "py_func"):
                waiting.append(value)
            elif isinstance(value, bool | int | float | str | tuple | np.ndarray):
                digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()[:16]
