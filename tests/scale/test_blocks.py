"""Detections larger than memory: blocks of time with an overlap, and people who keep their numbers."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import ran, run
from crossing_people import idf1, packed_square

import graphtrack as gt
from graphtrack.scale import AssociationOutcome, associate_dataset

Seen = tuple[Path, np.ndarray]

KNOWN = {"longest_gap": 1.0}
"""Overlaps of 3 s."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """30 s of a square in three files, in the order of time, and whose each detection is."""
    rng = np.random.default_rng(2)
    detections, whose = packed_square(rng, people=12, frames=150, noise=0.05, square_metres=100.0)
    x, y = detections.position.T
    table = pd.DataFrame({"frame": detections.frame, "t": detections.t, "x": x, "y": y})
    folder = tmp_path_factory.mktemp("square")
    for k, part in enumerate(np.array_split(np.arange(len(table)), 3)):
        table.iloc[part].to_parquet(folder / f"{k}.parquet", index=False)
    return folder, whose


@pytest.fixture(scope="module")
def in_blocks(seen: Seen, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, AssociationOutcome]:
    """The tracks of several blocks."""
    path = tmp_path_factory.mktemp("blocks") / "found.parquet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graphtrack.scale.dataset.BLOCK", 100)
        outcome = associate_dataset(seen[0], path, KNOWN, block_rows=250)
    assert outcome.blocks >= 5
    return path, outcome


def identities(written: Path, folder: Path) -> np.ndarray:
    """The number of each detection's person; −1: false."""
    rows = pd.concat(pd.read_parquet(path) for path in sorted(folder.iterdir()))
    found = pd.read_parquet(written)[["frame", "x", "y", "track_id"]]
    both = rows.merge(found, on=["frame", "x", "y"], how="left")
    assert len(both) == len(rows)
    return both.track_id.fillna(-1).to_numpy(np.int64)


@pytest.mark.slow
def test_one_block_is_what_the_recording_gives_in_memory_and_more_keep_peoples_numbers(
    seen: Seen, in_blocks: tuple[Path, AssociationOutcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, whose = seen
    monkeypatch.setattr("graphtrack.scale.dataset.BLOCK", 500)
    one, (many, blocks) = tmp_path / "one.parquet", in_blocks
    outcome = associate_dataset(folder, one, KNOWN)
    whole = pd.concat(pd.read_parquet(path) for path in sorted(folder.iterdir()))
    assert outcome.blocks == 1 and outcome.n_detections == len(whole)
    expected = gt.associate(whole, KNOWN).to_table()
    pd.testing.assert_frame_equal(pd.read_parquet(one), expected, check_like=True)
    found = identities(many, folder)
    assert idf1(found, whose) > idf1(identities(one, folder), whose) - 0.01 > 0.95
    pairs = pd.read_parquet(many)[["track_id", "frame"]]
    assert not pairs.duplicated().any()
    # The estimates of the smoother can follow.
    done = gt.scale.smooth_dataset(many, tmp_path / "smoothed.parquet", "position")
    assert done.n_smoothed == blocks.people


@pytest.mark.slow
def test_blocks_may_be_associated_anywhere(
    seen: Seen, in_blocks: tuple[Path, AssociationOutcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("graphtrack.scale.dataset.BLOCK", 100)
    there = tmp_path / "there.parquet"
    associate_dataset(seen[0], there, KNOWN, block_rows=250, cluster="local", jobs=2)
    assert in_blocks[0].read_bytes() == there.read_bytes()


def test_rows_that_are_not_in_the_order_of_time_are_one_error(seen: Seen, tmp_path: Path) -> None:
    folder, _ = seen
    table = pd.read_parquet(folder / "0.parquet").iloc[::-1]
    table.to_parquet(tmp_path / "back.parquet", index=False)
    with pytest.raises(gt.InputError, match="rows in the order of time"):
        associate_dataset(tmp_path / "back.parquet", tmp_path / "out.parquet")
    table.drop(columns="t").to_parquet(tmp_path / "timeless.parquet", index=False)
    with pytest.raises(gt.InputError, match="no column t"):
        associate_dataset(tmp_path / "timeless.parquet", tmp_path / "out.parquet")
    assert not (tmp_path / "out.parquet").exists()


@pytest.mark.slow
def test_the_command_associates_and_smooths_what_has_no_identities(
    seen: Seen, in_blocks: tuple[Path, AssociationOutcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("graphtrack.scale.dataset.BLOCK", 100)
    model, output = tmp_path / "model.toml", tmp_path / "smoothed.parquet"
    gt.Model("position", scene=KNOWN).save(model)
    options = ("-o", output, "--model", model, "--batch-frames", 250)
    done = ran("smooth", seen[0], *options, program="graphtrack")
    found, outcome = in_blocks
    detections, blocks = f"{outcome.n_detections} detections", f"{outcome.blocks} blocks"
    assert f"associated {detections} in {blocks}: {outcome.people} tracks" in done.stdout + done.stderr
    gt.scale.smooth_dataset(found, tmp_path / "expected.parquet", gt.Model("position"))
    assert output.read_bytes() == (tmp_path / "expected.parquet").read_bytes()
    # Nothing else is left behind.
    names = {"model.toml", "smoothed.parquet", "expected.parquet"}
    assert {path.name for path in tmp_path.iterdir()} == names


@pytest.mark.slow
def test_times_from_a_frame_rate(seen: Seen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = seen
    monkeypatch.setattr("graphtrack.scale.dataset.BLOCK", 100)
    whole = pd.concat(pd.read_parquet(path) for path in sorted(folder.iterdir()))
    whole.to_parquet(tmp_path / "timed.parquet", index=False)
    whole.drop(columns="t").to_parquet(tmp_path / "timeless.parquet", index=False)
    # Overlaps that are no multiple of a frame, whose rounding would count.
    options, scene = gt.ReadOptions(fps=5.0), {"longest_gap": 1.05}
    found, expected = tmp_path / "found.parquet", tmp_path / "expected.parquet"
    ours = associate_dataset(
        tmp_path / "timeless.parquet", found, scene, block_rows=250, read_options=options
    )
    theirs = associate_dataset(tmp_path / "timed.parquet", expected, scene, block_rows=250)
    assert ours == theirs and ours.n_detections == len(whole) and ours.blocks >= 5
    np.testing.assert_array_equal(pd.read_parquet(found).track_id, pd.read_parquet(expected).track_id)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--associate", "repair"], "--associate repair when streaming"),
        (["--associate", "never"], "no such column"),
        (["--select", "1"], "--select for rows without identities"),
    ],
)
def test_what_cannot_be_streamed_is_one_error(
    seen: Seen, tmp_path: Path, options: list[str], message: str
) -> None:
    folder, _ = seen
    done = run("smooth", folder, "-o", tmp_path / "out.parquet", *options, program="graphtrack")
    assert done.returncode == 2 and message in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_bad_cell_is_named_by_its_file_and_row(seen: Seen, tmp_path: Path) -> None:
    folder, _ = seen
    parts = [pd.read_parquet(path) for path in sorted(folder.iterdir())]
    parts[1].loc[parts[1].index[7], "frame"] = np.nan
    (tmp_path / "in").mkdir()
    for k, part in enumerate(parts):
        part.to_parquet(tmp_path / "in" / f"{k}.parquet", index=False)
    done = run("smooth", tmp_path / "in", "-o", tmp_path / "out.parquet", program="graphtrack")
    assert done.returncode == 2 and "1.parquet, line 8, column frame" in done.stderr
    assert not (tmp_path / "out.parquet").exists()
