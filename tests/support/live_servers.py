"""Loopback servers of live video: MJPEG over HTTP, and RTSP with an MPEG transport stream over TCP."""

import socket
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np


@contextmanager
def mjpeg_server(images: Sequence[np.ndarray], pause: Callable[[int], None], cuts: set[int]) -> Iterator[str]:
    """Serve images as multipart JPEG; connections end before the frames in ``cuts``, and at the end.

    ``pause`` is called with the number of each frame before it is sent; a further client gets the frames that
    no client before it got.
    """
    left = iter(range(len(images)))
    cut = set(cuts)

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            for k in left:
                pause(k)
                data = cv2.imencode(".jpg", images[k])[1].tobytes()
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + data + b"\r\n")
                except OSError:
                    return
                if k + 1 in cut:
                    return

        def log_message(self, *arguments: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/stream"
    finally:
        server.shutdown()
        server.server_close()


_ANSWERS = {
    "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n\r\n",
    "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 7\r\n\r\n",
    "PLAY": "Session: 7\r\n\r\n",
    "TEARDOWN": "Session: 7\r\n\r\n",
}
_SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=-\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\n"
    "m=video 0 RTP/AVP 33\r\na=control:v\r\n"
)


@contextmanager
def rtsp_server(stream: bytes, pause: Callable[[int], None]) -> Iterator[str]:
    """Serve an MPEG transport stream once (RFC 2326, 2250), interleaved in the connection of the requests.

    ``pause`` is called with the number of each RTP packet before it is sent.
    """
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        connection, _ = listener.accept()
        with connection, connection.makefile("rb") as requests:
            for line in iter(requests.readline, b""):
                method = line.split()[0].decode()
                headers = dict(
                    one.decode().strip().split(": ", 1) for one in iter(requests.readline, b"\r\n")
                )
                answer = _ANSWERS.get(method) or (
                    f"Content-Type: application/sdp\r\nContent-Length: {len(_SDP)}\r\n\r\n{_SDP}"
                )
                connection.sendall(f"RTSP/1.0 200 OK\r\nCSeq: {headers['CSeq']}\r\n{answer}".encode())
                if method == "PLAY":
                    break
            for k, start in enumerate(range(0, len(stream), 7 * 188)):
                pause(k)
                part = stream[start : start + 7 * 188]
                packet = struct.pack(">BBHII", 0x80, 33, k & 0xFFFF, 90 * k, 1) + part
                try:
                    connection.sendall(struct.pack(">cBH", b"$", 0, len(packet)) + packet)
                except OSError:
                    return

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"rtsp://127.0.0.1:{listener.getsockname()[1]}/camera"
    finally:
        listener.close()
        thread.join(5.0)
