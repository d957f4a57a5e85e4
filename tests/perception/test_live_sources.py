"""Live sources: loopback servers, pipes, lost connections, dropped frames, and what is refused."""

import io
import json
import os
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ran, run
from encoded_videos import encoded
from live_servers import mjpeg_server, rtsp_server

from graphtrack.errors import InputError
from perception.images import live
from perception.images.frames import FrameSource
from perception.images.live import LiveFrames, LiveSource, record

RNG = np.random.default_rng(0)
SMOOTH = cv2.GaussianBlur(RNG.integers(0, 256, (96, 128, 3)).astype(np.uint8), (0, 0), 4.0)
IMAGES = [np.roll(SMOOTH, 4 * k, axis=1) for k in range(30)]

FINE = {"b": "4M"}


def opened(address: str, said: list[str], **options: float) -> LiveFrames:
    source = LiveSource.of(address)
    assert source is not None
    return LiveFrames(source, report=said.append, **options)


def which(image: np.ndarray) -> int:
    """Return the number of the image that was sent."""
    return int(np.argmin([np.abs(image.astype(float) - one).mean() for one in IMAGES]))


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_WAITS", (0.01, 0.1))


@pytest.mark.usefixtures("at_once")
def test_a_lost_connection_is_made_again_and_frames_keep_their_order() -> None:
    said: list[str] = []
    with mjpeg_server(IMAGES, lambda k: time.sleep(0.02), {12}) as address:
        found, times = [], []
        with opened(address, said, reconnect=5.0) as frames:
            for frame in frames:
                found.append(which(frame.image))
                times.append(float(frames.clock(25.0).seconds(frame.number)))
                if found[-1] == len(IMAGES) - 1 or len(found) > len(IMAGES):
                    break
    assert found == sorted(set(found)) and found[0] < 12 < found[-1]
    assert times[0] >= 0.0 and all(np.diff(times) > 0.0)
    assert any("connecting again" in line for line in said) and any(
        "connected again" in line for line in said
    )


def test_only_the_newest_frame_is_kept_and_the_rest_counted() -> None:
    sent, taken = threading.Event(), threading.Event()

    def pause(k: int) -> None:
        if k == 20:
            sent.set()
            taken.wait(10.0)

    with mjpeg_server(IMAGES, pause, set()) as address, opened(address, [], reconnect=0.0) as frames:
        numbers = []
        for frame in frames:
            numbers.append(frame.number)
            if len(numbers) == 1:
                assert sent.wait(10.0)
                while frames.received < 19:
                    time.sleep(0.01)
                taken.set()
        assert len(numbers) + frames.dropped == frames.received
        assert frames.dropped >= 10 and numbers == sorted(set(numbers))
        assert f"{frames.dropped} of {frames.received} dropped" in frames.state()
        assert "latency" in frames.state()


@pytest.mark.usefixtures("at_once")
def test_a_source_that_does_not_come_back_is_an_error_and_none_at_first_too() -> None:
    said: list[str] = []
    with (
        mjpeg_server(IMAGES[:3], lambda k: None, set()) as address,
        opened(address, said, reconnect=0.3) as frames,
        pytest.raises(InputError, match=r"a connection that was lost .* within 0.3 s"),
    ):
        list(frames)
    with (
        pytest.raises(InputError, match="expected a webcam") as found,
        opened("http://me:secret@127.0.0.1:9/x", said),
    ):
        pass
    assert "secret" not in str(found.value)


def test_rtsp_is_read(tmp_path: Path) -> None:
    path = encoded(tmp_path / "a.ts", IMAGES, "mpeg2video", 25, options=FINE)
    with (
        rtsp_server(path.read_bytes(), lambda k: time.sleep(0.002)) as address,
        opened(address, [], reconnect=0.0) as frames,
    ):
        found = [which(frame.image) for frame in frames]
        assert frames.size() == (128, 96)
    assert found == sorted(found) and len(found) >= 1 and found[-1] >= 15


