r"""Typeset equations: LaTeX between dollar signs becomes MathML, which browsers draw, in the built site.

`pymdownx.arithmatex` finds the equations and leaves them as ``\(…\)`` and ``\[…\]``; pages need no script.
"""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

EQUATION = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\(?:\(|\[)(?P<latex>.*?)\\(?:\)|\])</(?P=tag)>', flags=re.S
)


def on_page_content(content: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replace the equations of a page."""
    return EQUATION.sub(_typeset, content)


def _typeset(found: re.Match[str]) -> str:
    block = found["tag"] == "div"
    markup = convert(html.unescape(found["latex"]).strip(), display="block" if block else "inline")
    markup = markup.replace(r"\_", "_")  # names of parameters, which the converter leaves escaped
    return f'<div class="equation">{markup}</div>' if block else markup
