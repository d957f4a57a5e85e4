"""The file of a stream that can be gone on with: nothing is lost in it, and damage is found."""

import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graphtrack.errors import InputError
from graphtrack.streaming.saved_state import Saving, StateFile, StateInUse, remove

VALUES = [{"first": 1}, {"member": 1}, [2, "\udcff"], [3, "x"]]
HOUR = 3600.0


def made(path, values=VALUES, members=1):
    file = StateFile(path, HOUR)
    file.begin()
    for value in values[1 : 1 + members]:
        file.add(value)
    file.replace(values[0])
    for value in values[1 + members :]:
        file.append(value)
    file.close()
    return path


def content(path):
    file = StateFile(path, HOUR)
    file.close()
    return file.entries


def copied(path, to):
    """A copy of the files as they are, as a kill at this moment would leave them."""
    to.mkdir()
    for ending in ("", "-wal"):
        if (one := path.with_name(path.name + ending)).exists():
            shutil.copy(one, to)
    return to / path.name


def test_what_is_added_is_there_at_once(tmp_path):
    path = made(tmp_path / "state", VALUES[:2])
    file = StateFile(path, HOUR)
    for k, value in enumerate(VALUES[2:], 3):
        file.append(value)
        assert content(copied(path, tmp_path / str(k))) == VALUES[:k]
    file.close()
    assert content(path) == VALUES


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(places=st.lists(st.floats(0.0, 1.0, exclude_max=True), min_size=1, max_size=3), bit=st.integers(0, 7))
def test_flipped_bits_change_no_value(tmp_path_factory, places, bit):
    path = made(tmp_path_factory.mktemp("states") / "state")
    damaged = bytearray(path.read_bytes())
    for place in places:
        damaged[int(place * len(damaged))] ^= 1 << bit
    path.write_bytes(damaged)
    try:
        found = content(path)
    except InputError as error:
        assert "state" in str(error)
    else:
        assert found == VALUES


def test_a_flipped_bit_of_any_value_is_found(tmp_path):
    data = made(tmp_path / "state").read_bytes()
    for value in (b"first", b"member", b'"x"'):
        damaged = data.replace(value, bytes([value[0] ^ 1]) + value[1:])
        assert damaged != data
        (tmp_path / "state").write_bytes(damaged)
        with pytest.raises(InputError, match="damaged state"):
            StateFile(tmp_path / "state", HOUR)
        assert (tmp_path / "state").read_bytes() == damaged


def test_a_file_that_was_cut_off_is_refused_and_stays(tmp_path):
    path = made(tmp_path / "state", [*VALUES, *([k, "long" * 99] for k in range(4, 50))])
    data = path.read_bytes()
    for end in range(0, len(data), 997):
        path.write_bytes(data[:end])
        with pytest.raises(InputError, match=r"damaged state|no saved state"):
            StateFile(path, HOUR)
        assert path.read_bytes() == data[:end]


@pytest.mark.slow
def test_the_end_of_the_log_may_be_cut_off(tmp_path):
    """As a failure of the power leaves it: the last rows are missing, and it goes on."""
    path = made(tmp_path / "state")
    file = StateFile(path, HOUR)
    for k in range(4, 9):
        file.append([k, "long" * 99])
    kept = copied(path, tmp_path / "copy")
    file.close()
    log = kept.with_name("state-wal").read_bytes()
    expected = [*VALUES, *([k, "long" * 99] for k in range(4, 9))]
    for end in range(len(log), -1, -511):
        shutil.copytree(kept.parent, one := tmp_path / str(end))
        (one / "state-wal").write_bytes(log[:end])
        found = content(one / "state")
        assert found == expected[: len(found)] and len(found) >= len(VALUES)
        file = StateFile(one / "state", HOUR)
        file.append(6)
        file.close()
        assert content(one / "state") == [*found, 6]


