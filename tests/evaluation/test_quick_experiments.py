"""Long experiments on a few people: their tables, and properties of these."""

from __future__ import annotations

import numpy as np
import pytest

from graphtrack.experiments import Settings, baxter_weight, unseen_people
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour
from graphtrack.simulation.crowd import strollers

SETTINGS = Settings(quick=True)


def test_baxter_weight_fits_each_dependence_of_the_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    corpus = simulate_behaviour(4, CorpusParameters(tracks=3, steps=120), rng=SETTINGS.rng(0))
    first, *others = corpus.tracks()
    source = baxter_weight.Source("corpus", 2.5, [first], others)
    monkeypatch.setattr(baxter_weight, "sources", lambda settings: [source])
    monkeypatch.setattr(baxter_weight, "METHODS", ("intentional",))
    done: list[int] = []
    detail, beside = baxter_weight.EXPERIMENT.run(SETTINGS, done.append).tables
    weights = {row["weight"]: row for row in detail.records()}
    assert set(weights) == {"constant", "grows", "falls"} and len(done) > 6
    low, high = "λ at 0° (1/s)", "λ at 90° (1/s)"
    assert weights["constant"][low] == pytest.approx(weights["constant"][high])
    assert weights["grows"][low] < weights["grows"][high]
    assert weights["falls"][low] > weights["falls"][high]
    (row,) = beside.records()
    for weight in ("grows", "falls"):
        gain = weights[weight]["nats"] - weights["constant"]["nats"]
        assert row[f"{weight} − constant (nats)"] == pytest.approx(gain)


def test_unseen_people_fits_without_each_source(monkeypatch: pytest.MonkeyPatch) -> None:
    def people(seed: int):  # type: ignore[no-untyped-def]
        return lambda settings, stream: {
            "10 Hz": strollers(np.random.default_rng([seed, stream]), people=2, seconds=6.0)
        }

    sources = {name: people(k) for k, name in enumerate(("one", "other"))}
    free = unseen_people.FREE[:2]
    monkeypatch.setattr(unseen_people, "SOURCES", sources)
    monkeypatch.setattr(unseen_people, "FREE", free)
    monkeypatch.setattr(unseen_people, "FITTED", tuple(one.name for one in free))
    done: list[int] = []
    errors, summary, constants = unseen_people.EXPERIMENT.run(SETTINGS, done.append).tables
    models = (*unseen_people.PRESETS, "full, fitted without it")
    assert [(row["source"], row["model"]) for row in errors.records()] == [
        (source, model) for source in ("one", "other") for model in models
    ]
    assert all(0.0 < row["position (m)"] < 0.5 and row["body (°)"] < 90.0 for row in errors.records())
    assert len(summary.rows) == len(models) * len(sources)
    assert any(row["median"] != row["default"] for row in constants.records())
    for row in constants.records():
        assert row["least"] <= row["median"] <= row["greatest"]
        assert 0.2 * row["default"] < row["least"] and row["greatest"] < 5.0 * row["default"]
    assert len(done) >= len(sources) * 2
