"""`graphtrack track - --groups --attention --forecast`: its output, its timing, and after a restart."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import Done, run

import graphtrack as gt
from graphtrack.interaction.people import Place
from graphtrack.model import Model
from graphtrack.streaming.answers import Scenes, TrackAnswers
from graphtrack.streaming.behaviour import Asked
from graphtrack.streaming.session import Answers
from graphtrack.tracking import OnlineTracker

ALL = Asked(True, True, (Place("bar", np.array([[1.0, 3.0]]), 0.5),))
OF_GROUPS = ["group", "kind", "probability", "centre_x", "centre_y"]


def rows(frames: int = 8, people: int = 3) -> list[dict[str, Any]]:
    """Two people who walk side by side, and further people far from them."""
    far = {1: 0.0, 2: 0.7}
    return [
        {"track_id": k, "frame": f, "t": round(0.4 * f, 6), "x": round(0.5 * f, 6), "y": far.get(k, 20.0 * k)}
        for f in range(frames)
        for k in range(1, people + 1)
    ]


def people_of(asked: Asked | None = ALL, *, ahead: bool = True) -> TrackAnswers:
    return Answers(Model("position"), horizon=(0.8, 0.4) if ahead else None, asked=asked).people()


def answers(people: Any, given: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [one for n, row in enumerate(given, 1) for one in people.answers(n, json.dumps(row).encode())]


def test_rows_with_identities_are_answered_at_once_and_a_frame_when_it_has_ended() -> None:
    people = people_of()
    found = answers(people, rows()) + people.finish()
    told = [row for row in found if "status" not in row]
    assert [(row["track_id"], row["frame"]) for row in told] == [(k, f) for f in range(8) for k in (1, 2, 3)]
    # A person observed once is in a group, or alone, and has no forecast.
    assert list(told[0]) == ["track_id", "frame", "t", *OF_GROUPS, "attention"]
    assert list(told[-1]) == [*told[0], "forecast"]
    first, second, alone = told[-3:]
    assert first["group"] == second["group"] >= 0 and first["kind"] == "walking"
    assert alone["group"] == -1 and alone["kind"] is None and alone["centre_x"] is None
    assert sum(look["probability"] for look in first["attention"]) == pytest.approx(1.0, abs=0.05)
    assert first["attention"][-1]["kind"] == "nothing"
    place = found.index(told[3])
    assert [row.get("status") for row in found[place : place + 4]] == [None] * 3 + ["new"]
    plain = answers(people_of(None), rows())
    assert [r for r in found if "status" in r] == [r for r in plain if "status" in r]


def test_answers_with_identities_are_those_of_a_table_of_estimates(tmp_path: Path) -> None:
    people = people_of(Asked(groups=True))
    found = answers(people, rows()) + people.finish()
    path = tmp_path / "answers.ndjson"
    path.write_text("".join(json.dumps(row) + "\n" for row in found))
    table = gt.groups(gt.read(path), online=True).to_table()
    told = [row for row in found if "status" not in row]
    assert table["group"].tolist() == [row["group"] for row in told]
    np.testing.assert_allclose(table["probability"], [row["probability"] for row in told], atol=1e-9)


def test_late_rows_and_rows_of_a_frame_that_was_told_change_no_frame() -> None:
    people, given = people_of(Asked(groups=True), ahead=False), rows(5, people=2)
    moved = [*given[:4], *given[5:], given[4]]  # one comes two frames late
    told = [row for row in answers(people, moved) + people.finish() if "group" in row]
    assert [row["frame"] for row in told] == sorted(row["frame"] for row in told)
    assert len(told) == len(given) - 1
    assert [row for row in answers(people, [given[-1]]) + people.finish() if "group" in row] == []


def detections(given: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key != "track_id"} for row in given]


def test_detections_are_told_with_groups_and_looks() -> None:
    scenes = Scenes(lambda: OnlineTracker("position"), None, horizon=(0.8, 0.4), asked=ALL)
    answers(scenes, detections(rows(14)))
    last = [row for row in scenes.finish() if "track_id" in row]
    assert len(last) == 3
    for row in last:
        assert {*OF_GROUPS, "attention", "forecast", "identity_p"} <= set(row)
    by_y = {round(row["y"]): row["group"] for row in last}
    assert by_y[0] == by_y[1] >= 0 > by_y[60]


def graphtrack(line: str, **options: Any) -> Done:
    return run(*line.split(), program="graphtrack", **options)


def track(given: list[dict[str, Any]], options: str) -> Done:
    return graphtrack(f"track - --model {options}", rows=given)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("track - --places places.csv", "expected --attention too"),
        ("track - --attention --places none.csv", "none.csv"),
        ("track - --attention --places places.csv", "neither radius nor polygon"),
        ("track tracks.csv -o out.csv --groups", "graphtrack groups --online"),
        ("track tracks.csv -o out.csv --attention", "graphtrack attention --online"),
        ("track - --groups --forecast 0", "horizon = 0"),
        ("track - --groups --forecast 86400", "60 at most"),
    ],
)
def test_what_cannot_be_is_told(cwd: Path, line: str, message: str) -> None:
    (cwd / "places.csv").write_text("name,x,y,radius\na,0,0,\n")
    (cwd / "tracks.csv").write_text("track_id,frame,t,x,y\n1,0,0,0,0\n")
    done = graphtrack(line)
    assert done.returncode == 2 and message in done.stderr, done.stderr