@pytest.mark.parametrize(
    "change",
    [
        "DELETE FROM entry WHERE kind = 0",
        "DELETE FROM entry WHERE kind = 1",
        "DELETE FROM entry WHERE kind = 2 AND place = 0",
        "DELETE FROM entry WHERE kind = 2 AND place = 1",
        "DELETE FROM entry WHERE kind = 2 AND place = 1; UPDATE entry SET place = 1 WHERE place = 2",
        "UPDATE entry SET kind = 2, snapshot = 0, place = 3 WHERE kind = 1",
        "UPDATE entry SET text = (SELECT text FROM entry WHERE kind = 1) WHERE kind = 0",
        "INSERT INTO entry SELECT kind, snapshot, 3, text, digest FROM entry WHERE kind = 2 AND place = 2",
    ],
)
def test_entries_that_are_missing_moved_or_repeated_are_found(tmp_path, change):
    path = made(tmp_path / "state", [*VALUES, [4, "y"]])
    database = sqlite3.connect(path)
    database.executescript(change)
    database.close()
    with pytest.raises(InputError, match="damaged state"):
        content(path)


def test_states_of_earlier_versions_and_other_files_are_refused(tmp_path):
    path = tmp_path / "state"
    path.write_bytes(b"graphtrack-state 0005 00000000000000000076 " + b"0" * 32 + b"\n")
    with pytest.raises(InputError, match=r"a state of version 5, expected version 11; without the file"):
        StateFile(path, HOUR)
    assert remove(path)
    for content_of in (b"", b"\n", b"{}\n", b'{"version": 2, "rows": 1}', b"\x00\xff\n", b"0" * 40):
        path.write_bytes(content_of)
        with pytest.raises(InputError, match="no saved state"):
            StateFile(path, HOUR)
        assert path.read_bytes() == content_of
    path.unlink()
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE entry (kind)")
    database.close()
    with pytest.raises(InputError, match="no saved state"):
        StateFile(path, HOUR)
    with pytest.raises(InputError, match="no saved state"):
        remove(path)


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
    file = StateFile(path, HOUR)
    for name in (path, link):
        with pytest.raises(InputError, match="another process"):
            StateFile(name, HOUR)
    file.close()
    assert content(link) == VALUES


def test_a_snapshot_takes_the_place_of_the_last_one_with_all_that_was_added_since(tmp_path):
    path = made(tmp_path / "state")
    path.chmod(0o640)
    file = StateFile(path, HOUR)
    file.append("before")
    file.begin()
    file.append("since")
    file.add("member")
    file.append("while it is written")
    assert content(copied(path, tmp_path / "copy")) == [*VALUES, "before", "since", "while it is written"]
    shutil.rmtree(tmp_path / "copy")
    file.replace("header")
    file.append("after")
    file.close()
    assert content(path) == ["header", "member", "since", "while it is written", "after"]
    assert path.stat().st_mode & 0o777 == 0o640
    assert [entry.name for entry in tmp_path.iterdir()] == ["state"]


def test_a_snapshot_that_was_not_ended_leaves_no_trace(tmp_path):
    file = StateFile(made(tmp_path / "state"), HOUR)
    file.begin()
    file.add("half")
    path = copied(tmp_path / "state", tmp_path / "copy")
    file.close()
    assert content(path) == VALUES
    assert made(path, ["header", "a", "b"], members=2)
    assert content(path) == ["header", "a", "b"]


def test_a_file_that_is_not_there_appears_whole(tmp_path):
    path = tmp_path / "state"
    file = StateFile(path, HOUR)
    assert file.entries == [] and not path.exists()
    with pytest.raises(InputError, match="another process"):
        StateFile(path, HOUR)
    file.close()
    assert not list(tmp_path.iterdir())
    (tmp_path / "state.new").write_bytes(b"of a process that was killed")
    assert content(made(path, [1, 2], members=0)) == [1, 2]
    assert [entry.name for entry in tmp_path.iterdir()] == ["state"]


