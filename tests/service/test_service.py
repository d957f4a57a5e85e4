"""`graphtrack serve` for clients: answers of `track -`, nothing lost, and isolation of clients."""

import json
import os
import re
import signal
import socket
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

import pytest
from command import run
from serving import OPTIONS, answers, everything, processes_of, rows, serving, wait_until
from websockets.exceptions import ConnectionClosed


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with serving("--state", str(tmp_path_factory.mktemp("states")), "--max-streams", "3") as running:
        yield running


def of_track(lines):
    """Answers of ``graphtrack track -`` to the same rows."""
    return run("track", "-", "--model", "position", program="graphtrack", rows=lines).stdout.splitlines()


@pytest.mark.slow
def test_answers_are_those_of_track_however_rows_come(service):
    sent = [*rows(20), '{"track_id": 0, "frame": 3}', "no row", *rows(2, first=20)]
    with service.connect("same") as connection:
        for line in sent:
            connection.send(line)
        connection.send("")
        found, closed = everything(connection)
    assert closed.code == 1000 and found == of_track(sent)
    sent = rows(40)
    expected = of_track(sent)
    with service.connect("together") as connection:
        connection.send("\n".join(sent))
        assert answers(connection, len(sent)) == expected
    status, body = service.request("POST", "/v1/streams/body", "\n".join(sent))
    assert (status, body.splitlines()) == (200, expected)
    with service.connect("frames?answers=together") as connection:
        for k in range(0, len(sent), 8):
            connection.send("\n".join(sent[k : k + 8]))
        connection.send("")
        messages, closed = everything(connection)
    assert closed.code == 1000 and len(messages) < len(sent)
    assert "\n".join(messages).splitlines() == expected


def test_a_stream_goes_on_where_its_connection_ended(service):
    sent = rows(30)
    whole = of_track(sent)
    with service.connect("kept") as connection:
        for line in sent[:40]:
            connection.send(line)
        found = answers(connection, 40)
    with service.connect("kept") as connection:
        there = json.loads(connection.recv(timeout=60))
        assert there == {"rows": 40, "line": 40, "given_again": False}
        for line in sent[40:]:
            connection.send(line)
        found += answers(connection, 20)
    assert found == whole and service.request("DELETE", "/v1/streams/kept")[0] == 204
    with service.connect("kept") as connection:  # and starts again
        connection.send(sent[0])
        assert connection.recv(timeout=60) == whole[0]


@pytest.mark.slow
def test_a_stream_that_another_service_has_open_is_not_forgotten(service):
    arguments = service.process.args
    folder = arguments[arguments.index("--state") + 1]
    kept = Path(folder) / "shared.state"
    with serving("--state", folder) as other:
        with service.connect("shared") as connection:
            connection.send(rows(1)[0])
            first = connection.recv(timeout=60)
            before = kept.stat().st_ino, kept.read_bytes()
            status, told = other.request("DELETE", "/v1/streams/shared")
            assert status == 409 and "another process" in told
            assert (kept.stat().st_ino, kept.read_bytes()) == before
            connection.send("")
            everything(connection)
        assert other.request("DELETE", "/v1/streams/shared")[0] == 204 and not kept.exists()
        assert other.request("DELETE", "/v1/streams/shared")[0] == 404
        with service.connect("shared") as connection:
            connection.send(rows(1)[0])
            assert connection.recv(timeout=60) == first


@pytest.mark.slow
def test_one_connection_a_stream_and_so_many_streams(service):
    with service.connect("one") as connection:
        connection.send(rows(1)[0])
        connection.recv(timeout=60)
        with service.connect("one") as again:
            assert everything(again)[1].code == 4409
        assert service.request("POST", "/v1/streams/one", "")[0] == 409
        assert service.request("DELETE", "/v1/streams/one")[0] == 409
        with service.connect("two"), service.connect("three"), service.connect("four") as fourth:
            closed = everything(fourth)[1]
            assert closed.code == 4429 and "3 streams are open" in closed.reason
        connection.send(rows(1, first=1)[0])
        assert json.loads(connection.recv(timeout=60))["frame"] == 1
    assert service.request("POST", "/v1/streams/..%2Fetc", "")[0] == 404


@pytest.mark.slow
def test_those_who_misbehave_hurt_nobody_else(service):
    with service.connect("good") as good:
        with service.connect("oversized") as bad:
            bad.send("x" * (1 << 17))
            assert everything(bad)[1].code == 1009
        # A client that never reads: rows wait in the sockets, and no longer in any process's memory.
        slow = service.connect("slow", max_queue=1)
        text = "\n".join(rows(200))
        with slow, half_open(service.port):
            slow.socket.settimeout(5.0)
            with suppress(TimeoutError, ConnectionClosed):
                for _ in range(3):
                    slow.send(text)
            for line in rows(10):
                good.send(line)
            assert len(answers(good, 20)) == 20


