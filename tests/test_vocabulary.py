"""Names and docstrings in the field's terms: words that readers had to translate do not come back."""

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted(path for name in ("graphtrack", "perception") for path in (ROOT / name).rglob("*.py"))

NAMES = {
    *("told", "tell", "tells", "said", "say", "says"),  # report, emit
    *("foresee", "foretell", "foretold"),  # predict
    *("stated", "stating"),  # calibrated covariance
    *("sway", "who", "whom", "whoever", "seen", "beside", "anew", "mend", "mended", "restart", "late"),
    *("looks", "whole", "marks", "ones", "others"),  # appearance or gaze, offline, the noun that is meant
}
OF_OTHERS = {"ones", "ones_like", "tell", "_BYTE_ORDER_MARKS"}  # NumPy, files, Unicode
TEXT = (
    "whoever",
    "foretell",
    "foretold",
    "thereof",
    "anew",
    "who is who",
    "mend",
    "mended",
    "made-up",
    "beside",
)
QUESTIONS = ("What", "Whether", "How", "Where", "Who", "Whoever")


def words(name):
    return {part.lower() for part in re.split(r"_|(?<=[a-z])(?=[A-Z])", name)}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_uses_the_terms_of_the_field(path):
    source = path.read_text(encoding="utf-8")
    tokens = list(tokenize.generate_tokens(io.StringIO(source).readline))
    names = {token.string for token in tokens if token.type == tokenize.NAME} - OF_OTHERS
    assert not sorted(name for name in names if words(name) & NAMES)
    texts = [token for token in tokens if token.type in (tokenize.STRING, tokenize.COMMENT)]
    found = [
        f"line {token.start[0]}: {word}"
        for token in texts
        for word in TEXT
        if re.search(rf"\b{word}\b", token.string, re.IGNORECASE)
    ]
    assert not found
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = (ast.get_docstring(node) or "-").split()[0]
            assert first not in QUESTIONS, f"{getattr(node, 'name', 'module')}: {first}"


@pytest.mark.parametrize(
    "path", [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))], ids=lambda path: path.name
)
def test_a_page_uses_the_terms_of_the_field(path):
    text = path.read_text(encoding="utf-8").lower()
    assert not [word for word in TEXT if re.search(rf"\b{word}\b", text)]
