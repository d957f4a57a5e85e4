"""`graphtrack demo`."""

from __future__ import annotations

from pathlib import Path

from graphtrack.cli import options
from graphtrack.cli.compare import FIGURES, print_comparison, write_figures
from graphtrack.cli.console import emit, progress_bar

OBSERVATIONS, ESTIMATES, REPORT, TRACKS = "observations.csv", "estimates.csv", "report.html", "tracks.png"


def demo(
    out: Path = Path("demo"),
    model: options.BestModelName = None,
    seconds: float = 30.0,
    seed: options.Seed = 0,
) -> None:
    """Simulate people, smooth them offline, track them online, compare with filters, and write a report.

    Parameters
    ----------
    out : Folder for the results.
    seconds : Length of the scene.
    """
    import numpy as np

    from graphtrack.evaluation.compare import compare
    from graphtrack.io import atomic_path, write
    from graphtrack.model import Model
    from graphtrack.report.build import tracking_report
    from graphtrack.report.html import write_html
    from graphtrack.report.pairing import pair_tracks
    from graphtrack.report.plots.scene import plot_pairs
    from graphtrack.simulation.scenario import scenario
    from graphtrack.smoothing import smooth

    observed = scenario(np.random.default_rng(seed), seconds=seconds)
    names = (OBSERVATIONS, ESTIMATES, REPORT, TRACKS, *FIGURES)
    options.check_outputs({"--out": options.files_in(out, names)}, {"--model": options.model_file(model)})
    chosen = Model.named(model)
    options.make_folder(out)
    emit(f"{len(observed)} people, {observed.n_frames} person-frames, simulated")
    write(observed, out / OBSERVATIONS)
    with progress_bar(observed.n_frames) as advance:
        estimates = smooth(observed, chosen, progress=advance)
    write(estimates, out / ESTIMATES)
    methods = ["kf", "chain", "isam2", "rts", "smoother"]
    with progress_bar(observed.n_frames) as advance:
        comparison = compare(observed, methods, model=chosen, progress=advance)
    print_comparison(comparison)
    write_figures(comparison, out)
    figure = plot_pairs(pair_tracks(estimates, observed), title="Smoothed tracks")
    with atomic_path(out / TRACKS) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
    report = tracking_report(
        estimates,
        observed,
        title="graphtrack demo",
        comparison=comparison.rows,
        consistency=comparison.nees,
        calibration=comparison.calibration,
    )
    write_html(out / REPORT, report)
    emit(f"the report is {out / REPORT}")