@contextmanager
def half_open(port):
    """A client that sends an incomplete request."""
    with socket.create_connection(("127.0.0.1", port)) as begun:
        begun.sendall(b"GET /v1/streams/half HTTP/1.1\r\nHost: here\r\nUpgr")
        yield


def test_a_process_that_dies_is_told_and_comes_back(service):
    with service.connect("dying") as connection:
        for line in rows(5):
            connection.send(line)
        found = answers(connection, 10)
        for process in processes_of(service):
            os.kill(process, signal.SIGKILL)
        closed = everything(connection)[1]
        assert closed.code == 1011 and "connect again" in closed.reason
    with service.connect("dying") as connection:
        there = json.loads(connection.recv(timeout=60))
        kept = found[: there["rows"] - there["given_again"]]
        connection.send("")
        assert [*kept, *everything(connection)[0]] == found


def test_counts(service):
    with service.connect("counted") as connection:
        for row in rows(30):
            connection.send(row)
        answers(connection, 60)
        connection.send("")
        everything(connection)
    status, text = service.request("GET", "/metrics")
    counted = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert status == 200 and float(counted["graphtrack_rows_total"]) > 50
    bounds = re.findall(r'graphtrack_latency_seconds_bucket{le="([^"]+)"}', text)
    assert all(float(a) < float(b) for a, b in pairwise(bounds)) and bounds[-1] == "+Inf"
    below = [float(n) for name, n in counted.items() if name.startswith("graphtrack_latency_seconds_bucket")]
    assert all(a <= b for a, b in pairwise(below)) and below[-1] == float(counted["graphtrack_rows_total"])
    for name in ("waiting", "people", "streams"):
        key = "graphtrack_rows_waiting" if name == "waiting" else f"graphtrack_{name}"
        wait_until(lambda key=key: f"\n{key} 0.0\n" in service.request("GET", "/metrics")[1])
    assert json.loads(service.request("GET", "/health")[1]) == {"status": "ok", "streams": 0}


def test_the_learned_scene_is_a_gauge_while_the_stream_is_open(service):
    """Three people walk abreast at 2 Hz, each detected in each frame."""
    with service.connect("hall") as connection:
        for k in range(24):
            for x in (0.0, 3.0, 6.0):
                connection.send(json.dumps({"t": 0.5 * k, "x": x, "y": 0.6 * k}))
            connection.send(json.dumps({"end": 0.5 * k}))
        kept = re.compile(r'graphtrack_scene\{parameter="detection_probability",stream="hall"\} (\S+)')
        wait_until(lambda: kept.search(service.request("GET", "/metrics")[1]))
        found = kept.search(service.request("GET", "/metrics")[1])
        assert found is not None and float(found[1]) > 0.8
        connection.send("")
        everything(connection)
    wait_until(lambda: "graphtrack_scene{" not in service.request("GET", "/metrics")[1])


@pytest.mark.slow
def test_a_token_is_asked_for_and_people_are_bounded():
    with serving("--max-people", "2", "--forget-after", "1", GRAPHTRACK_TOKEN="secret") as service:
        assert service.request("GET", "/health")[0] == 200
        for path in ("/metrics", "/v1/streams"):
            assert service.request("GET", path)[0] == 401
            assert service.request("GET", path, Authorization="Bearer secret")[0] == 200
        with service.connect("x") as connection:
            assert everything(connection)[1].code == 4401
        with service.connect("x?token=secret") as connection:
            for line in (*rows(1, people=3), *rows(1, first=30, people=1), *rows(1, first=31, people=3)[2:]):
                connection.send(line)
            found = [json.loads(one) for one in answers(connection, 5)]
    assert "one more than 2 people" in found[2]["error"]
    assert found[4]["track_id"] == 2 and found[4]["status"] == "new"  # for by then another was forgotten


TOKEN_FILE = ("--token-file", "token")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "token", "said"),
    [
        (("--host", "203.0.113.7", *TOKEN_FILE), b"secret", "an address of this machine"),
        (("--host", "0.0.0.0"), b"", "--host 0.0.0.0 without a token, expected --token-file"),
        (("--lag", "-1"), b"", "lag"),
        (("--allow-host", "http://x"), b"", "--allow-host http://x, expected"),
        (("--allow-host", "x:80"), b"", "--allow-host x:80, expected"),
        (("--allow-origin", "x.example/a"), b"", "--allow-origin x.example/a, expected"),
        (TOKEN_FILE, b"", "error: token: found an empty token"),
        (TOKEN_FILE, b"\xff\xfe\x00secret", "error: token: found byte 1 is no UTF-8"),
        (TOKEN_FILE, "grün".encode(), "error: token: found a token with other characters"),
        (TOKEN_FILE, b"two words", "error: token: found a token with other characters"),
        (TOKEN_FILE, b"x" * 5000, "error: token: found more than 4096 bytes"),
    ],
)
def test_what_cannot_be_served_is_told(options, token, said, cwd):
    Path("token").write_bytes(token)
    done = run("serve", *OPTIONS, *options, program="graphtrack")
    assert done.returncode == 2 and said in done.stderr
