"""Frames of videos and folders: used, reported and refused."""

import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import run

from graphtrack import io
from graphtrack.errors import InputError
from perception.images.frames import FrameSource

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (48, 64, 3)).astype(np.uint8)


def written(path: Path, count: int = 5) -> Path:
    """A video of so many frames."""
    code = cv2.VideoWriter.fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v"))
    writer = cv2.VideoWriter(str(path), code, 10.0, (64, 48))
    assert writer.isOpened()
    for k in range(count):
        writer.write(np.roll(IMAGE, k, axis=0))
    writer.release()
    return path


def refused(path: Path) -> str:
    with pytest.raises(InputError) as found:
        FrameSource.open(path)
    return str(found.value)


def test_frames_of_a_folder_have_the_numbers_of_their_names(tmp_path: Path) -> None:
    for name, image in (
        ("0010.png", np.zeros((4, 5), np.uint8)),
        ("0007.png", np.zeros((4, 5, 3), np.uint16)),
    ):
        cv2.imwrite(str(tmp_path / name), image)
    (tmp_path / "0008.png").write_bytes(b"no picture")
    frames = list(FrameSource.open(tmp_path))
    assert [frame.number for frame in frames] == [7, 8, 10]
    assert [frame.image is None for frame in frames] == [False, True, False]
    assert frames[0].image.dtype == np.uint8 and frames[2].image.shape == (4, 5, 3)
    assert "0008.png" in frames[1].reason


def test_numbers_are_those_of_the_frames_that_there_are(tmp_path: Path) -> None:
    source = FrameSource.open(written(tmp_path / "film.avi", 5))
    assert source.numbers() == list(range(5))
    assert replace(source, count=2).numbers() == list(range(5))  # some containers declare arbitrary values
    for name in ("0003.png", "0011.png"):
        cv2.imwrite(str(tmp_path / name), np.zeros((20, 20, 3), np.uint8))
    (tmp_path / "film.avi").unlink()
    assert FrameSource.open(tmp_path).numbers() == [3, 11]


NO_VIDEOS = {
    "notes.txt": b"hello world\n" * 99,
    "begins as a film.txt": b"The free lunch\n" * 99,
    "begins as a picture.txt": b"BMW\n" * 99,
    "colours.ans": b"\x1b[31mhello\x1b[0m\r\n" * 99,
    "sixteen.txt": "hello".encode("utf-16"),
    "subtitles.srt": b"1\n00:00:01,000 --> 00:00:02,000\nhello\n",
    "playlist.m3u8": b"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nother.mp4\n#EXT-X-ENDLIST\n",
    "list.mp4": b"ffconcat version 1.0\nfile other.mp4\n",
    "noise.bin": RNG.bytes(40_000),
    "noise.mp4": RNG.bytes(40_000),
    "playlist with a null.m3u8": b"#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nother.mp4\n\0",
}


@pytest.mark.parametrize("name", NO_VIDEOS)
def test_text_and_other_bytes_are_no_video_whatever_opencv_makes_of_them(tmp_path: Path, name: str) -> None:
    written(tmp_path / "other.mp4")  # which the playlists name
    (tmp_path / name).write_bytes(NO_VIDEOS[name])
    what = "something else" if name.startswith(("noise", "playlist with")) else "text"
    assert f"found {what}, expected a video" in refused(tmp_path / name)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".webp", ".tif", ".ppm"])
def test_a_picture_is_no_video(tmp_path: Path, suffix: str) -> None:
    for k in (1, 2):
        assert cv2.imwrite(str(tmp_path / f"000{k}{suffix}"), IMAGE)
    assert "a single picture" in refused(tmp_path / f"0001{suffix}")


