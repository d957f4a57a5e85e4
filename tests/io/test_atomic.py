"""Atomic writing: through links, in parallel, after runs that were killed, and without POSIX."""

import errno
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd
import pytest

from graphtrack.errors import InputError
from graphtrack.io import atomic_path
from graphtrack.io.atomic import check_distinct

KILLED = """
import os, signal, sys
from graphtrack.io.atomic import atomic_path
with atomic_path(sys.argv[1], directory=len(sys.argv) > 2) as temporary:
    (temporary / "a" if len(sys.argv) > 2 else temporary).write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text)


def killed(path: Path, *directory: str) -> None:
    """A process that is killed while it writes."""
    done = subprocess.run([sys.executable, "-c", KILLED, str(path), *directory], check=False)
    assert done.returncode == -signal.SIGKILL


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_and_its_target_is_written(tmp_path: Path, there: bool) -> None:
    (tmp_path / "far").mkdir()
    target, link, outer = tmp_path / "far" / "a.csv", tmp_path / "link.csv", tmp_path / "outer.csv"
    if there:
        target.write_text("old")
    link.symlink_to(Path("far", "a.csv"))
    outer.symlink_to(link)
    write(outer, "new")
    assert target.read_text() == "new" and not target.is_symlink()
    assert link.is_symlink() and outer.is_symlink()
    assert {entry.name for entry in tmp_path.rglob("*")} == {"far", "a.csv", "link.csv", "outer.csv"}
    (tmp_path / "empty").mkdir()
    (tmp_path / "folder").symlink_to("empty")
    with atomic_path(tmp_path / "folder", directory=True) as folder:
        (folder / "a").write_text("new")
    assert (tmp_path / "folder").is_symlink() and (tmp_path / "empty" / "a").read_text() == "new"


def test_links_that_lead_nowhere_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(InputError, match="leads back to itself"):
        write(tmp_path / "a", "new")
    assert (tmp_path / "a").is_symlink() and len(list(tmp_path.iterdir())) == 2
    (tmp_path / "c").symlink_to("missing/a")
    with pytest.raises(InputError, match=r"no folder .*missing"):
        write(tmp_path / "c", "new")


@pytest.mark.parametrize("directory", [False, True])
def test_a_result_appears_whole_or_not_at_all(tmp_path: Path, directory: bool) -> None:
    path = tmp_path / "result"
    with pytest.raises(ZeroDivisionError), atomic_path(path, directory=directory) as temporary:
        (temporary / "page" if directory else temporary).write_text("half")
        assert not path.exists()
        _ = 1 / 0
    assert not list(tmp_path.iterdir())
    with atomic_path(path, directory=directory) as temporary:
        (temporary / "page" if directory else temporary).write_text("whole")
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(InputError), atomic_path(path, directory=True):
        pass


def test_a_device_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="a device"):
        write(tmp_path / "pipe", "new")
    assert (tmp_path / "pipe").is_fifo()


def test_what_killed_runs_left_goes_with_the_next_writing_to_the_same_place(tmp_path: Path) -> None:
    killed(tmp_path / "a.csv")
    killed(tmp_path / "shown", "directory")
    killed(tmp_path / "b.csv")
    mine = tmp_path / ".a.csv.backup.unfinished"
    mine.mkdir()
    assert len(list(tmp_path.iterdir())) == 4
    write(tmp_path / "a.csv", "whole")
    with atomic_path(tmp_path / "shown", directory=True):
        pass
    left = {entry.name for entry in tmp_path.iterdir()} - {"a.csv", "shown", mine.name}
    # Remains at another path wait for the next write to that path.
    assert len(left) == 1 and left.pop().startswith(".b.csv.")


def test_those_who_still_write_are_left_alone_and_permissions_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with atomic_path(path) as first:
        first.write_text("first")
        write(path, "second")
        assert path.read_text() == "second"
    assert path.read_text() == "first" and list(tmp_path.iterdir()) == [path]
    path.chmod(0o600)
    write(path, "new")
    assert path.stat().st_mode & 0o777 == 0o600


def test_an_error_names_the_place_that_was_given(tmp_path: Path) -> None:
    path = tmp_path / "people.mcap"
    with pytest.raises(InputError) as caught, atomic_path(path) as temporary:
        raise InputError("no package mcap", "the extra", path=temporary)
    assert str(caught.value) == f"{path}: found no package mcap, expected the extra"
    with pytest.raises(InputError, match=r"^other\.csv: "), atomic_path(path):
        raise InputError("nothing", "something", path="other.csv")
    with pytest.raises(InputError) as caught, atomic_path(tmp_path / "out", directory=True) as temporary:
        raise InputError("a", "b", path=temporary / "x.csv")
    assert caught.value.args == (f"{tmp_path / 'out' / 'x.csv'}: found a, expected b",)


def test_a_file_without_write_permission_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("kept")
    path.chmod(0o444)
    with pytest.raises(InputError, match="without write permission"):
        write(path, "new")
    assert path.read_text() == "kept"
    (tmp_path / "link.csv").symlink_to(path)
    with pytest.raises(InputError, match="without write permission"):
        check_distinct({"--output": tmp_path / "link.csv"}, {})


@pytest.mark.parametrize("length", [180, 181, 240, 255])
def test_long_names_are_written(tmp_path: Path, length: int) -> None:
    path = tmp_path / ("ä" * 20 + "x" * (length - 44) + ".csv")
    check_distinct({"--output": path}, {})
    killed(path)
    assert len(list(tmp_path.iterdir())) == 1
    write(path, "new")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["x" * 252 + ".csv", "ä" * 126 + ".csv"])
def test_names_that_are_too_long_are_refused_before_the_work(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=os.strerror(errno.ENAMETOOLONG)):
        check_distinct({"--output": tmp_path / name}, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES, errno.ENOSPC])
def test_folders_that_cannot_be_written_to_are_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(tempfile, "mkdtemp", refuse)
    with pytest.raises(InputError, match=os.strerror(number)) as caught:
        check_distinct({"--output": tmp_path / "a.csv"}, {})
    assert caught.value.path == str(tmp_path / "a.csv")
    check_distinct({"--output": tmp_path / "new" / "a.csv"}, {}, to_make=[tmp_path / "new"])


WITHOUT_MEMORY = """
import shutil, sys
from graphtrack.io.atomic import atomic_path
removing = shutil.rmtree
def fail(*_, **__):
    shutil.rmtree = removing
    raise MemoryError
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("half")
    shutil.rmtree = fail
    raise MemoryError
