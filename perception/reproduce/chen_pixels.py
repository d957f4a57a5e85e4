"""Chen et al. 2011, Table 2 from pixels, online beside online, with estimates drawn on the frames as in its
Fig. 6–9.

Then people of motion capture, whose poses are rendered and answered for by Chen et al.'s classifiers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.evaluation.reproduce import chen_classes
from graphtrack.evaluation.reproduce.chen_tables import Scores, beside, detail, draw_errors
from graphtrack.evaluation.reproduce.experiment import (
    Cell,
    Experiment,
    Progress,
    Reproduction,
    Settings,
    Table,
)
from graphtrack.evaluation.resampling import bootstrap, mean_difference
from perception.evaluation.joint_effect import LAG, METHODS, ObservedPerson, joint_scores, people_of
from perception.models import load_classifier, load_head_localiser
from perception.observe.pipeline import Models
from perception.reproduce.chen_sheet import Sheet, draw_sheet
from perception.reproduce.known_poses import captured_people, confusions, known_poses
from perception.synthetic.clips import Clip, walking_clip

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADS = ("deep_belief", "templates")
"""Head pose classifiers: ours, and Chen et al.'s with distances after a Fisher projection."""

BESIDE = "Paper / ours: mean error in degrees (Chen et al. 2011 on CHIL with its particle filter; "
"ours on rendered people)"

GROUPS = {name: method.group for name, method in METHODS.items()}


def _effort(settings: Settings) -> tuple[int, int, tuple[str, ...]]:
    """Clips, frames of each, and head pose classifiers."""
    return (1, 8, HEADS[:1]) if settings.quick else (10, 30, HEADS)


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment."""
    count, frames, heads = _effort(settings)
    clips: list[Clip] = []
    for k in range(count):
        clips.append(walking_clip(settings.rng(1, k), steps=frames))
        progress(1)
    found, first = [], None
    for name in heads:
        models = Models(load_head_localiser(), load_classifier("body_pose"), load_classifier(name))
        people: list[ObservedPerson] = []
        for clip in clips:
            people += people_of(clip, models)
            if first is None and people:
                first = Sheet(clip, list(people))
            progress(1)
        found.append(joint_scores(name, people))
        progress(1)
    assert first is not None
    body, head = load_classifier("body_pose"), load_classifier("templates")
    everyone = captured_people(settings)
    posed, answers = known_poses(everyone, body, head, settings.rng(22), progress)
    rng = settings.rng(99)
    notes = (
        "Rendered people who walk as the model joint has it, three a clip, boxes off as a detector's are, "
        "heads found by the localiser; each column has another classifier of heads, the bodies are the same.",
        "Mean absolute error per person, mean over people, of five or more with its 95 % bootstrap interval; "
        "of the particle filter the mean of 3 seeds. Every method has the package's parameters and the same "
        "observations, with heads chosen from the past alone, but for the last smoother, whose heads are "
        f"chosen along the whole track. Online estimates use the past alone; the graphs keep {LAG:g} s open.",
        "joint-body is what Chen et al. (2011) call separate (κ₂ = 0 in eq. 10); in separate the "
        "body does not follow the "
        "motion either. eq. 12–14: the closest class in the image, at each particle's own position.",
        "The frames show who of the first clip is seen longest, as Chen et al. 2011, Fig. 5: "
        "circles of 50 cm at feet "
        "(red: body) and head (yellow); thin lines: the likeliest class of the frame alone; arrows: "
        "estimates; green ticks: the truth. From above, as Fig. 7, enlarged circles: speed (grey, outside), "
        "body (colour), head (black).",
        "Known poses: motion capture at 10 frames a second, each frame another rendered person in that pose, "
        "answered for by body_pose (8 classes) and templates (12 pans × 3 tilts, summed out), in heads boxed "
        "as the localiser does; errors are independent from frame to frame.",
    )
    whole, effect, table_2 = detail(found, GROUPS, rng), _effect(found, rng), beside(found, GROUPS, BESIDE)
    of_posed = replace(
        detail(posed, chen_classes.GROUPS, settings.rng(98)),
        title="Known poses: body and head of motion capture from the answers of Chen et al.'s classifiers",
    )
    tables = (whole, effect, of_posed, *confusions(answers, head.classes), table_2)
    return Reproduction("chen-pixels", tables, _figure(found, first, rng), notes)


def _effect(found: Sequence[Scores], rng: np.random.Generator) -> Table:
    """Paired differences: joint less separate, and what causal heads cost."""
    records: list[dict[str, Cell]] = []
    for one in found:
        pairs = [(name, "joint − joint-body", ("joint", name), ("joint-body", name)) for name in METHODS]
        whole = "smoother, heads of the whole track"
        cost = "heads of the whole track − causal heads"
        pairs += [("smoother", f"{cost}, {p}", (p, whole), (p, "smoother")) for p in ("separate", "joint")]
        pairs += [
            (name, "full − joint", ("full", name), ("joint", name))
            for name, method in METHODS.items()
            if "full" in method.presets
        ]
        pairs.append(("per frame", cost, ("observation", "whole track"), ("observation", "")))
        for method, what, after, before in pairs:
            row: dict[str, Cell] = {"data": one.data, "method": method, "difference": what}
            for angle in ("body", "head"):
                interval = bootstrap(
                    mean_difference, one.errors[*after, angle], one.errors[*before, angle], rng=rng
                )
                span = f" ({interval.low:+.1f} … {interval.high:+.1f})" if np.isfinite(interval.low) else ""
                row[f"{angle} (°)"] = f"{interval.value:+.1f}{span}"
            records.append(row)
    return Table.of(
        "Paired differences with 95 % intervals over people; below 0 the first is better", records
    )


def _figure(found: Sequence[Scores], sheet: Sheet, rng: np.random.Generator) -> Figure:
    from graphtrack.report.style import new_figure

    figure = new_figure(13.0, 18.1)
    parts = np.asarray(figure.subfigures(2, 1, height_ratios=[5.0, 13.1]), dtype=object)
    top, bottom = parts[0], parts[1]
    grid = top.subplots(2, len(found), sharex=True, sharey="row", squeeze=False)
    draw_errors(grid, found, GROUPS, rng)
    top.legend(
        *grid[0, 0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=3,
        frameon=False,
        fontsize=8,
    )
    draw_sheet(bottom, sheet)
    return figure


def work(settings: Settings) -> int:
    """Clips that are rendered, clips that are looked at, estimates, and sources of known poses."""
    clips, _, heads = _effort(settings)
    return clips + len(heads) * (clips + 1) + len(captured_people(settings))


EXPERIMENT = Experiment(
    "chen-pixels",
    "Chen et al. 2011, Table 2 and Fig. 6–9, from pixels, online beside online",
    work,
    run,
    "1 clip of 8 frames with at most 3 people",
)