def test_videos_of_many_kinds_are_taken(tmp_path: Path) -> None:
    paths = [written(tmp_path / name) for name in ("a.avi", "b.mp4", "c.mkv", "d.mov", "e.mpg", "f.ts")]
    raw = tmp_path / "g.y4m"  # its grey levels are letters
    raw.write_bytes(b"YUV4MPEG2 W64 H48 F25:1 C420jpeg\n" + 5 * (b"FRAME\n" + b"A" * (64 * 48 * 3 // 2)))
    jpegs = tmp_path / "h.mjpeg"
    jpegs.write_bytes(b"".join(cv2.imencode(".jpg", np.roll(IMAGE, k, 0))[1].tobytes() for k in range(5)))
    for path in (*paths, raw, jpegs):
        assert sum(frame.image is not None for frame in FrameSource.open(path)) == 5, path


def test_a_name_with_a_colon_is_a_name(cwd: Path) -> None:
    written(cwd / "a.mp4").rename(cwd / "concat:a.mp4")
    assert sum(frame.image is not None for frame in FrameSource.open("concat:a.mp4")) == 5


@pytest.mark.parametrize("video", [True, False])
def test_frames_that_are_not_wanted_are_left_out_and_not_told_of(tmp_path: Path, video: bool) -> None:
    path = written(tmp_path / "a.avi") if video else tmp_path
    for k in range(5):
        (tmp_path / f"{k}.png").write_bytes(cv2.imencode(".png", np.roll(IMAGE, k, axis=0))[1].tobytes())
    (tmp_path / "1.png").write_bytes(b"no picture")
    source = FrameSource.open(path)
    every, some = {frame.number: frame for frame in source}, list(source.where(lambda k: k in (0, 3)))
    assert [frame.number for frame in some] == [0, 3]
    for frame in some:
        np.testing.assert_array_equal(frame.image, every[frame.number].image)


def test_the_stamp_changes_with_the_images_and_with_nothing_else(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), IMAGE)
    frames = FrameSource.open(tmp_path)
    before = frames.stamp()
    (tmp_path / "out.csv.journal").write_text("x")
    assert frames.stamp() == before
    cv2.imwrite(str(tmp_path / "1.png"), IMAGE[:40])
    assert frames.stamp() != before


def test_nothing_and_a_folder_of_nothing_are_refused(tmp_path: Path) -> None:
    assert "without images" in refused(tmp_path) and "no such file" in refused(tmp_path / "absent")


@pytest.mark.parametrize("names", [("1.png", "01.png"), ("0001.png", "thumbs.png"), ("99999999999.png",)])
def test_images_whose_frames_are_in_doubt_are_refused(tmp_path: Path, names: tuple[str, ...]) -> None:
    for name in names:
        cv2.imwrite(str(tmp_path / name), IMAGE)
    assert names[0] in refused(tmp_path)


@pytest.mark.parametrize(("suffix", "code"), [(".avi", "MJPG"), (".mp4", "mp4v")])
def test_of_a_video_that_was_cut_off_what_can_be_read_is_kept(tmp_path: Path, suffix: str, code: str) -> None:
    path, rng = tmp_path / f"video{suffix}", np.random.default_rng(0)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 25, (160, 120))
    for _ in range(40):
        video.write(rng.integers(0, 255, (120, 160, 3)).astype(np.uint8))
    video.release()
    source = FrameSource.open(path)
    assert source.count == 40 and source.fps == pytest.approx(25.0)
    assert len([frame for frame in source if frame.image is not None]) == 40
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    if suffix == ".mp4":
        with pytest.raises(InputError, match="cut off has lost its index"):
            FrameSource.open(path)
        return
    frames = list(FrameSource.open(path))
    assert len([frame for frame in frames if frame.image is not None]) in range(18, 22)
    assert frames[-1].reason == f"the video ends at frame {len(frames) - 1} of 40"


def filmed(path: Path, milliseconds: list[int]) -> Path:
    """A video whose frames have these time stamps."""
    av = pytest.importorskip("av", reason="the extra video has it")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1000)
        for k, at in enumerate(milliseconds):
            frame = av.VideoFrame.from_ndarray(np.roll(IMAGE, k, axis=0), format="bgr24")
            frame.pts, frame.time_base = at, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


UNEVEN = [0, 40, 80, 333, 400, 520]


def test_times_of_a_variable_frame_rate_are_those_of_the_container(tmp_path: Path) -> None:
    video, boxes = filmed(tmp_path / "film.mp4", UNEVEN), tmp_path / "boxes.txt"
    boxes.write_text("".join(f"{k},1,20,5,16,40,1,-1,-1,-1\n" for k in range(len(UNEVEN))))
    done = run("observe", video, "--boxes", boxes, "-o", tmp_path / "o.csv")
    assert done.returncode == 0 and "times by the video's time stamps" in done.stderr
    (track,) = io.read_identified(tmp_path / "o.csv")
    np.testing.assert_allclose(track.t, np.array(UNEVEN) / 1000.0, atol=1e-6)
    done = run("observe", video, "--boxes", boxes, "--fps", 10, "-o", tmp_path / "o.csv")
    assert "time stamps" not in done.stderr
    np.testing.assert_allclose(
        io.read_identified(tmp_path / "o.csv").tracks[0].t, np.arange(len(UNEVEN)) / 10.0
    )


def test_times_are_by_the_nominal_rate_where_that_holds_or_nothing_else_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    even = FrameSource.open(filmed(tmp_path / "even.mp4", [0, 40, 80, 120, 160]))
    clock = even.clock(25.0)
    assert clock.stamps is None and not caplog.records
    np.testing.assert_allclose(clock.seconds([0, 3, 10]), [0.0, 0.12, 0.4])
    uneven = FrameSource.open(filmed(tmp_path / "uneven.mp4", UNEVEN))
    np.testing.assert_allclose(uneven.clock(20.0).seconds([3, 5, 7]), [0.333, 0.52, 0.62], atol=1e-6)
    monkeypatch.setitem(sys.modules, "av", None)
    caplog.clear()
    assert uneven.clock(20.0).stamps is None and "no PyAV (the extra video)" in caplog.text
