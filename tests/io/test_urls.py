"""Files by their URLs."""

from __future__ import annotations

from pathlib import Path

import command
import numpy as np
import pandas as pd
import pytest
from refusals import refused

from graphtrack import io


def walks() -> pd.DataFrame:
    parts = [
        pd.DataFrame({"who": who, "seconds": np.arange(4), "east": k + np.arange(4.0), "north": 0.5})
        for k, who in enumerate(("anna", "bob", "eve"))
    ]
    return pd.concat(parts, ignore_index=True)


@pytest.mark.parametrize("name", ["walks.parquet", "walks.csv"])
def test_a_file_by_its_url(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec = pytest.importorskip("fsspec")
    monkeypatch.chdir(tmp_path)
    url = f"memory://bucket/{name}"
    with fsspec.open(url, "wb") as stream:
        walks().to_csv(stream, index=False) if name.endswith("csv") else walks().to_parquet(stream)
    columns = "id=who,t=seconds,x=east,y=north"
    tracks = io.read_identified(url, columns=columns)
    assert [track.label for track in tracks] == ["anna", "bob", "eve"]
    assert "each file once" in str(refused([url, url], columns=columns))
    done = command.run("info", url, "--columns", columns, program="graphtrack")
    assert done.returncode == 0 and url in done.stderr and "anna" in done.stdout
    walks().to_csv("walks.csv", index=False)
    assert len(io.read_identified(f"file://{tmp_path}/walks.csv", columns=columns)) == 3
    for wrong in ("memory://bucket/none.csv", "nosuch://bucket/walks.csv", f"file://{tmp_path}/none.csv"):
        assert wrong in str(refused(wrong))
        done = command.run("info", wrong, program="graphtrack")
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
