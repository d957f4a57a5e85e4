"""Draw the pictures of README and documentation: ``python docs/pictures.py``, by ``make pictures``.

`docs/images/replay.gif` replays a simulated scene, `docs/images/factor_graph.png` has three frames of the
factor graph, `docs/images/tutorial.png` is what the code of the tutorial draws, and `docs/images/report.png`
is the top of a report, as Chromium shows it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, FancyArrow
from PIL import Image

import graphtrack as gt
from graphtrack.interaction.attention import attention
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.scenario import party, scenario
from graphtrack.tracks.display import BODY_COLOUR, HEAD_COLOUR, person_colour

IMAGES = Path(__file__).parent / "images"
GREY, INK = "#8A9099", "#3A3F47"
FRAMES_A_SECOND = 10
BEGIN, TRAIL, DOTS = 2.5, 3.5, 2.5
"""Seconds: where the replay begins in the scene; how long paths and observations of a person stay."""
MIDDLES = ((-1.5, 1.4), (1.5, 0.2), (-5.5, -1.8), (3.5, -3.0), (6.5, 1.0), (-3.5, 2.9))
"""Metres: where each person is in the middle of the replay, so that all are in the picture."""
NAMES = ("Anna", "Ben", "Cleo", "Dan", "Eva", "Finn", "Gül", "Hana")
HALF_WIDTH, HALF_HEIGHT = 11.0, 6.6


def main() -> None:
    """Draw all pictures."""
    factor_graph(IMAGES / "factor_graph.png")
    replay(IMAGES / "replay.gif")
    tutorial(IMAGES / "tutorial.png")
    report(IMAGES / "report.png")
    for name in ("factor_graph.png", "replay.gif", "tutorial.png", "report.png"):
        print(f"{name}: {(IMAGES / name).stat().st_size / 1024:.0f} KiB")


def report(path: Path, width: int = 1100, height: int = 1180) -> None:
    """Write the top of a report on a party, if Chromium is there; else keep the picture."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        print("report.png: not drawn again, for there is no Chromium")
        return
    rng = np.random.default_rng(4)
    met = party(rng, people=8, steps=120).tracks
    estimates = gt.smooth(add_noise(met, position_std=0.05, body_kappa=4.0, head_kappa=4.0, rng=rng))
    names = dict(zip((track.track_id for track in estimates), NAMES, strict=True))
    named = estimates.map(lambda track: replace(track, label=names[track.track_id]))
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        gt.write_report(page, named, groups=gt.groups(named), attention=attention(named), title="A party")
        size, shot = f"--window-size={width},{height}", f"--screenshot={path.resolve()}"
        options = [
            "--headless",
            "--no-sandbox",
            "--hide-scrollbars",
            "--virtual-time-budget=4000",
            size,
            shot,
        ]
        subprocess.run([browser, *options, f"{page.as_uri()}#person=Anna"], check=True, capture_output=True)
    Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=128).save(path, optimize=True)


