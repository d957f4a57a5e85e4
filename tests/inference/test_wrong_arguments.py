"""Arguments that cannot be used are one `InputError`; estimates that fail name the input that made them."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.inference.engines import with_extreme

N = 20
POSITION = np.column_stack([np.arange(N) * 0.1, np.zeros(N)])


def track(t: np.ndarray | None = None, **channels: np.ndarray) -> gt.Track:
    given = {"position": POSITION, **channels}
    return gt.Track(0, frame=np.arange(N), t=np.arange(N) * 0.1 if t is None else t, **given)


@pytest.mark.parametrize("jobs", [-1, 0, 1.5, True, "2"])
@pytest.mark.parametrize("engine", ["chain", "gtsam"])
def test_jobs_are_a_whole_number_of_one_at_least(jobs: object, engine: str) -> None:
    with pytest.raises(gt.InputError, match="jobs = "):
        gt.smooth(track(), "position", jobs=jobs, engine=engine)


@pytest.mark.parametrize("given", [None, 3.0, {"t": 0.0}])
def test_an_observation_that_is_none_is_refused(given: object) -> None:
    smoother = gt.OnlineSmoother("position", engine="fixed-lag")
    with pytest.raises(gt.InputError, match="an Observation"):
        smoother.update(given)


@pytest.mark.parametrize("t", ["0.3", None, np.nan, np.inf, 1e300, -1e12, 10**400, True])
@pytest.mark.parametrize("detections", [[], [(0.0, 0.0)]], ids=["nobody", "somebody"])
def test_times_that_are_no_seconds_are_refused(t: object, detections: list[tuple[float, float]]) -> None:
    tracker = gt.OnlineTracker("position")
    with pytest.raises(gt.InputError, match="t = "):
        tracker.update(t, detections)
    assert tracker.updates == 0


@pytest.mark.parametrize("detections", [None, 5, 1.5])
def test_detections_that_are_no_sequence_are_refused(detections: object) -> None:
    with pytest.raises(gt.InputError, match="detections = "):
        gt.OnlineTracker("position").update(0.0, detections)


def test_complex_positions_are_refused_everywhere() -> None:
    with pytest.raises(gt.InputError, match="complex"):
        track(position=POSITION + 1j)
    smoother = gt.OnlineSmoother("position", engine="fixed-lag")
    with pytest.raises(gt.InputError, match="position"):
        smoother.update(gt.Observation(t=0.0, position=np.array([1j, 2.0])))
    n = np.arange(N)
    table = {"track_id": n * 0, "frame": n, "t": n / 10, "x": n * (1 + 1j), "y": n * 0.0}
    with pytest.raises(gt.InputError, match="column x: found '0j'"):
        gt.smooth(table, "position")
    with pytest.raises(gt.InputError):
        gt.read(table)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (gt.SolverOptions, "max_iterations", 1.5),
        (gt.SolverOptions, "step_tolerance", np.nan),
        (gt.OnlineSmoother, "engine", "kalman"),
        (gt.OnlineSmoother, "lag", 0.0),
        (gt.OnlineSmoother, "lag", np.nan),
        (gt.OnlineSmoother, "relinearize_threshold", 0.0),
        (gt.OnlineSmoother, "step_tolerance", -1.0),
        (gt.OnlineSmoother, "max_iterations", 0),
        (gt.OnlineSmoother, "max_iterations", 1.5),
        (gt.OnlineSmoother, "max_iterations", "3"),
        (gt.OnlineSmoother, "step_tolerance", "x"),
        (gt.OnlineSmoother, "relinearize_threshold", None),
        (gt.OnlineSmoother, "lag", 10**400),
        (gt.OnlineSmoother, "camera", "image"),
        (gt.OnlineTracker, "camera", "image"),
        (gt.OnlineSmoother, "model", "jiont"),
    ],
)
def test_options_out_of_range_are_refused(kind: type, name: str, value: object) -> None:
    with pytest.raises(gt.InputError, match=str(value)):
        kind(**{name: value})


def test_an_estimate_that_is_not_finite_names_the_input_that_made_it_so() -> None:
    (failed,) = gt.solve(track(position_std=np.full(N, 1e8)), "joint", constants="default")
    assert failed.reason == (
        "the estimate is not finite: position_std = 1e+08 in frame 0, expected 0.0001 to 1000"
    )
    model = gt.Model("joint")
    far = track(position_std=np.full(N, 2e4))
    assert "position_std = 2e+04 in frame 0" in with_extreme("failed", far, model)
    assert with_extreme("failed", track(), model) == "failed"


def test_a_linear_system_without_a_solution_is_told_in_a_few_words() -> None:
    """GTSAM's own text is a paragraph; the message of a user's factor is kept."""
    said = "Indeterminate linear system detected while working near variable\n70616 (Symbol: b8).\n\nThrown"
    model = gt.Model("joint")
    assert with_extreme(said, track(), model) == (
        "the linear system has no unique solution: the factors do not determine b8"
    )
    far = track(position_std=np.full(N, 2e4))
    assert with_extreme(said, far, model).startswith("the estimate is not finite: position_std = 2e+04")
    assert with_extreme("my factor failed", far, model).startswith("my factor failed: position_std = 2e+04")


def test_interrupts_at_any_time_end_quietly(tmp_path: Path) -> None:
    rows = "".join(f"1,{k},{k / 10},0,0\n" for k in range(5))
    (tmp_path / "a.csv").write_text("track_id,frame,t,x,y\n" + rows)
    code = "import sys; from graphtrack.cli import main; print('ready', flush=True); main()"
    line = [sys.executable, "-c", code, "smooth", str(tmp_path / "a.csv"), "-o", str(tmp_path / "b.csv")]
    codes = set()
    for wait in (0.0, 0.05, 0.2):
        with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            process.stdout.readline()
            time.sleep(0.03 + wait)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=120)
        codes.add(process.returncode)
        # Where the test itself was held up, it came when all was done.
        assert process.returncode == 0 or ("Traceback" not in said and said.count("\n") <= 2), said
    assert 130 in codes and codes <= {0, 130}
