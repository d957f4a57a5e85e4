"""Yan et al. 2011, Table 1: a person under a ceiling camera, tracked by three cues, and by motion alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from graphtrack.evaluation.metrics import bootstrap
from graphtrack.experiments.harness import Cell, Experiment, Panel, Parts, Settings, Table
from graphtrack.tracks.display import counted
from perception.experiments.sigma_pi_runs import (
    FIXED,
    GRAPH,
    MOTION,
    OURS,
    PRINTED,
    LabelledPerson,
    PersonJob,
    Tally,
    recordings,
    run_all,
    run_job,
)
from perception.synthetic.ceiling import ALL_KINDS, KINDS

PAPER: Mapping[str, tuple[int, int, int, float]] = dict(
    zip(
        KINDS,
        (
            (2012, 19, 22, 97.96),
            (2258, 169, 12, 91.98),
            (1190, 78, 21, 91.68),
            (980, 22, 130, 84.18),
            (1151, 89, 30, 89.66),
            (1564, 157, 141, 80.94),
        ),
        strict=True,
    )
)
"""Yan et al. 2011, Table 1: frames, missing, mismatch, success in per cent, for each kind."""
PAPER_MEAN, PAPER_MOTION = 90.28, 69.0
"""Yan et al. 2011: success on average, and by motion alone (per cent)."""
_TITLE = "Paper / ours: Table 1 in per cent; motion: success by motion alone; means over frames, over kinds"
REAL = ("wk1gt", "wk2gt")
ALL_PERSONS = "all persons"
_FEWEST = 100

Runs = Mapping[str, Sequence[Mapping[str, Tally]]]
"""Results by sequence, seed and method."""


def _effort(settings: Settings) -> tuple[int, int]:
    """Return the number of seeds, and of frames of a rendered sequence."""
    return (1, 120) if settings.quick else (10, 400)


def _people(settings: Settings) -> list[LabelledPerson]:
    if settings.data is None:
        return []
    return recordings(Path(settings.data) / "caviar", REAL, _FEWEST)


def _jobs(settings: Settings) -> tuple[list[PersonJob], list[PersonJob]]:
    """Return jobs for rendered and real sequences, each with every seed."""
    seeds, frames = _effort(settings)
    drawn = [
        PersonJob(kind, (settings.seed, i, k), frames)
        for i, kind in enumerate(ALL_KINDS)
        for k in range(seeds)
    ]
    most = 60 if settings.quick else None
    real = [PersonJob(person, (settings.seed, k), most) for person in _people(settings) for k in range(seeds)]
    return drawn, real


def _parts(settings: Settings) -> Parts:
    seeds, frames = _effort(settings)
    rooms, people = _jobs(settings)
    jobs = [*rooms, *people]
    settings.expect(len(jobs))
    drawn: dict[str, list[dict[str, Tally]]] = {}
    real: dict[str, list[dict[str, Tally]]] = {}
    for job, found in zip(jobs, run_all(run_job, jobs, settings.progress), strict=True):
        (drawn if isinstance(job.sequence, str) else real).setdefault(job.name, []).append(found)
    successes = [method_table(drawn, "Rendered sequences: success of each method")]
    differences = difference_table(drawn, settings.rng(1))
    yield successes[0]
    yield differences
    if real:
        successes.append(method_table(real, "Real frames (CAVIAR): success of each method"))
        yield successes[1]
    yield _published_table(drawn)
    for table in successes:
        ends = ("least", "greatest")
        yield Panel(table.title, table.records(), "sequence", "success (%)", "method", ends=ends)
    rows, apart = differences.records(), "difference (points)"
    yield Panel(differences.title, rows, "sequence", apart, "ours less", ("low", "high"))
    yield (
        "Success: the person is found and the estimated centre lies in the labelled box. Missing: the person "
        "is present and not found. Mismatch: found, but the centre is outside the box."
    )
    yield (
        f"Ours are {counted(seeds, 'rendered sequence')} of {frames} frames of each kind, with another room "
        "and other people for every seed; the tracker starts without a box."
    )
    yield (
        "Motion not adaptive: the reliability of the linear term of motion stays at 1, as Yan et "
        "al. (2011) have it (§2.2)."
    )
    yield (
        "As in the paper: `--as-in-the-paper`, eq. 4 at the last positions, the mean of all particles, 5 % "
        "anywhere in each step, colour and shape learned in every frame."
    )
    yield ("Cue-graph: the cues are factors of the graph, whose solution is the estimate; it draws nothing.")
    yield (
        "Yan et al. (2011) track a person or a mobile robot (§4) and has figures of the person "
        "only: the means are without the robot."
    )
    yield "Parameters were chosen on rendered sequences of other seeds, none on the real frames."
    yield (
        "Real frames: begun with the first labelled box of each person, all labelled frames count. Local "
        "features: without the view in that box."
        if real
        else "No recordings were found: rendered sequences only."
    )


def success(runs: Sequence[Mapping[str, Tally]], method: str) -> np.ndarray:
    """Return the success (seeds,) of a method in per cent."""
    return np.array([100.0 * found[method].success for found in runs])


def method_table(runs: Runs, title: str) -> Table:
    """Tabulate frames and success of each method in each sequence, over the seeds."""
    records: list[dict[str, Cell]] = []
    for name, found in runs.items():
        for method in found[0]:
            tallies = [one[method] for one in found]
            share = success(found, method)
            records.append(
                {
                    "sequence": name,
                    "method": method,
                    "seeds": len(found),
                    "frames": sum(tally.frames for tally in tallies),
                    "missing": sum(tally.missing for tally in tallies),
                    "mismatch": sum(tally.mismatch for tally in tallies),
                    "alarms in empty frames": sum(tally.alarms for tally in tallies),
                    "success (%)": float(share.mean()),
                    "std": float(share.std(ddof=1)) if len(share) > 1 else None,
                    "least": float(share.min()),
                    "greatest": float(share.max()),
                }
            )
    return Table.of(title, records)


def difference_table(runs: Runs, rng: np.random.Generator) -> Table:
    """Tabulate paired differences of success on the same sequences, with 95 % intervals.

    Rows are for each kind, and for all kinds with persons; the robot, for which Yan et al. (2011) have no
    figures, is excluded from the latter.
    """
    persons = [one for kind, found in runs.items() if kind in PAPER for one in found]
    records: list[dict[str, Cell]] = []
    for name, found in ((ALL_PERSONS, persons), *runs.items()):
        for method in (FIXED, PRINTED, MOTION, GRAPH):
            apart = success(found, OURS) - success(found, method)
            one = bootstrap(lambda values: values.mean(axis=-1), apart, rng=rng)
            records.append(
                {
                    "sequence": name,
                    "ours less": method,
                    "sequences": len(apart),
                    "difference (points)": one.value,
                    "low": one.low,
                    "high": one.high,
                    "ours better (sequences)": int((apart > 0.0).sum()),
                    "worse (sequences)": int((apart < 0.0).sum()),
                }
            )
    return Table.of("Paired differences of success on rendered sequences, 95 % intervals", records)


def _published_table(runs: Runs) -> Table:
    records: list[dict[str, Cell]] = []
    for kind, found in runs.items():
        printed = PAPER.get(kind)
        tallies = [one[OURS] for one in found]
        frames = sum(tally.frames for tally in tallies)
        records.append(
            {
                "kind": kind,
                "paper: frames": printed and printed[0],
                "paper: missing": printed and 100.0 * printed[1] / printed[0],
                "paper: mismatch": printed and 100.0 * printed[2] / printed[0],
                "paper: success": printed and printed[3],
                "ours: frames": frames,
                "ours: missing": 100.0 * sum(tally.missing for tally in tallies) / max(frames, 1),
                "ours: mismatch": 100.0 * sum(tally.mismatch for tally in tallies) / max(frames, 1),
                "ours: success": float(success(found, OURS).mean()),
                "ours: motion not adaptive": float(success(found, FIXED).mean()),
                "ours: as in the paper": float(success(found, PRINTED).mean()),
                "paper: motion": None,
                "ours: motion": float(success(found, MOTION).mean()),
            }
        )
    of_persons = [record for record in records if record["kind"] in PAPER]
    mean: dict[str, Cell] = {"kind": "mean of the persons"}
    for column in list(records[0])[1:]:
        cells = [record[column] for record in of_persons]
        values = [float(cell) for cell in cells if isinstance(cell, int | float)]
        mean[column] = float(np.mean(values)) if values else None
    total, unseen, astray = (sum(values[k] for values in PAPER.values()) for k in range(3))
    mean |= {
        "paper: frames": int(total),
        "paper: missing": 100.0 * unseen / total,
        "paper: mismatch": 100.0 * astray / total,
        "ours: frames": sum(one[OURS].frames for kind in PAPER for one in runs[kind]),
        "paper: success": PAPER_MEAN,
        "paper: motion": PAPER_MOTION,
    }
    return Table.of(_TITLE, [*records, mean])


EXPERIMENT = Experiment(
    "yan-sigma-pi",
    "Yan et al. 2011, Table 1: a person under a ceiling camera, by motion, colour and shape",
    "1 sequence of 120 frames of each kind",
    _parts,
    columns=1,
)
