"""The methods paragraph, its references, and the version that is cited."""

import tomllib
from pathlib import Path

import pytest
import yaml
from command import run
from documents import ROOT

import graphtrack as gt
from graphtrack.model import Model
from graphtrack.model.model import presets
from graphtrack.report.methods import _ENGINES, REFERENCES, methods_text
from graphtrack.tracks.track import ReadSummary


def test_the_cited_version_is_that_of_the_package() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["version"] == project["version"]
    done = run("cite", "--bibtex", program="graphtrack")
    assert f"version = {{{gt.__version__}}}" in done.stdout and citation["title"] in done.stdout


def test_papers_of_the_citation_file_are_cited_in_the_same_words() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    works = {one.cited: one.work for one in REFERENCES.values()}
    for paper in citation["references"]:
        first = paper["authors"][0]["family-names"]
        same = [
            work for cited, work in works.items() if cited.startswith(first) and str(paper["year"]) in cited
        ]
        assert all(paper["title"] in work for work in same)


@pytest.mark.parametrize("preset", presets)
@pytest.mark.parametrize("engine", _ENGINES)
def test_every_preset_and_engine_has_a_text_whose_references_are_listed(preset: str, engine: str) -> None:
    text, works = methods_text(Model(preset), engine)
    assert "{" not in text and f"The preset is {preset} with" in text
    assert all(one.cited in text for one in works)
    assert {one.cited for one in REFERENCES.values() if one.cited in text} == {one.cited for one in works}


def test_what_was_refused_and_changed_is_in_the_text() -> None:
    model = Model.from_dict({"preset": "joint", "motion": {"acceleration_density": 0.7}})
    summary = ReadSummary("csv", 12, {"without a position": 3, "repeated": 0})
    text, _ = methods_text(model, "chain", constants="the defaults", summary=summary, failed=2)
    assert "motion.acceleration_density=0.7" in text and "default parameters" not in text
    assert "Of 12 rows of the input (csv) 9 were used; refused were 3 without a position." in text
    assert "2 tracks had no estimate and were left out." in text


def test_the_report_of_a_run_has_the_paragraph_with_learned_constants(cwd: Path) -> None:
    made = run("simulate", "-o", "tracks.csv", "--tracks", "2", "--steps", "60", program="graphtrack")
    assert made.returncode == 0, made.stderr
    done = run("smooth", "tracks.csv", "-o", "out.csv", "--report", "page.html", program="graphtrack")
    assert done.returncode == 0, done.stderr
    page = Path("page.html").read_text(encoding="utf-8")
    assert "Methods, for a paper" in page and "each of 2 people were learned" in page
    assert f"graphtrack {gt.__version__} as a factor graph" in page
