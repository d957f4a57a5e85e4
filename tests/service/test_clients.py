"""Clients that vanish, stay silent or are foreign web pages."""

import gzip
import http.client
import json
import signal
import socket
import time
from contextlib import ExitStack, suppress

import jsonschema
import pytest
from serving import everything, rows, serving, wait_until
from websockets.exceptions import InvalidStatus

import graphtrack
from graphtrack.service.client import StreamClient

HEAD = b"POST /v1/streams/%s HTTP/1.1\r\nHost: localhost\r\n"
CHUNKED = b"Transfer-Encoding: chunked\r\n\r\n"


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    options = ("--state", str(tmp_path_factory.mktemp("states")), "--patience", "3", "--max-rate", "1e6")
    with serving(*options) as running:
        yield running
        running.process.send_signal(signal.SIGTERM)
        log = running.process.stderr.read()
        assert "Traceback" not in log and "ERROR" not in log


def begin(service, name, headers=CHUNKED):
    client = socket.create_connection(("127.0.0.1", service.port))
    client.sendall(HEAD % name + headers)
    return client


def chunk(lines):
    text = "".join(f"{line}\n" for line in lines).encode()
    return b"%x\r\n%s\r\n" % (len(text), text)


def is_open(service, name):
    return name in json.loads(service.request("GET", "/v1/streams")[1])["streams"]


def flood(client):
    """Send 60,000 rows and read no answers; until nothing more is taken."""
    client.settimeout(1.0)
    with suppress(TimeoutError):
        for first in range(0, 30_000, 100):
            client.sendall(chunk(rows(100, first=first)))


def ended(service, name, seconds=15.0):
    """Wait until the stream of a client that asked for it a moment ago has ended, its process too.

    The time is a guard against a hang: half of the patience of a service by default.
    """
    until = time.monotonic() + seconds
    while (still := is_open(service, name)) and time.monotonic() < until:
        time.sleep(0.05)
    return not still


@pytest.mark.slow
@pytest.mark.parametrize("leaves", [False, True])
def test_answers_that_are_never_read_end_after_the_patience_or_with_the_client(service, leaves):
    with begin(service, b"unread") as client:
        flood(client)
        if leaves:
            client.close()
        assert ended(service, "unread")


@pytest.mark.slow
@pytest.mark.parametrize("reset", [False, True])
def test_a_client_that_leaves_in_the_middle_of_its_body_ends_its_stream(service, reset):
    client = begin(service, b"left")
    client.sendall(chunk(rows(3)) + b'20\r\n{"track_id": 0, ')
    wait_until(lambda: is_open(service, "left"))
    if reset:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    client.close()
    assert ended(service, "left")
    status, body = service.request("POST", "/v1/streams/left", "")
    assert status == 200 and json.loads(body.splitlines()[0])["rows"] % 6 == 0  # none that was cut off
    for k in range(8):  # more than may be open together
        client = begin(service, b"many%d" % k, b"Content-Length: 1000\r\n\r\n")
        wait_until(lambda k=k: is_open(service, f"many{k}"))
        client.close()
    wait_until(lambda: not json.loads(service.request("GET", "/v1/streams")[1])["streams"])


@pytest.mark.slow
@pytest.mark.parametrize("headers", [CHUNKED, b"Content-Length: 1000\r\n\r\n"])
def test_headers_without_a_body_end_after_the_patience(service, headers):
    with begin(service, b"silent", headers) as client:
        wait_until(lambda: is_open(service, "silent"))
        assert ended(service, "silent")
        client.settimeout(10.0)
        found = client.recv(1 << 16)
        while b"\r\n0\r\n" not in found:
            found += client.recv(1 << 16)
        assert b"no row came for 3 s" in found


@pytest.mark.slow
def test_a_client_that_is_slowed_down_may_leave(tmp_path):
    with serving("--state", str(tmp_path), "--max-rate", "1") as slow:
        client = begin(slow, b"slow")
        client.sendall(chunk(rows(3000)))
        wait_until(lambda: is_open(slow, "slow"))
        client.close()
        assert ended(slow, "slow")
        with slow.connect("slow") as websocket:
            for line in rows(50):
                websocket.send(line)
            websocket.socket.shutdown(socket.SHUT_RDWR)
        assert ended(slow, "slow")


@pytest.mark.slow
def test_a_request_that_is_never_finished_is_dropped(service):
    with socket.create_connection(("127.0.0.1", service.port)) as client:
        client.sendall(b"GET /health HTTP/1.1\r\nHost: loc")
        client.settimeout(10.0)
        with suppress(ConnectionError):
            assert client.recv(1) == b""


