"""Tables of explanation and reference pages that are taken from the code when the site is built.

A page has one line for a table: ``[rooms]`` for the contents of the packages' rooms, ``[addresses]`` for the
addresses of the service. What follows the name in the brackets says where the code has it.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
MARKER = re.compile(r"^\[(?P<name>rooms|addresses)(?:: [^\]\n]*)?\]$", flags=re.M)


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put the tables of a page into it."""
    return MARKER.sub(lambda match: f"\n{TABLES[match['name']]()}\n", markdown)


def rooms() -> str:
    """Return a table of the rooms of both packages: the first sentence of each docstring."""
    lines = ["| room | contents |", "|---|---|"]
    for package in ("graphtrack", "perception"):
        folders = (path.parent for path in (ROOT / package).glob("*/__init__.py"))
        modules = (path for path in (ROOT / package).glob("*.py") if not path.stem.startswith("__"))
        for path in sorted([*folders, *modules]):
            lines.append(f"| `{path.relative_to(ROOT)}{'/' if path.is_dir() else ''}` | {summary(path)} |")
    return "\n".join(lines)


def summary(path: Path) -> str:
    """Return the summary line of a package or module without its full stop."""
    source = path / "__init__.py" if path.is_dir() else path
    text = ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""
    return text.partition("\n")[0].rstrip(".").replace("``", "`").replace("|", r"\|")


def addresses() -> str:
    """Return a table of the addresses of the service, as its description has them."""
    from graphtrack.service.description import addresses as described

    lines = ["| method | address | content |", "|---|---|---|"]
    lines += [
        f"| {method} | `{path.replace('{name}', 'NAME')}` | {text.rstrip('.')} |"
        for method, path, text in described()
    ]
    return "\n".join(lines)


TABLES = {"rooms": rooms, "addresses": addresses}
