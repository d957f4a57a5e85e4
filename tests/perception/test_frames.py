"""Frames of videos and folders: used, reported and refused."""

import struct
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import PIL.Image
import pytest
from command import run
from encoded_videos import encoded

from graphtrack import io
from graphtrack.errors import InputError
from perception.images.frames import FrameSource

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (48, 64, 3)).astype(np.uint8)


def written(path: Path, count: int = 5, image: np.ndarray = IMAGE, **kind: object) -> Path:
    """A video of so many frames, of an image that rolls down by one row a frame; see `encoded`."""
    return encoded(path, [np.roll(image, k, axis=0) for k in range(count)], **kind)


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


@pytest.mark.parametrize(("suffix", "codec"), [(".avi", "mjpeg"), (".mp4", "mpeg4")])
def test_of_a_video_that_was_cut_off_what_can_be_read_is_kept(
    tmp_path: Path, suffix: str, codec: str
) -> None:
    path, rng = tmp_path / f"video{suffix}", np.random.default_rng(0)
    images = [rng.integers(0, 255, (120, 160, 3)).astype(np.uint8) for _ in range(40)]
    encoded(path, images, codec, rate=25)
    source = FrameSource.open(path)
    assert source.count == 40 and source.fps == pytest.approx(25.0)
    assert len([frame for frame in source if frame.image is not None]) == 40
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    if suffix == ".mp4":
        with pytest.raises(InputError, match="cut off has lost its index"):
            FrameSource.open(path)
        return
    frames = list(FrameSource.open(path))
    assert len([frame for frame in frames if frame.image is not None]) in range(12, 24)
    assert frames[-1].reason == f"the video ends at frame {len(frames) - 1} of 40"


def filmed(path: Path, milliseconds: list[int]) -> Path:
    """A video whose frames have these time stamps."""
    images = [np.roll(IMAGE, k, axis=0) for k in range(len(milliseconds))]
    return encoded(path, images, rate=25, times=milliseconds)


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
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    even = FrameSource.open(filmed(tmp_path / "even.mp4", [0, 40, 80, 120, 160]))
    clock = even.clock(25.0)
    assert clock.stamps is None and not caplog.records
    np.testing.assert_allclose(clock.seconds([0, 3, 10]), [0.0, 0.12, 0.4])
    uneven = FrameSource.open(filmed(tmp_path / "uneven.mp4", UNEVEN))
    np.testing.assert_allclose(uneven.clock(20.0).seconds([3, 5, 7]), [0.333, 0.52, 0.62], atol=1e-6)


SMOOTH = cv2.GaussianBlur(RNG.integers(0, 256, (96, 130, 3)).astype(np.uint8), (0, 0), 4.0)
INTERLACED = {"flags": "+ilme+ildct", "b": "4M", "field_order": "tt"}


def decoded(path: Path) -> list[np.ndarray]:
    frames = list(FrameSource.open(path))
    assert [frame.number for frame in frames] == list(range(len(frames)))
    images = [frame.image for frame in frames]
    assert all(image is not None for image in images)
    return images  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("h264.mp4", "libx264", {"x264-params": "tff=1", "qp": "10"}),
        ("mpeg2.mpg", "mpeg2video", INTERLACED),
        ("mpeg4.avi", "mpeg4", INTERLACED),
        ("progressive.mkv", "libx264", {"qp": "10"}),
    ],
)
def test_interlaced_video_is_decoded_as_it_was_encoded(
    tmp_path: Path, name: str, codec: str, options: dict[str, str]
) -> None:
    path = written(tmp_path / name, 12, SMOOTH[:, :128], codec=codec, options=options)
    if "progressive" not in name:
        with av.open(str(path)) as container:
            assert all(frame.interlaced_frame for frame in container.decode(video=0))
    for k, image in enumerate(decoded(path)):
        error = np.abs(image.astype(float) - np.roll(SMOOTH[:, :128], k, axis=0))
        assert error.mean() < 6.0, k


@pytest.mark.parametrize("shape", [(96, 33), (75, 101), (130, 50)])
@pytest.mark.parametrize(("name", "codec"), [("a.gif", "gif"), ("a.mkv", "ffv1"), ("a.avi", "mjpeg")])
def test_odd_sizes_and_portraits_are_decoded(
    tmp_path: Path, shape: tuple[int, int], name: str, codec: str
) -> None:
    image = cv2.resize(SMOOTH, shape[::-1])
    for k, found in enumerate(decoded(written(tmp_path / name, 3, image, codec=codec))):
        assert found.shape == image.shape
        assert np.abs(found.astype(float) - np.roll(image, k, axis=0)).mean() < 25.0  # GIF: 8 bits


MATRICES = {0: (1, 0, 0, 1), 90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}


@pytest.mark.parametrize("clockwise", MATRICES)
def test_a_telephone_held_upright_has_upright_frames(tmp_path: Path, clockwise: int) -> None:
    path = written(tmp_path / "film.mp4", 2, SMOOTH[:, :128], codec="libx264", options={"qp": "10"})
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40  # the display matrix of ISO 14496-12
    a, b, c, d = (65536 * one for one in MATRICES[clockwise])
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    (first, _), source = decoded(path), FrameSource.open(path)
    expected = np.rot90(SMOOTH[:, :128], -clockwise // 90)
    assert first.shape == expected.shape and source.size() == expected.shape[1::-1]
    assert np.abs(first.astype(float) - expected).mean() < 6.0


def test_a_photograph_is_upright_by_its_exif_tag(tmp_path: Path) -> None:
    tags = PIL.Image.Exif()
    tags[0x0112] = 6  # 90° clockwise
    for k in range(2):
        picture = PIL.Image.fromarray(SMOOTH[..., ::-1])
        picture.save(tmp_path / f"{k}.jpg", exif=tags, quality=95, subsampling=0)
    first = decoded(tmp_path)[0]
    assert np.abs(first.astype(float) - np.rot90(SMOOTH, -1)).mean() < 6.0


@pytest.mark.parametrize(
    ("name", "codec"), [("a.mp4", "libx264"), ("b.mp4", "mpeg4"), ("c.mpg", "mpeg2video")]
)
def test_frames_with_bit_errors_are_known(tmp_path: Path, name: str, codec: str) -> None:
    images = [np.roll(SMOOTH[:, :128], 3 * k, axis=1) for k in range(40)]
    path = encoded(tmp_path / name, images, codec)
    source = FrameSource.open(path)
    assert len(decoded(path)) == len(list(source)) == 40 and not source.damaged
    data, rng = bytearray(path.read_bytes()), np.random.default_rng(0)
    for at in rng.integers(len(data) // 3, 2 * len(data) // 3, 25):
        data[at] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)
    source = FrameSource.open(path)
    frames = list(source)
    good = [frame.number for frame in frames if frame.image is not None]
    assert source.damaged and source.damaged <= set(good)
    assert 30 < len(good) <= 40 and all(frame.reason for frame in frames if frame.image is None)


def test_an_undecodable_frame_has_its_number(tmp_path: Path) -> None:
    path = encoded(tmp_path / "a.avi", [np.roll(SMOOTH, k, axis=0) for k in range(6)], "mjpeg")
    data = bytearray(path.read_bytes())
    frame = data.index(b"\xff\xd8\xff", data.index(b"\xff\xd8\xff", data.index(b"\xff\xd8\xff") + 1) + 1)
    data[frame : frame + 600] = bytes(600)  # the third
    path.write_bytes(data)
    frames = list(FrameSource.open(path))
    assert [one.number for one in frames if one.image is None] == [2]
    assert frames[2].reason == "frame 2 cannot be decoded" and len(frames) == 6
