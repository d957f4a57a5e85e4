"""The file of a stream that can be gone on with: nothing is lost in it, and damage is found."""

import json
import os
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graphtrack.errors import InputError
from graphtrack.streaming import saved_state
from graphtrack.streaming.saved_state import Saving, StateFile, StateInUse, line_of, remove

VALUES = [{"first": 1}, [2, "grün \udcff"], [3, "x"]]
HOUR = 3600.0


def made(path, values=VALUES):
    file = StateFile(path, HOUR)
    file.mark()
    file.replace(list(map(line_of, values)))
    file.wait()
    file.close()
    return path


def values_in(path):
    """The values in a file that is open."""
    return [json.loads(line[33:]) for line in path.read_bytes().splitlines()[1:]]


def content(path):
    file = StateFile(path, HOUR)
    file.close()
    return file.entries


def test_what_is_added_is_there_at_once(tmp_path):
    path = made(tmp_path / "state", VALUES[:1])
    file = StateFile(path, HOUR)
    for k, value in enumerate(VALUES[1:], 2):
        file.append(value)
        assert values_in(path) == VALUES[:k]
    file.close()
    assert content(path) == VALUES


def test_any_flipped_bit_is_found(tmp_path):
    data = made(tmp_path / "state").read_bytes()
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1 << (place % 8)
        (tmp_path / "state").write_bytes(damaged)
        with pytest.raises(InputError, match=r"state"):
            StateFile(tmp_path / "state", HOUR)
        assert (tmp_path / "state").read_bytes() == damaged


def test_a_file_that_was_cut_off_is_refused_and_stays(tmp_path):
    path = made(tmp_path / "state")
    data = path.read_bytes()
    for end in range(len(data)):
        path.write_bytes(data[:end])
        with pytest.raises(InputError, match=r"cut off|no saved state"):
            StateFile(path, HOUR)
        assert path.read_bytes() == data[:end]


def test_lines_that_no_flush_has_reached_may_be_cut_off(tmp_path):
    """As a failure of the power leaves them."""
    path = made(tmp_path / "state")
    flushed = path.stat().st_size
    file = StateFile(path, HOUR)
    file.append([4, "x"])
    file.append([5, "long" * 9])
    data = path.read_bytes()
    file.close()
    for end in range(flushed, len(data)):
        path.write_bytes(data[:end])
        known = [*VALUES, [4, "x"]][: data[:end].count(b"\n") - 1]
        assert content(path) == known
        assert path.read_bytes() == data[:end]  # no other process has appended
        file = StateFile(path, HOUR)
        file.append(6)
        file.close()
        assert content(path) == [*known, 6]


@settings(max_examples=200)
@given(data=st.data(), n=st.integers(2, 6))
def test_lines_that_are_missing_repeated_moved_or_foreign_are_found(tmp_path_factory, data, n):
    folder = tmp_path_factory.mktemp("states")
    values = [{"rows": 0}, *([k, "row"] for k in range(n))]
    whole = made(folder / "state", values).read_bytes()
    foreign = made(folder / "other", [{"rows": 1}, *values[1:]]).read_bytes().splitlines(keepends=True)
    lines = whole.splitlines(keepends=True)
    changed = data.draw(st.lists(st.sampled_from([*lines, *foreign]), max_size=n + 4))
    after = b"".join(changed) + data.draw(st.binary(max_size=3))
    (folder / "state").write_bytes(after)
    try:
        found = content(folder / "state")
    except InputError:
        pass
    else:  # only the incomplete last line
        assert found in (values, [{"rows": 1}, *values[1:]])
    assert (folder / "state").read_bytes() == after


def test_a_state_that_is_open_is_not_removed(tmp_path):
    path, link = tmp_path / "state", tmp_path / "link"
    link.symlink_to(path)
    file = StateFile(path, HOUR)
    with pytest.raises(StateInUse):  # it is about to be made
        remove(path)
    file.close()
    assert not remove(path)
    file = StateFile(made(path), HOUR)
    before = path.read_bytes()
    for name in (path, link):
        with pytest.raises(StateInUse):
            remove(name)
    assert path.read_bytes() == before
    file.close()
    assert remove(link)
    assert not list(tmp_path.iterdir())


def test_one_process_at_a_time(tmp_path):
    path, link = made(tmp_path / "state"), tmp_path / "link"
    link.symlink_to(path)
    for name in (path, link):
        file = StateFile(path, HOUR)
        file.mark()
        file.replace([line_of(VALUES[0])])
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
    file.replace([line_of("new"), line_of("content")])
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
    file.replace([line_of(1)])
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
        patch.setattr(saved_state, "_write", full)
        with pytest.raises(InputError, match="No space left"):
            file.append("x")
        file.mark()
        file.replace([line_of("new")])
        with pytest.raises(InputError, match="No space left"):
            file.wait()
    with pytest.raises(InputError, match="No space left"):  # and by then no row is answered
        file.append("x")
    file.close()
    assert content(path) == VALUES


def test_it_is_flushed_from_time_to_time(tmp_path, monkeypatch):
    flushed = []
    path = made(tmp_path / "state")
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(os.fstat(file).st_size))
    file = StateFile(path, 0.01)
    file.append("x")
    while not flushed:
        pass
    file.close()
    assert flushed == [path.stat().st_size]
    assert json.loads(path.read_bytes().splitlines()[-1][33:]) == "x"


def writings(path, seconds):
    """Times at which an empty stream is written, every ten seconds, after its start at 0."""
    now, found = 0.0, []
    nobody = SimpleNamespace(rows=0, line=0, members={}, before_change=None, shared_state=dict)
    file = StateFile(path, 3600.0)
    saving = Saving(file, nobody, {}, 10.0, lambda: now)
    saving.begin()
    before = path.stat().st_ino
    while now < seconds:
        now += 0.25
        saving.tend()
        saving.tend()
        file.wait()
        if path.stat().st_ino != before:
            before = path.stat().st_ino
            found.append(now)
    file.close()
    return found


def test_streams_that_begin_together_are_written_at_different_times(tmp_path):
    first, second = zip(*(writings(tmp_path / f"stream{k}", 20.0)[:2] for k in range(8)), strict=True)
    assert max(first) <= 10.25 and len(set(first)) >= 5
    assert all(after - before in (10.0, 10.25) for before, after in zip(first, second, strict=True))