@pytest.mark.slow
def test_the_service_stops_within_seconds(tmp_path):
    """With clients that have sent nothing, some rows, and rows whose answers they do not read."""
    with serving("--state", str(tmp_path), "--max-streams", "8") as running, ExitStack() as clients:
        _, some, flooding, gone = (
            clients.enter_context(begin(running, name)) for name in (b"silent", b"some", b"flood", b"gone")
        )
        some.sendall(chunk(rows(3)))
        flood(flooding)
        with running.connect("socket") as websocket:
            websocket.send(rows(1)[0])
            wait_until(lambda: all(is_open(running, name) for name in ("silent", "some", "flood")))
            gone.close()
            running.process.send_signal(signal.SIGTERM)
            began = time.monotonic()
            assert running.process.wait(timeout=60) == 0 and time.monotonic() - began < 5.0
        log = running.process.stderr.read()
        assert "Traceback" not in log and "ERROR" not in log


@pytest.mark.parametrize("as_text", [False, True])
def test_bytes_that_are_no_text_are_answered_at_once(service, as_text):
    with service.connect(f"bytes{as_text}") as connection:
        connection.send(b"\xff\xfe\xfd", text=as_text)
        assert everything(connection)[1].code == 1007


def test_a_client_that_waits_to_be_asked_for_its_body_is_asked(service):
    """As curl does with large bodies."""
    body = rows(3)[0].encode() + b"\n"
    headers = b"Expect: 100-continue\r\nContent-Length: %d\r\n\r\n" % len(body)
    with begin(service, b"waiting", headers) as client:
        client.settimeout(10.0)
        found = client.recv(1 << 16)
        assert found.startswith(b"HTTP/1.1 100 ")
        client.sendall(body)
        while b"\r\n0\r\n" not in found:
            found += client.recv(1 << 16)
        assert found.count(b'"status":"new"') == 1


def test_a_compressed_body_is_refused(service):
    body = gzip.compress("\n".join(rows(3)).encode())
    status, answer = service.request("POST", "/v1/streams/packed", body, **{"Content-Encoding": "gzip"})
    assert status == 415 and "gzip" in json.loads(answer)["error"]
    status, answer = service.request(
        "POST", "/v1/streams/packed", rows(3)[0], **{"Content-Encoding": "identity"}
    )
    assert status == 200 and '"new"' in answer


@pytest.fixture(scope="module")
def keeping(tmp_path_factory):
    """A service that others may use by name, and the folder of its states."""
    folder = tmp_path_factory.mktemp("kept") / "states"
    folder.mkdir()
    named = ("--allow-host", "camera.example", "--allow-origin", "https://view.example")
    with serving(*named, "--state", str(folder)) as running:
        yield running, folder


@pytest.mark.slow
def test_clients_do_not_learn_where_states_are_kept(keeping):
    service, folder = keeping
    service.request("POST", "/v1/streams/hall", "\n".join(rows(3)))
    state = folder / "hall.state"
    state.write_bytes(state.read_bytes()[:-999])
    _, answer = service.request("POST", "/v1/streams/hall", rows(3)[0])
    (told,) = map(json.loads, answer.splitlines())
    assert told["error"].startswith("state of stream hall: found a damaged state")
    assert str(folder) not in answer
    assert service.request("DELETE", "/v1/streams/hall")[0] == 204 and not state.exists()


def test_what_is_no_state_is_not_removed(keeping):
    service, folder = keeping
    other = folder.parent / "other"
    other.write_text("of somebody else")
    (folder / "link.state").symlink_to(other)
    (folder / "folder.state").mkdir()
    for name in ("link", "folder"):
        status, answer = service.request("DELETE", f"/v1/streams/{name}")
        assert status == 409 and "expected" not in answer and name in json.loads(answer)["error"]
    assert other.read_text() == "of somebody else"
    assert {one.name for one in folder.iterdir()} >= {"link.state", "folder.state"}


FOREIGN = {"Origin": "http://evil.example"}


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "evil.example"}, 400),
        ({"Host": "evil.example:8765", "Origin": "http://evil.example:8765"}, 400),
        ({"Host": "localhost.evil.example"}, 400),
        (FOREIGN, 403),
        ({**FOREIGN, "Content-Type": "text/plain"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://localhost:1"}, 403),
        ({"Host": "localhost"}, 200),
        ({"Host": "[::1]:8765"}, 200),
        ({"Host": "localhost:8765", "Origin": "http://localhost:8765"}, 200),
    ],
)
def test_foreign_pages_do_nothing(service, headers, status):
    assert service.request("POST", "/v1/streams/mine", rows(1)[0], **headers)[0] == status
    assert service.request("GET", "/v1/streams", **headers)[0] == status
    expected = 204 if status == 200 else status
    if status != 200:
        service.request("POST", "/v1/streams/mine", rows(1)[0])
    assert service.request("DELETE", "/v1/streams/mine", **headers)[0] == expected
    if headers == FOREIGN:
        with pytest.raises(InvalidStatus) as refused:
            service.connect("page", origin=FOREIGN["Origin"])
        assert refused.value.response.status_code == 403
        with service.connect("page", origin=f"http://127.0.0.1:{service.port}") as connection:
            connection.send(rows(1)[0])
            assert "x" in json.loads(connection.recv(timeout=60))


