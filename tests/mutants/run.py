"""Do the tests notice mistakes? Each mutant is one, made by hand, in a copy of the tree that is thrown away.

``python tests/mutants/run.py [NAME…]`` runs the tests that should notice each, or those named, and prints
what became of it. It takes an hour or two, most of which compiles the mistakes; it is no part of CI.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "graphtrack"
LONGEST = 3600.0
"""Seconds after which tests that do not end count as failed."""

NO_END = "no end"

MODEL = ("tests/model", "tests/inference")
READERS = ("tests/io",)
TRACKING = ("tests/evaluation/tracking",)


@dataclass(frozen=True)
class Mutant:
    """A mistake: a piece of code that stands once in the package, what takes its place, who should notice.

    The piece is looked for in all files, so that it may move from one to another.
    """

    name: str
    old: str
    new: str
    tests: tuple[str, ...] = MODEL


MUTANTS = (
    # Terms: cost, gradient, curvature, normaliser.
    Mutant(
        "motion-body-curvature-sign",
        "mixed = (-s_theta - by_phi / speed) / speed",
        "mixed = (-s_theta + by_phi / speed) / speed",
    ),
    Mutant(
        "motion-body-gauss-newton-factor",
        "s_theta = kappa * excess * across",
        "s_theta = 2.0 * kappa * excess * across",
    ),
    Mutant(
        "coupling-weight-of-first-frame",
        "short = (dt > 0.0) & (dt < self.correlation_time)",
        "short = dt < self.correlation_time",
    ),
    Mutant(
        "steered-jacobian-entry",
        "transition[HEAD, p] -= speed * w * aim_place",
        "transition[HEAD, p] -= speed * w * aim_spread",
    ),
    Mutant(
        "steered-covariance-factor",
        "once * once / (2.0 * rate * rate))",
        "once * once / (rate * rate))",
    ),
    Mutant(
        "motion-normaliser-factor",
        "dt**2) ** 2 / 12.0",
        "dt**2) ** 2 / 3.0",
        (*MODEL, "tests/learning"),
    ),
    Mutant(
        "outlier-curvature-factor",
        "- inlier * (1.0 - inlier) * slope * slope",
        "- inlier * slope * slope",
    ),
    Mutant(
        "classes-curvature-factor",
        "kappa * scale * (along - kappa * square) + slope * slope",
        "kappa * scale * (along - square) + slope * slope",
    ),
    Mutant(
        "derived-residual-factor",
        "residual[row] = left[pivot] / root",
        "residual[row] = left[pivot] * root",
    ),
    Mutant(
        "pixel-swapped-columns",
        "vx, vy = to_image[1, 0] / depth - pv * cx, to_image[1, 1] / depth - pv * cy",
        "vx, vy = to_image[1, 0] / depth - pv * cy, to_image[1, 1] / depth - pv * cx",
    ),
    Mutant(
        "huber-factor",
        "robust_threshold * (distance - 0.5 * robust_threshold), cost",
        "robust_threshold * (distance - robust_threshold), cost",
    ),
    Mutant(
        "drift-circle-off-by-one",
        "row[_LAST] = own + share * (behind + first - 2.0 * own)",
        "row[_LAST] = own + share * (behind + row[1] - 2.0 * own)",
    ),
    Mutant(
        "switch-back-not-adjoint",
        "follows_near += ahead * modes.share[j - BINS]",
        "follows_near += ahead * modes.anywhere[j - BINS]",
    ),
    Mutant(
        "lead-of-the-other-coupling",
        "squared_excess(vx, vy, shared.speed_threshold),\n            modes.lead - left,",
        "squared_excess(vx, vy, shared.speed_threshold),\n            gait.head.lead - left,",
    ),
    # The solver.
    Mutant(
        "inverse-cholesky-entry",
        "m42 = -m44 * (l42 * m22 + l43 * m32)",
        "m42 = -m44 * (l42 * m22)",
    ),
    Mutant(
        "step-accepted-though-worse",
        "worse = running & negate(found <= cost)",
        "worse = running & negate(found <= cost + 1.0)",
    ),
    Mutant(
        "gap-filled-from-the-far-side",
        "earlier = last >= 0 and t[gap] - t[last] <= t[k] - t[gap]",
        "earlier = last >= 0 and t[gap] - t[last] >= t[k] - t[gap]",
    ),
    Mutant(
        "quarter-turn-sign",
        "unturned = turned if q == 2 else -turned",
        "unturned = turned",
    ),
    Mutant(
        "masked-view-reaches-every-lane",
        "value = builder.select(given.mask, value, builder.load(pointer, align=8))",
        "pass",
    ),
    Mutant(
        "another-lane-s-mode-sums",
        "modes[k, 0] = lane_of(held[k, 2], lane)",
        "modes[k, 0] = lane_of(held[k, 2], 0)",
    ),
    # Covariances.
    Mutant(
        "pull-of-the-frame-before-added",
        "total -= link[k - 1, j, i] * solution[k - 1, j]",
        "total += link[k - 1, j, i] * solution[k - 1, j]",
    ),
    Mutant(
        "lag-of-past-and-future-at-the-end",
        "return past, past + (1.0 - newest) * 0.5 * square",
        "return past, past + 0.5 * square",
    ),
    Mutant(
        "turn-across-with-the-wrong-sign",
        "across = covariance[HEAD, VY] * vx - covariance[HEAD, VX] * vy",
        "across = covariance[HEAD, VY] * vx + covariance[HEAD, VX] * vy",
    ),
    # The online window.
    Mutant(
        "turn-counted-twice",
        "    frame.body_turn_kappa = 0.0\n",
        "",
    ),
    Mutant(
        "lag-off-by-one",
        "observation.t - lag - TIME_TOLERANCE",
        "observation.t - lag + TIME_TOLERANCE",
    ),
    Mutant(
        "modes-before-off-by-one",
        "normalise(modes.filtered_body[k], windows.modes_before[slot, BODY_MODE])",
        "normalise(modes.filtered_body[end - begin - 1], windows.modes_before[slot, BODY_MODE])",
    ),
    # Readers.
    Mutant(
        "eth-swapped-column",
        "np.column_stack([table.metres(2), table.metres(4)])",
        "np.column_stack([table.metres(2), table.metres(3)])",
        READERS,
    ),
    Mutant(
        "mirrored-shoulders",
        "quarter = -np.pi / 2.0 if not camera.is_mirrored else np.pi / 2.0",
        "quarter = -np.pi / 2.0",
        READERS,
    ),
    Mutant(
        "whole-numbers-unbounded",
        "bad = (np.abs(values) > highest) | (values != np.floor(values))",
        "bad = values != np.floor(values)",
        READERS,
    ),
    # Scores of tracks and identities.
    Mutant(
        "mota-pairs-are-not-kept",
        "KEEPING * kept + similarity",
        "similarity",
        TRACKING,
    ),
    Mutant(
        "hota-matching-without-the-whole-sequence",
        "alike[np.ix_(truth, estimates)] * similarity",
        "similarity",
        TRACKING,
    ),
    Mutant(
        "hota-rows-count-twice",
        "of_person + of_track - rows",
        "of_person + of_track",
        TRACKING,
    ),
)


def copy_tree(folder: Path) -> None:
    """The files that git knows, with their times, which compiled code is kept by."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True)
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def find(tree: Path, piece: str) -> Path:
    """The file of the package in which a piece of code stands."""
    counts = {path: path.read_text("utf-8").count(piece) for path in (tree / PACKAGE).rglob("*.py")}
    (found,) = (path for path, count in counts.items() if count)
    if counts[found] != 1:
        raise ValueError(f"{counts[found]} times in {found.name}")
    return found


