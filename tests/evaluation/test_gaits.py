"""Gain from coupling modes: every method has the same people, noise and models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from graphtrack.experiments import Settings, gaits
from graphtrack.simulation.sampling import simulate


def test_every_way_is_scored_on_the_same_people(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = simulate("joint", n_tracks=4, n_steps=15, rng=np.random.default_rng(0))
    some = {gaits.ORDINARY: drawn, gaits.SIDEWAYS: drawn.with_tracks(drawn.tracks[:2])}
    monkeypatch.setattr(gaits, "people", lambda settings: some)
    monkeypatch.setattr(gaits, "DRAWS", 2)
    steps: list[int] = []
    expected: list[int] = []
    found = gaits.EXPERIMENT.run(Settings(), steps.append, expected.append)
    assert [sum(steps)] == expected
    errors, differences, rivals = (table.records() for table in found.tables)
    assert len(errors) == 2 * len(gaits.ESTIMATORS) * len(gaits.PRESETS)
    rows = {(row["people"], row[""], row["model"]): row for row in errors}
    for (who, way, preset), row in rows.items():
        count = 2 if who == gaits.SIDEWAYS or way != "offline" else 4
        assert (row["clips"], row["draws"]) == (count, 1 if way.endswith("isam2") else 2)
        assert 0.0 < row["body (°)"] < 90.0 and 0.0 < row["position (m)"] < 0.5, preset
    for row in differences:
        full, other = (rows[row["people"], row[""], model] for model in ("full", row["full less"]))
        assert row["head (°)"] == pytest.approx(full["head (°)"] - other["head (°)"])
    for row in rivals:
        graph, particles = (rows[row["people"], way, row["model"]] for way in (gaits.CHAIN, gaits.PARTICLES))
        assert row["body (°)"] == pytest.approx(graph["body (°)"] - particles["body (°)"])


def test_a_clip_has_the_same_noise_whoever_else_is_there() -> None:
    drawn = simulate("joint", n_tracks=3, n_steps=5, rng=np.random.default_rng(0))
    alone, all_of_them = (
        gaits._noisy(tracks, Settings(), 1) for tracks in (drawn.with_tracks(drawn.tracks[2:]), drawn)
    )
    np.testing.assert_array_equal(alone.tracks[0].position, all_of_them.tracks[2].position)
    assert not np.array_equal(
        gaits._noisy(drawn, Settings(), 0).tracks[0].position, all_of_them.tracks[0].position
    )


def test_without_the_recording_a_line_says_so(tmp_path: Path) -> None:
    found = gaits.EXPERIMENT.run(Settings(data=tmp_path))
    assert not found.tables and "--data" in found.notes[0]
    assert gaits.people(Settings()) == {}
