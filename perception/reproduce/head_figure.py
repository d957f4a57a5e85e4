"""The page of figures of ba-mixed-state: Ba & Odobez's Figs. 3 and 4, and Table 2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.report.style import new_figure, tidy
from perception.evaluation.measures import draw_confusion
from perception.images.pixels import Image
from perception.reproduce.head_runs import (
    AS_PRINTED,
    JOINT,
    OUR_EXEMPLARS,
    REMEMBERED,
    SEQUENTIAL,
    Run,
)
from perception.reproduce.still_heads import CONFUSION, PANS
from perception.synthetic.head_clips import HeadClip

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

ClipRuns = tuple[HeadClip, Mapping[str, Run]]

COLOURS = {
    **{SEQUENTIAL: "#D55E00", REMEMBERED: "#E69F00", AS_PRINTED: "#66C7A3", JOINT: "#0072B2"},
    OUR_EXEMPLARS: "#CC79A7",
}
_WIDTHS = {AS_PRINTED: 3.2}
"""Of lines: that of the paper's own stays seen under the other, which often lies on it."""
_TRUTH = "#222222"
_SAMPLES = 4
_MARGIN = 2.2
"""Half of a cut-out's side, in heights of the head."""


@dataclass(frozen=True, eq=False)
class Failure:
    """A frame in which a box is badly placed and the pan wrong."""

    clip: HeadClip
    runs: Mapping[str, Run]
    frame: int


def failures(done: Sequence[ClipRuns], method: str = SEQUENTIAL, count: int = _SAMPLES) -> list[Failure]:
    """The worst frame of each of the worst sequences, by e(t) times the error of the pan.

    Boxes that lost the head altogether are passed over: of those a picture shows nothing.
    """
    found: list[tuple[float, Failure]] = []
    for clip, runs in done:
        run = runs[method]
        badness = np.where(run.error < 1.0, run.error * run.pan_error, 0.0)
        frame = int(badness.argmax())
        found.append((float(badness[frame]), Failure(clip, runs, frame)))
    return [failure for _, failure in sorted(found, key=lambda item: -item[0])[:count]]


def page(shown: ClipRuns, failed: Sequence[Failure], confusion: FloatArray) -> Figure:
    """Fig. 3 of one sequence, Fig. 4 of some frames, and Table 2.

    Parameters
    ----------
    confusion : (9, 9) per cent, in the order of `PANS`
    """
    figure = new_figure(11.0, 15.0)
    parts = figure.subfigures(3, 1, height_ratios=[6.2, 5.6, 4.6], squeeze=False)
    curves, pictures, tables = parts[:, 0]
    _curves(curves, *shown)
    _pictures(pictures, failed)
    axes = tables.subplots(1, 2)
    names = [f"{pan:g}" for pan in PANS]
    draw_confusion(axes[0], CONFUSION, names, "Table 2: paper")
    draw_confusion(axes[1], confusion, names, "Table 2: ours")
    return figure


def _curves(figure: SubFigure, clip: HeadClip, runs: Mapping[str, Run]) -> None:
    top, bottom = figure.subplots(2, 1, sharex=True)
    time = np.arange(len(clip)) / clip.fps
    for name, colour in COLOURS.items():
        if name in runs:
            width = _WIDTHS.get(name, 1.3)
            top.plot(time, runs[name].error, color=colour, label=name, linewidth=width)
            bottom.plot(time, np.degrees(runs[name].pan), color=colour, label=name, linewidth=width)
    bottom.plot(time, np.degrees(clip.pan), color=_TRUTH, linestyle="--", label="truth", linewidth=1.1)
    top.set(ylabel="e(t)", ylim=(-0.02, 1.02))
    top.set_title("The sequence of the median error, as Ba & Odobez 2003, Fig. 3", loc="left", fontsize=10)
    bottom.set(ylabel="pan (°)", yticks=range(-90, 91, 45), xlabel="time (s)")
    bottom.legend(frameon=False, fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.18))
    for axes in (top, bottom):
        tidy(axes)


def _pictures(figure: SubFigure, failed: Sequence[Failure]) -> None:
    """A column for each frame: above the colour tracker's box and pan, below the mixed-state tracker's."""
    grid = figure.subplots(2, max(len(failed), 1), squeeze=False)
    for column, failure in zip(grid.T, failed, strict=False):
        for axes, method in zip(column, (SEQUENTIAL, JOINT), strict=True):
            _picture(axes, failure, method)
    for row, method in zip(grid, (SEQUENTIAL, JOINT), strict=True):
        row[0].set_ylabel(method, fontsize=9)
    figure.suptitle(
        "As Ba & Odobez 2003, Fig. 4: the pan fails where the box does. White: the head's box; "
        "arrows: pan, down is to the "
        "camera (dashed: truth)",
        x=0.02,
        ha="left",
        fontsize=9,
    )


def _picture(axes: Axes, failure: Failure, method: str) -> None:
    k, run = failure.frame, failure.runs[method]
    image, corner, scale = _cut_out(failure.clip.images[k], failure.clip.boxes[k])
    axes.imshow(image)
    colour = COLOURS[method]
    lengths = 0.8 * float(failure.clip.boxes[k, 3]) * scale
    for box, pan, shade, style in (
        (failure.clip.boxes[k], failure.clip.pan[k], "#FFFFFF", "--"),
        (run.boxes[k], run.pan[k], colour, "-"),
    ):
        left, top = (box[:2] - corner) * scale
        width, height = box[2:] * scale
        x, y = [left, left + width, left + width, left, left], [top, top, top + height, top + height, top]
        axes.plot(x, y, style, color=shade, lw=1.6)
        middle = np.array([left + width / 2.0, top + height / 2.0])
        tip = middle + lengths * np.array([np.sin(pan), np.cos(pan)])
        arrow = {"arrowstyle": "->", "color": shade, "lw": 1.8, "linestyle": style}
        axes.annotate("", tuple(tip), tuple(middle), arrowprops=arrow, annotation_clip=False)
    axes.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0), xticks=[], yticks=[])
    said = f"e(t) {run.error[k]:.2f}, pan {np.degrees(run.pan_error[k]):.0f}° off"
    axes.set_title(said, fontsize=8)


def _cut_out(image: Image, box: FloatArray) -> tuple[Image, FloatArray, float]:
    """The surroundings (red green blue) of a box, its corner in the image and how much it is enlarged."""
    centre, half = box[:2] + box[2:] / 2.0, _MARGIN * box[3]
    low = np.maximum(np.floor(centre - half), 0).astype(int)
    high = np.minimum(np.ceil(centre + half).astype(int), [image.shape[1], image.shape[0]])
    part = cv2.cvtColor(image[low[1] : high[1], low[0] : high[0]], cv2.COLOR_BGR2RGB)
    scale = 300.0 / max(part.shape[:2])
    resized = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.asarray(resized, np.uint8), low.astype(float), scale
