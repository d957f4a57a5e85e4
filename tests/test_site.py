"""The documentation site is built strictly, its links hold, and it has an entry for every public name."""

import os
import re
import subprocess
import sys
import tomllib
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import results
from documents import ROOT

import graphtrack

REFERENCE = "".join(
    path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs" / "reference").glob("*.md"))
)


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


class Loaded(HTMLParser):
    """Addresses that a browser loads by itself when it opens a page."""

    def __init__(self):
        super().__init__()
        self.addresses = []
        self.script = False

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag in ("img", "script"):
            self.addresses.append(given.get("src") or "")
        if tag == "link" and "stylesheet" in (given.get("rel") or ""):
            self.addresses.append(given["href"])
        self.script = tag == "script"

    def handle_endtag(self, tag):
        self.script = False

    def handle_data(self, data):
        if self.script:  # import … from "https://…" within a page
            self.addresses += re.findall(r"""\bimport\b[^;]*?["'](https?://[^"']+)""", data)


class Links(HTMLParser):
    """Targets of a page's links and pictures, and the anchors of the page."""

    def __init__(self):
        super().__init__()
        self.targets, self.anchors = [], set()

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        self.targets += [given[key] for key in ("href", "src") if given.get(key)]


@cache
def links(page: Path) -> Links:
    parser = Links()
    parser.feed(page.read_text(encoding="utf-8"))
    return parser


def broken(page: Path, site: Path) -> list[str]:
    """Links of a page to files or anchors that the site does not have."""
    found = []
    for target in links(page).targets:
        parts = urlsplit(target)
        if parts.scheme or parts.netloc or target.startswith("/"):  # of the page that no address has
            continue
        path = (page.parent / unquote(parts.path)).resolve() if parts.path else page
        path = path / "index.html" if path.is_dir() else path
        anchor = unquote(parts.fragment)
        if (
            not path.is_relative_to(site.resolve())
            or not path.exists()
            or (anchor and path.suffix == ".html" and anchor not in links(path).anchors)
        ):
            found.append(target)
    return found


@pytest.mark.slow
def test_every_link_of_the_site_leads_somewhere(site):
    """Those of notebooks, and of pages that are generated, too."""
    pages = sorted(site.resolve().rglob("*.html"))
    assert len(pages) > 50 and any("notebooks" in page.parts for page in pages)
    found = {str(page.relative_to(site.resolve())): broken(page, site) for page in pages}
    assert not {page: targets for page, targets in found.items() if targets}


def test_a_broken_link_of_a_built_page_is_found(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "index.html").write_text('<h1 id="there">A</h1>', encoding="utf-8")
    page = tmp_path / "index.html"
    page.write_text(
        '<a href="a/#there">1</a><a href="a/#gone">2</a><a href="b/">3</a><img src="c.png">', encoding="utf-8"
    )
    assert broken(page.resolve(), tmp_path) == ["a/#gone", "b/", "c.png"]


def test_the_site_has_commands_functions_and_pictures(site):
    commands = (site / "reference" / "commands" / "index.html").read_text(encoding="utf-8")
    assert "graphtrack smooth" in commands and "--homography" in commands and "perception adapt" in commands
    functions = (site / "reference" / "tracks" / "index.html").read_text(encoding="utf-8")
    assert "several, whose tracks are merged" in re.sub(r"\s+", " ", functions)
    model = re.sub(r"<[^>]+>", "", (site / "reference" / "model" / "index.html").read_text(encoding="utf-8"))
    assert re.search(r"Model\(\s*preset: str = (\"|&quot;)joint", model), "classes have their signatures"
    assert len(list((site / "gallery").glob("*.png"))) >= 10
    gallery = (site / "gallery" / "index.html").read_text(encoding="utf-8")
    cards = gallery[gallery.index('class="grid cards gallery"') : gallery.index("<h2")]
    assert len(re.findall(r"<img ", cards)) == len(list((ROOT / "notebooks").glob("*.ipynb")))
    assert (site / "notebooks" / "01-smoothing" / "index.html").exists()


def test_the_reference_has_choices_ranges_and_descriptions_in_place_of_references(site):
    def text(page):
        found = re.sub(r"<[^>]+>", "", (site / page / "index.html").read_text(encoding="utf-8"))
        return re.sub(r"\s+", " ", found)

    commands = text("reference/commands")
    assert "--units m, cm, mm, ft Unit of the lengths." in commands
    assert "--port integer, 0 to 65535" in commands and "--jobs integer, from 1" in commands
    for page in ("reference/smoothing", "reference/association", "reference/behaviour"):
        assert not re.search(
            r"– as (?:in|of|for) (?:solve|smooth|OnlineSmoother|OnlineGroups)\b", text(page)
        ), page


