"""Tables with the well-known names of other programs are read as they are meant."""

import json

import numpy as np
import pandas as pd
import pytest

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.io.column_names import with_synonyms
from graphtrack.io.options import ReadOptions

PEOPLE = (7, 8, 9)


def rows(names):
    """Rows of three people under other names: native column → name."""
    native = [
        {"track_id": one, "frame": k, "t": k / 10, "x": round(0.1 * k + one, 3), "y": float(one)}
        for k in range(12)
        for one in PEOPLE
    ]
    return [{name: row[key] for key, name in names.items()} for row in native]


def written(rows, path):
    if path.suffix == ".csv":
        pd.DataFrame(rows).to_csv(path, index=False)
    elif path.suffix == ".parquet":
        pd.DataFrame(rows).to_parquet(path)
    else:
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


def is_read(tracks):
    assert [one.track_id for one in tracks] == list(PEOPLE)
    for one in tracks:
        np.testing.assert_allclose(one.position[:, 0], 0.1 * np.arange(12) + one.track_id)
        np.testing.assert_allclose(np.diff(one.t), 0.1)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".ndjson"])
@pytest.mark.parametrize(
    "name", ["id", "ID", "person", "agent_id", "ped_id", "pedestrian", "tid", "Track ID", "PersonID"]
)
def test_identities_are_kept_under_their_common_names(tmp_path, suffix, name):
    names = {"frame": "frame", "track_id": name, "x": "x", "y": "y"}
    tracks = gt.read(written(rows(names), tmp_path / f"a{suffix}"), fps=10)
    is_read(tracks)
    assert any("as track_id" in note for note in tracks.summary.notes)


def test_a_unit_in_the_name_counts(tmp_path):
    table = [
        row | {"time_ms": 1000 * row.pop("t"), "pos_x_cm": 100 * row.pop("x"), "pos_y_cm": 100 * row.pop("y")}
        for row in rows({"t": "t", "track_id": "id", "x": "x", "y": "y"})
    ]
    is_read(gt.read(written(table, tmp_path / "a.csv")))


def test_native_columns_are_what_they_are(tmp_path):
    native = {key: key for key in ("t", "track_id", "frame", "x", "y")}
    table = [row | {"id": 1, "time": 5.0, "pos_x": 0.0} for row in rows(native)]
    is_read(gt.read(written(table, tmp_path / "a.csv")))


def test_two_names_of_one_column_are_an_error(tmp_path):
    table = [row | {"person": 1} for row in rows({"frame": "frame", "track_id": "id", "x": "x", "y": "y"})]
    with pytest.raises(InputError, match=r"'id' and 'person'.*--columns id=NAME"):
        gt.read(written(table, tmp_path / "a.csv"), fps=10)
    is_read(gt.read(tmp_path / "a.csv", fps=10, columns="id=id"))


def test_what_may_be_an_identity_is_not_ignored_in_silence(tmp_path):
    path = written(rows({"frame": "frame", "track_id": "device", "x": "x", "y": "y"}), tmp_path / "a.csv")
    notes = gt.read(path, fps=10).summary.notes
    assert any("'device' may be an identity" in note and "--columns id=device" in note for note in notes)


def test_pixels_are_never_taken_for_metres():
    options, notes = with_synonyms(["frame", "track_id", "u", "v", "pos_x", "pos_y"], ReadOptions())
    assert options.columns is None and not notes
