"""After `warm_up` there is nothing left to compile or to load, whatever the tracks are like."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import first_calls
import numpy as np
import pytest
from first_calls import machine_code
from random_tracks import lens_camera, random_track
from walks import walk

from graphtrack.baselines import particle_filter as particle
from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.forecasting.recorded import forecast
from graphtrack.inference import SolverOptions, engines, smooth_track
from graphtrack.inference.engines import make_solver_ready
from graphtrack.interaction.attention import OnlineAttention
from graphtrack.interaction.groups import OnlineGroups
from graphtrack.interaction.people import people_at
from graphtrack.learning.fit import TruthLikelihood
from graphtrack.model import LikelihoodParameters, Model, Observation, Parameters
from graphtrack.simulation.scenario import party
from graphtrack.smoothing import smooth
from graphtrack.tracking import WARMED, track_online, warm_up
from graphtrack.tracks.track import TrackSet

ROBUST = Parameters(likelihood=LikelihoodParameters(robust="cauchy", body_outliers=0.1, head_outliers=0.1))


@pytest.mark.parametrize("preset", ["joint"])
def test_no_track_needs_more_than_was_made_ready(preset: str) -> None:
    for name in ("position", preset):
        warm_up(name)
    before = machine_code()
    camera = lens_camera()
    seen = random_track(np.random.default_rng(1), camera)
    people = TrackSet((walk(12), walk(9, track_id=2, classes=True), replace(seen, track_id=3)), camera)
    smooth(people, preset, jobs=1)
    smooth(people, Model(preset, ROBUST), options=SolverOptions(basin_search=False))
    smooth(TrackSet((walk(1),)), "position")
    for track in people:
        track_online(track, preset, lag=0.3, camera=camera)
    smoother = OnlineSmoother(preset)
    for t in (0.0, 0.2, 0.1):
        smoother.update(Observation(t, position=(t, 0.0)))
    OnlineSmoother.from_state(smoother.state(), preset).update(Observation(0.3))
    assert machine_code() == before


@pytest.fixture
def rehearsed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """Names of rehearsals that were asked for; nothing is compiled."""
    found: list[tuple[str, ...]] = []
    for module in (engines, particle):
        monkeypatch.setattr(
            module, "make_ready", lambda what, *some: found.append((what, *(one.name for one in some)))
        )
    return found


def test_models_and_ways_make_ready_what_they_call(rehearsed) -> None:
    linear, full = Model("position"), Model("joint")
    for given, names in (
        ((linear, "chain"), ("offline linear",)),
        ((full, "chain"), ("offline angles", "start")),
        ((full, "gtsam"), ("graph angles",)),
    ):
        make_solver_ready(*given)
        assert sorted(rehearsed[-1]) == sorted(("the offline solver", *names))
    for camera, model, options in (
        (None, linear, {"complete": True}),
        (None, Model("position", ROBUST), {}),
        (lens_camera(), linear, {}),
    ):
        make_solver_ready(model, "chain", camera, **options)
        assert "offline angles" in rehearsed[-1]


def test_groups_looks_and_forecasts_need_no_more_than_was_made_ready() -> None:
    warm_up("position", behaviour=True)
    before = machine_code()
    made = party(np.random.default_rng(3), people=5, steps=12).tracks
    forecast(made, horizon=1.0)
    groups, attention = OnlineGroups(), OnlineAttention()
    for k in range(6):
        numbers = {
            one.track_id: (*one.position[k], 0.0, 0.0, one.body[k], one.head[k], 0.01, 0.01) for one in made
        }
        people = people_at(float(k), k, numbers)
        attention.take(people, groups.take(people))
    assert machine_code() == before


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="each name has a process of its own")
@pytest.mark.parametrize(
    "names", [("OnlineTracker", "forecast"), pytest.param(WARMED, marks=pytest.mark.slow)], ids=["two", "all"]
)
def test_each_function_is_made_ready_by_its_name(names: tuple[str, ...]) -> None:
    command = [sys.executable, first_calls.__file__, *names]
    done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [f"{name} compiles nothing" for name in names]


def test_unknown_functions_are_refused() -> None:
    with pytest.raises(InputError, match="OnlineTracker"):
        warm_up("joint", functions="Tracker")


def test_whoever_calls_compiled_code_makes_it_ready_first(rehearsed) -> None:
    track, model = walk(5), Model("joint")
    for run in (
        lambda: smooth(TrackSet((track,)), "joint", constants="default"),
        lambda: smooth_track(track, model, engine="gtsam"),
        lambda: OnlineSmoother("joint", constants="default"),
        lambda: TruthLikelihood([track], model, None),
        lambda: particle.particle_filter(track, "joint"),
        lambda: particle.particle_smoother(track, "joint"),
    ):
        count = len(rehearsed)
        run()
        assert len(rehearsed) > count
    assert {what for what, *_ in rehearsed} >= {"the offline solver", "the online solver"}
    count = len(rehearsed)
    with pytest.raises(InputError):
        OnlineSmoother("joint", lag=-1.0)
    assert len(rehearsed) == count
