"""A running `graphtrack serve`, its clients, and rows for them."""

import http.client
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

OPTIONS = ("--model", "position", "--port", "0")


class Service:
    """A running service."""

    def __init__(self, *options, **environment):
        command = [sys.executable, "-m", "graphtrack", "serve", *OPTIONS, *options]
        self.process = subprocess.Popen(
            command, stderr=subprocess.PIPE, text=True, env={**os.environ, **environment}
        )
        said = []
        for line in self.process.stderr:
            said.append(line)
            if found := re.search(r"ws://127\.0\.0\.1:(\d+)/", line):
                self.port = int(found[1])
                return
        raise AssertionError("".join(said))

    def connect(self, name, **more):
        return connect(f"ws://127.0.0.1:{self.port}/v1/streams/{name}", **more)

    def request(self, method, path, body=None, **headers):
        asking = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        asking.request(method, path, body, headers)
        answer = asking.getresponse()
        return answer.status, answer.read().decode()

    def stop(self, how=signal.SIGTERM):
        self.process.send_signal(how)
        status = self.process.wait(timeout=60)
        self.process.stderr.close()
        return status


@contextmanager
def serving(*options, **environment):
    service = Service(*options, **environment)
    try:
        yield service
    finally:
        if service.process.poll() is None:
            service.stop()


def rows(n, people=2, first=0):
    return [
        json.dumps({"track_id": one, "frame": k, "t": k / 10, "x": 0.13 * k + one, "y": 0.1 * (k % 3)})
        for k in range(first, first + n)
        for one in range(people)
    ]


def answers(connection, n):
    return [connection.recv(timeout=60) for _ in range(n)]


def everything(connection):
    """All messages until the service closes."""
    found = []
    with pytest.raises(ConnectionClosed) as closed:
        while True:
            found.append(connection.recv(timeout=60))
    return found, closed.value.rcvd


def wait_until(holds):
    for _ in range(300):
        if holds():
            return
        time.sleep(0.1)
    raise AssertionError("it never held")


def processes_of(service):
    """Return the ids of the streams' processes: the children of the fork server."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended in between
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    children = {one for one, parent in parents.items() if parent == service.process.pid}
    return [one for one, parent in parents.items() if parent in children]
