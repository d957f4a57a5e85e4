"""`graphtrack view -`: the viewer shows the answers."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun_recordings import nanoseconds, read_recording

from graphtrack.viewer.live import LiveView, track_of
from graphtrack.viewer.recording import Target


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
