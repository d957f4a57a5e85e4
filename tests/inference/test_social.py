"""The model ``social``: conversations turn bodies to each other; who is alone stays as ``full`` has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import graphtrack as gt
from graphtrack.geometry.angles import mean_absolute_error
from graphtrack.simulation.party import party


def test_bodies_of_a_party_are_found_from_positions() -> None:
    made = party(np.random.default_rng(3), people=8, steps=60, fps=1.0)
    seen = made.tracks.map(lambda track: replace(track, body=None, head=None))
    errors = {}
    for model in ("full", "social"):
        found = gt.smooth(seen, model)
        inside = made.group >= 0
        body = np.stack([track.body for track in found])
        errors[model] = mean_absolute_error(
            body[inside], np.stack([track.true_body for track in found])[inside]
        )
        assert not any("group" in track.inputs for track in found)
    assert errors["social"] < min(0.7, 0.8 * errors["full"])


def test_a_single_person_is_as_without_groups() -> None:
    track = party(np.random.default_rng(3), people=1, steps=30).tracks.tracks[0]
    one, other = (gt.smooth(track, model) for model in ("full", "social"))
    np.testing.assert_allclose(one.body, other.body, atol=1e-6)
