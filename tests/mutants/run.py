"""Mutation tests: each mutant is a mistake, made by hand, in a temporary copy of the tree.

``python tests/mutants/run.py [NAME…]`` runs the tests that should notice each, or those named, and prints
the outcome. It takes an hour or two, most of which compiles the mistakes; it is no part of CI.
"""

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
PACKAGES = ("graphtrack", "perception")
LONGEST = 3600.0
"""Seconds after which tests that do not end count as failed."""

NO_END = "no end"

TESTS = "model inference"
"""Folders of the tests that should notice a mistake, unless its headline names others."""


@dataclass(frozen=True)
class Mutant:
    """A mistake: a unique piece of code of the packages, its replacement, and the tests that should fail.

    The piece is looked for in all files, so that it may move from one to another.
    """

    name: str
    old: str
    new: str
    tests: tuple[str, ...]


def mutants() -> list[Mutant]:
    """Mistakes of ``mistakes.txt``: a headline ``@ name (folders)``, lines ``-``, and ``+`` for them."""
    found = []
    for part in re.split(r"^@ ", (Path(__file__).parent / "mistakes.txt").read_text("utf-8"), flags=re.M)[1:]:
        head, *lines = part.splitlines()
        name, _, folders = head.partition(" (")
        old, new = ("\n".join(line[2:] for line in lines if line[:1] == sign) for sign in "-+")
        tests = tuple(f"tests/{one}" for one in (folders.removesuffix(")") or TESTS).split())
        found.append(Mutant(name, old, new, tests))
    return found


def copy_tree(folder: Path) -> None:
    """The files that git knows, with their times, which compiled code is kept by."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True)
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def find(tree: Path, piece: str) -> Path:
    """The file of the packages that contains a piece of code."""
    paths = [path for package in PACKAGES for path in (tree / package).rglob("*.py")]
    found = [path for path in paths for _ in range(path.read_text("utf-8").count(piece))]
    if len(found) != 1:
        raise ValueError(f"{len(found)} times in the packages")
    return found[0]


def fails(tree: Path, tests: tuple[str, ...]) -> str:
    """The line of pytest that names the first failed test; "" if all pass."""
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
    """The first test that fails twice: some fail where their first call is compiled."""
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
    chosen = [mutant for mutant in mutants() if not names or mutant.name in names]
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
