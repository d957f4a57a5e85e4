"""What `StreamClient` takes: addresses of streams, and rows of plain and of NumPy numbers."""

import json

import numpy as np
import pytest

import graphtrack as gt

ADDRESS = "ws://127.0.0.1:8765/v1/streams/hall"


@pytest.mark.parametrize(
    ("url", "found", "expected"),
    [
        ("http://127.0.0.1:8765/v1/streams/hall", "http://127.0.0.1:8765", "ws://127"),
        ("127.0.0.1:8765/v1/streams/hall", "127.0.0.1:8765", "ws://127"),
        ("ws:///v1/streams/hall", "ws:///v1", "ws://127"),
        ("ws://127.0.0.1:99999/v1/streams/hall", "99999", "ws://127"),
        (8765, "8765", "ws://127"),
        ("ws://127.0.0.1:8765/v1/stream/hall", "'/v1/stream/hall'", "/v1/streams/NAME"),
        ("ws://127.0.0.1:8765", "the path ''", "/v1/streams/NAME"),
        ("ws://127.0.0.1:8765/v1/streams/", "the stream ''", "64 letters"),
        ("ws://127.0.0.1:8765/v1/streams/the hall", "'the hall'", "64 letters"),
        ("ws://127.0.0.1:8765/v1/streams/hall/1", "'hall/1'", "64 letters"),
        ("ws://127.0.0.1:8765/v1/streams/" + "a" * 65, "'aaa", "64 letters"),
    ],
)
def test_an_address_of_no_stream_is_refused_before_connecting(url, found, expected):
    with pytest.raises(gt.InputError) as error:
        gt.StreamClient(url)
    assert found in error.value.found and expected in error.value.expected


@pytest.mark.parametrize("url", [ADDRESS, "wss://site.example/tracks/v1/streams/a.b-1?token=x"])
def test_addresses_of_streams_are_taken(url):
    gt.StreamClient(url)


class Connection:
    """A connection that answers each frame, and keeps what it was sent."""

    def __init__(self):
        self.sent, self._answers = [], []

    def send(self, text):
        rows = [json.loads(line) for line in text.splitlines()]
        self.sent += rows
        self._answers += [{"end": row["end"], "people": 0} for row in rows if "end" in row]

    def recv(self, timeout):
        return json.dumps(self._answers.pop(0))


@pytest.fixture
def client():
    found = gt.StreamClient(ADDRESS)
    found._connection = Connection()
    return found


def test_numbers_of_numpy_are_sent_as_numbers(client):
    position, t = np.array([0.25, 2.0], np.float32), np.int64(3)
    row = {"x": position[0], "y": position[1], "track_id": np.int64(7), "body_deg": np.float64(1.5)}
    (answers,) = client.follow_frames([(t, [row | {"input_appearance": np.array([1, 2])}])])
    assert client._connection.sent == [
        {"x": 0.25, "y": 2.0, "track_id": 7, "body_deg": 1.5, "input_appearance": [1, 2], "t": 3},
        {"end": 3},
    ]
    assert answers == [{"end": 3, "people": 0}]


@pytest.mark.parametrize(
    ("row", "found"),
    [
        ((0.0, 1.0), "a row (0.0, 1.0)"),
        ({"x": object(), "y": 0.0}, "(object) in the row"),
        ({"x": {1, 2}}, "(set) in the row"),
        ({(1, 2): 0.0}, "keys must be"),
    ],
)
@pytest.mark.parametrize("way", ["send", "follow", "follow_frames"])
def test_other_rows_are_refused_by_name_and_nothing_is_sent(client, way, row, found):
    calls = {
        "send": lambda: client.send(row),
        "follow": lambda: list(client.follow([row])),
        "follow_frames": lambda: list(client.follow_frames([(0.0, [row])])),
    }
    with pytest.raises(gt.InputError) as error:
        calls[way]()
    assert found in str(error.value) and client._connection.sent == []


def test_a_frame_that_waits_is_answered_later(client):
    connection = client._connection
    connection.send = lambda text: connection._answers.extend(
        [
            {"end": 0.1, "sensor": "west", "people": 1},  # of another sensor at the same time
            {"end": 0.1, "sensor": "east", "status": "held"},
        ]
    )
    (answers,) = client.follow_frames([(0.1, [])], sensor="east")
    assert [one.get("status") for one in answers] == [None, "held"]