def test_every_page_has_the_version_and_its_neighbours(site):
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    for page in ("report", "results", "how-to/video"):
        shown = (site / page / "index.html").read_text(encoding="utf-8")
        assert f"graphtrack {version}" in shown
        assert "md-footer__link--prev" in shown and "md-footer__link--next" in shown
    home = (site / "index.html").read_text(encoding="utf-8")
    assert "pip install" in re.sub("<[^>]*>", "", home)


def test_pages_of_results_have_the_tables_of_the_data(site):
    paths = [*site.glob("results/**/index.html"), site / "papers" / "index.html"]
    pages = [path.read_text(encoding="utf-8") for path in paths]
    assert len(pages) > 5 and not any(re.search(r"\[(?:table|setting) ", page) for page in pages)
    tables = [results.block(name) for name in results.specs() if name not in results.NO_TABLES]
    assert sum(page.count("<table>") for page in pages) >= len(tables) - 1  # one is README's
    filters = (site / "results" / "filters" / "index.html").read_text(encoding="utf-8")
    cell = results.block("weight").splitlines()[2].split("|")[4]
    assert f"<td>{cell}</td>" in filters


def test_pages_have_the_tables_of_the_code(site):
    rooms = (site / "architecture" / "index.html").read_text(encoding="utf-8")
    assert "<td><code>graphtrack/association/</code></td>" in rooms and "[rooms" not in rooms
    service = (site / "serve" / "index.html").read_text(encoding="utf-8")
    assert "<td><code>/v1/streams/NAME</code></td>" in service and "[addresses" not in service


@pytest.mark.slow
def test_pages_load_nothing_from_elsewhere(site):
    pages = sorted(site.rglob("index.html"))
    assert len(pages) > 50
    for page in pages:
        parser = Loaded()
        parser.feed(page.read_text(encoding="utf-8"))
        assert not [one for one in parser.addresses if re.match(r"(\w+:)?//", one)], page


def test_equations_are_typeset_without_a_script(site):
    page = (site / "model" / "motion" / "index.html").read_text(encoding="utf-8")
    assert page.count("<math") > 10 and 'display="block"' in page
    for text in site.glob("model/**/index.html"):
        assert "arithmatex" not in text.read_text(encoding="utf-8"), text


def test_every_section_has_a_page(site):
    assert "Baxter" in (site / "references" / "index.html").read_text(encoding="utf-8")
    index = (site / "reference" / "index.html").read_text(encoding="utf-8")
    for page in ("commands", "parameters", "tracks", "smoothing", "model", "perception"):
        assert f'href="{page}/"' in index


def test_search_finds_the_projects_own_files(site):
    index = (site / "search" / "search_index.json").read_text(encoding="utf-8")
    for page in ("changelog", "citing", "contributing", "licence", "security"):
        assert f'"project/{page}/' in index
    citing = (site / "project" / "citing" / "index.html").read_text(encoding="utf-8")
    assert "baxter2014" in citing and "chen2011" in citing


def test_figures_are_marked_for_dark_mode_and_photographs_are_not(site):
    model = (site / "model" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'<img data-figure[^>]*src="../images/factor_graph.png"', model)
    notebook = (site / "notebooks" / "04-gait" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'<img data-figure[^>]*src="data:image/png', notebook)
    photographs = (site / "perception" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'<img (?!data-figure)[^>]*src="../images/\w+.jpg"', photographs)
    style = (site / "stylesheets" / "site.css").read_text(encoding="utf-8")
    assert "stylesheets/site.css" in model
    assert re.search(r"slate.*img\[data-figure\] \{ filter:", style)


def test_wide_code_wraps_and_wide_tables_scroll(site):
    style = (site / "stylesheets" / "site.css").read_text(encoding="utf-8")
    assert re.search(r"pre > code,[^}]*white-space: pre-wrap", style)
    assert re.search(r"__table \{[^}]*overflow-x: auto", style)


def test_every_public_name_has_an_entry():
    found = re.findall(r"^::: graphtrack\.(\w+)$", REFERENCE, flags=re.M)
    assert sorted(found) == sorted(graphtrack.__all__)


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
