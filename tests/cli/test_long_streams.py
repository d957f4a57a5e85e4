"""Ten minutes of a stream of 20 people at 25 frames a second: as long as they last, and with many kills."""

import json
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from command import TRACK_STREAM, going_on

pytestmark = pytest.mark.slow
PEOPLE, RATE, SECONDS = 20, 25, 600
LATEST = 0.2
"""Seconds after which an answer is late."""


def rows_of(n_frames, seed=0):
    """Rows frame by frame, with all that a stream may hold but bad rows."""
    rng = np.random.default_rng(seed)
    headings = rng.uniform(-180.0, 180.0, PEOPLE)
    lines = []
    for k in range(n_frames):
        headings += rng.normal(0.0, 3.0, PEOPLE)
        for i in range(PEOPLE):
            row = {"track_id": i, "frame": k, "t": round(k / RATE, 6)}
            if rng.random() < 0.95:
                row |= {
                    "x": round(0.05 * k + rng.normal(0.0, 0.1), 4),
                    "y": round(i + rng.normal(0.0, 0.1), 4),
                }
            if rng.random() < 0.8:
                angles = headings[i] + rng.normal(0.0, 20.0, 2)
                row |= {"body_deg": round(angles[0], 2), "head_deg": round(angles[1], 2)}
            lines.append(json.dumps(row).encode() + b"\n")
    for k in range(100, len(lines) - 2 * PEOPLE, 97):
        lines[k], lines[k + PEOPLE] = lines[k + PEOPLE], lines[k]
    return lines


def started(state):
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    command = [*TRACK_STREAM, "--state", str(state), "--save-every", "1"]
    return subprocess.Popen(command, **pipes)


class Stalls(threading.Thread):
    """When the machine itself stood still: a thread that does nothing but sleep, and looks at the clock."""

    def __init__(self):
        super().__init__(daemon=True)
        self.found = []
        self.start()

    def run(self):
        before = time.perf_counter()
        while True:
            time.sleep(0.005)
            now = time.perf_counter()
            if now - before > LATEST / 4:
                self.found.append((before, now))
            before = now

    def excuse(self, sent, received):
        """Whether there was a stall while a row waited, or shortly before, so that others waited still."""
        return any(begin < received and end > sent - SHORTLY for begin, end in self.found)


SHORTLY = 5.0


def test_no_answer_is_late(tmp_path):
    """On an idle machine, or with real-time priority (chrt); what comes of its own stalls is left aside."""
    lines, stalls = rows_of(SECONDS * RATE), Stalls()
    sent, received = np.zeros(len(lines)), np.zeros(len(lines))
    with started(tmp_path / "state") as one:
        one.stdin.write(lines[0])
        one.stdin.flush()
        one.stdout.readline()

        def send():
            start = time.perf_counter()
            for begin in range(1, len(lines), PEOPLE):
                time.sleep(max(0.0, start + begin / PEOPLE / RATE - time.perf_counter()))
                sent[begin : begin + PEOPLE] = time.perf_counter()
                one.stdin.write(b"".join(lines[begin : begin + PEOPLE]))
                one.stdin.flush()
            one.stdin.close()

        sender = threading.Thread(target=send)
        sender.start()
        for k in range(1, len(lines)):
            assert one.stdout.readline()
            received[k] = time.perf_counter()
        sender.join()
    delays = (received - sent)[1:]
    late = np.flatnonzero(delays > LATEST) + 1
    unexcused = [k for k in late.tolist() if not stalls.excuse(sent[k], received[k])]
    told = ", ".join(f"{q:g} %: {1e3 * np.percentile(delays, q):.1f} ms" for q in (50, 99, 99.9, 100))
    size = (tmp_path / "state").stat().st_size
    print(f"\ndelays of {len(delays)} rows: {told}; state {size / 1e6:.2f} MB", file=sys.stderr)
    print(f"{len(late)} late, {len(unexcused)} unexcused; {len(stalls.found)} stalls", file=sys.stderr)
    assert not unexcused
    assert len(late) < 0.02 * len(lines), "nothing can be said of a machine that stands still so often"


KILLS = 100


def test_kills_leave_no_trace_in_the_answers(tmp_path):
    lines, rng = rows_of(SECONDS * RATE), np.random.default_rng(1)
    (tmp_path / "rows").write_bytes(b"".join(lines))
    answers, begin = [], 0
    for left in range(KILLS, -1, -1):
        one = started(tmp_path / "state")
        if left < KILLS:
            begin, kept = going_on(one.stderr.readline().decode())
            assert len(answers) - 1 <= kept <= len(answers)
            del answers[kept:]
        sender = threading.Thread(target=send_all, args=(one, lines[begin:]))
        sender.start()
        if left:
            rows = rng.integers(1, 2 * (len(lines) - len(answers)) // (left + 1))
            answers += [one.stdout.readline() for _ in range(rows)]
            time.sleep(rng.uniform(0.0, 0.01))
            one.kill()
        answers += one.stdout.readlines()
        sender.join()
        one.wait()
    with (tmp_path / "rows").open("rb") as rows:
        whole = subprocess.run(TRACK_STREAM, stdin=rows, capture_output=True).stdout
    assert b"".join(answers) == whole


def send_all(one, lines):
    try:
        for begin in range(0, len(lines), 100):
            one.stdin.write(b"".join(lines[begin : begin + 100]))
        one.stdin.close()
    except BrokenPipeError:
        pass
