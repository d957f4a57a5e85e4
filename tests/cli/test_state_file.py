"""The file of a stream that can be gone on with: nothing is lost in it, and damage is found."""

import json
import os

import pytest

from graphtrack.cli import state_file
from graphtrack.cli.state_file import StateFile, seal
from graphtrack.errors import InputError

VALUES = [{"first": 1}, [2, "grün \udcff"], [3, "x"]]
HOUR = 3600.0


def made(path, values=VALUES):
    path.write_bytes(b"".join(map(seal, values)))
    return path


def content(path):
    file = StateFile(path, HOUR)
    file.close()
    return file.entries


def test_what_is_added_is_there_at_once(tmp_path):
    path = made(tmp_path / "state", VALUES[:1])
    file = StateFile(path, HOUR)
    for k, value in enumerate(VALUES[1:], 2):
        file.append(value)
        assert path.read_bytes() == b"".join(map(seal, VALUES[:k]))
    file.close()
    assert content(path) == VALUES


def test_any_flipped_bit_is_found(tmp_path):
    data = made(tmp_path / "state").read_bytes()
    for place in range(len(data) - 1):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        (tmp_path / "state").write_bytes(damaged)
        with pytest.raises(InputError, match=r"state"):
            StateFile(tmp_path / "state", HOUR)
        assert (tmp_path / "state").read_bytes() == damaged


def test_a_last_line_that_was_cut_is_left_aside(tmp_path):
    data = made(tmp_path / "state").read_bytes()
    for end in range(data.index(b"\n") + 1, len(data)):
        (tmp_path / "state").write_bytes(data[:end])
        assert content(tmp_path / "state") == VALUES[: data[:end].count(b"\n")]
        assert (tmp_path / "state").read_bytes().endswith(b"\n")


def test_one_process_at_a_time(tmp_path):
    path, link = made(tmp_path / "state"), tmp_path / "link"
    link.symlink_to(path)
    for name in (path, link):
        file = StateFile(path, HOUR)
        file.mark()
        file.replace([seal(VALUES[0])])
        file.wait()  # another file has the name now
        with pytest.raises(InputError, match="another process"):
            StateFile(name, HOUR)
        file.close()
    assert content(link) == VALUES[:1]


def test_a_new_content_takes_the_place_of_the_old_with_all_that_was_added_since(tmp_path):
    file = StateFile(made(tmp_path / "state"), HOUR)
    (tmp_path / "state").chmod(0o640)
    file.mark()
    file.append("since the mark")
    file.replace([seal("new"), seal("content")])
    file.append("while it is written, or after")
    file.wait()
    assert not file.is_replacing
    file.append("after")
    file.close()
    expected = ["new", "content", "since the mark", "while it is written, or after", "after"]
    assert content(tmp_path / "state") == expected
    assert (tmp_path / "state").stat().st_mode & 0o777 == 0o640
    assert [entry.name for entry in tmp_path.iterdir()] == ["state"]


def test_a_file_that_is_not_there_appears_whole(tmp_path):
    path = tmp_path / "state"
    file = StateFile(path, HOUR)
    assert file.entries == [] and not path.exists()
    with pytest.raises(InputError, match="another process"):
        StateFile(path, HOUR)
    file.close()
    assert not list(tmp_path.iterdir())
    file = StateFile(path, HOUR)
    file.mark()
    file.replace([seal(1)])
    file.wait()
    file.append(2)
    file.close()
    assert content(path) == [1, 2]


def test_a_disk_that_is_full_is_told_and_what_was_there_stays(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    path = made(tmp_path / "state")
    file = StateFile(path, HOUR)
    with monkeypatch.context() as patch:
        patch.setattr(state_file, "_write", full)
        with pytest.raises(InputError, match="No space left"):
            file.append("x")
        file.mark()
        file.replace([seal("new")])
        with pytest.raises(InputError, match="No space left"):
            file.wait()
    with pytest.raises(InputError, match="No space left"):  # and by then no row is answered
        file.append("x")
    file.close()
    assert content(path) == VALUES


def test_it_is_flushed_from_time_to_time(tmp_path, monkeypatch):
    flushed = []
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(os.fstat(file).st_size))
    path = made(tmp_path / "state")
    file = StateFile(path, 0.01)
    file.append("x")
    while not flushed:
        pass
    file.close()
    assert flushed == [path.stat().st_size]
    assert json.loads(path.read_bytes().splitlines()[-1][9:]) == "x"
