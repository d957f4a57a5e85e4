"""The methods paragraph, its references, and the version that is cited."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml
from command import run
from documents import ROOT

import graphtrack as gt
from graphtrack.interaction.attention import attention
from graphtrack.model import Model
from graphtrack.model.model import presets
from graphtrack.report.interaction import behaviour_of
from graphtrack.report.methods import _ENGINES, BEHAVIOUR, REFERENCES, methods_section, methods_text
from graphtrack.report.page import tracking_report
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
    text, works = methods_text(Model(preset), engine, behaviour=BEHAVIOUR)
    assert (
        "groups" in text and "Gaze targets" in text and "Gaze" not in methods_text(Model(preset), engine)[0]
    )
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


@pytest.mark.slow
def test_the_report_of_a_run_has_the_paragraph_with_learned_constants(cwd: Path) -> None:
    made = run("simulate", "-o", "tracks.csv", "--tracks", "2", "--steps", "60", program="graphtrack")
    assert made.returncode == 0, made.stderr
    done = run("smooth", "tracks.csv", "-o", "out.csv", "--report", "page.html", program="graphtrack")
    assert done.returncode == 0, done.stderr
    page = Path("page.html").read_text(encoding="utf-8")
    assert "Methods, for a paper" in page and "each of 2 people were learned" in page
    assert f"graphtrack {gt.__version__} as a factor graph" in page


def test_entries_of_all_works_have_authors_titles_and_years() -> None:
    done = run("cite", "--bibtex", "--groups", program="graphtrack")
    text, _, entries = done.stdout.partition("@software")
    assert "Conversation groups" in text and "Gaze targets" not in text
    found = ("@software" + entries).split("\n@")
    assert len(found) == 1 + len([line for line in text.splitlines() if line.startswith("  ")]) > 4
    for entry in found:
        assert all(f"  {name} = {{" in entry for name in ("author", "title")), entry
        assert re.search(r"^  year = \{(19|20)\d\d\},$", entry, re.MULTILINE), entry
        assert entry.count("{") == entry.count("}")
    keys = [entry.partition("{")[2].partition(",")[0] for entry in found]
    assert len(set(keys)) == len(keys)


@pytest.mark.parametrize("attended", [True, False])
def test_pages_with_groups_and_gaze_say_how_they_were_found(attended: bool) -> None:
    tracks = gt.simulate("joint", n_tracks=2, n_steps=20, rng=np.random.default_rng(1))
    behaviour = behaviour_of(
        tracks, groups=gt.groups(tracks), attention=attention(tracks) if attended else None
    )
    before = methods_section(["Tracks were estimated."])
    for sections in ((), (before,)):
        page = tracking_report(tracks, behaviour=behaviour, sections=sections)
        (own,) = (one for one in page.sections if one.title == before.title)
        text = " ".join(note.text for note in own.items)
        assert ("Tracks were estimated." in text) == bool(sections)
        assert "Kendon 1990" in text and ("Gaze targets" in text) == attended
    assert all(one.title != before.title for one in tracking_report(tracks).sections)
