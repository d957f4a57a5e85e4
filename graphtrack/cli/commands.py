"""The program graphtrack: its commands by their names."""

from __future__ import annotations

from graphtrack.cli.attention import attention
from graphtrack.cli.compare import CompareCommand, compare
from graphtrack.cli.convert import convert
from graphtrack.cli.demo import demo
from graphtrack.cli.fit import fit
from graphtrack.cli.forecast import forecast
from graphtrack.cli.groups import groups
from graphtrack.cli.info import formats, info
from graphtrack.cli.options import command_of, program_of
from graphtrack.cli.report import report
from graphtrack.cli.reproduce import reproduce
from graphtrack.cli.score import score
from graphtrack.cli.serve import serve
from graphtrack.cli.simulate import add_noise, simulate
from graphtrack.cli.smooth import smooth
from graphtrack.cli.track import track
from graphtrack.cli.view import view

app = program_of(
    "graphtrack",
    "Where pedestrians are, how they move and where their bodies and heads point.",
    {
        "smooth": smooth,
        "track": track,
        "serve": serve,
        "score": score,
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
    },
)
app.command("compare", cls=CompareCommand)(command_of(compare))
