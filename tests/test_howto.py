"""The guide's commands and Python run as printed, each page in an empty folder from top to bottom."""

import pytest
from costs import build_graph
from documents import ROOT, blocks, run

import graphtrack as gt
from graphtrack.inference.chain.initialisation import initial_states
from graphtrack.model.observation import chain

PAGES = ["docs/start.md", *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("docs/how-to/*.md"))]


def test_there_is_a_page_for_each_task():
    names = {page.rpartition("/")[2].removesuffix(".md") for page in PAGES}
    tasks = {
        "smooth-tracks",
        "detections-to-tracks",
        "video",
        "live",
        "view",
        "groups",
        "forecasts",
        "own-format",
    }
    assert tasks | {"own-term", "own-method", "robots"} <= names


@pytest.mark.parametrize("page", [page for page in PAGES if not page.endswith(("own-term.md", "start.md"))])
def test_a_page_runs(page, cwd):
    run(blocks(page), {}, slow=False)


def test_the_tutorial_ends_with_estimates_in_the_gap_and_a_picture(cwd):
    names = {}
    run(blocks("docs/start.md"), names, slow=False)
    assert len(names["walks"]) == 2 * 110 and [len(person) for person in names["smoothed"]] == [120, 120]
    person = names["smoothed"][1]
    inside, outside = person.std("x")[55], person.std("x")[30]
    assert inside > 1.4 * outside
    assert (cwd / "walks.png").stat().st_size > 10_000
    assert (cwd / "report.html").exists() and (cwd / "smoothed.csv").exists()


def test_the_term_of_ones_own_has_factors_of_its_density(cwd):
    names = {}
    run(blocks("docs/how-to/own-term.md"), names, slow=False)
    assert names["solution"].converged and names["solution"].engine == "gtsam"
    track = names["noisy"][1]
    with_term, without = names["model"], gt.Model("joint")
    states = initial_states(track, without)

    def graph_cost(model):
        graph, values = build_graph(chain(track), model, states)
        return graph.error(values)

    density = with_term.cost(states, track) - without.cost(states, track)
    assert density > 0.0 and graph_cost(with_term) - graph_cost(without) == pytest.approx(density)