def replay(path: Path, seconds: float = 12.0) -> None:
    """Write an animation: observations as dots, estimates as lines, arrows for body and head."""
    scene = scenario(
        np.random.default_rng(3), fps=FRAMES_A_SECOND, seconds=seconds, position_std=0.18, occlusion=1.6
    )
    observed = scene.with_tracks(moved(track, at) for track, at in zip(scene, MIDDLES, strict=True))
    smoothed = gt.smooth(observed)
    figure = Figure(figsize=(8.0, 4.8), dpi=110, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    frames = []
    for k in range(int(BEGIN * FRAMES_A_SECOND), int(seconds * FRAMES_A_SECOND)):
        figure.clear()
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        ground(axes)
        for place, (person, seen) in enumerate(zip(smoothed, observed, strict=True)):
            draw_person(axes, person, seen, k, person_colour(place))
        legend(axes)
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    several = np.concatenate([np.asarray(frame) for frame in frames[:: len(frames) // 6]])
    palette = Image.fromarray(several).quantize(colors=128, dither=Image.Dither.NONE)
    shown = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    duration = 1000 // FRAMES_A_SECOND
    shown[0].save(path, save_all=True, append_images=shown[1:], duration=duration, loop=0, optimize=True)


def moved(track: gt.Track, middle: tuple[float, float]) -> gt.Track:
    """Return a track moved so that its person is at ``middle`` half-way through."""
    shift = np.asarray(middle) - track.true_position[len(track) // 2]
    return replace(track, position=track.position + shift, true_position=track.true_position + shift)


def ground(axes: Axes) -> None:
    """Set the part of the ground that is shown, with a line for each two metres."""
    axes.set(xlim=(-HALF_WIDTH, HALF_WIDTH), ylim=(-HALF_HEIGHT, HALF_HEIGHT), aspect="equal")
    for x in np.arange(-40.0, 40.0, 2.0):
        axes.axvline(x, color="#EEF0F3", lw=0.8, zorder=0)
        axes.axhline(x, color="#EEF0F3", lw=0.8, zorder=0)
    axes.set_axis_off()


def draw_person(axes: Axes, person: gt.Track, seen: gt.Track, k: int, colour: str) -> None:
    """Draw one person at frame ``k`` with the path and the observations of the last seconds."""
    first, dots = max(0, k - int(TRAIL * FRAMES_A_SECOND)), max(0, k - int(DOTS * FRAMES_A_SECOND))
    axes.plot(*seen.position[dots : k + 1].T, ".", color=GREY, ms=5.0, zorder=1, mec="none")
    path = person.position[first : k + 1]
    for j in range(len(path) - 1):
        share = (j + 1) / len(path)
        axes.plot(
            *path[j : j + 2].T,
            color=colour,
            lw=2.4,
            alpha=0.15 + 0.85 * share,
            zorder=2,
            solid_capstyle="butt",
        )
    at, body, head = person.position[k], person.body[k], person.head[k]
    hidden = not np.isfinite(seen.position[k, 0])
    style = {"facecolor": "white" if hidden else colour, "edgecolor": colour, "lw": 1.4, "zorder": 4}
    axes.add_patch(Ellipse(at, 0.45, 0.84, angle=np.degrees(body), alpha=0.9, **style))
    arrow(axes, at, body, 1.25, 0.1, BODY_COLOUR, zorder=5)
    arrow(axes, at, head, 0.95, 0.065, HEAD_COLOUR, zorder=6)
    axes.add_patch(Circle(at, 0.17, facecolor="white", edgecolor=INK, lw=0.9, zorder=7))
    if hidden:
        axes.text(at[0], at[1] + 0.75, "not observed", color=INK, fontsize=8, ha="center", zorder=8)


def arrow(
    axes: Axes, at: np.ndarray, angle: float, length: float, width: float, colour: str, zorder: int
) -> None:
    """Draw an arrow in a direction."""
    step = length * np.array([np.cos(angle), np.sin(angle)])
    shape = {"width": width, "head_width": 3.6 * width, "head_length": 4.0 * width}
    axes.add_patch(
        FancyArrow(*at, *step, length_includes_head=True, color=colour, lw=0.0, zorder=zorder, **shape)
    )


def legend(axes: Axes) -> None:
    """Explain the marks."""
    marks = [
        Line2D([], [], marker=".", ls="", color=GREY, ms=6, label="observation"),
        Line2D([], [], color=person_colour(0), lw=2.4, label="estimate"),
        Line2D([], [], color=BODY_COLOUR, lw=3.0, label="body"),
        Line2D([], [], color=HEAD_COLOUR, lw=3.0, label="head"),
    ]
    axes.legend(
        handles=marks, loc="lower left", ncols=4, fontsize=9, handlelength=1.4, edgecolor="none"
    ).set_zorder(9)


def factor_graph(path: Path) -> None:
    """Draw three frames of the graph of `joint`: variables are circles, factors are squares."""
    figure = Figure(figsize=(8.2, 4.3), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    rows = {"X": 3.0, "V": 2.0, "B": 1.0, "H": 0.0}
    observed, dynamics, coupling = "#0072B2", INK, "#D55E00"

    def factor(at: tuple[float, float], ends: list[tuple[float, float]], colour: str) -> None:
        for end in ends:
            axes.plot(*zip(at, end, strict=True), color="#AAB0B8", lw=1.3, zorder=1)
        axes.plot(*at, "s", color=colour, ms=9, zorder=3)

    for k in range(3):
        x = 2.4 * k
        for name in "XBH":
            factor((x - 0.7, rows[name] + 0.42), [(x, rows[name])], observed)
        factor((x, 1.5), [(x, rows["V"]), (x, rows["B"])], coupling)
        factor((x, 0.5), [(x, rows["B"]), (x, rows["H"])], coupling)
        if k == 0:
            factor((x - 0.7, rows["V"] + 0.42), [(x, rows["V"])], "#8A9099")
        if k < 2:
            middle, after = x + 1.2, x + 2.4
            ends = [(one, rows[name]) for one in (x, after) for name in "XV"]
            factor((middle, 2.5), ends, dynamics)
            for name in "BH":
                factor((middle, rows[name]), [(x, rows[name]), (after, rows[name])], dynamics)
        for name, y in rows.items():
            axes.add_patch(Circle((x, y), 0.27, facecolor="white", edgecolor=INK, lw=1.5, zorder=4))
            axes.text(x, y, f"${name}_{k}$", ha="center", va="center", fontsize=12, zorder=5)
    for name, y in zip(("position", "velocity", "body", "head"), rows.values(), strict=True):
        axes.text(-1.15, y, name, ha="right", va="center", fontsize=11, color=INK)
    for k in range(3):
        axes.text(2.4 * k, 3.62, f"frame {k}", ha="center", fontsize=10, color=GREY)
    marks = [
        Line2D([], [], marker="s", ls="", color=colour, ms=8, label=label)
        for label, colour in (
            ("observation", observed),
            ("motion, turning", dynamics),
            ("coupling", coupling),
            ("first velocity", "#8A9099"),
        )
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=4, frameon=False, fontsize=10)
    axes.set(xlim=(-2.3, 5.4), ylim=(-0.45, 3.9), aspect="equal")
    axes.set_axis_off()
    figure.savefig(path)


def tutorial(path: Path) -> None:
    """Run the Python of the tutorial in an empty folder and keep its picture."""
    text = (Path(__file__).parent / "start.md").read_text(encoding="utf-8")
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            exec("\n".join(re.findall(r"^```python\n(.*?)^```$", text, flags=re.M | re.S)), {})
            path.write_bytes(Path("walks.png").read_bytes())
        finally:
            os.chdir(before)


if __name__ == "__main__":
    main()
