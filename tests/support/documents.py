"""Code blocks of documents: Python and commands run in this process, other lines in a shell."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import command

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = ("graphtrack", "perception")
NOT_RUN = ("make ", "pip ", "graphtrack serve ")
"""Lines that install the program, and a service that does not end."""
SLOW = ("graphtrack reproduce ",)
STAND_INS = """camera() { graphtrack simulate -o camera.ndjson --steps 20 >&2 && cat camera.ndjson; }
"""
"""Definitions of a reader's own programs for the shell."""
RECORDING = "frames"
"""A folder of the reader's own images: blocks about it are run where it is there."""
SHORTER = {
    "graphtrack simulate -o tracks.csv": "--steps 60",
    "graphtrack simulate -o party.csv": "--steps 12",
    "perception simulate -o clip": "--frames 4",
    "graphtrack simulate --scene crossing": "--steps 60",
    "graphtrack demo": "--seconds 12",
}
"""Added to lines that begin so, unless what takes minutes is run too."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a document: its kind, its text, and the heading above it."""

    kind: str
    text: str
    heading: str

    def lines(self) -> list[str]:
        """The command lines of a shell block as they would be typed, without comments."""
        joined = self.text.replace("\\\n", " ")
        lines = (shlex.join(shlex.split(line, comments=True)) for line in joined.splitlines())
        return [line.replace(" '|' ", " | ").replace(" '>' ", " > ") for line in lines if line]


def blocks(path: str) -> list[Block]:
    """Return all fenced blocks of a document, by its path from the root."""
    text = (ROOT / path).read_text(encoding="utf-8")
    parts = re.findall(r"^```(\w+)\n(.*?)^```$|^#+ ([^\n]*)$", text, flags=re.M | re.S)
    found, heading = [], ""
    for kind, body, title in parts:
        if kind:
            found.append(Block(kind, body, heading))
        else:
            heading = title
    return found


def is_about_recording(block: Block) -> bool:
    """Return True if commands of a block take the reader's own images."""
    return block.kind == "sh" and f" {RECORDING} " in block.text


def commands(program: str, *paths: str) -> Iterator[list[str]]:
    """The arguments of every line that calls a program."""
    for path in paths:
        for block in blocks(path):
            for line in block.lines() if block.kind == "sh" else ():
                for part in line.split(" | "):
                    words = shlex.split(part)
                    if words[0] == program:
                        yield words[1:]


def run(chosen: list[Block], names: dict[str, Any], *, slow: bool) -> dict[str, str]:
    """Run blocks in order; return command line → standard output, of lines that ran in a shell.

    ``names`` are those of the Python blocks, before and then after them; with ``slow``, lines that take
    minutes run too, all as printed. A line that fails is an error.
    """
    written = {}
    # A module, as for a script: compilers of functions look there for it.
    module = sys.modules["document"] = ModuleType("document")
    vars(module).update(names)
    for block in chosen:
        if is_about_recording(block) and not Path(RECORDING).exists():
            continue
        if block.kind == "python":
            exec(compile(block.text, "document", "exec"), vars(module))
        for line in block.lines() if block.kind == "sh" else ():
            if not line.startswith(NOT_RUN) and (slow or not line.startswith(SLOW)):
                more = (
                    [] if slow else [shorter for begin, shorter in SHORTER.items() if line.startswith(begin)]
                )
                written[line] = run_line(" ".join([line, *more]))
    names.update(vars(module))
    return written


def run_line(line: str) -> str:
    """Run a line in this process, since imports take longer than most; in a shell what needs one."""
    *before, last = line.split(" | ")
    last, *to = last.split(" > ")
    program, *arguments = shlex.split(last)
    if program not in PROGRAMS:
        return in_shell(line)
    rows = in_shell(" | ".join(before)).splitlines() if before else None
    done = command.ran(*arguments, program=program, rows=rows)
    for path in to:
        Path(path).write_text(done.stdout, "utf-8")
    return "" if to else done.stdout


def in_shell(line: str) -> str:
    """Return the standard output of a line in a shell."""
    known = "".join(f'{name}() {{ "{sys.executable}" -m {name} "$@"; }}\n' for name in PROGRAMS)
    script = f"set -o pipefail\n{known}{STAND_INS}{line}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, f"{line}\n{done.stderr}"
    return done.stdout
