"""Comparisons in the experiments: parameters fitted for each method alike, differences on the same tracks."""

from __future__ import annotations

import numpy as np
import pytest

from graphtrack.experiments.baxter_simulated import RIVAL, Gain, paired
from graphtrack.experiments.chen_joint import (
    ANGLES,
    FITTED,
    PAIRS,
    Scores,
    errors_of,
    fitted_models,
    pair_rows,
    parameter_table,
)
from graphtrack.experiments.harness import ISAM2
from graphtrack.inference import smooth_track
from graphtrack.model import Model
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.track import Track


def test_each_method_gets_its_own_parameters_and_isam2_those_of_its_graph() -> None:
    tracks = simulate("joint", n_tracks=2, n_steps=25, rng=np.random.default_rng(5))

    def smoothed(track: Track, model: Model) -> Track:
        return smooth_track(track, model).track

    def observed(track: Track, model: Model) -> Track:
        return track

    methods = {
        "graph": ("online", smoothed),
        f"graph{ISAM2}": ("online", smoothed),
        "none": ("online", observed),
    }
    seen: list[int] = []
    found = fitted_models(tracks, methods, 14, seen.append)
    assert set(found) == {(preset, method) for preset in FITTED for method in methods}
    for preset in FITTED:
        assert found[preset, f"graph{ISAM2}"] is found[preset, "graph"]
        before = np.mean([errors_of(smoothed(track, Model(preset)), track) for track in tracks])
        after = np.mean([errors_of(smoothed(track, found[preset, "graph"]), track) for track in tracks])
        assert after < before
    # The paper's separate filtering has no κ₂ to fit.
    of_head = "coupling.head_body_kappa"
    assert found["joint-body", "graph"].parameters.value(of_head) == Model("joint-body").parameters.value(
        of_head
    )
    rows = parameter_table(found).records()
    assert rows[0]["method"] == "default" and len(rows) == 1 + 2 * len(FITTED)
    assert [row["κ₂"] for row in rows if row["preset"] == "joint-body"] == [None, None]


def test_differences_between_methods_are_of_the_same_people() -> None:
    rng = np.random.default_rng(0)
    hard = rng.uniform(0.0, 100.0, 30)  # differs from person to person by far more than from method to method
    names = {name for pair in PAIRS for name in pair}
    worth = {name: float(i) for i, name in enumerate(sorted(names))}
    default = {
        ("joint", name, angle): hard + worth[name] + rng.normal(0.0, 0.1, 30)
        for name in names
        for angle in ANGLES
    }
    fitted = {("joint", name, angle): hard - worth[name] for name in names for angle in ANGLES}
    for row in pair_rows([Scores("people", 30, default)], {"people": fitted}, rng):
        first, second = str(row["difference"]).split(" − ")
        expected = worth[first] - worth[second]
        assert row["default (°)"] == pytest.approx(expected, abs=0.15)
        assert row["default: low"] < row["default (°)"] < row["default: high"]
        assert row["default: high"] - row["default: low"] < 0.3
        assert row["fitted (°)"] == pytest.approx(-expected, abs=1e-9)


def test_graphs_meet_the_tracker_on_the_same_tracks_of_each_cell() -> None:
    hard = np.exp(
        np.random.default_rng(1).normal(0.0, 1.0, 40)
    )  # squared errors of the tracker over the filter's
    found = []
    for behaviour, share in enumerate((0.5, 2.0)):  # the graph's squared error over the tracker's
        found.append(Gain(behaviour, 1.0, RIVAL, 1.0 / hard, 1.0 / hard, -hard))
        few = hard[:10]
        found.append(
            Gain(behaviour, 1.0, "graph joint", 1.0 / (share * few), 1.0 / few, -few - np.log(share))
        )
    cells, counts = paired(found, ("straight", "turn"), np.random.default_rng(2))
    first, second = cells.records()
    assert first["squared error / tracker's"] == pytest.approx(0.5)
    assert first["ratio: high"] == pytest.approx(0.5)
    assert second["squared error / tracker's"] == pytest.approx(2.0)
    assert first["nats a detection − tracker's"] == pytest.approx(np.log(2.0))
    assert second["nats: high"] == pytest.approx(-np.log(2.0))
    (count,) = counts.records()
    assert count["cells"] == 2
    assert count["squared error: better"] == count["squared error: clearly worse"] == 1
    assert count["likelihood: clearly better"] == count["likelihood: clearly worse"] == 1
