"""`graphtrack track -` as a user runs it: its state file, its ends, and its messages."""

import copy
import io
import json
import os
import select
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import TRACK_STREAM, going_on, run
from selection import others_slow

from graphtrack.cli import main
from graphtrack.errors import InputError
from graphtrack.model import Model
from graphtrack.streaming import session
from graphtrack.streaming.saved_state import StateFile


def scene(n_frames, people=3, seed=0):
    """Rows as a camera sends them: interleaved, with gaps, out of sequence, repeated and invalid."""
    rng = np.random.default_rng(seed)
    lines = []
    for k in range(n_frames):
        for i in range(people):
            row = {"track_id": i, "frame": k, "t": round(0.04 * k, 6)}
            if rng.random() < 0.9:
                x, y = rng.normal([0.05 * k, i], 0.1).tolist()
                row |= {"x": round(x, 4), "y": round(y, 4)}
            if rng.random() < 0.7:
                row |= {"body_deg": round(rng.normal(0.0, 30.0), 2), "head_deg": round(3.0 * k - 180.0, 2)}
            lines.append(json.dumps(row).encode() + b"\n")
    for k in range(0, len(lines) - 5, 17):
        lines[k], lines[k + 4] = lines[k + 4], lines[k]
    for k in range(10, len(lines), 7):
        lines.insert(k, (lines[k - 1], b"junk \xff\n", b"\n", b'{"track_id": 0, "frame": 1e300}\n')[k % 4])
    return lines


@pytest.fixture
def track(monkeypatch, capsys):
    """Runs the command on some lines: its status, answers and messages."""

    def run(lines, *options):
        stdin = None if lines is None else io.TextIOWrapper(io.BytesIO(b"".join(lines)))
        monkeypatch.setattr(sys, "stdin", stdin)
        monkeypatch.setattr(sys, "argv", ["graphtrack", "track", "-", *map(str, options)])
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        lines = [
            line
            for line in said.err.splitlines(keepends=True)
            if not line.startswith(("compiling", "compiled in"))
        ]
        return ended.value.code, said.out.splitlines(), "".join(lines)

    return run


# -- going on ------------------------------------------------------------------------------------------------


ENDINGS = ("", "-wal")
"""Endings of the names of a state and its write-ahead log."""


class Killed(BaseException):
    """Simulate a kill: the next run finds the file as it is at that moment."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "n_frames"), [("chain", 70), pytest.param("isam2", 12, marks=pytest.mark.slow)]
)
def test_kills_leave_no_trace_in_the_answers(monkeypatch, tmp_path, engine, n_frames):
    lines, state, rng = scene(n_frames, people=2), tmp_path / "state", np.random.default_rng(1)
    answers, left, kills, resumed, gone_on = [], 0, 0, False, []
    listener = session.Listener(went_on=lambda row, line, again: gone_on.append(row - again))

    def rows(stream, first):
        return ((n, lines[n - 1]) for n in range(first, len(lines) + 1) if lines[n - 1].strip())

    def give(answer):
        nonlocal left, resumed
        if resumed:
            kept = gone_on.pop()
            assert len(answers) - 1 <= kept <= len(answers)
            del answers[kept:]
            resumed = False
        left -= 1
        if left > 0 or rng.random() < 0.5:
            answers.append(json.dumps(answer))
        if left <= 0:
            for ending in ENDINGS:
                shutil.copy(f"{state}{ending}", tmp_path / f"left{ending}")
            raise Killed

    def track_all():
        answering = session.Answers(Model("joint"), engine, 0.5)
        session.track_stream(answering, state=state, save_every=0.02, listener=listener)

    monkeypatch.setattr(session, "lines_of", rows)
    monkeypatch.setattr(session, "open_streams", lambda: None)
    monkeypatch.setattr(session, "give", lambda answer: answers.append(json.dumps(answer)))
    track_all()
    whole, answers = answers, []
    state.unlink()
    monkeypatch.setattr(session, "give", give)
    while True:
        left = int(rng.integers(1, len(lines) // 4))
        try:
            track_all()
            break
        except Killed:
            for ending in ENDINGS:
                data = (tmp_path / f"left{ending}").read_bytes()
                if ending and rng.random() < 0.3:  # the kill came while a row was added, without an answer
                    data += b"0123456789abcdef0123"[: int(rng.integers(20))]
                Path(f"{state}{ending}").write_bytes(data)
            kills, resumed = kills + 1, True
    assert kills > 5
    assert answers == whole


@pytest.mark.slow
def test_a_program_that_is_killed_or_loses_its_reader_goes_on(tmp_path):
    lines, state = scene(40), tmp_path / "state"
    (tmp_path / "rows").write_bytes(b"".join(lines))
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with (tmp_path / "rows").open("rb") as rows:
        undisturbed = subprocess.Popen(
            TRACK_STREAM, stdin=rows, stdout=pipes["stdout"], stderr=pipes["stderr"]
        )

    with subprocess.Popen([*TRACK_STREAM, "--state", str(state)], **pipes) as one:
        one.stdin.write(b"".join(lines[:70]))
        one.stdin.flush()
        answers = [one.stdout.readline() for _ in range(50)]
        with pytest.raises(InputError, match="another process"):
            StateFile(state, 1.0)
        one.kill()
        answers += one.stdout.readlines()
    (tmp_path / "state.new").write_bytes(b"half of a snap")  # as a kill may leave it

    with subprocess.Popen([*TRACK_STREAM, "--state", str(state)], **pipes) as two:
        line, kept = going_on(two.stderr.readline().decode())
        answers[kept:] = [two.stdout.readline()]
        two.stdout.close()
        _, said = two.communicate(b"".join(lines[line:]))
    assert two.returncode == 2
    assert said.decode().startswith("error: standard output: ") and said.count(b"\n") == 1

    with subprocess.Popen([*TRACK_STREAM, "--state", str(state)], **pipes) as three:
        line, kept = going_on(three.stderr.readline().decode())
        more, _ = three.communicate(b"".join(lines[line:]))
    assert b"".join(answers[:kept]) + more == undisturbed.communicate(timeout=120)[0]
    assert {entry.name for entry in tmp_path.iterdir()} == {"rows", "state"}


# -- states that cannot be used ------------------------------------------------------------------------------


SAME = {"--model": "joint", "--fps": "25", "--lag": "1"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A state of some rows, and one row that came after the last snapshot."""
    path = tmp_path_factory.mktemp("made") / "state"
    options = [word for pair in SAME.items() for word in pair]
    rows = [line.decode().strip() for line in scene(4)]
    run("track", "-", *options, "--state", path, program="graphtrack", rows=rows)
    file = StateFile(path, 60.0)
    file.append([99, scene(1)[0].decode()])
    file.close()
    return path


