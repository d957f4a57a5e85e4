"""After `warm_up` there is nothing left to compile or to load, whatever the tracks are like."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_tracks import lens_camera, random_track
from walks import walk

from graphtrack.baselines.particle import filter as particle
from graphtrack.behaviour import warm
from graphtrack.behaviour.forecast.recorded import forecast
from graphtrack.behaviour.online_attention import OnlineAttention
from graphtrack.behaviour.online_groups import OnlineGroups
from graphtrack.behaviour.told import people_at
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
from graphtrack.inference.chain.lane_stating import solve_and_state
from graphtrack.inference.warm import lane_rehearsal, linear_rehearsal, offline_rehearsal, online_rehearsal
from graphtrack.learning import solving
from graphtrack.model import LikelihoodParameters, Model, Observation, Parameters
from graphtrack.simulation.party import party
from graphtrack.tracks import TrackSet

ROBUST = Parameters(likelihood=LikelihoodParameters(robust="cauchy", outlier_probability=0.1))


def machine_code(model: Model) -> dict[str, list[object]]:
    """The signatures of everything that smoothing and tracking with a model call."""
    called = {**offline_rehearsal(model, steps=True).called, **online_rehearsal(model).called}
    called |= linear_rehearsal().called
    return {kernel.py_func.__name__: list(kernel.signatures) for kernel in called}


@pytest.mark.parametrize("preset", ["joint", "full"])
def test_no_track_needs_more_than_was_made_ready(preset: str) -> None:
    for name in ("position", preset):
        warm_up(name)
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


AS_CALLED = """
from graphtrack.inference import warm_up
from graphtrack.inference.chain import advance, engine, modes, mode_spread, newton, restart, start, stating
from graphtrack.inference.chain import window_kernels
from graphtrack.inference.parts import compile_parts

parts = {"descent": newton.minimise, "grid": restart.find_other_basin, "leaving": window_kernels.let_go,
         "window": advance.solve_or_restore, "stating": stating.state_uncertainty}
if PRESET == "full":
    parts |= {"modes": modes.renew_tracks, "couplings": modes.renew_couplings,
              "spread": mode_spread.spread_tracks, "newest": mode_spread.spread_newest,
              "memory": advance.memory_in, "adding": advance.add_newest, "judging": advance.judge_modes,
              "concluding": advance.conclude}
compile_parts(PRESET, "start", *parts)
parts |= {"initialise": start.initialise, "finish": engine.finish}
if PRESET == "full":
    beside = advance.memory_for, advance.problem_in, advance.go_on, advance.tell_modes
    parts |= {function.__name__: function for function in beside}
before = {name: list(function.signatures) for name, function in parts.items()}
warm_up(PRESET)
for name, function in parts.items():
    assert len(function.signatures) == 1 and function.signatures == before[name], name
"""


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["joint", "full"])
def test_parts_are_compiled_as_they_are_called(preset: str, tmp_path: Path) -> None:
    """Else they would be compiled twice, which shows where nothing has been compiled before."""
    done = subprocess.run(
        [sys.executable, "-c", f"PRESET = {preset!r}\n{AS_CALLED}"],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_where_the_linear_solution_may_do_it_is_made_ready_too() -> None:
    """With a camera it does for tracks without pixels, and learning takes Newton's steps besides."""
    model, camera = Model("position"), lens_camera()
    assert linear_rehearsal().called.items() <= offline_rehearsal(model, camera).called.items()
    assert linear_rehearsal().called.items() <= offline_rehearsal(model, steps=True).called.items()
    assert solve_and_state in lane_rehearsal(model).called
    assert solve_and_state in lane_rehearsal(model, camera).called
    assert solve_and_state not in lane_rehearsal(Model("joint")).called


def test_a_linear_model_needs_the_linear_solution_alone() -> None:
    least = linear_rehearsal().called
    assert offline_rehearsal(Model("position")).called == least
    assert offline_rehearsal(Model("position", ROBUST)).called != least
    assert offline_rehearsal(Model("position"), lens_camera()).called != least


def test_groups_looks_and_forecasts_need_no_more_than_was_made_ready(monkeypatch) -> None:
    warm_up("position", behaviour=True)
    called = [*warm.online_rehearsal().called, *warm.forecast_rehearsal().called]
    before = [list(kernel.signatures) for kernel in called]
    assert all(before)
    made = party(np.random.default_rng(3), people=5, steps=12).tracks
    forecast(made, horizon=1.0)
    groups, attention = OnlineGroups(), OnlineAttention()
    for k in range(6):
        numbers = {
            one.track_id: (*one.position[k], 0.0, 0.0, one.body[k], one.head[k], 0.01, 0.01) for one in made
        }
        people = people_at(float(k), k, numbers)
        attention.take(people, groups.take(people))
    assert [list(kernel.signatures) for kernel in called] == before


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
