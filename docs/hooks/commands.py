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
            lines += [f"```\n{usage(name, command)}\n```", "", *options(name, command), ""]
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


def options(command_name: str, command: Any) -> list[str]:
    """A table of arguments and options, with the values that each takes and its default."""
    rows = ["| option | values | meaning |", "|---|---|---|"]
    context = command.make_context(command_name, [], resilient_parsing=True)
    for one in command.params:
        if getattr(one, "hidden", False):
            continue
        names = [one.name.upper()] if one.param_type_name == "argument" else [*one.opts, *one.secondary_opts]
        said = MARKS.sub(r"\\\g<0>", " ".join((getattr(one, "help", None) or "").split()))
        default = one.default if one.param_type_name == "option" and not callable(one.default) else None
        notes = ["Required."] if one.required else []
        if default not in (None, False, (), []) and "default" not in said.lower():
            notes.append(f"Default {'yes' if default is True else default}.")
        shown = ", ".join(f"`{option}`" for option in names)
        rows.append(f"| {shown} | {values(one, context)} | {' '.join([said, *notes])} |")
    return rows


WORDS = {"float": "number", "int": "integer", "float range": "number", "int range": "integer", "str": "text"}
"""Names of types in the help → words of the reference."""
RANGE = re.compile(r"(?:[-+.\d]+<=?)?\bx(?:[<>]=?[-+.\d]+)?(?=[;\]])")
"""Range of a number in a line of the help, such as [default: 1; 0<=x<=9]."""


def values(one: Any, context: Any) -> str:
    """What an option takes, as the help has it: its choices, its range, or the kind of value."""
    if one.param_type_name == "argument" or getattr(one, "is_flag", False):
        return ""
    names, text = one.get_help_record(context)
    kind = (names[names.index("<") :] if "<" in names else names.rpartition(" ")[2]).strip("<>")
    words = [f"`{word}`" if word.islower() and "|" in kind else word for word in kind.split("|")]
    limits = RANGE.search(text)
    ends = re.findall(r"[-+.\d]+", limits[0]) if limits else []
    least_only = len(ends) == 1 and limits is not None and ">" in limits[0]
    within = [f"from {ends[0]}" if least_only else " to ".join(ends)] if ends else []
    return ", ".join([*([WORDS[kind]] if kind in WORDS else words), *within])
