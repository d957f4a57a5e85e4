"""Names and docstrings in the field's terms: words that readers had to translate do not come back."""

import ast
import io
import re
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODULES = sorted(path for name in ("graphtrack", "perception") for path in (ROOT / name).rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

NAMES = {
    *("told", "tell", "tells", "said", "say", "says"),  # report, emit
    *("foresee", "foretell", "foretold"),  # predict
    *("stated", "stating"),  # calibrated covariance
    *("sway", "who", "whom", "whoever", "seen", "beside", "anew", "mend", "mended", "restart", "late"),
    *("looks", "whole", "marks", "ones", "others"),  # appearance or gaze, offline, the noun that is meant
}
OF_OTHERS = {"ones", "ones_like", "tell", "_BYTE_ORDER_MARKS"}  # NumPy, files, Unicode
WORDS = re.compile(
    r"\b(?:whoever|foretell|foretold|thereof|anew|who is who|mend|mended|made-up|beside)\b", re.IGNORECASE
)
QUESTIONS = ("What", "Whether", "How", "Where", "Who", "Whoever")


def words(name):
    return {part.lower() for part in re.split(r"_|(?<=[a-z])(?=[A-Z])", name)}


def text_of(path):
    return path.read_text(encoding="utf-8")


def findings(path):
    """What a reader would have to translate in a module: names, text, first words of docstrings."""
    tokens = list(tokenize.generate_tokens(io.StringIO(text_of(path)).readline))
    for name in {token.string for token in tokens if token.type == tokenize.NAME} - OF_OTHERS:
        if words(name) & NAMES:
            yield name
    for token in tokens:
        if token.type in (tokenize.STRING, tokenize.COMMENT):
            yield from (f"line {token.start[0]}: {word}" for word in WORDS.findall(token.string))
    for node in ast.walk(ast.parse(text_of(path))):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = (ast.get_docstring(node) or "-").split()[0]
            if first in QUESTIONS:
                yield f"{getattr(node, 'name', 'module')}: {first}"


def test_modules_and_pages_use_the_terms_of_the_field():
    found = {path: list(findings(path)) for path in MODULES} | {p: WORDS.findall(text_of(p)) for p in PAGES}
    assert len(found) > 300
    assert not {str(path.relative_to(ROOT)): words for path, words in found.items() if words}
