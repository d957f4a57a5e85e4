"""The chain engine for a list of terms: that of the package, or one written for terms of a user's own."""

from __future__ import annotations

import atexit
import hashlib
import importlib
import importlib.util
import re
import shutil
import sys
import tempfile
import uuid
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from graphtrack.errors import InputError
from graphtrack.inference.chain import advance, basin_search, covariance, newton, solver, window_kernels
from graphtrack.model import Model, Term
from graphtrack.model.kernels import program
from graphtrack.model.kernels.compiled import machine_code_folder
from graphtrack.model.kernels.generator import Program
from graphtrack.model.kernels.kernel import Function
from graphtrack.model.kernels.packing import RecordTypes
from graphtrack.model.model import every_term

Compiled = Callable[..., Any]

_PROGRAM = program.__name__
_CALLERS = tuple(module.__name__ for module in (newton, basin_search, covariance, solver, window_kernels, advance))
"""The modules whose functions call those of the frame program, directly or not."""

_PUBLIC = ("program", "newton", "basin_search", "solver", "covariance", "advance")


@dataclass(frozen=True, eq=False)
class ChainProgram:
    """The compiled functions of an engine that Python calls or compiles, and the records that they read.

    Attributes
    ----------
    types : of the records
    links, switched : gates of what links a frame to the one before, and of what the couplings' modes switch
    """

    types: RecordTypes
    links: tuple[str, ...]
    switched: tuple[str, ...]
    minimise: Compiled
    solve_tracks: Compiled
    solve_lanes: Compiled
    find_other_basin: Compiled
    spread_track: Compiled
    advance: Compiled
    advance_with_modes: Compiled

    @classmethod
    def of(cls, modules: Sequence[ModuleType]) -> ChainProgram:
        """The functions in the modules `_PUBLIC` of a program."""
        frame, newton, search, solver, covariance, advance = modules
        return cls(
            RecordTypes(frame.FRAME, frame.SHARED),
            frame.LINKS,
            frame.SWITCHED,
            newton.minimise,
            solver.solve_tracks,
            solver.solve_lanes,
            search.find_other_basin,
            covariance.spread_track,
            advance.advance,
            advance.advance_with_modes,
        )


OF_PRESETS = ChainProgram.of((program, newton, basin_search, solver, covariance, advance))


def program_of(model: Model) -> ChainProgram:
    """The engine for a model whose terms are compiled; see `is_chain`."""
    return _program_of(tuple(dict.fromkeys(type(term) for term in model.compiled_terms)))


@cache
def _program_of(kinds: tuple[type[Term], ...]) -> ChainProgram:
    """The engine for some terms: the presets' where they bring nothing new, else one of their own."""
    if _brought(kinds) <= _brought(every_term()):
        return OF_PRESETS
    title = ", ".join(kind.__name__ for kind in kinds)
    functions = list(_functions(kinds))
    _check(functions)
    source = Program(kinds, title, every_term()).source
    mark = _mark(source, functions)
    package = f"graphtrack_own_{mark}" if mark else f"graphtrack_unkept_{uuid.uuid4().hex[:16]}"
    texts = {"__init__": f'"""The chain engine of {title}."""\n', "program": source}
    for caller in _CALLERS:
        path = Path(sys.modules[caller].__file__ or "")
        texts[caller.rpartition(".")[2]] = _redirected(path.read_text(encoding="utf-8"), package)
    _load(_written((machine_code_folder() if mark else None) or _passing(), package, texts), package)
    return ChainProgram.of([importlib.import_module(f"{package}.{name}") for name in _PUBLIC])


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
            if kernel.search is not None:
                yield from (one for one in vars(kernel.search).values() if one is not None)


def _check(functions: Iterable[Function]) -> None:
    """Raise InputError for a function that the program could not import."""
    for function in functions:
        name = getattr(function, "py_func", function).__name__
        if getattr(sys.modules.get(function.__module__), name, None) is not function:
            raise InputError(
                f"the kernel {name}, which no module has under that name",
                "a function at the top of a module, a script or a notebook",
            )


def _mark(source: str, functions: Iterable[Function]) -> str:
    """A digest of all that the machine code will depend on; "" where a kernel's source is in no file."""
    digest = hashlib.sha256(source.encode())
    for function in functions:
        written = Path(getattr(function, "py_func", function).__code__.co_filename)
        if not written.is_file():
            return ""
        digest.update(function.__module__.encode() + written.read_bytes())
    return digest.hexdigest()[:16]


def _passing() -> Path:
    """A folder that goes when the process ends."""
    folder = Path(tempfile.mkdtemp(prefix="graphtrack-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _redirected(text: str, package: str) -> str:
    """A caller's source, with the program and the other callers taken from the package."""
    for module in (_PROGRAM, *_CALLERS):
        text = re.sub(rf"\b{re.escape(module)}\b", f"{package}.{module.rpartition('.')[2]}", text)
    return text


def _written(home: Path, package: str, texts: dict[str, str]) -> Path:
    """The folder of the package, written whole: others may be writing the same."""
    folder = home / package
    if not folder.is_dir():
        home.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=home))
        for name, text in texts.items():
            (scratch / f"{name}.py").write_text(text, encoding="utf-8")
        try:
            scratch.rename(folder)
        except OSError:  # it is there by now
            for left in scratch.iterdir():
                left.unlink()
            scratch.rmdir()
    return folder


def _load(folder: Path, package: str) -> None:
    """Import a package from its folder."""
    location = folder / "__init__.py"
    found = importlib.util.spec_from_file_location(
        package, location, submodule_search_locations=[str(folder)]
    )
    assert found is not None and found.loader is not None
    module = sys.modules[package] = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
