"""Write the reference of both programs' commands from the programs themselves, when the site is built."""

from __future__ import annotations

import re
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from graphtrack.cli.commands import program as graphtrack_program
from perception.cli.commands import program as perception_program

PROGRAMS = {"graphtrack": graphtrack_program(), "perception": perception_program()}
MARKS = re.compile(r"[*_|<\\]")
"""What Markdown would take for more than itself."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page."""
    files.append(File.generated(config, "reference/commands.md", content=page()))
    return files


def page() -> str:
    """A heading for every command, with what it does and a table of what it takes."""
    lines = [
        "# Commands",
        "",
        "`--help` prints the same text. Papers are cited by author and year: [references](../references.md).",
        "",
    ]
    for program, app in PROGRAMS.items():
        group: Any = typer.main.get_command(app)
        for name, command in sorted(commands_of(group, program).items()):
            lines += [f"## {name}", "", *(command.help or "").split("\n"), ""]
            lines += [f"```\n{usage(name, command)}\n```", "", *options(command), ""]
    return "\n".join(lines)


def commands_of(group: Any, prefix: str) -> dict[str, Any]:
    """Commands by their full names, those of groups within groups too."""
    found: dict[str, Any] = {}
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            found |= commands_of(command, f"{prefix} {name}")
        else:
            found[f"{prefix} {name}"] = command
    return found


def usage(name: str, command: Any) -> str:
    """The command line in short."""
    arguments = [p.name.upper() for p in command.params if p.param_type_name == "argument"]
    return " ".join([name, *arguments, "[OPTIONS]"])


def options(command: Any) -> list[str]:
    """A table of arguments and options."""
    rows = ["| option | meaning | |", "|---|---|---|"]
    for one in command.params:
        if getattr(one, "hidden", False):
            continue
        names = [one.name.upper()] if one.param_type_name == "argument" else [*one.opts, *one.secondary_opts]
        said = MARKS.sub(r"\\\g<0>", " ".join((getattr(one, "help", None) or "").split()))
        default = one.default if one.param_type_name == "option" and not callable(one.default) else None
        notes = ["required"] if one.required else []
        if default not in (None, False, (), []):
            notes.append(f"default {default}")
        shown = ", ".join(f"`{option}`" for option in names)
        rows.append(f"| {shown} | {said} | {'; '.join(notes)} |")
    return rows
