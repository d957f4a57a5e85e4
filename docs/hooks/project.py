"""Take the public addresses from pyproject.toml, and show the project's own files as pages of the site."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "SECURITY.md": "project/security.md",
    "LICENSE": "project/licence.md",
    "CITATION.cff": "project/citing.md",
}
"""File of the repository → page of the site."""
LINK = re.compile(r"\]\((?!\w+:|#)(?P<path>[^)#\s]+)(?P<anchor>#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Set the version, and the addresses of site and repository where ``[project.urls]`` has them."""
    metadata = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    addresses = metadata.get("urls", {})
    # In the header of every page.
    config.site_name = f"{metadata['name']} {metadata['version']}"
    config.site_url = addresses.get("Documentation", config.site_url)
    config.repo_url = addresses.get("Repository", config.repo_url)
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each file."""
    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        if name == "LICENSE":
            text = "# Licence\n\n" + text
        elif name == "CITATION.cff":
            text = citing(yaml.safe_load(text))
        files.append(File.generated(config, page, content=LINK.sub(_link, text)))
    return files


def _link(found: re.Match[str]) -> str:
    path, anchor = found["path"], found["anchor"] or ""
    if path in PAGES:
        return f"]({Path(PAGES[path]).name}{anchor})"
    place = path.removeprefix("docs/")
    return f"](../{place}{anchor})"


def citing(citation: dict) -> str:
    """Return a page with a BibTeX entry for the program and for each paper."""
    entries = [entry("software", "graphtrack", citation)]
    entries += [entry(one["type"], key(one), one) for one in citation["references"]]
    shown = "\n\n".join(f"```bibtex\n{one}\n```" for one in entries)
    return f"# Citing\n\n{citation['message']}\n\n{shown}\n"


def key(work: dict) -> str:
    """Return the name by which a work is cited: author and year."""
    return work["authors"][0]["family-names"].lower() + str(work["year"])


def entry(kind: str, name: str, work: dict) -> str:
    """Return a BibTeX entry of a work of ``CITATION.cff``."""
    types = {"article": "article", "conference-paper": "inproceedings", "report": "techreport"}
    authors = " and ".join(
        f"{{{one['name']}}}" if "name" in one else f"{one['family-names']}, {one['given-names']}"
        for one in work["authors"]
    )
    fields = {
        "title": f"{{{work['title']}}}",
        "author": authors,
        "year": work.get("year"),
        "booktitle": work.get("collection-title"),
        "number": work.get("number"),
        "version": work.get("version"),
    }
    lines = [f"  {field} = {{{value}}}," for field, value in fields.items() if value is not None]
    return "\n".join([f"@{types.get(kind, 'software')}{{{name},", *lines, "}"])
