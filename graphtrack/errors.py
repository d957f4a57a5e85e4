"""Errors for users. The command line prints them in one line and exits with status 2."""

from __future__ import annotations

from pathlib import Path


class GraphtrackError(Exception):
    """Error that the user can fix: bad input, a bad option, a model that cannot be solved."""


class InputError(GraphtrackError):
    """Invalid input, with its location and the expected form.

    Parameters
    ----------
    found, expected : str
        The value found, and the expected form.
    path : path of the file, if there is one
    line : line (text files, from 1) or row (Parquet, from 1)
    column : name or number of the column
    """

    def __init__(
        self,
        found: str,
        expected: str,
        *,
        path: str | Path | None = None,
        line: int | None = None,
        column: str | int | None = None,
    ) -> None:
        self.found, self.expected = found, expected
        self.path = None if path is None else str(path)
        self.line, self.column = line, column
        super().__init__(str(self))

    def at(
        self,
        path: str | Path | None = None,
        line: int | None = None,
        column: str | int | None = None,
        hint: str = "",
    ) -> InputError:
        """Return the error with the place in a file that is known here, and a hint to the expected form."""
        return InputError(
            self.found,
            f"{self.expected}; {hint}" if hint else self.expected,
            path=self.path if path is None else path,
            line=self.line if line is None else line,
            column=self.column if column is None else column,
        )

    def __reduce__(self) -> tuple[object, ...]:
        parts = (self.found, self.expected, self.path, self.line, self.column)
        return _rebuild_input_error, (type(self), *parts)

    def __str__(self) -> str:
        place = [] if self.path is None else [self.path]
        if self.line is not None:
            place.append(f"line {self.line}")
        if self.column is not None:
            place.append(f"column {_cut(str(self.column))}")
        where = ", ".join(place)
        return f"{where + ': ' if where else ''}found {_cut(self.found)}, expected {_cut(self.expected)}"


_LONGEST = 1000  # characters of a part of a message; files may hold names of any length


def _cut(text: str) -> str:
    """Return a text without the middle of a very long one."""
    half = _LONGEST // 2
    return text if len(text) <= _LONGEST else f"{text[:half]} … {text[-half:]}"


class UnknownTrackError(InputError, KeyError):
    """Id of no track in a set; also a `KeyError`, as raised by a mapping."""


class TrackIndexError(InputError, IndexError):
    """Index of no track in a set; also an `IndexError`, as raised by a list."""


def _rebuild_input_error(
    kind: type[InputError],
    found: str,
    expected: str,
    path: str | None,
    line: int | None,
    column: str | int | None,
) -> InputError:
    return kind(found, expected, path=path, line=line, column=column)


class SolveError(GraphtrackError):
    """A track whose estimate could not be computed or failed its check."""

    def __init__(self, track_id: int, reason: str) -> None:
        self.track_id, self.reason = track_id, reason
        super().__init__(track_id, reason)

    def __str__(self) -> str:
        return f"track {self.track_id}: {self.reason}"


NO_POSITION = "found no position at all, expected at least one"
"""Reason of failure for a track without any observed position."""


class InputWarning(UserWarning):
    """Input that was used after a repair, such as frames that had to be sorted."""
