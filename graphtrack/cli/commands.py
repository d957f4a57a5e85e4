"""Command table of the program graphtrack."""

from __future__ import annotations

from graphtrack.cli.behaviour import attention, forecast, groups
from graphtrack.cli.compare import compare
from graphtrack.cli.files import convert, formats, info
from graphtrack.cli.fit import fit
from graphtrack.cli.options import program_of
from graphtrack.cli.report import report, view
from graphtrack.cli.reproduce import demo, reproduce
from graphtrack.cli.score import score
from graphtrack.cli.simulate import add_noise, simulate
from graphtrack.cli.smooth import smooth, warm_up
from graphtrack.cli.track import serve, track

app = program_of(
    "graphtrack",
    "Pedestrian tracking: positions, velocities, and body and head orientations.",
    {
        "smooth": smooth,
        "track": track,
        "serve": serve,
        "score": score,
        "compare": compare,
        "groups": groups,
        "attention": attention,
        "fit": fit,
        "forecast": forecast,
        "report": report,
        "view": view,
        "reproduce": reproduce,
        "demo": demo,
        "simulate": simulate,
        "add-noise": add_noise,
        "convert": convert,
        "info": info,
        "formats": formats,
        "warm-up": warm_up,
    },
)
