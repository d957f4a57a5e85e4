"""Body and head over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from graphtrack.report.pairing import Pair, has_angle, observed_angle, pair_track
from graphtrack.report.shapes import NORMAL_95, angle_bands, break_at_seam, finite_runs, open_holes
from graphtrack.report.style import ANGLE_COLOURS, NEUTRAL_COLOUR, TRUTH_COLOUR, new_figure, tidy
from graphtrack.tracks import Track


def plot_angles(estimate: Track, observation: Track | None = None) -> Figure:
    """Draw the body and head orientation of one person over time, in degrees.

    One panel for each angle that is estimated or observed: the estimate with its ±1σ and 95 % bands, the
    observations as dots and the truth where it is known. Lines and bands that leave at +180° come in at
    −180°. Times without an observation of the angle are shaded.

    Parameters
    ----------
    estimate : with ``body`` and ``head`` where they are known, and ``covariance`` for the bands
    observation : the track it was estimated from

    Returns
    -------
    matplotlib.figure.Figure
    """
    pair = pair_track(estimate, observation)
    names = [name for name in ANGLE_COLOURS if has_angle(pair, name)]
    figure = new_figure(9.4, 1.0 + 2.3 * max(len(names), 1))
    figure.suptitle(pair.name.replace("$", r"\$"), x=0.01, ha="left", fontsize=11)
    if not names:
        axes = figure.add_subplot()
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no angle was estimated or observed", ha="center", color=NEUTRAL_COLOUR)
        return figure
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        _draw_angle(axes, pair, name)
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=9)
    panels[-1].set_xlabel("time (s)")
    return figure


def _draw_angle(axes: Axes, pair: Pair, name: str) -> None:
    colour, estimate = ANGLE_COLOURS[name], pair.estimate
    angle, std = getattr(estimate, name), estimate.std(name)
    if pair.observation is not None:
        _draw_observed_angle(axes, pair.observation, name, colour)
    if angle is not None and std is not None:
        for scale, alpha, label in ((NORMAL_95, 0.16, "95 %"), (1.0, 0.26, "±1σ")):
            for i, band in enumerate(angle_bands(*open_holes(estimate.t, angle, scale * std))):
                axes.fill_between(
                    band.t,
                    np.degrees(band.lower),
                    np.degrees(band.upper),
                    color=colour,
                    alpha=alpha,
                    linewidth=0,
                    label=label if i == 0 else None,
                    zorder=1.5,
                )
    truth = pair.true_angle(name)
    if np.isfinite(truth).any():
        t, cut = break_at_seam(*open_holes(estimate.t, truth))
        axes.plot(t, np.degrees(cut), color=TRUTH_COLOUR, lw=1.0, dashes=(5, 2.5), label="truth", zorder=4)
    if angle is not None and np.isfinite(angle).any():
        t, cut = break_at_seam(*open_holes(estimate.t, angle))
        # A line needs two points: an angle known at a single frame between unknown ones would be invisible.
        alone = [run.start for run in finite_runs(np.isfinite(angle)) if run.stop - run.start == 1]
        axes.plot(t, np.degrees(cut), color=colour, linewidth=1.6, label="estimate", zorder=3)
        axes.plot(estimate.t[alone], np.degrees(angle[alone]), "D", color=colour, markersize=4, zorder=3)
    axes.set_ylim(-180.0, 180.0)
    axes.set_yticks(np.arange(-180, 181, 90))
    axes.set_ylabel(f"{name} (°)")
    tidy(axes)


def _draw_observed_angle(axes: Axes, observation: Track, name: str, colour: str) -> None:
    observed = observed_angle(observation, name)
    if observed is None:
        return
    known = np.isfinite(observed)
    axes.plot(
        observation.t[known],
        np.degrees(observed[known]),
        "o",
        color=colour,
        markersize=2.6,
        alpha=0.5,
        markeredgewidth=0,
        linewidth=0,
        label="observation",
        zorder=2,
    )
    shaded = False
    for run in finite_runs(~known):
        # From the last observation before the gap to the first one after it.
        start, stop = observation.t[max(run.start - 1, 0)], observation.t[min(run.stop, len(observation) - 1)]
        if run.stop - run.start >= 3:
            label = None if shaded else "not observed"
            axes.axvspan(start, stop, color="#EEF0F3", linewidth=0, zorder=0.5, label=label)
            shaded = True
