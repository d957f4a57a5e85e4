"""`make claims` finds the numbers that the pages state, and reports wrong ones."""

from pathlib import Path

import pytest
from claim import Claim, Results, Shown, numbers
from documents import ROOT
from stated import CLAIMS

from graphtrack.experiments import all_experiments

PAGE = """
| method | error |
|---|---|
| `one`, *fitted* | 1.25 (−0.5 … 1,200) |
| two | < −1,000 |

It is 12.5 % better
than the other.
"""
TABLES = [
    {"title": "Errors of all", "columns": ["method", "error (m)"], "rows": [["one", 1.254], ["two", -2e3]]}
]


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim.page} {claim.header or claim.labels}")
def test_the_page_has_the_numbers_that_are_compared(claim: Claim) -> None:
    shown = claim.shown(ROOT)
    assert shown and all(shown.values())
    assert claim.command.split()[0] in all_experiments() or claim.command.startswith("perception evaluate ")


def test_numbers_are_read_as_pages_write_them() -> None:
    assert numbers("**0.65** – 1,200, −3 (< −1,000)") == [
        Shown(0.65, 0.01),
        Shown(1200.0, 1.0),
        Shown(-3.0, 1.0),
        Shown(-1000.0, 1.0, is_bound=True),
    ]


def claim_of(error: float, text: float = 12.5) -> list[Claim]:
    def table(results: Results) -> dict[str, list[float | None]]:
        assert results.row("Errors", method="one")["error (m)"] == 1.254
        return {"one, fitted": [error, -0.5, None], "two": [results.row("Errors", method="two")["error (m)"]]}

    said = "It is {} % better than"
    return [
        Claim("page.md", "errors", table, "| method |"),
        Claim("page.md", "errors", lambda results: {said: [text]}, labels=(said,)),
    ]


@pytest.mark.parametrize(
    ("error", "text", "held"), [(1.254, 12.46, True), (1.27, 12.5, False), (1.25, 12.7, False)]
)
def test_what_was_measured_is_compared_to_the_last_place(
    error: float, text: float, held: bool, tmp_path: Path
) -> None:
    (tmp_path / "page.md").write_text(PAGE, encoding="utf-8")
    rows = [row for claim in claim_of(error, text) for row in claim.compare(Results(TABLES), tmp_path)]
    assert len(rows) == 4 and all(holds for *_, holds in rows) == held
    (tmp_path / "page.md").write_text(PAGE.replace("| two", "| three"), encoding="utf-8")
    with pytest.raises(LookupError, match="no line 'two'"):
        claim_of(1.25)[0].compare(Results(TABLES), tmp_path)


def test_a_label_may_have_several_cells(tmp_path: Path) -> None:
    lines = "| model | Hz | error |\n|---|---|---|\n| `full` | 10 | 1.5 (95) |\n| `full` | 2.5 | 2.5 (90) |\n"
    (tmp_path / "page.md").write_text(lines, encoding="utf-8")
    claim = Claim("page.md", "errors", lambda results: {}, "| model |", cells=2)
    assert claim.shown(tmp_path) == {
        "full | 10": [Shown(1.5, 0.1), Shown(95.0, 1.0)],
        "full | 2.5": [Shown(2.5, 0.1), Shown(90.0, 1.0)],
    }
