"""Damaged files: a reader gives tracks or a `GraphtrackError`, never anything else, and soon."""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from format_samples import SAMPLES, Sample, name_of, sample_of
from mutations import mutate

from graphtrack import io
from graphtrack.errors import GraphtrackError, InputWarning
from graphtrack.tracks.track import Track, TrackSet

MUTANTS, MUTANTS_MORE = 50, 1500
MUTANTS_BESIDE = 60
SLOWEST_READ = 5.0
"""Seconds; a sample reads in milliseconds, so that this is a hang and not a slow machine."""


def assert_as_checked(track: Track) -> None:
    """Assert that a reader's arrays pass the checks of a user's own."""
    checked = Track(**vars(track))
    for name, value in vars(track).items():
        if isinstance(value, np.ndarray):
            assert value.dtype == getattr(checked, name).dtype and not value.flags.writeable
            np.testing.assert_array_equal(value, getattr(checked, name))


def outcome(path: Path, options: dict[str, object], seed: int) -> str:
    """ "read", or the message of the error; other exceptions pass, with the seed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", InputWarning)
        start = time.perf_counter()
        try:
            tracks = io.read_identified(path, **options)
        except GraphtrackError as error:
            result = str(error)
        except Exception as error:
            error.add_note(f"seed {seed}")
            raise
        else:
            assert isinstance(tracks, TrackSet) and tracks.summary.rows_used == tracks.n_frames
            for track in tracks:
                assert_as_checked(track)
            result = "read"
    assert time.perf_counter() - start < SLOWEST_READ
    return result


def refusals(sample: Sample, named: bool, seeds: range, tmp_path: Path) -> set[str]:
    """Messages of the errors of damaged copies, or "read"."""
    path = sample.write(tmp_path)
    whole = path.read_bytes()
    options = dict(sample.options)
    if named:
        options["format"] = sample.format
    refused = set()
    for seed in seeds:
        path.write_bytes(mutate(whole, np.random.default_rng([seed, named])))
        refused.add(outcome(path, options, seed))
    return refused


EVERY_SAMPLE = pytest.mark.parametrize("sample", SAMPLES, ids=name_of)
NAMED = pytest.mark.parametrize("named", [False, True], ids=["recognised", "format given"])


@pytest.mark.parametrize(
    "seeds", [range(MUTANTS), pytest.param(range(MUTANTS, MUTANTS_MORE), marks=pytest.mark.slow)], ids=len
)
@NAMED
@EVERY_SAMPLE
def test_damaged_copies_are_read_or_refused(
    sample: Sample, named: bool, seeds: range, tmp_path: Path
) -> None:
    # The damage must have been felt, in more than one way.
    assert len(refusals(sample, named, seeds, tmp_path)) > 5


CAMERAS = {
    "homography": b"0.01 0 0\n0 -0.01 0\n0 0.0001 1\n",
    "point_pairs": b"# u v X Y\n0 0 0 0\n100 0 1 0\n100 100 1 -1\n0 100 0 -1.1\n50 50 0.5 -0.5\n",
}
BESIDE = [(sample, name) for sample in SAMPLES for name in sample.beside]
BESIDE += [(sample_of("mot"), name) for name in CAMERAS]


@pytest.mark.parametrize(("sample", "name"), BESIDE, ids=[name for _, name in BESIDE])
def test_damaged_companions_and_cameras_are_read_or_refused(
    sample: Sample, name: str, tmp_path: Path
) -> None:
    path, options = sample.write(tmp_path), dict(sample.options)
    if name in CAMERAS:
        options[name] = tmp_path / name
    whole = CAMERAS.get(name) or (tmp_path / name).read_bytes()
    for seed in range(MUTANTS_BESIDE):
        (tmp_path / name).write_bytes(mutate(whole, np.random.default_rng(seed)))
        outcome(path, options, seed)