@pytest.fixture
def state(made, tmp_path):
    """A copy of the state."""
    for path in made.parent.iterdir():
        shutil.copy(path, tmp_path / path.name)
    return tmp_path / "state"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"--fps": "10"}, "fps = 25.0, expected one with fps = 10.0"),
        ({"--lag": "2"}, "lag = 1.0, expected one with lag = 2.0"),
        ({"--lag": "none", "--engine": "isam2"}, "expected one with "),
        ({"--model": "separate"}, 'model.preset = "joint", expected one with model.preset = "separate"'),
        ({"--engine": "fixed-lag"}, 'engine = "chain", expected one with engine = "fixed-lag"'),
        ({"--forecast": "2"}, "forecast"),
        ({"--forget-after": "30"}, "forget_after = 60.0, expected one with forget_after = 30.0"),
        ({"--walkable": "area.wkt"}, "walkable = "),
        ({"--attention": "--groups"}, "attention = "),
        ({"--homography": "plane.txt"}, "homography = null, expected one with homography = [[0.01"),
    ],
)
def test_a_state_of_other_options_is_refused_by_name(track, state, cwd, changed, told):
    Path("plane.txt").write_text("0.01 0 0\n0 0.01 0\n0 0 1\n")
    Path("area.wkt").write_text("POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0))")
    before = state.read_bytes()
    options = [word for pair in (SAME | changed).items() for word in pair]
    status, answers, said = track([], *options, "--state", "state")
    assert (status, answers) == (2, [])
    assert "error: state: found a state with " in said and told in said
    assert state.read_bytes() == before


def refused(track, state, *options):
    """Assert that a run with a state is one error, and leaves the file as it is."""
    before = state.read_bytes()
    status, answers, said = track(scene(1), *options, "--state", state)
    assert (status, answers, said.count("\n")) == (2, [], 1), said
    assert said.startswith("error: ") and "state: found" in said.replace(", line", ": found")
    assert state.read_bytes() == before


