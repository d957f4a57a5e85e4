"""Two identities are never confused: a double cannot distinguish all integers beyond 2⁵³ − 1."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from format_samples import sample_of

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError
from graphtrack.tracks.validation import LARGEST_ID

TOO_LARGE = [2**53, 2**53 + 1, -(2**53), -(2**53) - 1, 2**62, 2**63 + 2**53]


def rows(identity: int, n: int = 3) -> pd.DataFrame:
    k = np.arange(n)
    return pd.DataFrame({"track_id": identity, "frame": k, "t": k / 10, "x": 0.1 * k, "y": 0.0})


def csv(identity: int, folder: Path, n: int = 3) -> gt.TrackSet:
    text = rows(0, n).to_csv(index=False).replace("\n0,", f"\n{identity},")
    (folder / "a.csv").write_text(text)
    return io.read_identified(folder / "a.csv")


def parquet(identity: int, folder: Path) -> gt.TrackSet:
    rows(identity).to_parquet(folder / "a.parquet")
    return io.read_identified(folder / "a.parquet")


def table(identity: int, folder: Path) -> gt.TrackSet:
    return gt.TrackSet.from_table(rows(identity))


def other(format: str, before: str, after: str) -> Callable[[int, Path], gt.TrackSet]:
    """A sample of a format with the id of its first rows in place of 1."""

    def read(identity: int, folder: Path) -> gt.TrackSet:
        path = sample_of(format).write(folder)
        path.write_text(path.read_text().replace(before, after.format(identity), 1))
        return io.read_identified(path)

    return read


READERS = {
    "csv": csv,
    "long csv": partial(csv, n=10_000),  # pyarrow reads it
    "parquet": parquet,
    "table": table,
    "mot": other("mot", "1,1,", "1,{},"),
    "eth": other("eth", "1.0000000e+00 1.0000000e+00", "1.0000000e+00 {}"),
    "towncentre": other("towncentre", "0,1,", "0,{},"),
    "kitti": other("kitti", "0 1 Ped", "0 {} Ped"),
    "caviar": other("caviar", 'object id="0"', 'object id="{}"'),
}


@pytest.mark.parametrize("reader", READERS)
def test_the_largest_identity_is_itself_and_larger_ones_are_refused(reader: str, tmp_path: Path) -> None:
    assert LARGEST_ID in {track.track_id for track in READERS[reader](LARGEST_ID, tmp_path)}
    for identity in TOO_LARGE:
        with pytest.raises(InputError, match="id") as caught:
            READERS[reader](identity, tmp_path)
        assert caught.value.line is not None


def test_files_with_the_largest_identities_are_merged_into_one_that_can_be_read(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        pd.concat([rows(0), rows(LARGEST_ID)]).to_csv(tmp_path / name, index=False)
    merged = io.read_identified([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert len({track.track_id for track in merged}) == 4
    io.write(merged, tmp_path / "merged.csv")
    assert {track.track_id for track in io.read_identified(tmp_path / "merged.csv")} == {
        t.track_id for t in merged
    }
