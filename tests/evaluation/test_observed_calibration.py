"""Calibration on observations: of people of the model, and with a wrong noise."""

from dataclasses import replace

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.evaluation.observed import observed_calibration
from graphtrack.inference.engines import Solution
from graphtrack.model import LikelihoodParameters, Model
from graphtrack.report.page import observed_section


@pytest.fixture(scope="module")
def simulated():
    return gt.simulate("joint", n_tracks=8, rng=np.random.default_rng(7))


def rows_of(tracks, model):
    found = [one for one in gt.solve(tracks, model) if isinstance(one, Solution)]
    assert len(found) == len(tracks)
    return {row["quantity"]: row for row in observed_calibration(tracks, found, model)}


def test_people_of_the_model_are_calibrated(simulated):
    rows = rows_of(simulated, Model("joint"))
    assert set(rows) == {"position", "body", "head"}
    for row in rows.values():
        assert np.array(row["coverage"]) == pytest.approx(np.array(row["confidence"]), abs=0.04)
        assert row["nees"] == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize(("factor", "wide"), [(0.4, False), (2.5, True)])
def test_a_noise_that_is_believed_too_small_or_too_large_shows(simulated, factor, wide):
    usual = LikelihoodParameters()
    likelihood = replace(
        usual, position_std=factor * usual.position_std, head_kappa=usual.head_kappa / factor**2
    )
    model = Model("joint")
    believed = model.with_parameters(replace(model.parameters, likelihood=likelihood))
    bare = simulated.map(lambda track: replace(track, position_std=None, head_kappa=None))
    rows = rows_of(bare, believed)
    for name in ("position", "head"):
        row = rows[name]
        median = row["coverage"][row["confidence"].index(0.5)]
        assert (median > 0.6) if wide else (median < 0.45), name


def test_the_section_is_of_what_was_observed(simulated):
    positions = simulated.map(lambda t: replace(t, body=None, body_kappa=None, head=None, head_kappa=None))
    rows = rows_of(positions, Model("position"))
    assert set(rows) == {"position"}
    (section,) = observed_section(list(rows.values()))
    assert section.title == "Calibration" and len(section.items) == 3
    assert observed_section([]) == ()


def test_pixels_are_calibrated_as_the_same_positions_in_metres(simulated):
    metre = 0.0125
    table = {name: [] for name in ("track_id", "frame", "t", "x", "y")}
    for track in simulated:
        columns = (np.full(len(track), track.track_id), track.frame, track.t, *track.position.T)
        for name, values in zip(table, columns, strict=True):
            table[name].append(values)
    metres = {name: np.concatenate(values) for name, values in table.items()}
    pixels = {**metres, "u": metres["x"] / metre, "v": 1000.0 - metres["y"] / metre}
    del pixels["x"], pixels["y"]
    of_metres = rows_of(gt.read(metres), Model("joint"))["position"]
    of_pixels = rows_of(gt.read(pixels, metres_per_pixel=metre), Model("joint"))["position"]
    assert of_metres["nees"] == pytest.approx(1.0, abs=0.12)
    assert of_pixels["nees"] == pytest.approx(of_metres["nees"], abs=0.05)