def leaves(value, path=()):
    """Return the paths of all leaves of a JSON-able value."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    inner = [leaf for key, part in parts for leaf in leaves(part, (*path, key))]
    return inner or [path]


def replaced(entries, path, new):
    """A copy with another value at a place."""
    entries = copy.deepcopy(entries)
    within = entries
    for key in path[:-1]:
        within = within[key]
    within[path[-1]] = new
    return entries


@pytest.mark.slow
@pytest.mark.parametrize("step", others_slow([1, 41], [41]))
def test_values_of_a_wrong_type_are_refused(track, state, tmp_path, step):
    """In a file whose digests are right: each place, one after the other, holds something else."""
    options = [word for pair in SAME.items() for word in pair]
    file = StateFile(state, 60.0)
    entries = copy.deepcopy(file.entries)
    file.close()
    places, taken, members = leaves(entries), [], entries[0]["people"]
    assert len(places) > 100
    for k, path in enumerate(places[::step]):
        if "settings" in path or (path[-1] == 1 and isinstance(entries[path[0]], list)):
            continue
        new = [{"a": 1}, [[]], "?", True][k % 4]
        if new is True and path[-1] == "starts":
            continue
        (tmp_path / "state").unlink()
        file = StateFile(tmp_path / "state", 60.0)
        header, *rest = replaced(entries, path, new)
        file.begin()
        for one in rest[:members]:
            file.add(one)
        file.replace(header)
        for one in rest[members:]:
            file.append(one)
        file.close()
        try:
            refused(track, tmp_path / "state", *options)
        except AssertionError as error:
            taken.append((path, new, str(error)[:30]))
    assert not taken, "\n".join(map(str, taken))


def test_a_state_where_no_file_can_be(track, tmp_path):
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path, tmp_path / "missing" / "state", tmp_path / "fifo"):
        status, answers, said = track(scene(1), "--state", path)
        assert (status, answers) == (2, [])
        assert said.startswith("error: ")


# -- ends ----------------------------------------------------------------------------------------------------


def test_closed_streams_are_one_error(track, monkeypatch):
    status, _, said = track(None)
    assert (status, said.count("\n")) == (2, 1)
    assert "closed standard input" in said
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdin", sys.__stdin__)
        patch.setattr(sys, "stdout", None)
        with pytest.raises(InputError, match="closed standard output"):
            session.open_streams()


def test_unknown_keys_and_bad_rows_are_told(track):
    lines = [b'{"track_id": 1, "frame": 0, "x": 0, "y": 0, "mood": 1}\n', b"\n", b"junk\n"] * 2
    status, answers, said = track(lines, "--fps", 10)
    assert status == 2
    assert [json.loads(one).get("line") for one in answers] == [None, 3, None, 6]
    assert said == "note: ignored key 'mood'\nerror: 2 of 4 rows could not be used\n"


# -- other names ---------------------------------------------------------------------------------------------

STAMPS = {"ms": (10**3, 0), "ns": (10**9, 1_763_892_000_123_456_789)}
"""Counts in a second of a unit of time, and at the beginning: 0, or since 1970."""


def renamed(line, unit):
    """A row of `scene` in another valid notation; invalid rows are unchanged."""
    try:
        row = json.loads(line)
    except ValueError:
        return line
    names = {"track_id": "agent", "t": "stamp", "x": "pos_x", "y": "pos_y"}
    scale, first = STAMPS[unit]
    row = {
        names.get(key, key): first + round(scale * value) if key == "t" else value
        for key, value in row.items()
    }
    return json.dumps(row | {"x": "of the image"}).encode() + b"\n"


@pytest.mark.slow
@pytest.mark.parametrize("unit", others_slow(STAMPS, ["ms"]))
def test_a_stream_may_have_names_and_a_unit_of_time_of_its_own(track, tmp_path, unit):
    lines, (scale, start) = scene(12), STAMPS[unit]
    code, expected, _ = track(lines)
    options = ("--columns", "id=agent,t=stamp,x=pos_x,y=pos_y", "--time-unit", unit)
    state = tmp_path / "state"
    given = [renamed(line, unit) for line in lines]
    first_code, first, _ = track(given[:20], *options, "--state", state)
    second_code, second, said = track(given[20:], *options, "--state", state)
    assert (code, first_code, second_code) == (2, 2, 2)
    kept = going_on(said)[1]
    found = [json.loads(line) for line in [*first[:kept], *second]]
    assert len(found) == len(expected)
    for mine, other in zip(found, map(json.loads, expected), strict=True):
        if "error" in other:
            assert mine["line"] == other["line"]
            continue
        assert (mine["agent"], mine["frame"]) == (other["track_id"], other["frame"])
        assert mine["stamp"] == start + round(scale * other["t"]) and isinstance(mine["stamp"], int)
        if other["x"] is not None:
            assert mine["pos_x"] == pytest.approx(other["x"]) and mine["x_std"] == pytest.approx(
                other["x_std"]
            )
    code, _, said = track(lines, "--state", state)
    assert code == 2 and "columns" in said


@pytest.mark.slow
def test_a_row_that_cannot_be_read_is_answered_before_the_next_comes():
    """A client may wait for each answer before it sends the next row."""
    command = [*TRACK_STREAM, "--model", "position", "--fps", "10"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        for line, expected in (
            (b"no JSON\n", "error"),
            (b"{}}\n", "error"),
            (b'{"track_id": 1, "frame": 0, "x": 1, "y": 2}\n', "status"),
            (b"no JSON\n", "error"),
        ):
            process.stdin.write(line)
            process.stdin.flush()
            ready, _, _ = select.select([process.stdout], [], [], 120.0)
            assert ready, f"no answer to {line!r}"
            assert expected in json.loads(process.stdout.readline())
        process.stdin.close()
        assert process.wait(60) == 2


@pytest.mark.slow
def test_rows_that_were_refused_before_the_first_count_where_a_stream_goes_on(track, tmp_path):
    rows = [b'{"track_id": 1, "frame": %d, "x": 1, "y": 2}\n' % k for k in range(4)]
    options = ("--model", "position", "--fps", "10", "--state", tmp_path / "state")
    status, answers, said = track([b"no JSON\n", b"\n", b"nor this\n", *rows[:2]], *options)
    assert status == 2 and "2 of 4 rows could not be used" in said
    assert [json.loads(answer).get("line") for answer in answers] == [1, 3, None, None]
    status, answers, said = track([*rows[2:], b"no JSON\n"], *options)
    assert "after 4 rows (the last is line 5)" in said and len(answers) == 3
    assert json.loads(answers[-1])["line"] == 8
