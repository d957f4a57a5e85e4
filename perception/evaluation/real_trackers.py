"""The Sigma-Pi tracker on people of real recordings, begun with their first labelled box."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.evaluation.reproduce.experiment import Cell, Progress, Table
from perception.reproduce.side_by_side import run_all
from perception.reproduce.sigma_pi_runs import PersonJob, Recording, Tally, recordings, run_job
from perception.reproduce.yan_sigma_pi import method_table, success

_FEWEST_OF_PERSON = 50
"""Frames in a row in which somebody is labelled, to be counted."""


def people_of(folder: Path) -> list[Recording]:
    """Everybody in the recordings of a CAVIAR folder, ``frames/NAME/NUMBER.jpg`` and ``xml/NAME.xml``.

    Raises
    ------
    InputError
        If nobody is labelled in fifty frames in a row that are there.
    """
    names = sorted(path.name for path in (folder / "frames").glob("*") if path.is_dir())
    found = recordings(folder, names, _FEWEST_OF_PERSON)
    if not found:
        expected = (
            f"frames/NAME/NUMBER.jpg, and xml/NAME.xml with people in {_FEWEST_OF_PERSON} of them in a row"
        )
        raise InputError("no recordings of labelled people", expected, path=folder)
    return found


def sigma_pi_table(people: list[Recording], seeds: int, seed: int, progress: Progress) -> list[Table]:
    """Success of each method on each person, and over all, from ``seeds`` seeds each."""
    jobs = [PersonJob(person, (seed, k), None) for person in people for k in range(seeds)]
    runs: dict[str, list[dict[str, Tally]]] = {}
    for job, found in zip(jobs, run_all(run_job, jobs, progress), strict=True):
        runs.setdefault(job.name, []).append(found)
    rows: list[dict[str, Cell]] = []
    for method in next(iter(runs.values()))[0]:
        means = [success(found, method) for found in runs.values()]
        rows.append(
            {
                "method": method,
                "people": len(means),
                "seeds": seeds,
                "mean success (%)": float(np.mean([one.mean() for one in means])),
                "least of a person": float(min(one.mean() for one in means)),
                "least of a seed": float(min(one.min() for one in means)),
            }
        )
    title = "Sigma-Pi on real people, from the first labelled box: found, and the centre in the labelled box"
    return [method_table(runs, title), Table.of("Sigma-Pi on real people: everybody", rows)]
