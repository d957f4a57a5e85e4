"""Mark pictures that are drawn on white, which the style sheet inverts in dark mode; photographs are left."""

from __future__ import annotations

import base64
import posixpath
import re
from typing import Any

import cv2
import numpy as np
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

IMAGE = re.compile(r'<img(?P<before>[^>]*?)\ssrc="(?P<source>[^"]+)"', flags=re.S)
LEAST_WHITE = 0.4
"""Share of white pixels from which a picture is a figure."""

_files: dict[str, Any] = {}


def on_env(env: Any, *, config: MkDocsConfig, files: Files) -> Any:
    """Keep the files of the site, by their addresses."""
    _files.update({posixpath.normpath(file.url): file for file in files})
    return env


def on_post_page(output: str, *, page: Page, config: MkDocsConfig) -> str:
    """Give every figure of a page the attribute ``data-figure``."""

    def marked(found: re.Match[str]) -> str:
        content = _content(found["source"], page.url)
        if content is None or not is_figure(content):
            return found[0]
        return f'<img data-figure{found["before"]} src="{found["source"]}"'

    return IMAGE.sub(marked, output)


def is_figure(content: bytes) -> bool:
    """Return whether most pixels of an encoded image are white."""
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    return image is not None and float((image.min(axis=2) > 240).mean()) >= LEAST_WHITE


def _content(source: str, page: str) -> bytes | None:
    if source.startswith("data:image/png;base64,"):
        return base64.b64decode(source.split(",", 1)[1])
    file = _files.get(posixpath.normpath(posixpath.join(page, source)))
    return file.content_bytes if file is not None else None
