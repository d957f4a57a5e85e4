"""Show every picture of the notebooks on one page, when the site is built."""

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


@dataclass(frozen=True)
class Picture:
    """A picture of a notebook, and the heading that it stands under."""

    heading: str
    png: bytes


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page and its pictures."""
    lines = [f"# {TITLE}", "", "What the notebooks draw, each picture beside the code that made it.", ""]
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        title = notebook.cells[0].source.splitlines()[0].lstrip("# ")
        lines += [f"## {title}", "", f"[The notebook](notebooks/{path.name})", ""]
        heading = ""
        for k, picture in enumerate(pictures(notebook)):
            name = f"gallery/{path.stem}-{k}.png"
            files.append(File.generated(config, name, content=picture.png))
            if picture.heading != heading:
                lines += [f"### {picture.heading}", ""]
            heading = picture.heading
            lines += [f"![{picture.heading}]({name})", ""]
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