"""


def test_nothing_is_left_where_memory_ends(tmp_path: Path) -> None:
    command = [sys.executable, "-c", WITHOUT_MEMORY, str(tmp_path / "a.csv")]
    done = subprocess.run(command, capture_output=True, timeout=60)
    assert b"MemoryError" in done.stderr and not list(tmp_path.iterdir())


BLOCKED = """
import os, sys
sys.modules["fcntl"] = None
for name in ("O_DIRECTORY", "O_NOFOLLOW", "fchmod", "fchown", "pread", "pwrite", "getuid", "geteuid"):
    delattr(os, name)
plain = os.open
def opened(path, flags, *more, **options):
    if os.path.isdir(path):
        raise PermissionError(13, "Permission denied", path)
    return plain(path, flags, *more, **options)
os.open = opened
"""
"""`os` of Windows opens no folders."""


def run(folder, *arguments, stdin=""):
    (folder / "sitecustomize.py").write_text(BLOCKED)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *sys.path[1:]])}
    command = [sys.executable, "-m", "graphtrack", *map(str, arguments)]
    done = subprocess.run(
        command, input=stdin, capture_output=True, text=True, cwd=folder, env=environment, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_files_are_written_and_line_ends_of_windows_read(tmp_path):
    rows = [f"1,{k},{k / 10},{0.13 * k},0" for k in range(5)]
    (tmp_path / "tracks.csv").write_bytes("\r\n".join(["track_id,frame,t,x,y", *rows, ""]).encode())
    run(tmp_path, "convert", "tracks.csv", "-o", "again.csv")
    run(tmp_path, "convert", "again.csv", "-o", "again.parquet")
    assert len(pd.read_parquet(tmp_path / "again.parquet")) == 5
    assert b"\r" not in (tmp_path / "again.csv").read_bytes()
    run(tmp_path, "convert", "tracks.csv", "-o", "again.csv")  # in place of an older one
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".")]
