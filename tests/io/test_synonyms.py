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


def test_units_in_names_count_and_native_columns_are_what_they_are(tmp_path):
    table = rows({"t": "t", "track_id": "id", "x": "x", "y": "y"})
    factors = {"id": ("id", 1), "t": ("time_ms", 1000), "x": ("pos_x_cm", 100), "y": ("pos_y_cm", 100)}
    units = [{name: of * row[key] for key, (name, of) in factors.items()} for row in table]
    is_read(gt.read(written(units, tmp_path / "a.csv")))
    native = rows({name: name for name in ("t", "track_id", "frame", "x", "y")})
    both = [row | {"id": 1, "time": 5.0, "pos_x": 0.0} for row in native]
    is_read(gt.read(written(both, tmp_path / "a.csv")))
    path = written(rows({"frame": "frame", "track_id": "device", "x": "x", "y": "y"}), tmp_path / "a.csv")
    assert any("'device' may be an identity" in note for note in gt.read(path, fps=10).summary.notes)


def test_two_names_of_one_column_are_an_error(tmp_path):
    table = [row | {"person": 1} for row in rows({"frame": "frame", "track_id": "id", "x": "x", "y": "y"})]
    with pytest.raises(InputError, match=r"'id' and 'person'.*--columns id=NAME"):
        gt.read(written(table, tmp_path / "a.csv"), fps=10)
    is_read(gt.read(tmp_path / "a.csv", fps=10, columns="id=id"))


def test_pixels_are_never_taken_for_metres():
    options, notes = with_synonyms(["frame", "track_id", "u", "v", "pos_x", "pos_y"], ReadOptions())
    assert options.columns is None and not notes
