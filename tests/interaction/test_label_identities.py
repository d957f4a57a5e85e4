"""Labels of groups and gaze name people as the file of the tracks does."""

from pathlib import Path

import pandas as pd
import pytest
from command import run

import graphtrack as gt
from graphtrack.errors import InputError, UnknownTrackError

NAMES = ("anna", "bert", "P03")


@pytest.fixture
def named(tmp_path: Path) -> Path:
    """People with text identities, of whom the first two face each other."""
    places = {"anna": (0.0, 0.0, 0.0), "bert": (1.0, 0.0, 180.0), "P03": (6.0, 5.0, 90.0)}
    rows = [
        {"track_id": name, "t": 0.1 * k, "frame": k, "x": x, "y": y, "body_deg": angle, "head_deg": angle}
        for name, (x, y, angle) in places.items()
        for k in range(40)
    ]
    pd.DataFrame(rows).to_csv(tmp_path / "people.csv", index=False)
    return tmp_path / "people.csv"


def test_people_are_found_by_name_and_by_id(named: Path) -> None:
    tracks = gt.read(named)
    assert set(tracks.ids) == set(NAMES)
    for name, track_id in tracks.ids.items():
        assert tracks.by_id(name) is tracks.by_id(track_id)
    with pytest.raises(UnknownTrackError, match="no track 'carl', expected one of the ids anna, bert, P03"):
        tracks.by_id("carl")


@pytest.mark.parametrize("as_names", [True, False])
def test_labels_with_names_score_as_those_with_ids(named: Path, as_names: bool) -> None:
    tracks = gt.read(named)
    called = {name: name if as_names else tracks.ids[name] for name in NAMES}
    groups, gaze = named.with_name("groups.csv"), named.with_name("gaze.csv")
    groups_of = {"anna": 0, "bert": 0, "P03": -1}
    table = [
        {"frame": k, "track_id": called[one], "group": of} for k in range(40) for one, of in groups_of.items()
    ]
    pd.DataFrame(table).to_csv(groups, index=False)
    looks = {"anna": called["bert"], "bert": called["anna"], "P03": -1}
    table = [
        {"frame": k, "track_id": called[one], "target": at} for k in range(40) for one, at in looks.items()
    ]
    pd.DataFrame(table).to_csv(gaze, index=False)
    found = gt.groups(tracks)
    true = gt.read_groups(groups, tracks.ids).labels(found.frame, found.t, found.track_id)
    assert gt.score_groups(found.frame, found.track_id, found.group, true).pair_f1 == 1.0
    assert gt.score_gaze(gt.attention(tracks), gt.read_gaze(gaze, tracks.ids)).right == 1.0
    out = named.with_name("out.csv")
    for command, labels in (("groups", groups), ("attention", gaze)):
        done = run(command, named, "-o", out, "--truth", labels, program="graphtrack")
        assert done.returncode == 0, done.stderr
        if command == "groups":
            done = run("score", out, "--truth", labels, program="graphtrack")
            assert done.returncode == 0, done.stderr


def test_lists_of_groups_have_names_too(named: Path) -> None:
    labels = named.with_name("groups.txt")
    labels.write_text("anna bert\n")
    ids = gt.read(named).ids
    (step,) = gt.read_groups(labels, ids).steps
    assert step.groups == (frozenset({ids["anna"], ids["bert"]}),)
    labels.write_text("t;id;group\n0;anna;1\n")
    with pytest.raises(InputError, match="line 1: found 't;id;group', expected the columns frame or t"):
        gt.read_groups(labels, ids)
    labels.write_text("anna carl\n")
    with pytest.raises(InputError, match="line 1: found 'carl', expected the id of a person"):
        gt.read_groups(labels, ids)


def test_groups_have_names_and_times_and_gaze_has_places(named: Path) -> None:
    tracks = gt.read(named)
    labels, gaze, places = (named.with_name(f"{name}.csv") for name in ("groups", "gaze", "places"))
    rows = [
        {"t": 0.1 * k, "track_id": one, "group": {"anna": "by the bar", "bert": "by the bar"}.get(one)}
        for k in range(40)
        for one in NAMES
    ]
    pd.DataFrame(rows).to_csv(labels, index=False)
    found = gt.groups(tracks)
    true = gt.read_groups(labels, tracks.ids).labels(found.frame, found.t, found.track_id)
    assert gt.score_groups(found.frame, found.track_id, found.group, true).pair_f1 == 1.0
    places.write_text("name,x,y,radius\nposter,6,9,0.5\n")
    looks = {"anna": "bert", "bert": "anna", "P03": "poster"}
    table = [{"frame": k, "track_id": one, "target": at} for k in range(40) for one, at in looks.items()]
    pd.DataFrame(table).to_csv(gaze, index=False)
    read = gt.read_gaze(gaze, tracks.ids)
    assert read.places == ("poster",)
    assert gt.score_gaze(gt.attention(tracks, str(places)), read).right == 1.0
    with pytest.raises(InputError, match="gaze target 'poster', expected a person, a place or nobody"):
        gt.score_gaze(gt.attention(tracks), read)
    pd.DataFrame([{"frame": 0, "track_id": "anna", "target": "nobody"}]).to_csv(gaze, index=False)
    assert gt.read_gaze(gaze, tracks.ids).target.tolist() == [-1]
    pd.DataFrame([{"frame": 0, "track_id": "carl", "target": "nobody"}]).to_csv(gaze, index=False)
    with pytest.raises(InputError, match="column track_id: found 'carl', expected one of the people anna"):
        gt.read_gaze(gaze, tracks.ids)
