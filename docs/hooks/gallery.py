"""Show the pictures of the notebooks on one page of the site: one of each at the front, then all."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
TITLE = "Gallery"
FRONT: dict[str, int] = {}
"""Notebook → which of its pictures stands at the front, where it is not the first."""


@dataclass(frozen=True)
class Picture:
    """A picture of a notebook, and the heading that it stands under."""

    heading: str
    png: bytes


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page and its pictures."""
    cards, sections = ['<div class="grid cards gallery" markdown>', ""], []
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        title = notebook.cells[0].source.splitlines()[0].lstrip("# ")
        found, names = list(pictures(notebook)), []
        for k, picture in enumerate(found):
            names.append(f"gallery/{path.stem}-{k}.png")
            files.append(File.generated(config, names[-1], content=picture.png))
        link = f"notebooks/{path.name}"
        front = names[FRONT.get(path.stem, 0)]
        cards += [f"- [![{title}]({front})]({link})", "", f"    **[{title}]({link})**", ""]
        sections += [f"## {title}", "", f"[The notebook]({link})", ""]
        heading = ""
        for picture, name in zip(found, names, strict=True):
            if picture.heading != heading:
                sections += [f"### {picture.heading}", ""]
            heading = picture.heading
            sections += [f"![{picture.heading}]({name})", ""]
    lines = ["---", "hide: [toc]", "---", "", f"# {TITLE}", "", *cards, "</div>", "", *sections]
    files.append(File.generated(config, "gallery.md", content="\n".join(lines)))
    return files


def pictures(notebook: nbformat.NotebookNode) -> Iterator[Picture]:
    """All pictures that cells show, in their order."""
    heading = ""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            heads = [line.lstrip("# ") for line in cell.source.splitlines() if line.startswith("#")]
            heading = heads[-1] if heads else heading
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                yield Picture(heading, base64.b64decode(output["data"]["image/png"]))
