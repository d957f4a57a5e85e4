"""Docstrings: their examples run, and the reference has each parameter's own type and default."""

import doctest
import re
from importlib import import_module

import griffe
import pytest
from documents import ROOT

ENTRIES = re.findall(
    r"^::: ([\w.]+)$",
    "".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs/reference").glob("*.md"))),
    flags=re.M,
)
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for package in ("graphtrack", "perception")
    for path in (ROOT / package).rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_examples_run(module):
    found = doctest.testmod(import_module(module))
    assert found.attempted and not found.failed


@pytest.fixture(scope="module")
def packages():
    """The packages as the reference sees them."""
    extensions = griffe.load_extensions(str(ROOT / "docs" / "hooks" / "docstrings.py"))
    loader = griffe.GriffeLoader(extensions=extensions, docstring_parser="numpy", search_paths=[ROOT])
    found = {name: loader.load(name) for name in ("graphtrack", "perception")}
    loader.resolve_aliases()
    return found


def with_members(entry):
    """A function or class, and those in it."""
    yield entry
    if entry.is_class:
        for member in entry.members.values():
            if not member.is_alias and (member.is_function or member.is_class):
                yield from with_members(member)


def sections(entry, kind):
    parsed = [] if entry.docstring is None else entry.docstring.parse("numpy")
    return [item for section in parsed if section.kind.value == kind for item in section.value]


def test_each_parameter_has_its_own_type_and_default(packages):
    assert len(ENTRIES) > 50
    checked, wrong = 0, []
    for entry in ENTRIES:
        package, _, path = entry.partition(".")
        found = packages[package][path]
        for one in with_members(found.final_target if found.is_alias else found):
            for item in sections(one, "parameters"):
                own = one.parameters[item.name.lstrip("*")]
                checked += 1
                if (str(item.annotation), str(item.default)) != (str(own.annotation), str(own.default)):
                    wrong.append(f"{one.path}({item.name}: {item.annotation} = {item.default})")
            for item in sections(one, "attributes"):
                own = one.members.get(item.name)
                checked += 1
                if own is not None and own.is_attribute and str(item.annotation) != str(own.annotation):
                    wrong.append(f"{one.path}.{item.name}: {item.annotation}")
    assert checked > 300 and not wrong
