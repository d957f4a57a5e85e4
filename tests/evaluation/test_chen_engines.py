"""The engines that chen-classes has beside: the same people, the same model."""

from __future__ import annotations

import numpy as np

from graphtrack.evaluation.reproduce.chen_classes import METHODS, classified
from graphtrack.evaluation.reproduce.chen_engines import KNOWN, OTHERS, engine_table
from graphtrack.evaluation.reproduce.chen_joint import ANGLES, Scores
from graphtrack.geometry.angles import mean_absolute_error
from graphtrack.model import Model
from graphtrack.simulation.sampling import simulate


def test_every_engine_has_the_same_people_and_about_the_same_errors() -> None:
    people = classified(
        simulate("joint", n_tracks=2, n_steps=25, rng=np.random.default_rng(0)), np.random.default_rng(1)
    )
    errors = {("observation", "", angle): np.full(2, 40.0) for angle in ANGLES}
    for method in KNOWN.values():
        found = [METHODS[method][1](track, Model("joint")) for track in people]
        for angle in ANGLES:
            off = [
                mean_absolute_error(getattr(one, angle), getattr(track, f"true_{angle}"))
                for one, track in zip(found, people, strict=True)
            ]
            errors["joint", method, angle] = np.degrees(off)
    steps: list[int] = []
    table = engine_table(Scores("drawn", 2, errors), people, np.random.default_rng(2), steps.append)
    rows = {(row["angle"], row["method"]): row for row in table.records()}
    assert set(rows) == {(angle, name) for angle in ANGLES for name in (*KNOWN, *OTHERS)}
    assert sum(steps) == len(OTHERS) * len(people)
    for (angle, name), row in rows.items():
        assert row["model"] == "joint" and row["people"] == 2
        offline = name.endswith("offline")
        assert row["group"] == ("offline" if offline else "online")
        of_chain = rows[angle, "chain, offline" if offline else "chain"]["error (°)"]
        assert abs(row["error (°)"] - of_chain) < (0.5 if offline else 3.0), name
