"""Names of people in the page: text identities of a file, labels, and ids."""

from dataclasses import replace

import numpy as np
import pytest
from made_up import walker
from made_up_behaviour import grouped, looking, standing
from page_scripts import decoded, in_node

import graphtrack as gt
from graphtrack.interaction.attention import summary_of
from graphtrack.report.content import DataTable
from graphtrack.report.html import render_report
from graphtrack.report.interaction import behaviour_of
from graphtrack.report.lives import pair_tracks
from graphtrack.report.page import tracking_report
from graphtrack.report.plots.interaction import plot_look_timeline, plot_matrix
from graphtrack.report.plots.scene import plot_tracks
from graphtrack.tracks.table import AsRead
from graphtrack.tracks.track import TrackSet

NAMES = {1: "P07", 2: "P$08", 3: "Anna", 4: "4th"}


@pytest.fixture(scope="module")
def tracks():
    return replace(standing(), as_read=AsRead(columns={"track_id": "person"}, names=NAMES))


def tick_labels(axes):
    return {text.get_text() for axis in (axes.xaxis, axes.yaxis) for text in axis.get_ticklabels()}


def test_every_table_has_the_names_of_the_file(tracks):
    behaviour = behaviour_of(tracks, groups=grouped(tracks), attention=looking(tracks, ()))
    report = tracking_report(tracks, behaviour=behaviour)
    tables = [item for section in report.sections for item in section.items if isinstance(item, DataTable)]
    found = {
        row[table.columns.index(table.person_column)]
        for table in tables
        if table.person_column
        for row in table.rows
    }
    assert found == set(NAMES.values())
    rows = {
        table.title: [dict(zip(table.columns, row, strict=True)) for row in table.rows] for table in tables
    }
    assert rows["All groups"][0]["who"] == "P07, P$08"
    assert {row["looks most at"] for row in rows["Gaze of each person"]} <= set(NAMES.values())
    # The numbers are those of other files, such as of groups.
    assert [row["id"] for row in rows["Results of each person"]] == list(NAMES)
    assert {person["id"]: person["number"] for person in report.replay["people"]} == {
        name: str(number) for number, name in NAMES.items()
    }


def test_pictures_have_the_names_of_the_file(tracks):
    looks, shown = looking(tracks, ()), {"P07", r"P\$08", "Anna", "4th"}
    assert shown <= tick_labels(plot_look_timeline(looks, tracks.names).axes[0])
    axes = plot_matrix(summary_of(looks), list(NAMES), tracks.names).axes[0]
    assert tick_labels(axes) == shown | {"nothing"}
    figure = plot_tracks(tracks)
    assert shown <= {text.get_text() for text in figure.axes[0].texts}
    assert shown <= {text.get_text() for text in figure.legends[0].get_texts()}


def test_the_address_takes_names_and_numbers(tracks):
    replay = tracking_report(tracks).replay
    code = "const crowd = createCrowd(people); return ['Anna', '3', 'P07', '9'].map(crowd.indexOf);"
    assert in_node(("replay_data.js", "lives.js", "people.js"), decoded(replay) + code) == [2, 2, 0, -1]


def test_labels_are_names_where_each_is_of_one_person():
    def names(*labels):
        return TrackSet(tuple(walker(i, label=label) for i, label in enumerate(labels))).names

    assert names("Anna", "Ben") == {0: "Anna", 1: "Ben"}
    assert names("hall", "hall") == names("Anna", "") == {0: "0", 1: "1"}


def test_ids_that_were_added_keep_apart_from_identities_of_the_file():
    tracks = TrackSet(tuple(walker(i) for i in (1, 2, 3)), as_read=AsRead(names={1: "2", 2: "b"}))
    assert tracks.names == {1: "2", 2: "b", 3: "3"}
    tracks = replace(tracks, as_read=AsRead(names={1: "3", 2: "b"}))
    assert tracks.names == {1: "3", 2: "b", 3: "track 3"}


def test_estimates_without_names_have_those_of_the_observations(tracks):
    bare = replace(tracks, as_read=None)
    assert [pair.name for pair in pair_tracks(bare, tracks)] == list(NAMES.values())
    assert [pair.title for pair in pair_tracks(bare)] == [f"person {i}" for i in NAMES]


@pytest.mark.slow
def test_identities_of_the_data_have_no_section_of_their_own():
    walked = gt.simulate("joint", n_tracks=2, rng=np.random.default_rng(0))
    table = walked.to_table()
    table = table[(table.frame < 10) | (table.frame > 14)]
    report = tracking_report(gt.smooth(table), gt.read(table))
    assert "Identities" not in [section.title for section in report.sections]
    assert "births, deaths, joins" not in render_report(report)
    detections = table.drop(columns=["track_id", "label"])
    found = tracking_report(gt.smooth(gt.associate(detections)))
    assert "Identities" in [section.title for section in found.sections]