WRITES = """
import sys
from pathlib import Path
from graphtrack.streaming.saved_state import StateFile
file = StateFile(Path(sys.argv[1]), 0.01)
row, first = 0, 0
while True:
    file.begin()
    for member in range(3):
        file.add([member, row])
        row += 1
        file.append(row)
        print(row, flush=True)
    file.replace(row - 3)
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no kills")
def test_kills_at_any_moment_lose_no_row(tmp_path):
    path = tmp_path / "state"
    for wait in (0.0, 0.004, 0.02, 0.05, 0.1):
        path.unlink(missing_ok=True)
        (tmp_path / "state-wal").unlink(missing_ok=True)
        with subprocess.Popen([sys.executable, "-c", WRITES, path], stdout=subprocess.PIPE) as process:
            printed = int(process.stdout.readline())
            time.sleep(wait)
            process.kill()
            printed = int((process.stdout.read().split(b"\n")[:-1] or [printed])[-1])
        stored = content(path)
        header, *rest = stored or [0]
        members, rows = (rest[:3], rest[3:]) if stored else ([], rest)
        if rows or members:
            assert members == [[k, header + k] for k in range(3)] or header == 0
            assert rows == list(range(header + 1, header + 1 + len(rows)))
            assert header + len(rows) in (printed, printed + 1)


def test_a_disk_that_is_full_is_told_and_what_was_there_stays(tmp_path):
    path = made(tmp_path / "state")
    file = StateFile(path, HOUR)
    file._database.execute("PRAGMA max_page_count = 4")  # SQLite's own way to be full
    for change in (lambda: file.append("x" * 99999), lambda: file.add("new" * 99999)):
        file.begin()
        with pytest.raises(InputError, match=r"full, expected a file that can be written to"):
            change()
    file.close()
    assert content(path) == VALUES


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="no limit of file sizes")
def test_a_limit_of_the_disk_is_one_error(tmp_path):
    code = """
import resource, signal, sys
from pathlib import Path
from graphtrack.errors import InputError
from graphtrack.streaming.saved_state import StateFile
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
file = StateFile(Path(sys.argv[1]), 0.01)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
added = 0
try:
    while True:
        file.append([added, "x" * 999])
        added += 1
except InputError as error:
    print(added, error)
file.close()
"""
    path = made(tmp_path / "state")
    done = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and not done.stderr
    added, said = done.stdout.split(" ", 1)
    assert str(path) in said and "expected a file that can be written to" in said
    assert content(path) == [*VALUES, *([k, "x" * 999] for k in range(int(added)))]


def test_it_is_written_to_the_disk_from_time_to_time(tmp_path):
    path = made(tmp_path / "state")
    file = StateFile(path, 0.01)
    file.append("new")
    deadline = time.monotonic() + 60.0
    while b"new" not in path.read_bytes():
        assert time.monotonic() < deadline
    file.close()
    assert content(path) == [*VALUES, "new"]


def writings(path, seconds):
    """Times at which an empty stream is written, every ten seconds, after its start at 0."""
    now, found = 0.0, []
    nobody = SimpleNamespace(rows=0, line=0, members={}, shared_state=dict)
    file = StateFile(path, 3600.0)
    saving = Saving(file, nobody, {}, 10.0, lambda: now)
    saving.begin()
    replace = file.replace
    file.replace = lambda header: (found.append(now), replace(header))
    while now < seconds:
        now += 0.25
        saving.tend()
        saving.tend()
    file.close()
    return found


def test_streams_that_begin_together_are_written_at_different_times(tmp_path):
    first, second = zip(*(writings(tmp_path / f"stream{k}", 20.0)[:2] for k in range(8)), strict=True)
    assert max(first) <= 10.25 and len(set(first)) >= 5
    assert all(after - before in (10.0, 10.25) for before, after in zip(first, second, strict=True))
