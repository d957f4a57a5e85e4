"""Methods that find groups, on the same people."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import ran, run

import graphtrack as gt
from graphtrack.errors import InputError, InputWarning
from graphtrack.evaluation.groups import average_linkage, compare_groups, registry
from graphtrack.evaluation.methods import Method
from graphtrack.geometry.angles import direction, unit
from graphtrack.interaction.group_files import read_groups
from graphtrack.interaction.people import people_of
from graphtrack.interaction.scores import score_groups
from graphtrack.io.read_write import write_table
from graphtrack.simulation.scenario import Party, party


@pytest.fixture(scope="module")
def scene() -> Party:
    return party(np.random.default_rng(3), people=7, steps=20, fps=1.0)


@pytest.fixture
def labelled(scene: Party, tmp_path: Path) -> Path:
    write_table(scene.group_columns(), tmp_path / "labelled.csv")
    return tmp_path / "labelled.csv"


@pytest.mark.parametrize("hidden", [("body",), ("head",), ("body", "head")], ids="-".join)
def test_average_linkage_is_that_of_its_definition(scene: Party, hidden: tuple[str, ...]) -> None:
    people = people_of(scene.tracks.map(lambda track: replace(track, **dict.fromkeys(hidden))))
    label = average_linkage(people)
    toward = people.head + people.body  # one of them is zero
    stride = 0.0 if len(hidden) == 2 else 0.7
    for k in range(len(people.frame)):
        rows = slice(people.first[k], people.first[k + 1])
        space = people.position[rows] + stride * unit(direction(toward[rows]))
        groups = [[one] for one in range(len(space))]
        while len(groups) > 1:
            pairs = [(a, b) for b in range(len(groups)) for a in range(b)]
            far = [
                float(np.linalg.norm(space[groups[a]][:, None] - space[groups[b]], axis=2).mean())
                for a, b in pairs
            ]
            if min(far) > 0.9:
                break
            a, b = pairs[int(np.argmin(far))]
            groups[a] += groups.pop(b)
        found = {frozenset(np.flatnonzero(label[rows] == one).tolist()) for one in label[rows].tolist()}
        assert found == {frozenset(group) for group in groups}


def test_methods_are_scored_on_the_same_frames(scene: Party, labelled: Path) -> None:
    truth = scene.group_columns()

    def perfect(tracks: gt.TrackSet) -> np.ndarray:
        people = people_of(tracks)
        known = {(f, i): g for f, i, g in zip(truth["frame"], truth["track_id"], truth["group"], strict=True)}
        rows = zip(people.frame[people.frame_of], people.ids[people.person], strict=True)
        return np.array([known[row] for row in rows])

    methods = [*registry, Method("perfect", True, "the truth", perfect)]
    found = compare_groups(scene.tracks, read_groups(labelled), methods)
    assert found.scores["perfect"].f1 == (1.0, 1.0)
    for name, online in (("groups", False), ("online", True)):
        own = gt.groups(scene.tracks, online=online)
        true = read_groups(labelled).labels(own.frame, own.t, own.track_id)
        assert found.scores[name] == score_groups(own.frame, own.track_id, own.group, true)
    assert len({score.frames for score in found.scores.values()}) == 1


def test_the_command_reports_every_method(scene: Party, labelled: Path, tmp_path: Path) -> None:
    gt.write(scene.tracks, tmp_path / "party.csv")
    options = ("--groups", labelled, "--json", tmp_path / "found.json")
    done = ran("compare", tmp_path / "party.csv", *options, program="graphtrack")
    found = json.loads((tmp_path / "found.json").read_text())["methods"]
    assert [one["method"] for one in found] == list(registry)
    expected = compare_groups(gt.read(tmp_path / "party.csv"), read_groups(labelled)).to_dict()["methods"]
    assert found == expected
    assert all(f"{one['t_one']['f1']:.3g}"[:4] in done.stdout for one in found)


def test_wrong_methods_and_options_are_refused(scene: Party, labelled: Path, tmp_path: Path) -> None:
    labels = read_groups(labelled)
    with pytest.raises(InputError, match="method 'linkage'"):
        compare_groups(scene.tracks, labels, ["linkage"])
    with pytest.raises(InputError, match="each method once"):
        compare_groups(scene.tracks, labels, ["groups", "groups"])
    gt.write(scene.tracks, tmp_path / "party.csv")
    for wrong in (("--groups", labelled, "--fill"), ("--parameters", labelled)):
        done = run("compare", tmp_path / "party.csv", *wrong, program="graphtrack")
        assert done.returncode == 2 and str(wrong[-1] if len(wrong) > 2 else wrong[0]) in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "hidden",
    [
        pytest.param((), id="nothing"),
        pytest.param(("body",), id="body", marks=pytest.mark.slow),
        pytest.param(("head",), id="head", marks=pytest.mark.slow),
        pytest.param(("body", "head"), id="body-head"),
    ],
)
def test_groups_of_a_real_party_are_found_better_than_by_average_linkage(
    data_dir: Path, hidden: tuple[str, ...]
) -> None:
    tracks = gt.read(data_dir / "salsa" / "features.txt").map(
        lambda track: replace(track[(track.t > 1000.0) & (track.t < 1934.0)], **dict.fromkeys(hidden))
    )
    with pytest.warns(InputWarning):
        labels = read_groups(data_dir / "salsa" / "groups.txt")
    found = compare_groups(tracks, labels).scores
    ours, linked = found["groups"].f1, found["average-linkage"].f1
    assert ours[0] > linked[0] - 0.005 and ours[1] > linked[1] + 0.02
    assert min(ours[0] - 0.7, ours[1] - 0.4) > 0.0