def fails(tree: Path, tests: tuple[str, ...]) -> str:
    """What pytest says of the first test that fails; "" if all pass."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "PYTHONDONTWRITEBYTECODE": "1",
        "XDG_CACHE_HOME": str(tree.parent / "cache"),
        "GRAPHTRACK_DATA": os.environ.get("GRAPHTRACK_DATA") or str(ROOT.parent / "shared" / "data"),
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=LONGEST
        )
    except subprocess.TimeoutExpired:
        return NO_END
    failed = re.search(r"^(?:FAILED|ERROR) .*?(?= - |$)", done.stdout, flags=re.M)
    return "" if done.returncode == 0 else failed[0] if failed else done.stdout + done.stderr


def judge(tree: Path, mutant: Mutant) -> str:
    """Run the tests with the mistake in the tree, and the one that noticed without it."""
    try:
        path = find(tree, mutant.old)
    except ValueError as error:
        return f"not found: {error}"
    original, times = path.read_bytes(), path.stat()
    path.write_bytes(original.replace(mutant.old.encode(), mutant.new.encode()))
    try:
        failed = first_failure(tree, mutant.tests)
    finally:
        path.write_bytes(original)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    if not failed or failed == NO_END:
        return f"killed by {NO_END}" if failed else "LIVED"
    return f"UNCLEAR, for without it fails: {failed}" if fails(tree, (failed,)) else f"killed by {failed}"


def first_failure(tree: Path, tests: tuple[str, ...]) -> str:
    """The first test that fails, and does so again: some fail where their first call is compiled."""
    passed_over: tuple[str, ...] = ()
    while True:
        failed = fails(tree, (*tests, *(f"--deselect={test}" for test in passed_over)))
        if not failed or failed == NO_END:
            return failed
        test = failed.partition(" ")[2]
        if fails(tree, (test,)):
            return test
        passed_over += (test,)


def main(names: list[str]) -> None:
    """Judge the mutants of these names, or all."""
    chosen = [mutant for mutant in MUTANTS if not names or mutant.name in names]
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        copy_tree(tree)
        killed = 0
        for mutant in chosen:
            start = time.monotonic()
            outcome = judge(tree, mutant)
            killed += outcome.startswith("killed")
            print(f"{mutant.name}: {outcome} ({time.monotonic() - start:.0f} s)", flush=True)
        print(f"{killed} of {len(chosen)} killed")


if __name__ == "__main__":
    main(sys.argv[1:])
