"""Measure what README and docs state, at full size: ``python tests/claims/check.py [COMMAND…]``.

Tables that are in the folder ``claims`` already are not measured again; remove it to begin anew.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from claim import Results
from stated import CLAIMS

from graphtrack.experiments import all_experiments

ROOT = Path(__file__).resolve().parents[2]


def results_of(command: str, folder: Path) -> Results:
    """The tables of an experiment, or of a command line, which is run where they are not in the folder."""
    path = folder / f"{command.replace(' ', '_')}.json"
    if not path.is_file():
        line = command.split()
        if line[0] in all_experiments():
            line = ["graphtrack", "reproduce", *line, "--out", str(path.with_suffix(""))]
        subprocess.run([sys.executable, "-m", *line, "--json", str(path)], check=True)
    return Results(json.loads(path.read_text(encoding="utf-8")))


def main(wanted: list[str], folder: Path = Path("claims")) -> int:
    """Print each number that is not what was measured; 1 if there is one, or a line is missing, else 0."""
    folder.mkdir(exist_ok=True)
    wrong, right = 0, 0
    for claim in CLAIMS:
        if wanted and claim.command not in wanted:
            continue
        try:
            rows = claim.compare(results_of(claim.command, folder), ROOT)
        except LookupError as error:
            print(f"{claim.command}: {error}")
            wrong += 1
            continue
        for label, shown, measured, holds in rows:
            right, wrong = right + holds, wrong + (not holds)
            if not holds:
                where = f"{claim.page}, {claim.command}, {label!r}"
                print(f"{where}: stated {shown.value:g}, measured {measured:.4g}")
    print(f"{right} numbers are as stated, {wrong} are not")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
