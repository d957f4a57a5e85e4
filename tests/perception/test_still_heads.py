"""Identification of pans of still heads, as in Ba & Odobez 2003, Tables 1 to 3."""

from collections.abc import Mapping
from itertools import product

import numpy as np
import pytest

from graphtrack.experiments.harness import Settings, Table
from perception.experiments import still_heads as experiment
from perception.experiments.still_heads import (
    CONDITIONS,
    CONFUSION,
    FORMS,
    PANS,
    SplitJob,
    StillHeads,
    conditions,
    neighbour_table,
    rates,
    recognition,
    run_splits,
    still_heads,
)
from perception.pose.classes import PoseClasses
from perception.pose.exemplars import Exemplars
from perception.synthetic.raycast import Light

KINDS = len(PANS)


@pytest.fixture(scope="module")
def heads() -> StillHeads:
    """Synthetic features: a centre for each pan, and noise of each person and of each head."""
    rng = np.random.default_rng(0)
    centre = rng.normal(0.0, 1.0, (KINDS, 764))
    person = rng.normal(0.0, 1.0, (10, 1, 764))
    features = (centre + person + rng.normal(0.0, 1.0, (10, KINDS, 764))).reshape(-1, 764)
    return StillHeads(dict.fromkeys(FORMS, features), 10)


def test_a_split_is_what_a_classifier_of_half_the_people_says(heads: StillHeads) -> None:
    (found,) = run_splits(SplitJob(heads, (2,), ((5, 0),)))
    train = np.random.default_rng((5, 0)).permutation(10)[:5]
    learned = np.isin(np.arange(10 * KINDS) // KINDS, train)
    labels = np.arange(10 * KINDS) % KINDS
    for density, (form, plain) in product(("gaussian", "saturated"), FORMS.items()):
        model = Exemplars(PoseClasses.half_circle(), exemplars=2, density=density, plain=plain)
        features = heads.features[form]
        model.fit_features(features[learned], labels[learned], np.random.default_rng(0))
        said = model.scores(features[~learned]).argmax(axis=1)
        expected = np.zeros((KINDS, KINDS), np.int64)
        np.add.at(expected, (labels[~learned], said), 1)
        np.testing.assert_array_equal(found[form, density, 2], expected)


def test_splits_do_not_depend_on_how_they_are_divided_among_processes(
    heads: StillHeads, monkeypatch: pytest.MonkeyPatch
) -> None:
    together = recognition(heads, (1,), (3,), 4, processes=1)
    monkeypatch.setattr(experiment, "_CHUNK", 1)
    apart = recognition(heads, (1,), (3,), 4, processes=1)
    for key, found in together.items():
        np.testing.assert_array_equal(found, apart[key])
        assert (found.sum(axis=2) == 5).all()  # five test people at each pan


def test_rates_are_shares_of_the_diagonal() -> None:
    confusion = np.stack([np.eye(3, dtype=np.int64), np.ones((3, 3), np.int64)])
    np.testing.assert_allclose(rates(confusion), [100.0, 100.0 / 3.0])


def test_harder_heads_differ_in_every_condition() -> None:
    studio, harder = CONDITIONS["studio"], CONDITIONS["harder"]
    assert studio == conditions(0.0) and studio.pan == studio.tilt == studio.variation.shade == 0.0
    for name in ("offset", "scale", "roll", "elevation", "blur", "shade"):
        assert getattr(harder.variation, name) != getattr(studio.variation, name), name
    assert harder.pan > 0.0 and harder.tilt > 0.0


def test_shade_moves_light_from_all_around_to_one_side() -> None:
    light = Light.above(0.3, 0.8, (0.5, 0.4, 0.3), (0.6, 0.5, 0.4))
    assert light.shaded(0.0) == light
    dark = light.shaded(0.25)
    np.testing.assert_allclose(dark.key, 1.25 * np.array(light.key))
    np.testing.assert_allclose(dark.ambient, 0.75 * np.array(light.ambient))
    assert dark.direction == light.direction


@pytest.mark.slow
def test_the_tables_have_numbers_and_the_papers_next_to_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def small(people: int, how: object, rng: np.random.Generator) -> StillHeads:
        return render(12, how, rng)

    render = StillHeads.render
    monkeypatch.setattr(StillHeads, "render", small)
    named, claims, confused, errors = still_heads(Settings(quick=True))
    for row in named.records():
        assert 20.0 < _number(row, "ours (%)") <= 100.0  # by chance: 11
        assert 0.0 <= _number(row, "as printed: deviation") < 50.0
    assert {row["heads"] for row in claims.records()} == set(CONDITIONS)
    for row in claims.records():
        assert _number(row, "ours: low") <= _number(row, "ours (points)") <= _number(row, "ours: high")
    for row in confused.records():
        assert sum(_number(row, f"{pan:g}") for pan in PANS) == pytest.approx(100.0, abs=0.5)

    assert [row["of"] for row in errors.records()] == ["paper", "ours, studio", "ours, harder"]


def test_the_papers_errors_all_fall_on_a_neighbouring_pan() -> None:
    rows = [
        {
            "true pan (°)": pan,
            "of": "paper",
            **{f"{p:g}": value for p, value in zip(PANS, found, strict=True)},
        }
        for pan, found in zip(PANS, CONFUSION.tolist(), strict=True)
    ]
    (row,) = neighbour_table(Table.of("paper", rows)).records()
    assert row["errors on a neighbouring pan (%)"] == pytest.approx(100.0)
    assert (row["right, least (%)"], row["right, greatest (%)"]) == (85.3, 100.0)


def _number(row: Mapping[str, object], column: str) -> float:
    value = row[column]
    assert isinstance(value, float)
    return value
