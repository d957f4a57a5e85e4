"""The application and its commands."""

from __future__ import annotations

import typer

from perception.cli import adapt, calibrate, evaluate, follow, observe, report, simulate, train

app = typer.Typer(
    name="perception", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
)


@app.callback()
def start() -> None:
    """From video to the observations that graphtrack smooths."""


app.command("adapt")(adapt.adapt)
app.command("calibrate")(calibrate.calibrate)
app.command("report")(report.report)
app.command("observe")(observe.observe)
app.command("follow")(follow.follow)
app.command("simulate")(simulate.simulate)
app.command("train")(train.train)
app.command("evaluate")(evaluate.evaluate)
app.command("card")(train.card)
app.command("contact-sheet")(train.sheet)
