"""Recordings of tracks and of streams, read back: they hold the values of the table, at the same times."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import create_autospec

import cv2
import numpy as np
import pytest
from command import run
from rerun_recordings import nanoseconds, read_recording

import graphtrack as gt
from graphtrack.cli.options import Showing
from graphtrack.errors import InputError
from graphtrack.viewer import recording
from graphtrack.viewer.layout import Extent
from graphtrack.viewer.live import LiveView, track_of
from graphtrack.viewer.pictures import PersonBoxes
from graphtrack.viewer.recording import Target


def walks(*, hole: bool = False) -> gt.TrackSet:
    """Two people side by side, with all estimates; the second one starts later and ends earlier."""
    tracks = []
    for who, (start, stop) in {3: (0, 40), 8: (5, 30)}.items():
        frame = np.arange(start, stop)
        if hole and who == 3:
            frame = frame[(frame < 10) | (frame >= 25)]
        t = 0.1 * frame
        n = len(t)
        spread = np.zeros((n, 6, 6))
        spread[:] = np.diag([0.04, 0.01, 0.1, 0.1, 0.02, 0.03])
        spread[:, 0, 1] = spread[:, 1, 0] = 0.012
        tracks.append(
            gt.Track(
                track_id=who,
                frame=frame,
                t=t,
                position=np.column_stack([1.2 * t, 0.3 * np.sin(t) + 0.1 * who]),
                velocity=np.tile([1.2, 0.1], (n, 1)),
                covariance=spread,
                body=np.angle(np.exp(1j * (3.0 + 0.05 * frame))),
                head=np.where(frame % 7 == 0, np.nan, np.angle(np.exp(1j * (2.5 + 0.05 * frame)))),
            )
        )
    return gt.TrackSet(tuple(tracks))


def test_a_recording_holds_the_table(tmp_path: Path) -> None:
    tracks = walks()
    gt.view(tracks, save=tmp_path / "run.rrd")
    found = read_recording(tmp_path / "run.rrd")
    people = {"/".join(path.split("/")[:4]) for path in found if path.startswith("/ground/people/")}
    assert people == {f"/ground/people/{track.track_id}" for track in tracks}
    for track in tracks:
        path = f"/ground/people/{track.track_id}"
        assert found[path]["Points2D:labels"] == {-1: [str(track.track_id)]}
        assert list(found[path]["Points2D:positions"]) == nanoseconds(track.t)
        shown = np.array(list(found[path]["Points2D:positions"].values()))
        np.testing.assert_allclose(shown[:, 0], track.position, rtol=1e-6, atol=1e-6)
        for name in ("body", "head"):
            arrows = list(found[f"{path}/{name}"]["Arrows2D:vectors"].values())
            angle = getattr(track, name)
            assert [len(one) for one in arrows] == np.isfinite(angle).astype(int).tolist()
            pointed = np.array([np.arctan2(*one[0][::-1]) for one in arrows if one])
            np.testing.assert_allclose(pointed, angle[np.isfinite(angle)], atol=1e-5)
        strips = np.array(list(found[f"{path}/ellipse"]["LineStrips2D:strips"].values()))[:, 0]
        offset = strips - track.position[:, None, :]
        # Each point of the ellipse has the Mahalanobis distance that holds 95 %.
        inverse = np.linalg.inv(track.covariance[:, :2, :2])
        distance = np.einsum("npi,nij,npj->np", offset, inverse, offset)
        np.testing.assert_allclose(distance, -2.0 * np.log(0.05), rtol=1e-3)
    assert found["/ground"]["Transform3D:scale"] == {-1: [[1.0, -1.0, 1.0]]}  # y is up


def test_who_leaves_is_gone_and_holes_are_empty(tmp_path: Path) -> None:
    gt.view(walks(hole=True), save=tmp_path / "run.rrd")
    found = read_recording(tmp_path / "run.rrd")
    cleared = {who: found[f"/ground/people/{who}"].get("Clear:is_recursive", {}) for who in (3, 8)}
    assert list(cleared[3]) == nanoseconds([1.0])  # and not at the end of all
    assert list(cleared[8]) == nanoseconds([3.0])


def test_series_are_in_degrees_without_jumps_and_with_their_intervals(tmp_path: Path) -> None:
    tracks = walks()
    gt.view(tracks, save=tmp_path / "run.rrd")
    found = read_recording(tmp_path / "run.rrd")
    track = tracks.by_id(3)
    body = np.array(list(found["/series/3/body"]["Scalars:scalars"].values()))
    assert np.abs(np.diff(body[:, 0])).max() < 10.0 < np.degrees(np.abs(np.diff(track.body)).max())
    np.testing.assert_allclose(np.exp(1j * np.radians(body[:, 0])), np.exp(1j * track.body), atol=1e-9)
    np.testing.assert_allclose(body[:, 2] - body[:, 0], 1.96 * np.degrees(track.std("body")), rtol=1e-3)
    head = np.array(list(found["/series/3/head"]["Scalars:scalars"].values()))
    assert np.abs(head[:, 0].mean() - body[:, 0].mean()) < 60.0  # drawn next to the body, no turn away
    speed = found["/series/3/speed"]["Scalars:scalars"]
    np.testing.assert_allclose([one[0] for one in speed.values()], np.hypot(1.2, 0.1))


def test_observations_alone_can_be_viewed_and_clock_times_are_dates(tmp_path: Path) -> None:
    table = {"track_id": [1, 1, 1], "frame": [0, 1, 2], "t": [1.7e9, 1.7e9 + 0.5, 1.7e9 + 1.0]}
    tracks = gt.TrackSet.from_table({**table, "x": [0.0, np.nan, 1.0], "y": [0.0, np.nan, 2.0]})
    gt.view(tracks, save=tmp_path / "a.rrd")
    found = read_recording(tmp_path / "a.rrd")
    assert list(found["/ground/people/1"]["Points2D:positions"]) == nanoseconds([1.7e9, 1.7e9 + 1.0])
    assert not any("body" in path and "Arrows2D:vectors" in of for path, of in found.items())


def test_groups_and_forecasts_are_where_they_were_found(tmp_path: Path) -> None:
    tracks = walks()
    groups, forecasts = gt.groups(tracks), gt.forecast(tracks, horizon=1.2, step=0.4)
    groups = replace(groups, group=np.where(groups.t > 1.95, 0, -1))
    gt.view(tracks, save=tmp_path / "run.rrd", groups=groups, forecast=forecasts)
    found = read_recording(tmp_path / "run.rrd")
    spokes = found["/ground/groups"]["LineStrips2D:strips"]
    for t in np.unique(groups.t).tolist():
        (now,) = nanoseconds([t])
        rows = np.flatnonzero((groups.t == t) & (groups.group >= 0) & np.isfinite(groups.centre[:, 0]))
        expected = [[groups.centre[k], _position(tracks, groups, k)] for k in rows]
        np.testing.assert_allclose(np.ravel(spokes[now]), np.ravel(expected), atol=1e-5)
    assert any(spokes.values())
    columns = forecasts.columns
    for who in (3, 8):
        strips = found[f"/ground/people/{who}/forecast"]["LineStrips2D:strips"]
        mine = columns["track_id"] == who
        assert list(strips) == nanoseconds(np.unique(columns["t"][mine]))
        for now, (path, circle) in strips.items():
            at = mine & (np.array(nanoseconds(columns["t"])) == now)
            ahead = np.column_stack([columns["x"][at], columns["y"][at]])
            np.testing.assert_allclose(path[1:], ahead, atol=1e-5)
            radius = np.hypot(*(np.array(circle) - ahead[-1]).T)
            np.testing.assert_allclose(radius, columns["radius_90"][at][-1], rtol=1e-3, atol=1e-5)
            # The visible ground has room for the whole circle.
            (lines,) = found["/ground/grid"]["LineStrips2D:strips"].values()
            assert np.all(np.min(lines, axis=(0, 1)) <= np.min(circle, axis=0))
            assert np.all(np.max(circle, axis=0) <= np.max(lines, axis=(0, 1)))


def _position(tracks: gt.TrackSet, groups: gt.Groups, k: int) -> np.ndarray:
    track = tracks.by_id(int(groups.track_id[k]))
    return np.asarray(track.position[np.searchsorted(track.frame, groups.frame[k])])


def test_pictures_come_with_boxes_in_pixels_of_the_video(tmp_path: Path) -> None:
    folder, rng = tmp_path / "images", np.random.default_rng(0)
    folder.mkdir()
    for number in (0, 6, 7, 90):
        cv2.imwrite(str(folder / f"{number:04}.png"), rng.integers(0, 255, (300, 1280, 3), np.uint8))
    box = np.array([[100.0, 50.0, 30.0, 80.0], [110.0, 50.0, 30.0, 80.0], [5.0, 5.0, 9.0, 9.0]])
    boxes = PersonBoxes(np.array([6, 7, 6]), np.array([8, 8, 99]), box)
    gt.view(walks(), save=tmp_path / "run.rrd", video=folder, boxes=boxes)
    found = read_recording(tmp_path / "run.rrd")
    blobs = found["/video/frame"]["EncodedImage:blob"]
    assert list(blobs) == nanoseconds([0.0, 0.6, 0.7])  # frame 90 is after all tracks
    image = cv2.imdecode(np.array(next(iter(blobs.values()))[0], np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (150, 640, 3)
    assert next(iter(found["/video/frame"]["Transform3D:scale"].values())) == [[2.0, 2.0, 1.0]]
    assert [path for path in found if path.startswith("/video/people/")] == ["/video/people/8"]
    shown = found["/video/people/8"]
    centres = np.array(list(shown["Boxes2D:centers"].values()))[:, 0]
    half = np.array(list(shown["Boxes2D:half_sizes"].values()))[:, 0]
    np.testing.assert_allclose(np.hstack([centres - half, 2.0 * half]), box[:2])


def test_the_ground_that_is_seen_grows_when_somebody_leaves_it() -> None:
    seen = Extent.of(np.array([[0.0, 0.0], [2.0, 1.0], [np.nan, np.nan]]))
    assert seen.around(Extent.of(np.array([[1.0, 0.5]])), 0.5) is seen
    more = seen.around(Extent.of(np.array([[9.0, 0.5]])), 0.5)
    assert (more.low < seen.low).all() and more.high[0] > 10.0 and more.size > seen.size


def test_the_command_writes_what_python_writes(tmp_path: Path) -> None:
    gt.write(walks(), tmp_path / "tracks.csv")
    saved = tmp_path / "run.rrd"
    done = run("view", tmp_path / "tracks.csv", "--save", saved, "--groups", "find", "--forecast", "1.2",
               "--person", 8, program="graphtrack")  # fmt: skip
    assert done.returncode == 0 and not done.stdout and "rerun" in done.stderr
    found = read_recording(saved)
    np.testing.assert_allclose(
        [one[0] for one in found["/ground/people/8"]["Points2D:positions"].values()],
        gt.read(tmp_path / "tracks.csv").by_id(8).position,
        rtol=1e-6,
        atol=1e-6,
    )
    assert {"/ground/groups", "/ground/people/3/forecast"} <= set(found)


def test_a_viewer_elsewhere_is_connected_to_without_reruns_own_log(monkeypatch):
    monkeypatch.setenv("RUST_LOG", "info")  # so that it is put back
    Showing(connect="rerun://there/proxy").target()
    assert os.environ["RUST_LOG"] == "info"
    monkeypatch.delenv("RUST_LOG")
    Showing(save=Path("run.rrd")).target()
    assert "RUST_LOG" not in os.environ
    Showing(connect="rerun://there/proxy").target()
    assert os.environ["RUST_LOG"] == "off"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "no display, expected a file to write (--save run.rrd)"),
        (("--save", "run.png"), "the ending .rrd"),
        (("--save", "run.rrd", "--person", "4"), "no track 4"),
        (("--save", "run.rrd", "--connect", "rerun+http://127.0.0.1:9876/proxy"), "one of them"),
        (("--connect", "localhost"), "a URL such as"),
        (("--save", "run.rrd", "--boxes", "tracks.csv"), "no boxes with identities"),
        (("--save", "run.rrd", "--groups", "none.csv"), "none.csv"),
        (("--save", "run.rrd", "--forecast", "-3"), "horizon"),
    ],
)
def test_what_cannot_be_shown_is_one_error(
    options: tuple[str, ...], said: str, cwd: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(recording.sys, "platform", "linux")
    gt.write(walks(), "tracks.csv")
    done = run("view", "tracks.csv", *options, program="graphtrack")
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 2 and len(errors) == 1 and said in errors[0]
    assert not list(cwd.glob("run*"))


def test_a_window_is_that_of_the_package_with_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    import rerun

    given: list[dict[str, Any]] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(
        rerun, "spawn", create_autospec(rerun.spawn, side_effect=lambda **how: given.append(how))
    )
    gt.view(walks())
    (how,) = given
    assert how["memory_limit"] == "2GB" and Path(how["executable_path"]).is_file()


def test_without_the_package_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "find_spec", lambda name: None)
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    with pytest.raises(InputError, match=r"pip install 'graphtrack\[view\]'"):
        gt.view(walks(), save="run.rrd")


def rows(frames: int) -> list[dict[str, Any]]:
    """Two who walk side by side; the second one leaves, and the first one goes far."""
    return [
        {"track_id": k, "frame": f, "t": round(0.2 * f, 6), "x": 0.3 * f, "y": 0.7 * k}
        for f in range(frames)
        for k in (1, 2)
        if k == 1 or f < frames // 2
    ]


def answer(track_id: int, frame: int, x: float, **more: Any) -> dict[str, Any]:
    given = {"track_id": track_id, "frame": frame, "t": 0.2 * frame, "x": x, "y": 1.0, "status": "new"}
    return {**given, "x_std": 0.1, "y_std": 0.2, "body_deg": None, **more}


def shown(path: Path, person: int, what: str = "Points2D:positions") -> dict[int, Any]:
    return read_recording(path)[f"/ground/people/{person}"].get(what, {})


@pytest.mark.slow
def test_every_answer_is_shown_and_what_is_none_is_passed_over(tmp_path: Path) -> None:
    lines = [json.dumps(answer(row["track_id"], row["frame"], row["x"])) for row in rows(40)]
    given = "".join(f"{line}\n" for line in [*lines, "no JSON", "[1]"])
    command = [sys.executable, "-m", "graphtrack", "view", "-", "--save", "run.rrd", "--person", "2"]
    done = subprocess.run(command, input=given, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = read_recording(tmp_path / "run.rrd")
    for person in (1, 2):
        mine = [row for row in map(json.loads, lines) if row["track_id"] == person]
        positions = found[f"/ground/people/{person}"]["Points2D:positions"]
        assert list(positions) == nanoseconds([row["t"] for row in mine])
        there = [[row["x"], row["y"]] for row in mine]
        np.testing.assert_allclose([one[0] for one in positions.values()], there, rtol=1e-6, atol=1e-6)
    assert list(found["/ground/people/2"]["Clear:is_recursive"]) == nanoseconds([4.0])
    assert {path.split("/")[2] for path in found if path.startswith("/series/")} == {"2"}


def test_what_is_kept_of_people_does_not_grow_with_the_stream(tmp_path: Path) -> None:
    view = LiveView(Target(tmp_path / "run.rrd"))
    for first in range(0, 2000, 100):
        frames = range(first, first + 100)
        view.show([answer(person, k, 0.1 * k) for k in frames for person in (1, 1000 + k // 50)])
    (known,) = (one for who, one in view._people._known.items() if who == 1)
    assert len(known.t) <= 22 and len(view._reported) == 64 and len(view._people._known) <= 3
    view.close()
    assert len(shown(tmp_path / "run.rrd", 1)) == 2000


def test_a_late_row_and_one_that_is_answered_again_take_the_place_of_the_first(tmp_path: Path) -> None:
    view = LiveView(Target(tmp_path / "run.rrd"))
    view.show([answer(1, 0, 0.0), answer(1, 1, 1.0)])
    view.show([answer(1, 1, 1.5), {"track_id": 1, "frame": 3, "line": 9, "error": "bad"}])
    view.close()
    assert list(shown(tmp_path / "run.rrd", 1).values()) == [[[0.0, 1.0]], [[1.5, 1.0]]]


def test_what_is_taken_back_is_shown_as_somebody_elses(tmp_path: Path) -> None:
    view = LiveView(Target(tmp_path / "run.rrd"))
    for k in range(3):
        view.show([answer(1, k, 1.0 * k), answer(2, k, 10.0 + k), answer(3, k, 20.0 + k), {"end": 0.2 * k}])
    swapped = [{"t": 0.4, "frame": 2, "detection": 0, "before": 1, "after": 2},
               {"t": 0.4, "frame": 2, "detection": 1, "before": 2, "after": 1},
               {"t": 0.2, "frame": 1, "detection": 2, "before": 3, "after": -1}]  # fmt: skip
    view.show([answer(1, 3, 3.0), {"end": 0.6, "revised": swapped}])
    view.close()
    assert list(shown(tmp_path / "run.rrd", 1).values()) == [[[x, 1.0]] for x in (0.0, 1.0, 12.0, 3.0)]
    assert list(shown(tmp_path / "run.rrd", 2).values()) == [[[x, 1.0]] for x in (10.0, 11.0, 2.0)]
    assert list(shown(tmp_path / "run.rrd", 3, "Clear:is_recursive")) == nanoseconds([0.2])


def test_groups_and_forecasts_are_shown_when_their_frame_has_ended(tmp_path: Path) -> None:
    def told(k: int) -> list[dict[str, Any]]:
        of = {"frame": k, "t": 0.2 * k, "group": 0, "kind": "walking", "probability": 0.9}
        of |= {"centre_x": 1.0 * k, "centre_y": 2.0}
        step = {"ahead": 0.4, "x": 5.0, "y": 6.0, "radius_90": 0.5}
        return [{"track_id": who, **of, "forecast": [step]} for who in (1, 2)]

    view = LiveView(Target(tmp_path / "run.rrd"))
    for k in range(3):
        view.show([answer(1, k, 1.0 * k), answer(2, k, 2.0 * k)])
        view.show(told(k)[:1])  # a look may fall between the rows of a frame
        view.show(told(k)[1:])
    view.close()
    found = read_recording(tmp_path / "run.rrd")
    spokes = found["/ground/groups"]["LineStrips2D:strips"]
    assert list(spokes) == nanoseconds([0.0, 0.2, 0.4])
    np.testing.assert_allclose(spokes[nanoseconds([0.4])[0]], [[[2, 2], [2, 1]], [[2, 2], [4, 1]]])
    path, circle = found["/ground/people/2/forecast"]["LineStrips2D:strips"][nanoseconds([0.2])[0]]
    np.testing.assert_allclose(path, [[2.0, 1.0], [5.0, 6.0]])
    np.testing.assert_allclose(np.hypot(*(np.array(circle) - [5.0, 6.0]).T), 0.5, rtol=1e-5)


def test_the_ground_has_room_for_the_whole_circles_of_forecasts(tmp_path: Path) -> None:
    view = LiveView(Target(tmp_path / "run.rrd"))
    for k, (x, y, radius) in enumerate([(1.0, 1.0, 0.5), (-30.0, 4.0, 20.0), (2.0, 90.0, 1.0)]):
        step = {"ahead": 0.4, "x": x, "y": y, "radius_90": radius}
        view.show([answer(1, k, 0.1 * k), {"track_id": 1, "frame": k, "t": 0.2 * k, "forecast": [step]}])
    view.close()
    found = read_recording(tmp_path / "run.rrd")
    (lines,) = found["/ground/grid"]["LineStrips2D:strips"].values()
    strips = found["/ground/people/1/forecast"]["LineStrips2D:strips"]
    assert len(strips) == 3
    for _, circle in strips.values():
        assert np.all(np.min(lines, axis=(0, 1)) <= np.min(circle, axis=0))
        assert np.all(np.max(circle, axis=0) <= np.max(lines, axis=(0, 1)))


def test_an_answer_becomes_a_track_in_radians() -> None:
    track = track_of(4, [answer(4, 2, 7.0, body_deg=90.0, body_std_deg=10.0, head_deg=None, vx=1.0)])
    assert track.body is not None and track.body[0] == pytest.approx(math.pi / 2)
    std = [track.std(name) for name in ("x", "y", "body")]
    np.testing.assert_allclose(np.ravel(std), [0.1, 0.2, math.radians(10.0)])  # type: ignore[arg-type]
    assert track.velocity is not None and np.isnan(track.velocity[0, 1])


def test_fields_of_view_and_who_is_seen_are_shown(tmp_path: Path) -> None:
    t = np.repeat(0.1 * np.arange(20), 2)
    sensor = np.tile(["camera", "laser"], 20)
    position = np.column_stack([t, 0.2 * np.sin(5 * t)])
    ellipses = np.where((sensor == "laser")[:, None, None], np.nan, np.diag([0.04, 0.01]))
    track = gt.Track(1, np.arange(40), t, position, position_covariance=ellipses, sensor=sensor)
    described = {"camera": gt.Sensor(field_of_view=((0.0, -1.0), (3.0, -1.0), (3.0, 1.0)))}
    gt.view(gt.TrackSet((track,)), save=tmp_path / "run.rrd", sensors=described)
    found = read_recording(tmp_path / "run.rrd")
    strips = next(v for k, v in found["/ground/sensors/0/view"].items() if k.endswith(":strips"))[-1]
    np.testing.assert_allclose(strips[0], [[0, -1], [3, -1], [3, 1], [0, -1]])
    assert any(k.endswith(":strips") for k in found["/ground/sensors/1/view"])  # learned
    for number in (0, 1):
        rows = next(v for k, v in found[f"/ground/sensors/{number}/seen"].items() if k.endswith(":positions"))
        assert [time for time in rows if time >= 0][:20] == nanoseconds(np.unique(t))
    shapes = next(v for k, v in found["/ground/sensors/0/ellipses"].items() if k.endswith(":strips"))
    reach = np.ptp(np.array(shapes[0][0]), axis=0)
    np.testing.assert_allclose(reach, 2.0 * math.sqrt(5.991) * np.array([0.2, 0.1]), rtol=1e-2)
    assert not any(k.endswith(":strips") for k in found.get("/ground/sensors/1/ellipses", {}))
    gt.view(walks(), save=tmp_path / "none.rrd")
    assert not any("sensors" in path for path in read_recording(tmp_path / "none.rrd"))
