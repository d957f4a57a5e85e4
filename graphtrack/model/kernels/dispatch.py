"""How compiled functions reach each other: linked into their callers, or called by a symbol.

Numba links a function's code into all that call it, and theirs into what calls those, and optimises it anew
each time; it also gives every function what lets the interpreter call it. Of the seconds that a first run
waits that was a third. What is here stands on parts of numba that are not its public interface:
tests/model/test_dispatch.py says which properties are needed of them.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from typing import Any, NamedTuple

import llvmlite.binding
import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.compiler import CompileResult, Flags
from numba.core.registry import CPUDispatcher

from graphtrack.model.kernels.borrowing import BorrowingCompiler

Types = tuple[Any, ...]
"""Of a function's arguments, as numba has them."""


class Place(NamedTuple):
    """Where a function that is called by its symbol comes from."""

    module: str
    name: str
    arguments: Types


_PREFIX = "graphtrack."
_PLACES: dict[str, Place] = {}
"""Symbol → what stands behind it, where another process can find it, too."""


class _Flags(Flags):
    """How a function is compiled, compared by what was set.

    Numba asks at each operation whether it has been compiled with such flags; reading all of them each time
    would take a tenth of the whole.
    """

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Flags) and self._values == other._values)


class _Stored(CompileResultCacheImpl):
    """Machine code on disk with the list of what has to be there before it can be linked."""

    def check_cachable(self, cres: CompileResult) -> bool:
        return all(symbol in _PLACES for symbol in _called(cres)) and bool(super().check_cachable(cres))

    def reduce(self, cres: CompileResult) -> tuple[list[Place], Any]:
        return [_PLACES[symbol] for symbol in _called(cres)], super().reduce(cres)

    def rebuild(self, target_context: Any, payload: tuple[list[Place], Any]) -> CompileResult:
        called, result = payload
        for place in called:
            getattr(import_module(place.module), place.name).compile(place.arguments)
        return super().rebuild(target_context, result)


class _StoredEntry(_Stored):
    """The same of a function as Python calls it."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        return f"entry-{super().get_filename_base(fullname, abiflags)}"


def _called(cres: CompileResult) -> list[str]:
    """The symbols of what a function calls that is not linked into it."""
    functions = cres.library._final_module.functions
    return [one.name for one in functions if one.is_declaration and one.name.startswith(_PREFIX)]


class _Cache(FunctionCache):
    _impl_class = _Stored


class _EntryCache(FunctionCache):
    _impl_class = _StoredEntry


class _Function(CPUDispatcher):
    """A function, with and without what lets the interpreter call it."""

    _cache_of: type[FunctionCache] = _Cache

    def __init__(self, py_func: Callable[..., object], *given: Any, **options: Any) -> None:
        super().__init__(py_func, *given, pipeline_class=BorrowingCompiler, **options)
        self._compiler._customize_flags = _Flags
        self._folder = ""

    def keep_in(self, folder: str) -> None:
        """Keep the machine code in a folder."""
        self._folder = folder
        given, numba.config.CACHE_DIR = numba.config.CACHE_DIR, folder
        try:
            self._cache = self._cache_of(self.py_func)
        finally:
            numba.config.CACHE_DIR = given


class Apart(_Function):
    """A function whose machine code stands by itself: compiled once, called by its symbol, and from Python.

    Whatever calls it has to be of this module's kinds if it is kept on disk.
    """

    def add_overload(self, cres: CompileResult) -> None:
        """Have callers declare the symbol, where numba would have them link the library."""
        declared = copy.copy(cres.fndesc)
        declared.mangled_name = self._symbol(cres)
        address = cres.library.get_pointer_to_function(cres.fndesc.llvm_func_name)
        llvmlite.binding.add_symbol(declared.mangled_name, address)
        self.targetctx.remove_user_function(cres.entry_point)
        self.targetctx.insert_user_function(cres.entry_point, declared)
        super().add_overload(cres)

    def _symbol(self, cres: CompileResult) -> str:
        """The same in every process that can find the function by it."""
        place = Place(self.py_func.__module__, self.py_func.__qualname__, tuple(cres.signature.args))
        if not self._folder or "<locals>" in place.name:
            return f"{_PREFIX}{cres.fndesc.mangled_name}"
        digest = hashlib.sha256(repr(place).encode()).hexdigest()[:16]
        symbol = f"{_PREFIX}{place.name}.{digest}"
        _PLACES[symbol] = place
        return symbol


class Inner(Apart):
    """The same of a function that compiled code alone calls: it has nothing for the interpreter."""

    def __init__(self, py_func: Callable[..., object], *given: Any, **options: Any) -> None:
        super().__init__(py_func, *given, **options)
        self.targetoptions["no_cpython_wrapper"] = True

    def __call__(self, *arguments: object, **named: object) -> object:
        """Raise TypeError: there is nothing that Python could call."""
        raise TypeError(f"{self.py_func.__name__} is for compiled code alone")


class _Entry(_Function):
    """What Python calls for a function that is linked elsewhere."""

    _cache_of = _EntryCache


class Linked(_Function):
    """A function whose machine code is linked into what calls it, to be inlined where that seems to pay.

    Python can call it, too: for that it is compiled once more.
    """

    def __init__(self, py_func: Callable[..., object], *given: Any, **options: Any) -> None:
        super().__init__(py_func, *given, **options)
        self.targetoptions["no_cpython_wrapper"] = True

    def __call__(self, *arguments: object, **named: object) -> object:
        """The function's value, as Python has it."""
        return self._entry(*arguments, **named)

    @cached_property
    def _entry(self) -> _Entry:
        entry = _Entry(self.py_func, targetoptions={**self.targetoptions, "no_cpython_wrapper": False})
        if self._folder:
            entry.keep_in(self._folder)
        return entry

    @property
    def stats(self) -> Any:
        """Where machine code is kept, and how often it was found there."""
        own, entry = super().stats, self._entry.stats
        return own._replace(
            cache_hits=own.cache_hits + entry.cache_hits,
            cache_misses=own.cache_misses + entry.cache_misses,
        )
