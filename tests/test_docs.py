"""The commands of the other documents run as printed, each document in an empty folder from top to bottom."""

import re

import pytest
from documents import ROOT, blocks, run

PAGES = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").glob("*.md"))
WITH_COMMANDS = [page for page in PAGES if any(block.kind == "sh" for block in blocks(page))]


def test_commands_stand_where_they_are_run():
    assert {"docs/perception.md", "docs/trackers.md"} <= set(WITH_COMMANDS)
    for page in PAGES:  # and not in blocks of another kind
        text = (ROOT / page).read_text(encoding="utf-8")
        assert not re.findall(r"^    (?:graphtrack|perception) .*", text, flags=re.M), page


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_commands_of_a_page_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(blocks(page), {}, slow=True)
