"""Damaged companions and cameras: a reader gives tracks or a `GraphtrackError`, nothing else, and soon."""

import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from format_samples import SAMPLES, Sample, sample_of
from input_readers import as_checked
from mutations import mutate

from graphtrack import io
from graphtrack.errors import GraphtrackError, InputWarning

MUTANTS = 60
SLOWEST_READ = 5.0
"""Seconds; a sample reads in milliseconds, so that this is a hang and not a slow machine."""

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
    whole, refused = CAMERAS.get(name) or (tmp_path / name).read_bytes(), set()
    for seed in range(MUTANTS):
        (tmp_path / name).write_bytes(mutate(whole, np.random.default_rng(seed)))
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", InputWarning)
            try:
                as_checked(io.read_identified(path, **options))
            except GraphtrackError as error:
                refused.add(str(error))
        assert time.perf_counter() - start < SLOWEST_READ
    assert refused
