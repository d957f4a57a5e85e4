"""Packages that are optional, or slow to import and rarely needed."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from graphtrack.errors import InputError

__all__ = [
    "csgraph",
    "gtsam",
    "imported_names",
    "ndimage",
    "optimize",
    "package",
    "sparse",
    "spatial",
    "special",
    "sympy",
    "transform",
]


def imported_names(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` (PEP 562) that imports its names when they are first used.

    Reading a file then loads no solver, and printing help loads no readers.

    Parameters
    ----------
    package : full name of the module
    homes : module within the package → its names, separated by spaces
    """
    home_of = {name: home for home, names in homes.items() for name in names.split()}

    def attribute(name: str) -> Any:
        if name not in home_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{home_of[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return attribute


class _Later(ModuleType):
    """Proxy of a module that imports it at the first attribute access."""

    def __getattr__(self, name: str) -> Any:
        try:
            module = import_module(self.__name__)
        except ModuleNotFoundError as error:
            expected = "the package installed (GTSAM has no wheel for Windows: use the engine chain there)"
            raise InputError(f"no package {self.__name__}", expected) from error
        found = getattr(module, name)
        setattr(self, name, found)
        return found


if TYPE_CHECKING:
    import gtsam
    import sympy
    from scipy import ndimage, optimize, sparse, spatial, special
    from scipy.sparse import csgraph
    from scipy.spatial import transform
else:
    gtsam, sympy = _Later("gtsam"), _Later("sympy")
    ndimage, optimize, special = _Later("scipy.ndimage"), _Later("scipy.optimize"), _Later("scipy.special")
    sparse, csgraph = _Later("scipy.sparse"), _Later("scipy.sparse.csgraph")
    spatial, transform = _Later("scipy.spatial"), _Later("scipy.spatial.transform")


def package(name: str, extra: str) -> Any:
    """Return an optional package, imported when it is needed.

    Handlers that an import adds to the root logger are removed: the log belongs to the program.

    Parameters
    ----------
    name : import name of the package
    extra : extra of this package that installs it

    Raises
    ------
    InputError
        If it is not installed, with the extra to install.
    """
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(f"no package {name}", f"the extra: pip install 'graphtrack[{extra}]'") from error
    finally:
        if root.handlers != handlers:
            root.handlers[:] = handlers
            root.setLevel(level)
