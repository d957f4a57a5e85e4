"""A client that resumes by itself: the service is killed again and again, and nothing is lost."""

import json
import signal
import subprocess
import sys

import pytest
from command import run
from serving import Service, rows, serving

import graphtrack as gt
from graphtrack.service.client import StreamClient

KILLS = 10


class Killed:
    """A service on one port that is killed, or stopped, and started again."""

    def __init__(self, folder):
        self._arguments = ("--state", str(folder), "--save-every", "0.1")
        self.kills, self.service = 0, Service(*self._arguments)
        self.port = self.service.port

    def again(self):
        self.service.stop(signal.SIGTERM if self.kills % 3 == 2 else signal.SIGKILL)
        self.kills += 1
        self.service = Service(*self._arguments, "--port", str(self.port))

    def client(self, name, every):
        return Between(f"ws://127.0.0.1:{self.port}/v1/streams/{name}", self, every)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.service.stop()


class Between(StreamClient):
    """A client whose service is killed between sending rows and receiving their answers."""

    def __init__(self, url, killed, every):
        super().__init__(url)
        self._killed, self._every, self._receives = killed, every, 0

    def receive(self, timeout=None):
        self._receives += timeout is None
        if self._receives % self._every == 0 and self._killed.kills < KILLS and timeout is None:
            self._receives += 1
            if self._killed.kills % 2:
                super().receive(timeout)  # the answer is lost on its way
            self._killed.again()
        return super().receive(timeout)


def of_track(lines):
    done = run("track", "-", "--model", "position", program="graphtrack", rows=lines)
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.mark.slow
def test_no_row_is_used_twice_or_lost_while_the_service_is_killed_ten_times(tmp_path):
    """Of two streams, one of people with identities and one of detections."""
    sent = [json.loads(line) for line in rows(40)]
    frames = [
        (0.1 * k, [{"x": 0.12 * k + one, "y": 2.0 * one} for one in range(3 if k % 7 else 0)])
        for k in range(len(sent))
    ]
    with (
        Killed(tmp_path) as killed,
        killed.client("people", 13) as people,
        killed.client("boxes", 37) as boxes,
    ):
        both = list(zip(people.follow(sent), boxes.follow_frames(frames), strict=True))
        assert killed.kills == KILLS and min(people.reconnections, boxes.reconnections) >= KILLS - 1
        assert people.end() == boxes.end() == []
    assert [answer for answer, _ in both] == of_track(sent)
    lines = [row for t, given in frames for row in (*({**one, "t": t} for one in given), {"end": t})]
    assert [answer for _, answers in both for answer in answers] == of_track(lines)
    assert [answers[-1]["end"] for _, answers in both] == [t for t, _ in frames]


@pytest.mark.slow
def test_errors_and_unconfirmed_frames_are_answered_in_step(tmp_path):
    sent = [json.loads(line) for line in rows(3, people=1)]
    sent[1]["x"] = "here"
    frames = [
        (5.0, [{"x": 0.0, "y": 0.0}]),
        (500.0, [{"x": 0.0, "y": 0.0}]),
        (5.1, [{"x": "here", "y": 0.0}]),
    ]
    with serving("--state", str(tmp_path)) as service:
        url = f"ws://127.0.0.1:{service.port}/v1/streams/"
        with StreamClient(url + "errors") as client:
            found = list(client.follow(sent))
        assert ["error" in one for one in found] == [False, True, False]
        with StreamClient(url + "frames") as client:
            known, unconfirmed, wrong = client.follow_frames(frames)
        assert known[-1]["people"] == 1 and [one["status"] for one in unconfirmed] == ["unconfirmed"] * 2
        assert "error" in wrong[0] and wrong[-1]["detections"] == 0


@pytest.mark.slow
def test_what_cannot_go_on_is_one_error(tmp_path):
    sent = [json.loads(line) for line in rows(4, people=1)]
    with serving() as service:  # without states
        url = f"ws://127.0.0.1:{service.port}/v1/streams/hall"
        with StreamClient(url) as client:
            following = client.follow(sent)
            next(following)
            client._connection.socket.shutdown(2)
            with pytest.raises(gt.InputError, match=r"0 of 1 rows .*--state"):
                list(following)
        with pytest.raises(gt.InputError, match="stream name"), StreamClient(url + "%20") as client:
            list(client.follow(sent))
    with pytest.raises(gt.InputError, match="expected a service"), StreamClient(url, patience=0.2) as client:
        pass


def test_the_missing_extra_is_one_sentence():
    code = (
        "import sys; sys.modules['websockets'] = None\n"
        "from graphtrack.service.client import StreamClient\n"
        "from graphtrack.errors import InputError\n"
        "try: StreamClient('ws://127.0.0.1:1/v1/streams/hall')\n"
        "except InputError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "graphtrack[serve]" in done.stdout and len(done.stdout.splitlines()) == 1
