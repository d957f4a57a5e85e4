"""Make notebooks pages of the site, whose links lead to pages and which load nothing from elsewhere."""

from __future__ import annotations

import posixpath
import re

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

LINK = re.compile(r'href="(?P<path>[^"#:]+\.(?:md|ipynb))(?P<anchor>#[^"]*)?"')
REMOTE = re.compile(r"<script[^>]*>(?:(?!</script>).)*https://cdnjs(?:(?!</script>).)*</script>", flags=re.S)
"""A script that fetches another one, for diagrams that no notebook has."""


def on_page_content(content: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Rewrite the links of a notebook and leave out scripts that load others."""
    source = page.file.src_uri
    if not source.endswith(".ipynb"):
        return content

    def rewritten(found: re.Match[str]) -> str:
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), found["path"]))
        file = files.get_file_from_path(path.removeprefix("docs/"))
        if file is None:
            raise ValueError(f"{source}: no page for the link to {found['path']}")
        return f'href="{file.url_relative_to(page.file)}{found["anchor"] or ""}"'

    return LINK.sub(rewritten, REMOTE.sub("", content))
