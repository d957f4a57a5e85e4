"""Summary of reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ReadSummary:
    """Counts of the rows of an input. ``rows_read == rows_used + rows_refused``.

    Attributes
    ----------
    refused : reason → number of rows that were left out for it
    notes : what the reader assumed or repaired, one sentence each
    """

    format: str = "memory"
    rows_read: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def rows_refused(self) -> int:
        """Rows that were left out, whatever the reason."""
        return sum(self.refused.values())

    @property
    def rows_used(self) -> int:
        """Rows that stand in the tracks."""
        return self.rows_read - self.rows_refused

    def merged(self, other: ReadSummary) -> ReadSummary:
        """The summary of both inputs together."""
        refused = dict(self.refused)
        for reason, count in other.refused.items():
            refused[reason] = refused.get(reason, 0) + count
        formats = dict.fromkeys([*self.format.split(" + "), *other.format.split(" + ")])
        return ReadSummary(
            format=" + ".join(formats),
            rows_read=self.rows_read + other.rows_read,
            refused=refused,
            notes=self.notes + tuple(n for n in other.notes if n not in self.notes),
        )
