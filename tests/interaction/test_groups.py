"""Groups: their invariances, their state, and their files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import Done, ran
from command import run as run_program

import graphtrack as gt
from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import direction, mean_resultant_length, unit, wrap
from graphtrack.interaction.evidence import o_spaces, observed_scores
from graphtrack.interaction.group_files import read_groups
from graphtrack.interaction.groups import partition
from graphtrack.interaction.parameters import DEFAULT, GroupParameters
from graphtrack.interaction.people import people_of
from graphtrack.interaction.scores import matches, score_groups
from graphtrack.tracks.track import Track, TrackSet


def run(*arguments: object) -> Done:
    done = ran(*arguments, program="graphtrack")
    return done


def circle(ids: range, centre: tuple[float, float], radius: float, n: int, dt: float = 0.5) -> list[Track]:
    """People who stand on a circle and face its centre, a little restless."""
    rng = np.random.default_rng(min(ids))
    tracks = []
    for k, one in enumerate(ids):
        angle = 2.0 * np.pi * k / len(ids)
        place = np.array(centre) + radius * np.array([np.cos(angle), np.sin(angle)])
        position = place + 0.02 * rng.standard_normal((n, 2))
        facing = wrap(direction(np.array(centre) - position) + 0.1 * rng.standard_normal(n))
        frame = np.arange(n, dtype=np.int64)
        tracks.append(Track(one, frame, dt * frame, position, body=facing, head=facing))
    return tracks


def party(n: int = 20, dt: float = 0.5) -> TrackSet:
    """Two conversations and a single person, who looks away."""
    alone = circle(range(9, 10), (6.0, 3.0), 0.0, n, dt)[0]
    alone = replace(alone, body=np.full(n, 0.4), head=np.full(n, 0.4))
    return TrackSet(
        (*circle(range(1, 5), (0.0, 0.0), 0.7, n, dt), *circle(range(5, 8), (3.5, 0.5), 0.6, n, dt), alone)
    )


def walkers(n: int = 40, dt: float = 0.4) -> TrackSet:
    """A pair side by side, and a person who overtakes them."""
    frame = np.arange(n, dtype=np.int64)
    t = dt * frame
    ways = {1: (1.2, 0.0), 2: (1.2, 0.7), 3: (1.9, 1.6)}
    return TrackSet(
        tuple(Track(k, frame, t, np.column_stack([v * t, np.full(n, y)])) for k, (v, y) in ways.items())
    )


def partitions_of(found: gt.Groups) -> dict[int, set[frozenset[int]]]:
    return {frame: set(groups) for frame, groups in found.members().items()}


def reversed_in_time(tracks: TrackSet) -> TrackSet:
    def one(track: Track) -> Track:
        kept = {name: getattr(track, name) for name in ("position", "body", "head")}
        changed = {name: values[::-1] for name, values in kept.items() if values is not None}
        return replace(track, frame=-track.frame[::-1], t=-track.t[::-1], **changed)

    return tracks.map(one)


def test_conversations_are_found_and_who_is_alone_stays_so() -> None:
    found = gt.groups(party())
    expected = {frozenset(range(1, 5)), frozenset(range(5, 8))}
    assert all(groups == expected for groups in partitions_of(found).values())
    assert set(found.to_table()["kind"]) == {"", "conversing"}
    grouped = found.group >= 0
    assert (found.probability[grouped] > 0.5).all() and (found.probability >= 0.0).all()
    centre = found.centre[found.track_id == 1]
    assert np.hypot(*centre.T).max() < 0.3
    assert np.isnan(found.centre[~grouped]).all()


@pytest.mark.parametrize("tracks", [party(), walkers()], ids=["party", "walkers"])
def test_order_names_and_direction_of_time_are_without_effect(tracks: TrackSet) -> None:
    expected = partitions_of(gt.groups(tracks))
    assert partitions_of(gt.groups(tracks.tracks[::-1])) == expected
    back = partitions_of(gt.groups(reversed_in_time(tracks)))
    assert {-frame: groups for frame, groups in back.items()} == expected
    names = {track.track_id: 100 - 7 * track.track_id for track in tracks}
    renamed = partitions_of(
        gt.groups(tracks.map(lambda track: replace(track, track_id=names[track.track_id])))
    )
    assert renamed == {
        frame: {frozenset(names[k] for k in group) for group in groups} for frame, groups in expected.items()
    }


def test_less_is_sure_where_less_is_known() -> None:
    sure = gt.groups(party()).probability
    hidden = party().map(lambda track: replace(track, body=None, head=None))
    places = gt.groups(hidden)
    vague = party().map(lambda track: replace(track, body_kappa=np.full(len(track), 0.01), head=None))
    grouped = gt.groups(party()).group >= 0
    assert places.probability[grouped].mean() < sure[grouped].mean()
    np.testing.assert_allclose(gt.groups(vague).probability, places.probability, atol=0.02)


def test_the_frame_rate_is_without_effect() -> None:
    slow, fast = party(10, 1.0), party(200, 0.05)
    found = [set().union(*partitions_of(gt.groups(tracks)).values()) for tracks in (slow, fast)]
    assert found[0] == found[1]


def test_a_group_keeps_its_number_while_most_of_its_members_stay() -> None:
    first, then = party(), circle(range(1, 4), (0.0, 0.0), 0.7, 40)
    leaver = replace(
        first.by_id(4), position=first.by_id(4).position + np.where(np.arange(20)[:, None] > 9, 30.0, 0.0)
    )
    tracks = TrackSet((*(track[:20] for track in then), leaver))
    found = gt.groups(tracks)
    assert set(found.group[found.track_id == 1]) == {0}
    assert found.group[found.track_id == 4][-1] == -1


def test_one_person_and_nobody() -> None:
    one = gt.groups(party().tracks[:1])
    assert (one.group == -1).all() and (one.probability == 1.0).all()
    assert len(gt.groups(TrackSet(()))) == 0


def test_a_partition_is_nearly_the_best_of_all() -> None:
    rng = np.random.default_rng(2)
    left, right = np.triu_indices(5, 1)
    shares = []
    for _ in range(60):
        odds = rng.normal(size=len(left)) * 2.0

        def worth(label: np.ndarray, odds: np.ndarray = odds) -> float:
            size = np.bincount(label, minlength=5)[label[left]]
            return float((2.0 * odds / size)[label[left] == label[right]].sum())

        every = np.stack(np.meshgrid(*[range(5)] * 5, indexing="ij"), -1).reshape(-1, 5)
        best = max(worth(label) for label in every)
        found = worth(partition(5, left, right, odds, -4.0))
        assert found <= best + 1e-9
        shares.append(found / best)
    assert np.mean(shares) > 0.98


def test_the_marginal_of_o_spaces_is_that_of_drawn_directions() -> None:
    rng = np.random.default_rng(3)
    kappa, length = 4.0, mean_resultant_length(4.0)
    body = replace(DEFAULT, body_spread=0.0)
    one = replace(party(1).tracks[0], body=np.array([0.7]), head=None, body_kappa=np.array([kappa]))
    people = people_of([one])
    mean, spread = o_spaces(people, observed_scores(people, body), body.stride)
    drawn = people.position + body.stride * unit(rng.vonmises(0.7, kappa, 200_000))
    assert np.hypot(*people.body[0]) == pytest.approx(length)
    np.testing.assert_allclose(mean[0], drawn.mean(axis=0), atol=0.01)
    np.testing.assert_allclose(spread[0], np.cov(drawn.T), atol=0.01)


def test_people_with_less_known_of_their_bodies_are_as_with_wider_bodies() -> None:
    hidden = party().map(lambda track: replace(track, body=None))
    wider = party().map(lambda track: replace(track, body=track.head, head=None))
    found = gt.groups(hidden).probability
    same = gt.groups(wider, replace(DEFAULT, body_spread=DEFAULT.head_spread)).probability
    np.testing.assert_allclose(found, same, atol=1e-9)


def test_parameters_of_an_earlier_version_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "old.toml"
    path.write_text("[groups]\nstride = 0.65\n[groups.bodies]\nbias = 9.0\n")
    with pytest.raises(InputError, match=r"key groups\.bodies"):
        GroupParameters.load(path)


def test_scores_of_the_truth_are_one_and_of_nothing_zero() -> None:
    frame, person = np.repeat(np.arange(4), 5), np.tile(np.arange(5), 4)
    true = np.tile([0, 0, 1, 1, -1], 4)
    same, none = (
        score_groups(frame, person, label, true) for label in (true + 3 * (true >= 0), np.full(20, -1))
    )
    assert same.f1 == (1.0, 1.0) and same.pair_f1 == 1.0
    assert none.f1 == (0.0, 0.0) and none.pair_recall == 0.0
    three, four = frozenset({1, 2, 3}), frozenset({1, 2, 3, 4})
    assert matches([three], [four], 2 / 3) == 1 and matches([three], [four], 1.0) == 0
    assert matches([frozenset({1, 2, 7, 8})], [three], 2 / 3) == 0


def test_unknown_people_and_overlaps_are_told(tmp_path: Path) -> None:
    path = tmp_path / "groups.txt"
    rows = np.zeros(2, dtype=np.int64), np.zeros(2), np.array([1, 2])
    path.write_text("0.0 < ID_001 ID_0077 >\n")
    with pytest.raises(InputError, match="line 1: found person 77 in a group, expected people of the tracks"):
        read_groups(path).labels(*rows)
    path.write_text("0.0 < ID_002 > < ID_001 ID_002 >\n")
    with pytest.warns(InputWarning, match="in two groups at once in line 1"):
        assert (read_groups(path).labels(*rows) == 0).all()
    path.write_text("1 2 77\n")
    with pytest.warns(InputWarning, match="1 people"):
        assert (read_groups(path).labels(*rows) == 0).all()


@pytest.mark.slow
def test_the_command_writes_what_it_reads_and_learns(tmp_path: Path) -> None:
    gt.write(party(60), tmp_path / "party.csv")
    run("groups", tmp_path / "party.csv", "-o", tmp_path / "groups.csv")
    lines = (tmp_path / "groups.csv").read_text().splitlines()
    assert lines[0] == "frame,t,track_id,group,kind,probability,centre_x,centre_y"
    assert len(lines) == 1 + 8 * 60
    done = run("score", tmp_path / "groups.csv", "--truth", tmp_path / "groups.csv")
    assert "1" in done.stdout
    run("fit", tmp_path / "party.csv", "--groups", tmp_path / "groups.csv", "-o", tmp_path / "learned.toml")
    run(
        *("groups", tmp_path / "party.csv", "-o", tmp_path / "again.csv"),
        *("--parameters", tmp_path / "learned.toml", "--truth", tmp_path / "groups.csv"),
    )
    assert [line.split(",")[:4] for line in (tmp_path / "again.csv").read_text().splitlines()] == [
        line.split(",")[:4] for line in lines
    ]


@pytest.mark.parametrize(
    ("command", "truth", "told"),
    [
        ("groups", "frame,track_id,group\n0,99,1\n", "found person 99 in a group"),
        ("attention", "frame,track_id,target\n77,1,2\n", "no frame with labelled looks"),
    ],
)
def test_nothing_is_written_beside_a_truth_of_others(
    tmp_path: Path, command: str, truth: str, told: str
) -> None:
    gt.write(party(4), tmp_path / "party.csv")
    (tmp_path / "truth.csv").write_text(truth)
    paths = [tmp_path / "party.csv", "-o", tmp_path / "found.csv", "--truth", tmp_path / "truth.csv"]
    done = run_program(command, *paths, program="graphtrack")
    assert done.returncode == 2 and told in done.stderr
    assert not (tmp_path / "found.csv").exists()


def test_rows_of_several_sensors_are_refused_until_they_have_common_times() -> None:
    count = 20
    frame, sensor = np.repeat(np.arange(count), 2), np.tile(["a", "b"], count)
    t = 0.1 * frame + 0.05 * (sensor == "b")
    noise = np.full(len(t), 0.05)
    tracks = TrackSet(
        Track(k, frame, t, np.column_stack([t, 0.7 * k + 0.0 * t]), position_std=noise, sensor=sensor)
        for k in range(2)
    )
    with pytest.raises(InputError, match=r"rows of several sensors.*--resample"):
        gt.groups(tracks)
    assert len(gt.groups(gt.smooth(tracks, "position", resample=10.0)).frame)