@pytest.mark.parametrize("suffix", [".ts", ".mjpeg", ".mkv"])
def test_a_pipe_gives_every_frame_with_the_times_of_its_container(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mjpeg":
        data = b"".join(cv2.imencode(".jpg", one)[1].tobytes() for one in IMAGES)
    else:
        data = encoded(tmp_path / f"a{suffix}", IMAGES, "mpeg2video", 10, options=FINE).read_bytes()
    fifo = tmp_path / "camera"
    os.mkfifo(fifo)
    writer = threading.Thread(target=lambda: fifo.open("wb").write(data), daemon=True)
    writer.start()
    with opened(str(fifo), []) as frames:
        found = [(which(one.image), float(frames.clock(25.0).seconds(one.number))) for one in frames]
        assert frames.dropped == 0 and frames.received == len(IMAGES)
    assert [k for k, _ in found] == list(range(len(IMAGES)))
    rate = 25.0 if suffix == ".mjpeg" else 10.0
    np.testing.assert_allclose([t for _, t in found], np.arange(len(IMAGES)) / rate, atol=2e-3)


class Standard(io.TextIOWrapper):
    """Standard input with the bytes of a file."""

    def __init__(self, data: bytes) -> None:
        super().__init__(io.BytesIO(data))


@pytest.mark.slow
def test_rows_of_a_video_on_standard_input_are_those_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran("simulate", "street", "-o", tmp_path / "clip", "--frames", 4, "--people", 2, "--seed", 3)
    images = [frame.image for frame in FrameSource.open(tmp_path / "clip" / "video.mp4")]
    video = encoded(tmp_path / "a.mkv", [one for one in images if one is not None], "ffv1", rate=5)
    homography = tmp_path / "clip" / "homography.txt"
    of_file = ran("observe", video, "--homography", homography, "-o", "-").stdout
    monkeypatch.setattr(sys, "stdin", Standard(video.read_bytes()))
    of_pipe = ran("observe", "-", "--homography", homography, "-o", "-").stdout
    rows = [[json.loads(line) for line in text.splitlines()] for text in (of_file, of_pipe)]
    assert rows[0] and len(rows[0]) == len(rows[1])
    for one, other in zip(*rows, strict=True):
        assert one["frame"] == other["frame"] and one["t"] == pytest.approx(other["t"], abs=2e-3)
        assert one["x"] == other["x"] and one["body_p0"] == other["body_p0"]


def test_text_on_a_pipe_is_no_video(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", Standard(b"#EXTM3U\n#EXTINF:1,\nother.mp4\n"))
    done = run("observe", "-", "-o", "-")
    assert done.returncode == 2 and "found text" in done.stderr


def test_an_mp4_with_its_index_at_the_end_is_no_stream(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = [RNG.integers(0, 256, (96, 128, 3)).astype(np.uint8) for _ in range(60)]  # more than a buffer
    data = encoded(tmp_path / "a.mp4", noise, "mpeg4", options=FINE).read_bytes()
    for arguments in (["observe", "-", "-o", "-"], ["report", "-", "--live", "-o", tmp_path / "out"]):
        monkeypatch.setattr(sys, "stdin", Standard(data))
        done = run(*arguments)
        assert done.returncode == 2 and "standard input" in done.stderr and "MP4" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["rtsp://127.0.0.1/x", "-o", "a.csv"], "-o -"),
        (["/dev/video99", "-o", "-"], "expected a webcam"),
        (["99", "-o", "-"], "expected a webcam"),
        (["rtsp://127.0.0.1/x", "--boxes", "b.txt", "-o", "-"], "--boxes with rtsp://127.0.0.1/x"),
    ],
)
def test_what_a_live_source_cannot_do_is_refused(cwd: Path, arguments: list[str], words: str) -> None:
    (cwd / "b.txt").write_text("1,1,1,1,9,9,1,-1,-1,-1\n")
    done = run("observe", *arguments)
    assert done.returncode == 2 and words in done.stderr


def test_numbers_and_files_are_told_apart(cwd: Path) -> None:
    assert LiveSource.of("0") is not None and LiveSource.of("0").kind == "device"
    (cwd / "0").mkdir()
    assert LiveSource.of("0") is None and LiveSource.of("video.mp4") is None
    assert LiveSource.of("RTSP://a/b").kind == "network" and LiveSource.of("-").kind == "pipe"


def test_a_recording_has_the_times_of_arrival(tmp_path: Path) -> None:
    odd = [cv2.resize(one, (127, 95)) for one in IMAGES[:12]]
    with (
        mjpeg_server(odd, lambda k: time.sleep(0.1 if k < 6 else 0.03), set()) as address,
        opened(address, [], reconnect=0.0) as frames,
    ):
        count = record(frames, tmp_path / "recording.mkv", None)
        times = list(frames.clock(25.0).times.values())
    source = FrameSource.open(tmp_path / "recording.mkv")
    images = [frame.image for frame in source]
    assert len(images) == count == len(times)
    seconds = source.clock(source.fps or 25.0).seconds(np.arange(count))
    np.testing.assert_allclose(seconds, np.array(times) - times[0], atol=0.06)
    found = [which(cv2.resize(image[:95, :127], (128, 96))) for image in images if image is not None]
    assert found == sorted(set(found))


@pytest.mark.slow
def test_a_report_records_a_live_source_first(tmp_path: Path) -> None:
    done = run("report", tmp_path / "nothing.mp4", "--live", "-o", tmp_path / "out")
    assert done.returncode == 2 and "--live with" in done.stderr
    with mjpeg_server(IMAGES, lambda k: time.sleep(0.02), set()) as address:
        done = run("report", address, "--live", "--record-seconds", 0.3, "-o", tmp_path / "out")
        assert "recorded" in done.stderr and "latency" in done.stderr
        assert "without detections of people" in done.stderr  # there are none in the pictures
        done = run("report", address, "--live", "-o", tmp_path / "out")
    assert done.returncode == 2 and "a folder with a recording" in done.stderr
    assert 1 <= len(FrameSource.open(tmp_path / "out" / "recording.mkv").numbers()) < len(IMAGES)
