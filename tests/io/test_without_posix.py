"""Commands without the POSIX-only modules, as on Windows."""

import os
import subprocess
import sys

import pandas as pd

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


def test_files_are_written_and_line_ends_of_windows_read(tmp_path):
    rows = [f"1,{k},{k / 10},{0.13 * k},0" for k in range(5)]
    (tmp_path / "tracks.csv").write_bytes("\r\n".join(["track_id,frame,t,x,y", *rows, ""]).encode())
    run(tmp_path, "convert", "tracks.csv", "-o", "again.csv")
    run(tmp_path, "convert", "again.csv", "-o", "again.parquet")
    assert len(pd.read_parquet(tmp_path / "again.parquet")) == 5
    assert b"\r" not in (tmp_path / "again.csv").read_bytes()
    run(tmp_path, "convert", "tracks.csv", "-o", "again.csv")  # in place of an older one
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".")]


def test_a_stream_goes_on_from_its_state(tmp_path):
    rows = [f'{{"track_id": 1, "frame": {k}, "t": {k / 10}, "x": {0.13 * k}, "y": 0}}\n' for k in range(8)]
    stream = ("track", "-", "--model", "position", "--state", "people.state")
    parts = [run(tmp_path, *stream, stdin="".join(part)) for part in (rows[:5], rows[5:])]
    straight = run(tmp_path, *stream[:-2], stdin="".join(rows))
    assert "".join(parts) == straight
