"""Files on two sides that belong together, such as estimates and the truth of several sequences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from graphtrack.display import counted, listed
from graphtrack.errors import InputError
from graphtrack.io.folders import sequence_file, table_in
from graphtrack.io.registry import files_beside


def paired_files(estimates: Sequence[Path], truth: Sequence[Path]) -> dict[str, tuple[Path, Path]]:
    """Pairs of files by the name of their sequence, which is that of the file without its ending.

    One file on either side is a pair, whatever its name. A folder stands for the files in it, without hidden
    ones, and without what a reader finds beside a file by itself, such as a calibration; but one that is a
    sequence of MOTChallenge, or is in such a folder, for itself.

    Raises
    ------
    InputError
        If a folder has no files, two files on one side have the same name, or one has no partner.
    """
    first, second = _files(estimates), _files(truth)
    if len(first) == len(second) == 1:
        return {_name(first[0]): (first[0], second[0])}
    named, true = _by_name(first), _by_name(second)
    for mine, others, what in ((named, true, "the truth"), (true, named, "estimates")):
        alone = [path for name, path in mine.items() if name not in others]
        if alone:
            count = f"{counted(len(first), 'file')} of estimates and {len(second)} of the truth"
            raise InputError(
                f"{count}, and nothing to go with {listed(path.name for path in alone)}",
                f"{what} of each in a file of the same name",
            )
    return {name: (path, true[name]) for name, path in named.items()}


def _files(paths: Sequence[Path]) -> list[Path]:
    return [file for path in paths for file in (_files_in(path) if table_in(path).is_dir() else [path])]


def _files_in(folder: Path) -> list[Path]:
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    files += sorted(path for path in folder.iterdir() if sequence_file(path) is not None)
    beside = {place for path in files for place in files_beside(path)}
    found = [path for path in files if path not in beside]
    if not found:
        raise InputError("a folder without files", "files with tracks", path=folder)
    return found


def _by_name(paths: Sequence[Path]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in paths:
        other = found.setdefault(_name(path), path)
        if other is not path:
            raise InputError(f"{other} and {path}", "a name for each sequence")
    return found


def _name(path: Path) -> str:
    return Path(path.name.removesuffix(".gz")).stem
