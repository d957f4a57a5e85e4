"""After `warm_up` there is nothing left to compile or to load, whatever the tracks are like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_tracks import lens_camera, random_track
from walks import walk

from graphtrack.baselines.particle import filter as particle
from graphtrack.errors import InputError
from graphtrack.inference import (
    OnlineSmoother,
    SolverOptions,
    offline,
    online,
    smooth,
    smooth_track,
    track_online,
    warm_up,
)
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.warm import offline_rehearsal, online_rehearsal, start_rehearsal
from graphtrack.learning import solving
from graphtrack.model import LikelihoodParameters, Model, Observation, Parameters
from graphtrack.tracks import TrackSet

ROBUST = Parameters(likelihood=LikelihoodParameters(robust="cauchy", outlier_probability=0.1))


def machine_code(model: Model) -> dict[str, list[object]]:
    """The signatures of everything that smoothing and tracking with a model call."""
    called = {**offline_rehearsal(model, steps=True).called, **online_rehearsal(model).called}
    return {kernel.py_func.__name__: list(kernel.signatures) for kernel in called}


@pytest.mark.parametrize("preset", ["joint", "full"])
def test_no_track_needs_more_than_was_made_ready(preset: str) -> None:
    warm_up(preset)
    before = machine_code(Model(preset))
    assert all(before.values())
    camera = lens_camera()
    seen = random_track(np.random.default_rng(1), camera)
    people = TrackSet((walk(12), walk(9, track_id=2, classes=True), replace(seen, track_id=3)), camera)
    smooth(people, preset, jobs=1)
    smooth(people, Model(preset, ROBUST), options=SolverOptions(restart=False))
    smooth(TrackSet((walk(1),)), "position")
    for track in people:
        track_online(track, preset, lag=0.3, camera=camera)
    smoother = OnlineSmoother(preset)
    for t in (0.0, 0.2, 0.1):
        smoother.update(Observation(t, position=(t, 0.0)))
    OnlineSmoother.from_state(smoother.state(), preset).update(Observation(0.3))
    assert machine_code(Model(preset)) == before


def test_a_linear_model_needs_the_linear_solution_alone() -> None:
    least = start_rehearsal().called
    assert offline_rehearsal(Model("position")).called == least
    assert offline_rehearsal(Model("position", ROBUST)).called != least
    assert offline_rehearsal(Model("position"), lens_camera()).called != least


def test_whoever_calls_compiled_code_makes_it_ready_first(monkeypatch) -> None:
    rehearsed: list[str] = []
    for module in (offline, online, solving, particle):
        monkeypatch.setattr(module, "make_ready", lambda what, *_: rehearsed.append(what))
    track, model = walk(5), Model("joint")
    for run in (
        lambda: smooth(TrackSet((track,)), "joint"),
        lambda: smooth_track(track, model, engine="gtsam"),
        lambda: OnlineSmoother("joint"),
        lambda: solving.Solver([track], model, None),
        lambda: particle.particle_filter(track, "joint"),
        lambda: particle.particle_smoother(track, "joint"),
    ):
        count = len(rehearsed)
        run()
        assert len(rehearsed) == count + 1
    assert [rehearsed[k] for k in (0, 2)] == ["the solver of whole tracks", "the online solver"]
    with pytest.raises(InputError):
        OnlineSmoother("joint", lag=-1.0)
    assert len(rehearsed) == 6


def test_only_tracks_that_are_solved_alone_need_the_scalar_engine() -> None:
    seen, classified = walk(9), walk(9, classes=True)
    cases = (("full", seen, False), ("full", classified, True), ("joint", classified, False))
    for preset, track, alone in cases:
        model = Model(preset)
        assert (program_of(model).solve_tracks in offline_rehearsal(model, tracks=[track]).called) == alone
        assert (program_of(model).solve_lanes in offline_rehearsal(model, tracks=[track]).called) != alone
        both = offline_rehearsal(model, tracks=[seen, track]).called
        assert program_of(model).solve_lanes in both
        assert (program_of(model).solve_tracks in both) == alone
