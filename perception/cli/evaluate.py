"""`perception evaluate`: the papers' tables, on rendered people; and trackers on recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, print_table, progress_bar, save_figure, write_json
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.experiments.harness import Table

_TABLES = ("pose", "localisation", "recognition", "joint", "published", "keypoints")
_REAL = ("heads", "lobby", "street", "people")
"""Tables of recordings, which are made where they are asked for."""

Show = Callable[[str, Sequence[Mapping[str, Any]]], None]
"""Takes the title and the rows of a table."""


def evaluate(
    tables: Annotated[list[str] | None, typer.Argument(metavar="[TABLE]...")] = None,
    count: Annotated[int, typer.Option(min=50)] = 600,
    train: Annotated[int, typer.Option(min=100)] = 400,
    clips: Annotated[int, typer.Option(min=1)] = 2,
    head_pose: str = "deep_belief",
    plot: Path | None = None,
    data: Annotated[Path | None, typer.Option(envvar="GRAPHTRACK_DATA")] = None,
    heads: Annotated[int, typer.Option(min=1)] = 6,
    json_path: options.Json = None,
    seed: options.Seed = 1000,
) -> None:
    """Judge the package's models on rendered people whom they were not trained on, as the papers do.

    Parameters
    ----------
    tables : pose (errors and calibration of all classifiers; Baxter et al. 2014, Fig. 3), localisation (Chen
        et al. 2011, Table 1), recognition (Ba & Odobez 2003, Tables 1-3), joint (Chen et al. 2011, Table 2),
        published (Chen et al.'s perception as printed beside ours), keypoints (body and head by keypoints);
        these by default. Of recordings in --data: heads (Ba & Odobez's trackers on Town Centre's heads),
        lobby (adapted to CAVIAR's lobby), street (adapted to Town Centre, by every method), people (found in
        Town Centre: how often detections are right).
    count : Rendered images to judge on.
    train : Rendered images to train on: localisation, published.
    clips : Rendered clips of the table joint.
    head_pose : Classifier of the table joint.
    plot : Picture of reliability and confusion to write (.png).
    data : Folder with caviar and towncentre in it, for tables of recordings; else ../shared/data.
    heads : Heads of the table heads.
    """
    from graphtrack.cli.reproduce import BESIDE
    from graphtrack.experiments.harness import Table

    for name in tables or ():
        if name not in (*_TABLES, *_REAL):
            raise InputError(f"table {name!r}", f"one of {', '.join((*_TABLES, *_REAL))}")
    options.check_outputs({"--plot": plot, "--json": json_path})
    wanted = tables or _TABLES
    if plot is not None and "pose" not in wanted:
        raise InputError("--plot without the table pose", "pose among the tables")
    shown: list[Table] = []

    def show(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
        print_table(title, rows)
        shown.append(Table.of(title, rows))

    makers: dict[str, Callable[[np.random.Generator], None]] = {
        "pose": lambda rng: _pose(count, rng, plot, show),
        "localisation": lambda rng: _localisation(count, train, rng, show),
        "recognition": lambda rng: _recognition(rng, show),
        "joint": lambda rng: _joint(clips, head_pose, rng, show),
        "published": lambda rng: _published_forms(count, train, rng, show),
        "keypoints": lambda rng: _keypoints(count, rng, show),
    }
    recordings = data if data is not None else BESIDE
    for name in (*_TABLES, *_REAL):
        if name not in wanted:
            continue
        if name in makers:
            makers[name](np.random.default_rng(seed))  # a table is the same alone and among others
        else:
            table = _of_recordings(name, recordings, heads, seed)
            show(table.title, table.records())
    write_json(json_path, [table.to_dict() for table in shown])


def _pose(count: int, rng: np.random.Generator, plot: Path | None, show: Show) -> None:
    from perception.evaluation.classifiers import class_rates
    from perception.models import HEAD_POSE, load_classifier
    from perception.pose.classifier import PoseScores
    from perception.pose.classifier import evaluate as judge
    from perception.synthetic import make_heads, make_pedestrians
    from perception.training import FAR, FOUND_AS_WALKING

    exact, found = make_heads(count, rng), make_heads(count, rng, FOUND_AS_WALKING)
    near, far = make_pedestrians(count, rng), make_pedestrians(count, rng, FAR)
    sets: list[tuple[str, str, Any, Any]] = []
    for name in HEAD_POSE:
        sets += [(name, "heads of 16-32 pixels", exact.images, exact.pan)]
        sets += [(name, "heads as they are found", found.images, found.pan)]
    sets += [("body_pose", "people of 70-140 pixels", near.images, near.body)]
    sets += [("body_pose", "people of 24-80 pixels", far.images, far.body)]
    rows: list[dict[str, Any]] = []
    scores: dict[str, PoseScores] = {}
    degrees: dict[str, np.ndarray] = {}
    for name, what, images, angle in sets:
        model = load_classifier(name)
        result = judge(model, images, angle)
        scores.setdefault(name, result)
        degrees.setdefault(name, np.rad2deg(model.classes.pan))
        rows.append({"classifier": name, "images": what, **result.figures()})
    show(f"Errors and calibration on {count} rendered images each", rows)
    network = scores["deep_belief"]
    hits, false_alarms = class_rates(network.confusion)
    show(
        "deep_belief, heads of 16-32 pixels: confusion in percent and rates (Baxter et al. 2014, Fig. 3)",
        [
            {
                "true_deg": f"{degree:.0f}",
                **{
                    f"{column:.0f}": round(100 * value / max(row.sum(), 1))
                    for column, value in zip(degrees["deep_belief"], row, strict=True)
                },
                "TPR": float(hit),
                "FPR": float(false_alarm),
            }
            for degree, row, hit, false_alarm in zip(
                degrees["deep_belief"], network.confusion, hits, false_alarms, strict=True
            )
        ],
    )
    if plot is not None:
        from perception.evaluation.classifiers import reliability_figure

        save_figure(reliability_figure(scores, degrees), plot, dpi=110)


def _localisation(count: int, train: int, rng: np.random.Generator, show: Show) -> None:
    from perception.models import load_head_localiser
    from perception.pose.boosting import Weak
    from perception.pose.head_detection import HeadLocaliser
    from perception.synthetic import make_pedestrians
    from perception.training import localisation_figures

    people, judged = make_pedestrians(train, rng), make_pedestrians(count, rng)
    models = {"the package's (differential)": load_head_localiser()}
    kinds: tuple[Weak, ...] = ("differential", "fisher")
    for weak in kinds:
        model = HeadLocaliser(weak)
        models[f"{weak}, trained on {train}"] = model.fit(people.images, people.head_box)
    rows = [{"head localiser": name, **localisation_figures(m, judged)} for name, m in models.items()]
    columns = ("head localiser", "overlap_of_first", "best_overlap_of_all", "candidates")
    for printed in (
        ("differential, paper (real pictures)", 0.60, 0.64, 2.3),
        ("Fisher, paper (real pictures)", 0.58, 0.65, 3.0),
    ):
        rows.append(dict(zip(columns, printed, strict=True)))
    show(f"Head localisation on {count} rendered people (Chen et al. 2011, Table 1)", rows)


def _published_forms(count: int, train: int, rng: np.random.Generator, show: Show) -> None:
    from perception.evaluation.classifiers import published_beside_ours

    for name, rows in published_beside_ours(train, count, rng).items():
        title = f"{name}: ours and Chen et al.'s as printed, both trained on {train} rendered images"
        show(title, rows)


def _keypoints(count: int, rng: np.random.Generator, show: Show) -> None:
    from perception.evaluation.classifiers import keypoint_table
    from perception.models import load_keypoint_pose

    title = f"Body and head by keypoints, {count} rendered people of each size"
    show(title, keypoint_table(load_keypoint_pose(), count, rng))


def _recognition(rng: np.random.Generator, show: Show) -> None:
    from perception.evaluation.classifiers import recognition_table

    for title, people, exemplars, repetitions in (
        ("34 people train, 34 test (Ba & Odobez 2003, Table 1)", 68, (1, 2), 1),
        ("70 people train, 70 test, 5 splits (Ba & Odobez 2003, Table 3)", 140, (1, 2, 3, 4), 5),
    ):
        rows, confusion = recognition_table(people, exemplars, rng, repetitions=repetitions)
        show(
            f"Recognition of 9 pans: {title}",
            [
                {
                    "exemplars": row.exemplars,
                    "density": row.density,
                    "rate_percent": 100.0 * row.rate,
                    "deviation": 100.0 * row.deviation,
                }
                for row in rows
            ],
        )
        if repetitions == 1:
            pans = [f"{degree:g}" for degree in np.arange(-90.0, 91.0, 22.5)]
            show(
                "Confusion in percent, 2 exemplars, saturated (Ba & Odobez 2003, Table 2)",
                [
                    {"true_deg": pan, **dict(zip(pans, row.tolist(), strict=True))}
                    for pan, row in zip(pans, confusion, strict=True)
                ],
            )


def _joint(count: int, head_pose: str, rng: np.random.Generator, show: Show) -> None:
    from graphtrack.experiments.chen_joint import PAPER
    from perception.evaluation.joint_effect import joint_effect
    from perception.models import load_classifier, load_head_localiser
    from perception.observe.pipeline import Models
    from perception.synthetic.clips import walking_clip

    models = Models(load_head_localiser(), load_classifier("body_pose"), load_classifier(head_pose))
    rows = joint_effect((walking_clip(rng) for _ in range(count)), models)
    for name, values in PAPER.items():
        of_paper = dict(zip(("body_deg", "head_deg"), values, strict=True))
        blank = dict.fromkeys(rows[0], "")
        rows.append({**blank, "estimate": f"paper, {name}", "group": "online", **of_paper})
    show(f"Mean errors on {count} rendered clips, heads by {head_pose} (Chen et al. 2011, Table 2)", rows)
    emit("  the paper's separate filtering is joint-body (κ₂ = 0); ±: standard error")


def _of_recordings(name: str, data: Path, heads: int, seed: int) -> Table:
    """Return a table that is made of recordings, and show a progress bar."""
    town = data / "towncentre"
    if name == "heads":
        from perception.experiments.head_trackers import heads_table

        with progress_bar(heads, "heads") as advance:
            return heads_table(town, heads, seed, advance)
    if name == "lobby":
        from perception.evaluation.adapted_cameras import adapted_table, sequences_of

        sequences = sequences_of(data / "caviar")
        with progress_bar(len(sequences), "sequences") as advance:
            return adapted_table(sequences, seed, advance)
    if name == "street":
        from perception.evaluation.adapted_cameras import METHODS, PARTS, methods_table

        with progress_bar(PARTS + len(METHODS), "steps") as advance:
            return methods_table(town, seed, advance)
    from perception.evaluation.found_people import reliability_table
    from perception.images.frames import FrameSource

    count = len(FrameSource.open(town / "frames_001_150" / "img1").numbers())
    with progress_bar(count, "frames") as advance:
        return reliability_table(town, seed, advance)
