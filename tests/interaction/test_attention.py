"""Attention: calibrated on simulated gaze, joint posteriors, occluding people, and places."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import Done
from command import run as run_program

import graphtrack as gt
from graphtrack.errors import InputWarning
from graphtrack.geometry.angles import class_centres, direction, wrap
from graphtrack.interaction.attention import Attention, attention, attention_columns, summary_of
from graphtrack.interaction.group_files import GroupLabels, read_groups
from graphtrack.interaction.people import Place, read_places
from graphtrack.simulation.scenario import party
from graphtrack.tracks.track import Track, TrackSet


def run(*arguments: object) -> Done:
    return run_program(*arguments, program="graphtrack")


def still(one: int, x: float, y: float, head: float | None, n: int = 6) -> Track:
    frame = np.arange(n, dtype=np.int64)
    looks = None if head is None else np.full(n, head)
    return Track(one, frame, 0.5 * frame, np.tile([x, y], (n, 1)), head=looks)


def of(found: Attention, kind: str, name: str) -> float:
    """Mean probability of a target."""
    return float(found.probability[:, found.targets.index((kind, name))].mean())


def speakers(tracks: TrackSet, groups: GroupLabels) -> dict[tuple[int, int], tuple[int, int]]:
    """(person, frame) → the member whom most of the others look at, and how many members there are.

    That is of groups of five and more, by heads within 20° of a member; the person's own does not count.
    """
    found = {}
    first, ids = tracks.tracks[0], np.array([track.track_id for track in tracks])
    rows = np.tile(first.frame, len(ids)), np.tile(first.t, len(ids)), np.repeat(ids, len(first))
    labels = groups.labels(*rows).reshape(len(ids), -1)
    for row, (frame, label) in enumerate(zip(first.frame, labels.T, strict=True)):
        position = np.array([track.position[row] for track in tracks])
        heads = [0.0 if track.head is None else track.head[row] for track in tracks]
        for group in np.unique(label[label >= 0]):
            members = np.flatnonzero(label == group)
            looks = {}
            for one in members:
                others = members[members != one]
                away = np.abs(wrap(direction(position[others] - position[one]) - heads[one]))
                looks[one] = others[away.argmin()] if away.min() < np.radians(20.0) else -1
            for one in members:
                votes = [look for other, look in looks.items() if other != one]
                most = max(set(votes), key=votes.count)
                if most not in (-1, one) and votes.count(most) >= max(3.0, (len(members) - 2) * 2 / 3):
                    found[int(ids[one]), int(frame)] = int(ids[most]), len(members)
    return found


def test_at_a_real_party_looks_are_at_whom_the_others_look_at(data_dir: Path) -> None:
    tracks = gt.read(data_dir / "salsa" / "features.txt").map(
        lambda track: track[(track.t > 1000.0) & (track.t < 1934.0)]
    )
    with pytest.warns(InputWarning):
        groups = read_groups(data_dir / "salsa" / "groups.txt")
    known = speakers(tracks, groups)
    looks = {one.track_id: one for one in attention(tracks, groups=gt.groups(tracks))}
    right, shares, chance = [], [], []
    for (person, frame), (speaker, members) in known.items():
        told = looks[person].probability[np.searchsorted(looks[person].frame, frame)]
        place = looks[person].people.index(speaker)
        right.append(told.argmax() == place)
        shares.append(told[place])
        chance.append(1.0 / (members - 1))
    print(len(known), np.mean(right), np.mean(shares), np.mean(chance))
    assert len(known) > 300
    assert min(np.mean(right), np.mean(shares)) > 1.5 * np.mean(chance)


def test_probabilities_sum_to_one_whoever_comes_first() -> None:
    tracks = party(np.random.default_rng(2), people=6, steps=40).tracks
    found = attention(tracks)
    for one, other in zip(found, attention(tracks.tracks[::-1]), strict=True):
        np.testing.assert_allclose(one.probability.sum(axis=1), 1.0)
        np.testing.assert_allclose(one.probability, other.probability)


def test_who_stands_in_between_takes_the_look() -> None:
    looker, behind, between = still(1, 0.0, 0.0, 0.0), still(2, 4.0, 0.0, None), still(3, 2.0, 0.05, None)
    alone = of(attention([looker, behind])[0], "person", "2")
    hidden = attention([looker, behind, between])[0]
    assert alone > 0.8 and of(hidden, "person", "2") < 0.1 < 0.8 < of(hidden, "person", "3")


def test_both_modes_of_a_head_count() -> None:
    scores = np.exp(8.0 * (np.cos(2.0 * class_centres(12)) - 1.0))
    looker = replace(still(1, 0.0, 0.0, None), head_likelihood=np.tile(scores, (6, 1)))
    found = attention(
        [looker, still(2, 3.0, 0.0, None), still(3, -3.0, 0.0, None), still(4, 0.0, 3.0, None)]
    )[0]
    ahead, back, aside = (of(found, "person", name) for name in "234")
    assert ahead == pytest.approx(back, abs=0.02) and ahead > 0.3 and aside < 0.1


def test_an_unknown_head_leaves_the_prior_and_nobody_leaves_nothing() -> None:
    found = attention([still(1, 0.0, 0.0, None), still(2, 1.0, 0.0, None)])[0]
    assert of(found, "nothing", "") == pytest.approx(0.3)
    assert of(attention([still(1, 0.0, 0.0, 0.3)])[0], "nothing", "") == 1.0


def test_places_are_looked_at_the_larger_the_rather(tmp_path: Path) -> None:
    path = tmp_path / "places.csv"
    path.write_text("name,x,y,radius,polygon\nposter,4,0,0.5,\nstage,,,,-5 -1 -5 1 -6 0\n")
    poster, stage = read_places(path)
    for head, expected in ((0.0, "poster"), (np.pi, "stage")):
        found = attention([still(1, 0.0, 0.0, head)], [poster, stage])[0]
        assert of(found, "place", expected) > 0.8
    far, near = (attention([still(1, 0.0, 0.0, 0.5)], [Place("p", poster.outline, r)])[0] for r in (0.1, 2.0))
    assert of(near, "place", "p") > of(far, "place", "p")
    summary = summary_of(attention([still(1, 0.0, 0.0, 0.0)], [poster, stage]))
    seconds, intervals = summary.dwell["poster"][1]
    assert seconds > 2.0 and intervals == [(-0.25, 2.75)]


def test_the_command_writes_table_and_summary(tmp_path: Path) -> None:
    made = run(
        *("simulate", "-o", tmp_path / "party.csv", "--scene", "party", "--tracks", 5, "--steps", 30),
        *("--groups", tmp_path / "groups.csv", "--gaze", tmp_path / "looks.csv"),
    )
    assert made.returncode == 0, made.stderr
    (tmp_path / "places.csv").write_text("name,x,y,radius\nbar,1,1,0.5\n")
    done = run(
        *("attention", tmp_path / "party.csv", "-o", tmp_path / "attention.csv"),
        *("--places", tmp_path / "places.csv", "--json", tmp_path / "looks.json"),
    )
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((tmp_path / "attention.csv").open()))
    assert list(rows[0]) == ["frame", "t", "track_id", "kind", "target", "probability"]
    summary = json.loads((tmp_path / "looks.json").read_text())
    assert np.sum(summary["seconds"]) == pytest.approx(5 * 3.0, rel=1e-3)
    assert sum(row["kind"] == "nothing" for row in rows) == 5 * 30
    judged = run(
        "groups", tmp_path / "party.csv", "-o", tmp_path / "g.csv", "--truth", tmp_path / "groups.csv"
    )
    assert judged.returncode == 0, judged.stderr


def test_two_who_look_at_each_other_do_so_mutually() -> None:
    found = attention(TrackSet((still(1, 0.0, 0.0, 0.0), still(2, 1.5, 0.0, np.pi))))
    assert summary_of(found).mutual[1, 2] > 2.0
    assert set(attention_columns(found)["kind"]) <= {"person", "nothing"}
