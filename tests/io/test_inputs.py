"""Inputs of a track: their names and values, in memory, in tables and in a stream."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.inference.state import checked
from graphtrack.io.formats.ndjson import parse_line, read_cells
from graphtrack.scale.dataset import open_dataset
from graphtrack.scale.job import smooth_dataset
from graphtrack.streaming.protocol import observation_of
from graphtrack.tracks.schema import input_columns, is_input_name, numeric
from graphtrack.tracks.track import Track, TrackSet

GOAL = np.array([[1.0, 2.0], [np.nan, np.nan], [3.0, 4.0]])


def person(track_id: int = 1, **inputs: object) -> Track:
    return Track(track_id, np.arange(3), 0.1 * np.arange(3), np.zeros((3, 2)), inputs=inputs)  # type: ignore[arg-type]


@given(name=st.text(st.sampled_from("ab_019"), max_size=8))
def test_a_column_belongs_to_one_input_alone(name: str) -> None:
    """Were ``goal_0`` the name of an input, its column would be that of an array called ``goal``."""
    if not is_input_name(name):
        return
    for size in ((), (3,)):
        columns = list(input_columns(f"input_{name}", size))
        assert [column.field for column in columns] == [f"input_{name}"] * len(columns)
        assert [numeric(column.name) for column in columns] == columns
        assert len({column.name for column in columns}) == (size[0] if size else 1)


def test_a_track_keeps_its_inputs_and_nobody_changes_them() -> None:
    track = person(goal=GOAL, density=[1, 2, 3])
    np.testing.assert_array_equal(track.input("goal", 2), GOAL)
    np.testing.assert_array_equal(track[1:].input("density"), [2.0, 3.0])
    assert track.input("absent", 4).shape == (3, 4)
    with pytest.raises(ValueError, match="read-only"):
        track.inputs["goal"][0] = 0.0
    assert GOAL.flags.writeable


@pytest.mark.parametrize(
    ("inputs", "said"),
    [
        ({"goal_0": np.zeros(3)}, "input 'goal_0'"),
        ({"ziel des wegs": np.zeros(3)}, "letters, digits"),
        ({"goal": np.zeros(2)}, r"shape \(3,\)"),
        ({"goal": np.zeros((3, 0))}, "one number at least"),
        ({"goal": np.zeros((3, 2, 2))}, "shape"),
        ({"goal": np.array([[1.0, np.nan]] * 3)}, "frame 0"),
        ({"goal": [0.0, np.inf, 0.0]}, "input_goal = inf in frame 1"),
        ({"goal": ["a", "b", "c"]}, "no array of numbers"),
    ],
)
def test_what_is_no_input_is_told(inputs: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        person(**inputs)
    with pytest.raises(InputError, match="input 'goal' of one number a frame in track 2, expected 2 numbers"):
        TrackSet((person(goal=GOAL), person(2, goal=np.zeros(3))))
    for value in ("north", None, [], [[1.0]], [1.0, np.nan], np.inf):
        with pytest.raises(InputError, match="input goal ="):
            checked(gt.Observation(t=0.0, inputs={"goal": value}))  # type: ignore[dict-item]


BAD = {
    "a gap": ("input_goal_0,input_goal_2", "1,2", "a column input_goal_1 next to input_goal_0"),
    "no beginning": ("input_goal_1", "1", "a column input_goal_0 next to input_goal_1"),
    "two sizes": ("input_goal,input_goal_0", "1,2", "a column input_goal next to input_goal_0"),
    "half a row": ("input_goal_0,input_goal_1", "1,", "an empty cell"),
    "too long": ("input_goal_999999", "1", "a column input_goal_0 next to"),
    "infinite": ("input_goal", "1e999", "1e999"),
    "text": ("input_goal", "north", "'north'"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_table_says_where_its_inputs_are_wrong(case: str, tmp_path: Path) -> None:
    names, cells, said = BAD[case]
    path = tmp_path / "people.csv"
    path.write_text(f"track_id,frame,t,x,y,{names}\n1,0,0,0,0,{cells}\n")
    with pytest.raises(InputError, match=said):
        io.read_identified(path)


def test_appearance_is_an_input_whose_columns_have_no_prefix(tmp_path: Path) -> None:
    looks = np.array([[1.0, -2.0], [np.nan, np.nan], [3.0, 4.0]])
    names = list(TrackSet((person(appearance=looks, zone=np.zeros(3)),)).to_table().columns)
    assert names[-3:] == ["appearance_0", "appearance_1", "input_zone"]
    path, out = tmp_path / "people.parquet", tmp_path / "out.parquet"
    io.write(TrackSet((person(appearance=looks),)), path)
    np.testing.assert_array_equal(io.read_identified(path).by_id(1).inputs["appearance"], looks)
    assert {"appearance_0", "appearance_1"} < set(open_dataset(path).columns)
    smooth_dataset(path, out, "position")
    assert not any("appearance" in name for name in io.read_identified(out).to_table().columns)
    # One way of writing it: else two columns would be one number.
    assert numeric("input_appearance_0") is None


def cells(**columns: object) -> dict[str, object]:
    return read_cells(parse_line(json.dumps({"track_id": 1, "frame": 0, "x": 0.0, "y": 0.0, **columns})))


def test_a_stream_has_inputs() -> None:
    seen = observation_of(
        cells(input_goal_1=2.0, input_goal_0=1.0, input_density=3, input_unknown=None), 10.0
    )
    assert checked(seen).inputs == {"goal": (1.0, 2.0), "density": 3.0}
    assert observation_of(cells(appearance_1=2, appearance_0=1), 10.0).inputs == {"appearance": (1.0, 2.0)}
    with pytest.raises(InputError, match="a key appearance next to appearance_0"):
        observation_of(cells(appearance=2.0, appearance_0=1.0), 10.0)
    with pytest.raises(InputError, match="an empty cell") as raised:
        cells(input_goal_1=2.0)
    assert raised.value.column == "input_goal_0"
    with pytest.raises(InputError, match="one of the two"):
        observation_of(cells(input_goal=2.0, input_goal_0=1.0), 10.0)
