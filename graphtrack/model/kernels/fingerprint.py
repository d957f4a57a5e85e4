"""A digest of what machine code depends on: its sources, the compiler and the processor."""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
from functools import cache
from pathlib import Path

import llvmlite.binding
import numba

_IMPORT = re.compile(rb"^(?:from ([\w.]+) import|import ([\w.]+))", re.MULTILINE)
_INSTALLED = ("site-packages", "dist-packages")
_LANES = f"{__name__.rpartition('.')[0]}.vector_math"
"""With what it imports, the types that any kernel can be given in place of floats."""


@cache
def fingerprint(module: str) -> str:
    """A digest of the sources of a module and of all that it imports, directly or not, and of the machine.

    Imports are followed within the module's package, or among the files beside one without a package (a
    script), and into this package.
    """
    first = list(dict.fromkeys([module, _LANES]))
    digest, waiting, seen = hashlib.sha256(_machine().encode()), first, set(first)
    while waiting:
        source, imported = _source(waiting.pop())
        digest.update(source)
        for name in imported:
            if name not in seen and _is_followed(name, module):
                seen.add(name)
                waiting.append(name)
    return digest.hexdigest()[:16]


@cache
def source_file(module: str) -> Path | None:
    """The source file of a module, whether it is loaded or not; None where there is none."""
    if module in sys.modules:
        found = getattr(sys.modules[module], "__file__", None)
    else:
        try:
            specification = importlib.util.find_spec(module)
        except (ImportError, ValueError):
            return None
        found = specification.origin if specification is not None and specification.has_location else None
    return None if found is None else Path(found).absolute()


def _is_followed(name: str, module: str) -> bool:
    top, own = name.partition(".")[0], _name(module).partition(".")
    if top in (own[0], __name__.partition(".")[0]):
        return True
    home, beside = source_file(module), source_file(top)
    if own[1] or home is None or beside is None or home.parent.name in _INSTALLED:
        return False
    return home.parent in (beside.parent, beside.parent.parent)


def _name(module: str) -> str:
    """What a module is imported as, though it runs as the program (``python -m``)."""
    specification = getattr(sys.modules.get(module), "__spec__", None)
    return module if specification is None else str(specification.name)


@cache
def _source(module: str) -> tuple[bytes, list[str]]:
    path = source_file(module)
    if path is None or not path.is_file():
        return b"", []
    source, name = path.read_bytes(), _name(module)
    package = name if path.stem == "__init__" else name.rpartition(".")[0]
    return source, [_absolute((a or b).decode(), package) for a, b in _IMPORT.findall(source)]


def _absolute(name: str, package: str) -> str:
    try:
        return importlib.util.resolve_name(name, package)
    except ImportError:  # what looks like an import in a text need not be one
        return name


@cache
def _machine() -> str:
    binding = llvmlite.binding
    cpu, features = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    return f"numba {numba.__version__}, {cpu}, {features}"
