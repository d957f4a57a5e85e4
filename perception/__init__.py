"""From pixels to the observations that `graphtrack` smooths: people, heads, body and head pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

from graphtrack.packages import imported_names

if TYPE_CHECKING:
    from perception.cli.observe import ModelOptions
    from perception.cli.searching import NetworkOptions
    from perception.interface import follow, observe, report
    from perception.observation.tables import Observations

__all__ = ["ModelOptions", "NetworkOptions", "Observations", "follow", "observe", "report"]

__getattr__ = imported_names(
    __name__,
    {
        "cli.observe": "ModelOptions",
        "cli.searching": "NetworkOptions",
        "interface": "follow observe report",
        "observation.tables": "Observations",
    },
)


def __dir__() -> list[str]:
    return sorted(__all__)
