"""`graphtrack track -` with rows without identities."""

from __future__ import annotations

import json

import numpy as np
import pytest
from crossing_people import street

from graphtrack.smoothing import OnlineTracker
from graphtrack.streaming.answers import Scenes
from graphtrack.tracks.scene import SceneParameters

SCENE = SceneParameters(clutter_density=2e-3, birth_density=3e-3, death_rate=0.1)


def rows_of(seed: int, frames: int = 20, **more: object) -> list[dict[str, object]]:
    detections, _ = street(np.random.default_rng(seed), people=5, frames=frames)
    places = detections.position.tolist()
    return [
        {"frame": int(f), "t": round(0.4 * f, 6), "x": x, "y": y, **more}
        for f, (x, y) in zip(detections.frame.tolist(), places, strict=True)
    ]


def descriptors_of_people(k: int) -> dict[str, float]:
    """Some descriptor and score of detection k."""
    shown = np.random.default_rng(k).random(4).tolist()
    return {"score": shown[3]} | {f"appearance_{i}": value for i, value in enumerate(shown[:3])}


def scenes() -> Scenes:
    return Scenes(lambda: OnlineTracker("position", scene=SCENE), None)


def answers(rows: list[dict[str, object]], of: Scenes | None = None) -> list[dict[str, object]]:
    of = scenes() if of is None else of
    lines = [json.dumps(row).encode() for row in rows]
    found = [one for number, line in enumerate(lines, 1) for one in of.answers(number, line)]
    return found + of.finish()


def test_each_frame_ends_with_its_people_and_what_was_taken_back() -> None:
    rows = rows_of(0)
    found = answers(rows)
    ends = [row for row in found if "end" in row]
    assert [row["end"] for row in ends] == sorted({row["t"] for row in rows})
    assert sum(row["detections"] for row in ends) == len(rows)
    said = [row for row in found if "track_id" in row]
    assert sum(row["people"] for row in ends) == len(said)
    frames = {row["frame"] for row in rows}
    assert {row["frame"] for row in said} <= frames
    for row in said:
        assert row["observed"] in (0.0, 1.0)
        assert (row["identity_p"] is None) == (row["observed"] == 0.0)
    taken_back = [one for row in ends for one in row.get("revised", [])]
    assert taken_back
    assert {"t", "frame", "detection", "before", "after"} == taken_back[0].keys()


def test_an_end_tells_at_once_and_one_of_no_detections_is_a_frame_too() -> None:
    of = scenes()
    row = json.dumps({"t": 0.0, "x": 0.0, "y": 0.0}).encode()
    assert of.answers(1, row) == []
    *people, told = of.answers(2, b'{"end": 0.0}')
    assert told == {"end": 0.0, "people": len(people), "detections": 1}
    assert of.answers(3, b'{"end": 0.4}')[-1]["detections"] == 0
    (wrong,) = of.answers(4, b'{"end": 0.2}')
    assert "after 0.4" in wrong["error"]


def test_streams_do_not_know_of_each_other() -> None:
    one, other = rows_of(1, stream="north"), rows_of(2, stream=7)
    together = [row for pair in zip(one, other, strict=False) for row in pair]
    found = answers(together)
    for name, rows in (("north", one[: len(other)]), (7, other[: len(one)])):
        alone = answers(rows)
        assert [row for row in found if row["stream"] == name] == alone
    assert all("stream" not in row for row in answers([{**row, "stream": None} for row in one]))


@pytest.fixture(scope="module")
def in_two_parts():
    """Rows, those that follow, and the answers to all of them."""
    rows = [row | descriptors_of_people(k) for k, row in enumerate(rows_of(3, frames=11))]
    later = [{**one, "t": one["t"] + 4.4, "frame": None} for one in rows]
    return rows, later, answers([*rows, *later])


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ({"t": 4.0, "x": 1.0}, "all of x … y"),
        ({"t": 4.0}, "a detection without a position"),
        ({"x": 1.0, "y": 1.0}, "neither t nor frame"),
        ({"t": 3.0, "x": 1.0, "y": 1.0}, "a time from 4 on"),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "track_id": 3}, "--associate always"),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "stream": [1]}, "stream = "),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "appearance_0": 1.0}, "a descriptor of 1 numbers"),
        ({"t": 4.0, "x": 1.0, "y": 1.0, "score": -1.0}, "score"),
        ({"end": "now"}, "the time of the frame that ends"),
    ],
)
def test_what_cannot_be_used_is_told_and_changes_nothing(
    row: dict[str, object], told: str, in_two_parts
) -> None:
    rows, later, undisturbed = in_two_parts
    found = answers([*rows, row, *later])
    (wrong,) = [one for one in found if "error" in one]
    assert told in wrong["error"]
    assert wrong["line"] == len(rows) + 1
    assert [one for one in found if "error" not in one] == undisturbed
