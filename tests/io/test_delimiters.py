"""Tables with delimiters other than commas: a one-line error, with a command that converts them."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from format_samples import sample_of
from refusals import refused

from graphtrack import io
from graphtrack.errors import InputError

TABLE = "track_id,frame,t,x,y\n" + "".join(f"7,{k},{k / 10},{1.5 + k / 8},-0.25\n" for k in range(4))
NAMES = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "spaces"}


def named(error: InputError) -> dict[str, str]:
    """The options that the message recommends."""
    words = shlex.split(error.expected.split("; ")[-1].removesuffix(" reads it"))
    assert words and all(word.startswith("--") for word in words[::2])
    return {name.removeprefix("--"): value for name, value in zip(words[::2], words[1::2], strict=True)}


@pytest.mark.parametrize("name", ["table.csv", "table.txt", "table"])
@pytest.mark.parametrize("before", ["", "sep={mark}\r\n", "\n"], ids=["", "sep", "empty"])
@pytest.mark.parametrize(("mark", "decimal"), [(";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", ".")])
def test_a_native_table_is_diagnosed(mark: str, decimal: str, before: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    table = TABLE.replace(",", mark).replace(".", decimal)
    path.write_text(before.format(mark=mark) + table)
    error = refused(path)
    assert NAMES[mark] in error.found and ("decimal commas" in error.found) == (decimal == ",")
    assert str(refused(path, format="csv")) == str(error)
    track = io.read_identified(path, **named(error)).by_id(7)
    np.testing.assert_allclose(track.position[:, 0], 1.5 + np.arange(4) / 8)


@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize("format", [None, "mot"])
def test_numbers_without_a_header_are_diagnosed(format: str | None, mark: str, tmp_path: Path) -> None:
    path = sample_of("mot").write(tmp_path)
    expected = io.read_identified(path)
    path.write_text(path.read_text().replace(",", mark))
    error = refused(path, format=format)
    assert NAMES[mark] in error.found
    found = io.read_identified(path, **named(error))
    np.testing.assert_array_equal(found.by_id(1).pixel, expected.by_id(1).pixel)


def test_a_line_before_the_header_and_a_decimal_comma_are_named(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("sep=,\n" + TABLE)
    error = refused(path)
    assert error.found == "the line 'sep=,'" and io.read_identified(path, **named(error)).n_frames == 4
    path.write_text('track_id,frame,t,x,y\n7,0,"0,5",1,2\n')
    error = refused(path)
    assert "decimal point" in error.expected and (error.line, error.column) == (2, "t")
