"""Modules that take longer to import than most of what is done without them: imported at their first use."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any


class _Later(ModuleType):
    """Stands for a module, and imports it when something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        found = getattr(import_module(self.__name__), name)
        setattr(self, name, found)
        return found


if TYPE_CHECKING:
    import gtsam
    from scipy import special
else:
    gtsam, special = _Later("gtsam"), _Later("scipy.special")

__all__ = ["gtsam", "special"]
