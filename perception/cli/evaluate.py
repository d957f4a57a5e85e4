"""`perception evaluate`: the papers' tables on rendered people, and trackers on recordings."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import print_table, progress_bar, save_figure, write_json
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.experiments.harness import Table

_TABLES = ("pose", "localisation", "published", "keypoints")
_REAL = ("heads", "hidden", "lobby", "street", "people", "follow")
"""Tables of recordings, made on request."""


def evaluate(
    tables: Annotated[list[str] | None, typer.Argument(metavar="[TABLE]...")] = None,
    count: Annotated[int, typer.Option(min=50)] = 600,
    train: Annotated[int, typer.Option(min=100)] = 400,
    plot: Path | None = None,
    data: Annotated[Path | None, typer.Option(envvar="GRAPHTRACK_DATA")] = None,
    heads: Annotated[int, typer.Option(min=1)] = 6,
    json_path: options.Json = None,
    seed: options.Seed = 1000,
) -> None:
    """Evaluate the package's models on held-out rendered people, as in the papers.

    Parameters
    ----------
    tables : pose (errors and calibration of all classifiers), localisation (Chen et al. 2011, Table 1),
        published (Chen et al.'s perception as published, and ours), keypoints (body and head from
        keypoints); all of these by default. On recordings in --data: heads (Ba & Odobez's trackers on Town
        Centre's heads), lobby (adapted to CAVIAR's lobby), street (adapted to Town Centre, by every method),
        people (precision of detections in Town Centre), hidden (classes of people who are partly hidden),
        follow (reliability of the confidence of perception follow, on rendered sequences too).
    count : Rendered images to evaluate on.
    train : Rendered images to train on: localisation, published.
    plot : Picture of reliability and confusion to write (.png).
    data : Folder with caviar and towncentre in it, for tables of recordings; else ../shared/data.
    heads : Heads of the table heads.
    """
    from graphtrack.cli.reproduce import DATA_FOLDER

    for name in tables or ():
        if name not in (*_TABLES, *_REAL):
            raise InputError(f"table {name!r}", f"one of {', '.join((*_TABLES, *_REAL))}")
    options.check_outputs({"--plot": plot, "--json": json_path})
    wanted = tables or _TABLES
    if plot is not None and "pose" not in wanted:
        raise InputError("--plot without the table pose", "pose among the tables")
    shown: list[Table] = []
    for name in (*_TABLES, *_REAL):
        if name not in wanted:
            continue
        if name in _TABLES:
            found = _rendered(name, count, train, plot, np.random.default_rng(seed))
        else:
            found = _recorded(name, data if data is not None else DATA_FOLDER, heads, seed)
        for table in found:
            print_table(table.title, table.records())
            shown.append(table)
    write_json(json_path, [table.to_dict() for table in shown])


def _rendered(
    name: str, count: int, train: int, plot: Path | None, rng: np.random.Generator
) -> Iterable[Table]:
    """Compute the tables of a name on rendered people; they do not depend on the other tables."""
    from perception.evaluation import classifiers
    from perception.evaluation.localisation import localisation_tables
    from perception.models import load_keypoint_pose

    if name == "pose":
        table, figure = classifiers.pose_table(count, rng)
        if plot is not None:
            save_figure(figure, plot, dpi=110)
        return [table]
    if name == "localisation":
        return localisation_tables(count, train, rng)
    if name == "published":
        return classifiers.published_tables(train, count, rng)
    return [classifiers.keypoint_table(load_keypoint_pose(), count, rng)]


def _recorded(name: str, data: Path, heads: int, seed: int) -> Iterable[Table]:
    """Compute the tables of recordings, with a progress bar."""
    town = data / "towncentre"
    if name == "heads":
        from perception.experiments.head_trackers import heads_table

        with progress_bar(heads, "heads") as advance:
            return [heads_table(town, heads, seed, advance)]
    if name == "lobby":
        from perception.evaluation.adapted_cameras import adapted_table, sequences_of

        sequences = sequences_of(data / "caviar")
        with progress_bar(len(sequences), "sequences") as advance:
            return [adapted_table(sequences, seed, advance)]
    if name == "hidden":
        from perception.experiments.hidden_people import lobby, street, tables

        with progress_bar(None, "recordings") as advance:
            everybody = [street(town, seed, advance), lobby(data / "caviar", seed, advance)]
        return tables(everybody, np.random.default_rng(seed))
    if name == "street":
        from perception.evaluation.adapted_cameras import METHODS, PARTS, methods_table

        with progress_bar(PARTS + len(METHODS), "steps") as advance:
            return [methods_table(town, seed, advance)]
    if name == "follow":
        from perception.experiments.following import SEQUENCES, reliability_tables, sources

        with progress_bar(len(sources(1, data, SEQUENCES)), "sequences") as advance:
            return reliability_tables(data, SEQUENCES, advance)
    from perception.evaluation.found_people import reliability_table
    from perception.images.frames import FrameSource

    count = len(FrameSource.open(town / "frames_001_150" / "img1").numbers())
    with progress_bar(count, "frames") as advance:
        return [reliability_table(town, seed, advance)]
