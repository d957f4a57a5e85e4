"""Estimates drawn on the frames, separately and jointly, and seen from above (Chen et al. 2011, Fig. 6, 7
and 9)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from graphtrack.geometry.angles import FloatArray, class_centres, difference, unit
from graphtrack.model import Model
from graphtrack.tracks import Track
from perception.evaluation.joint_effect import METHODS, ObservedPerson
from perception.images.drawing.cues import Cues, draw_cues
from perception.images.pixels import Image
from perception.synthetic.clips import Clip

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

ROWS = (
    *(("particle", "joint-body"), ("particle", "joint")),
    *(("graph, chain", "joint"), ("graph, isam2", "joint")),
)
"""Method and preset of the sheet's rows: Chen et al.'s separate and joint filtering, and the graph online."""

_SPEED, _HEAD = "#666666", "#111111"
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


@dataclass(frozen=True, eq=False)
class Sheet:
    """What is drawn.

    Attributes
    ----------
    clip : its frames
    people : all who are judged in it
    columns : frames that are shown
    """

    clip: Clip
    people: list[ObservedPerson]
    columns: int = 6

    @property
    def shown(self) -> ObservedPerson:
        """Who is drawn on the frames: the first of those who are seen longest."""
        return max(self.people, key=lambda person: len(person.causal))

    @property
    def rows(self) -> list[int]:
        """Rows of the shown person's track, evenly spread over it, without the first."""
        n = len(self.shown.causal)
        first = min(3, n - 1)
        count = min(self.columns, n - first)
        return np.linspace(first, n - 1, count).round().astype(int).tolist()


def draw_sheet(figure: SubFigure, sheet: Sheet) -> None:
    """A row of frames for each of `ROWS`, and one from above with the joint filter's estimates of all."""
    person, rows = sheet.shown, sheet.rows
    grid = figure.subplots(len(ROWS) + 1, len(rows), squeeze=False)
    for line, (method, preset) in enumerate(ROWS):
        estimate = METHODS[method].estimate(person, Model(preset), 0)
        for column, row in enumerate(rows):
            axes = grid[line, column]
            picture, caption = cell(sheet, person, estimate, row)
            axes.imshow(picture[:, :, ::-1])
            axes.set_xticks([])
            axes.set_yticks([])
            axes.set_xlabel(caption, fontsize=8)
            if line == 0:
                axes.set_title(f"t = {person.causal.t[row]:.1f} s", fontsize=9)
        grid[line, 0].set_ylabel(f"{method}, {preset}", fontsize=9)
    found = [METHODS["particle"].estimate(one, Model("joint"), 0) for one in sheet.people]
    for column, row in enumerate(rows):
        _from_above(grid[-1, column], found, float(person.causal.t[row]))
        grid[-1, column].set_xlabel("x (m)", fontsize=8)
    grid[-1, 0].set_ylabel("from above, y (m):\nparticle, joint", fontsize=9)
    figure.legend(
        handles=[
            Line2D([], [], color=_SPEED, linewidth=1.4, label="velocity"),
            *(
                Line2D([], [], color=colour, linewidth=2.2, label=f"body, person {k}")
                for k, colour in zip(range(1, len(found) + 1), cycle(_COLOURS), strict=False)
            ),
            Line2D([], [], color=_HEAD, linewidth=1.6, label="head"),
        ],
        loc="outside lower center",
        ncols=2 + len(found),
        frameon=False,
        fontsize=9,
    )


def cell(sheet: Sheet, person: ObservedPerson, estimate: Track, row: int) -> tuple[Image, str]:
    """The picture of a frame, and the errors of body and head in words."""
    observed, truth = person.causal, person.truth
    assert observed.body_likelihood is not None and observed.head_likelihood is not None
    assert estimate.body is not None and estimate.head is not None
    assert truth.true_body is not None and truth.true_head is not None
    frame = int(observed.frame[row])
    likely = [
        float(class_centres(found.shape[1])[found[row].argmax()])
        for found in (observed.body_likelihood, observed.head_likelihood)
    ]
    cues = Cues(
        np.array(person.boxes[row]),
        person.head_boxes[row],
        observed.position[row],
        np.array(likely),
        np.array([estimate.body[row], estimate.head[row]]),
        np.array([truth.true_body[row], truth.true_head[row]]),
    )
    assert cues.true is not None
    body, head = np.degrees(np.abs(difference(cues.estimated, cues.true)))
    picture = draw_cues(sheet.clip.images[frame], cues, person.camera)
    return picture, f"off by {body:.0f}° body, {head:.0f}° head"


def _from_above(axes: Axes, found: list[Track], t: float) -> None:
    """As Chen et al. 2011, Fig. 7: two circles and three arrows each, from outer to inner speed, body and
    head."""
    every = np.concatenate([track.position for track in found])
    (left, low), (right, high) = every.min(axis=0) - 2.0, every.max(axis=0) + 2.0
    half = max(right - left, high - low) / 2.0
    size = 0.26 * half
    for k, track in enumerate(found):
        near = int(np.abs(track.t - t).argmin())
        if abs(track.t[near] - t) > 1e-6:
            continue
        assert track.velocity is not None and track.body is not None and track.head is not None
        centre, colour = track.position[near], _COLOURS[k % len(_COLOURS)]
        for radius in (0.6 * size, size):
            circle = centre + radius * unit(np.linspace(-np.pi, np.pi, 49))
            axes.plot(*circle.T, color=colour, linewidth=0.8)
        body, head = unit(float(track.body[near])), unit(float(track.head[near]))
        speed = float(np.linalg.norm(track.velocity[near]))
        if speed > 0.0:
            along = track.velocity[near] / speed
            _arrow(axes, centre + size * along, 0.5 * size * speed * along, _SPEED, 1.4)
        _arrow(axes, centre, size * body, colour, 2.2)
        _arrow(axes, centre, 0.6 * size * head, _HEAD, 1.6)
    axes.set_xlim((left + right) / 2.0 - half, (left + right) / 2.0 + half)
    axes.set_ylim((low + high) / 2.0 - half, (low + high) / 2.0 + half)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)


def _arrow(axes: Axes, start: FloatArray, along: FloatArray, colour: str, width: float) -> None:
    axes.annotate(
        "",
        tuple(start + along),
        tuple(start),
        arrowprops={
            "arrowstyle": "-|>",
            "mutation_scale": 8,
            "color": colour,
            "lw": width,
            "shrinkA": 0,
            "shrinkB": 0,
        },
        annotation_clip=False,
    )