def test_hosts_and_origins_may_be_allowed(keeping):
    service, _ = keeping
    for headers in ({"Host": "camera.example:80"}, {"Origin": "https://view.example"}):
        assert service.request("POST", "/v1/streams/one", rows(1)[0], **headers)[0] == 200
    asked = {"Origin": "https://view.example", "Access-Control-Request-Method": "DELETE"}
    assert service.request("OPTIONS", "/v1/streams/one", **asked)[0] == 200
    assert service.request("GET", "/", Host="other.example")[0] == 400
    assert service.request("GET", "/", Origin="http://view.example")[0] == 403
    with service.connect("one", origin="https://view.example"):
        pass


def test_every_address_is_described(service):
    document = json.loads(service.request("GET", "/openapi.json")[1])
    _, root = service.request("GET", "/")
    _, page = service.request("GET", "/docs")
    for path, calls in document["paths"].items():
        if path == "/":
            continue
        assert path.replace("{name}", "NAME") in root and path in page
        if "{name}" not in path:
            assert service.request("GET", path)[0] == 200
        for method in {"get", "post", "delete"} - set(calls):
            assert service.request(method.upper(), path.replace("{name}", "x"))[0] in (404, 405)
    assert "http" not in page.replace("https://json-schema.org", "")  # nothing is loaded from elsewhere
    assert json.loads(service.request("GET", "/version")[1]) == {"version": graphtrack.__version__}
    assert json.loads(service.request("GET", "/ready")[1]) == {"status": "ready"}


def test_rows_and_answers_follow_their_schemas(service):
    schemas = json.loads(service.request("GET", "/openapi.json")[1])["components"]["schemas"]
    of_all = {"head_deg": 10.0, "input_gaze": None, "sensor": "laser", "pos_std": None}
    of_all |= {"observed_x_std": 0.1, "observed_y_std": 0.2, "observed_xy_corr": 0.5}
    sent = [json.loads(line) | of_all for line in rows(3)]
    sent.append(sent[-1] | {"x": 1e300})
    _, body = service.request("POST", "/v1/streams/schemas", "\n".join(map(json.dumps, sent)))
    note, *answers = [json.loads(line) for line in body.splitlines()]
    assert "'head_deg' is not used" in note["note"]
    assert len(answers) == len(sent) and "error" in answers[-1]
    assert [one["sensor"] for one in answers[:-1]] == ["laser"] * (len(sent) - 1)
    for answer in answers:
        jsonschema.validate(answer, schemas["Answer"])
    for row in sent[:-1]:
        jsonschema.validate(row, schemas["Row"])
    with pytest.raises(jsonschema.ValidationError, match=r"1e\+300"):
        jsonschema.validate(sent[-1], schemas["Row"])


@pytest.mark.parametrize(
    ("method", "path", "headers"),
    [
        ("GET", "/nowhere", {}),
        ("PUT", "/v1/streams/x", {}),
        ("GET", "/", {"Host": "evil.example"}),
        ("GET", "/", FOREIGN),
        ("DELETE", "/v1/streams/nobody", {}),
        ("DELETE", "/v1/streams/-", {}),
    ],
)
def test_errors_have_one_form(service, method, path, headers):
    status, body = service.request(method, path, **headers)
    assert status >= 400 and list(json.loads(body)) == ["error"]


def test_the_client_of_a_resumed_stream_is_in_step(service):
    url = f"ws://127.0.0.1:{service.port}/v1/streams/resumed"
    sent, frames = [json.loads(line) for line in rows(8, people=1)], []
    for part in (sent[:3], sent[3:]):
        with StreamClient(url) as client:
            frames += [answer["frame"] for answer in client.follow(part)]
    assert frames == [row["frame"] for row in sent]
    assert client.known_rows == 3 and all(answer["frame"] < 3 for answer in client.repeated)


@pytest.mark.slow
def test_a_client_that_reads_slowly_gets_every_answer(service):
    """Closing waits for clients that still read."""
    asking = http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)
    asking.request("POST", "/v1/streams/reader", "\n".join(rows(1000)), {"Connection": "close"})
    answer, found = asking.getresponse(), b""
    while data := answer.read(20_000):
        found += data
        time.sleep(0.1)
    assert len(found.splitlines()) == 2000
