"""The commands of the program `perception`."""

from __future__ import annotations

from graphtrack.cli.options import program_of
from perception.cli.adapt import adapt, calibrate
from perception.cli.evaluate import evaluate
from perception.cli.follow import follow
from perception.cli.observe import observe
from perception.cli.report import report
from perception.cli.train import card, simulate, train

app = program_of(
    "perception",
    "From video to the observations that graphtrack smooths.",
    {
        "adapt": adapt,
        "calibrate": calibrate,
        "report": report,
        "observe": observe,
        "follow": follow,
        "simulate": simulate,
        "train": train,
        "evaluate": evaluate,
        "card": card,
    },
)
