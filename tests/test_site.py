"""The documentation site is built strictly, and says something of every public name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from documents import ROOT

import graphtrack

REFERENCE = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")


def build(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(folder), *options]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(command, cwd=ROOT, env=quiet, capture_output=True, text=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def test_the_site_has_commands_functions_and_pictures(site):
    commands = (site / "reference" / "commands" / "index.html").read_text(encoding="utf-8")
    assert "graphtrack smooth" in commands and "--homography" in commands and "perception adapt" in commands
    functions = (site / "reference" / "python" / "index.html").read_text(encoding="utf-8")
    assert "several whose tracks are merged" in re.sub(r"\s+", " ", functions)
    assert len(list((site / "gallery").glob("*.png"))) >= 10
    assert (site / "notebooks" / "01-smoothing" / "index.html").exists()
    index = (site / "reference" / "index.html").read_text(encoding="utf-8")
    assert all(f'href="{page}/"' in index for page in ("commands", "python", "model", "perception"))
    assert "Baxter" in (site / "references" / "index.html").read_text(encoding="utf-8")


def test_pages_of_the_guide_load_nothing_from_elsewhere(site):
    # Notebooks bring MathJax and their kind along; the guide and the reference do not.
    pages = [site / "index.html", *site.glob("how-to/*/index.html"), *site.glob("reference/*/index.html")]
    assert len(pages) > 10
    loaded = r'<(?:img|script)\b[^>]*\ssrc="([^"]*)"|<link\b[^>]*\brel="[^"]*stylesheet[^>]*\shref="([^"]*)"'
    for page in pages:
        addresses = [one for both in re.findall(loaded, page.read_text(encoding="utf-8")) for one in both]
        assert any(addresses) and not [one for one in addresses if "//" in one], page


def test_figures_turn_dark_photographs_do_not_and_wide_code_wraps(site):
    front = (site / "index.html").read_text(encoding="utf-8")
    assert re.search(r'<img data-figure[^>]*src="images/demo.png"', front)
    notebook = (site / "notebooks" / "04-gait" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'<img data-figure[^>]*src="data:image/png', notebook)
    photographs = (site / "perception" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'<img (?!data-figure)[^>]*src="../images/observed.jpg"', photographs)
    style = (site / "stylesheets" / "site.css").read_text(encoding="utf-8")
    assert "stylesheets/site.css" in front and re.search(r"slate.*img\[data-figure\] \{ filter:", style)
    assert re.search(r"pre > code,[^}]*white-space: pre-wrap", style)
    assert re.search(r"__table \{[^}]*overflow-x: auto", style)


def test_every_public_name_has_an_entry():
    assert set(re.findall(r"^::: graphtrack\.(\w+)$", REFERENCE, flags=re.M)) == set(graphtrack.__all__)


def test_a_broken_link_fails(tmp_path):
    page = tmp_path / "docs" / "index.md"
    page.parent.mkdir()
    page.write_text("[nowhere](nowhere.md)\n", encoding="utf-8")
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    validation = settings[settings.index("validation:") : settings.index("nav:")]
    path = tmp_path / "mkdocs.yml"
    path.write_text(f"site_name: small\nstrict: true\n{validation}", encoding="utf-8")
    done = build(tmp_path / "site", "--config-file", str(path))
    assert done.returncode and "nowhere.md" in done.stderr
