"""A class of terms with a kernel from one function that reads an input: on every engine."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kernels import evaluate, packed_alone, rows_of
from walks import walk

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, direction, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import smooth_track
from graphtrack.inference.chain.initialisation import initial_states, pack
from graphtrack.inference.chain.window import FrameRows
from graphtrack.kernels.layout import Field, N
from graphtrack.learning.fit import fit
from graphtrack.model import Model, States, Term
from graphtrack.model.generator import OF_PRESETS, Contribution, FrameProgram, program_of
from graphtrack.model.kernel import Kernel
from graphtrack.model.model import every_term
from graphtrack.model.observation import chain, observations
from graphtrack.model.packing import PackedTracks
from graphtrack.model.terms.motion import Motion
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track


def look(now: Any, window_cos: Any, window_sin: Any, window_kappa: Any) -> Any:
    """Return the residuals of κ·(1 − cos(head − bearing of the window))."""
    return gt.chord(window_kappa, now.head, (window_cos, window_sin))


class LooksAtWindow(Term):
    """Heads turn to a window within reach, or to the input with its position in a frame."""

    uses = frozenset({"head"})
    window, reach, kappa = np.array([1.0, 2.0]), 9.0, 2.0
    fields = (Field("window_cos", ""), Field("window_sin", ""), Field("window_kappa", ""))
    kernels = (Kernel(look, gate="window_kappa", variables=("head",)),)

    def pull(self, position: np.ndarray, window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = np.where(np.isnan(window), self.window, window) - position
        near = np.linalg.norm(away, axis=1) <= self.reach
        return unit(direction(away)), np.where(near, self.kappa, 0.0)

    def pack(self, packed: PackedTracks) -> None:
        bearing, packed.records["window_kappa"] = self.pull(packed.position, packed.input("window", 2))
        packed.records["window_cos"], packed.records["window_sin"] = bearing.T


MODEL = Model("separate", terms=[LooksAtWindow])


def told(track: Track, move: float = 0.4) -> Track:
    """The track with a window that moves ``move`` metres a frame and is known in most frames."""
    window = np.column_stack([move * np.arange(len(track)), np.full(len(track), -2.0)])
    window[::5] = np.nan
    return replace(track, inputs={"window": window})


# An engine of its own takes a minute to compile.


@pytest.mark.slow
def test_it_is_solved_as_gtsam_solves_it_offline_and_online() -> None:
    track = told(walk(30, seed=4))
    found, graph = (smooth_track(track, MODEL, engine=engine) for engine in ("chain", "gtsam"))
    assert found.engine == "chain" and found.cost == pytest.approx(graph.cost, rel=1e-7)
    np.testing.assert_allclose(difference(found.track.head, graph.track.head), 0.0, atol=1e-4)
    for engine, near in (("chain", 1e-4), ("fixed-lag", 1e-2)):
        last = track_online(track, MODEL, engine=engine, lag=100.0)
        assert difference(last.head[-1], found.track.head[-1]) == pytest.approx(0.0, abs=near)


def test_its_kernel_is_its_density() -> None:
    totals = []
    for track in (walk(12, seed=1), told(walk(12, seed=1))):
        term = LooksAtWindow(MODEL.parameters)
        states = initial_states(track, MODEL)
        rows, packed = np.nan_to_num(rows_of(states)), packed_alone(term, track)
        totals.append(sum(evaluate(term, packed, k, rows[k - 1], rows[k])[0] for k in range(len(track))))
        assert totals[-1] == pytest.approx(term.cost(states, track), rel=1e-12)
    assert 0.0 < totals[0] != totals[1] > 0.0


def test_its_input_reaches_the_engines_of_gtsam() -> None:
    """Offline and online, with a saved state in between, next to people with the same observations."""
    track = told(walk(20, seed=4))
    offline = smooth_track(track, MODEL, engine="gtsam").track
    assert offline.inputs.keys() == track.inputs.keys()
    moved = smooth_track(told(track, 0.2), MODEL, engine="gtsam").track
    assert np.abs(difference(offline.head, moved.head)).max() > 0.01
    options: dict[str, Any] = {"engine": "fixed-lag", "lag": 100.0, "step_tolerance": 0.0}
    smoother = gt.OnlineSmoother(MODEL, **options)
    for k, seen in enumerate(observations(track)):
        if k == 10:
            saved = json.loads(json.dumps(smoother.state()))
            smoother = gt.OnlineSmoother.from_state(saved, MODEL, **options)
        last = smoother.update(seen)
    assert difference(last.head, offline.head[-1]) == pytest.approx(0.0, abs=1e-3)


def test_what_brings_nothing_new_takes_the_engine_that_there_is() -> None:
    class Faster(Motion):
        kernels, fields = Motion.kernels, Motion.fields

    assert program_of(Model("joint", terms=[Faster])) is OF_PRESETS
    assert program_of(MODEL) is not OF_PRESETS
    assert program_of(MODEL) is program_of(Model("separate", terms=[LooksAtWindow]))


def test_what_it_cannot_do_is_told() -> None:
    """An input of another size, a child that takes its parent's kernels, and learning."""

    class Wider(LooksAtWindow):
        def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
            return 2.0 * super().cost(states, track, camera)

    track = replace(walk(5), inputs={"window": np.zeros(5)})
    with pytest.raises(InputError, match=r"input 'window' of one number .*, expected 2 numbers"):
        smooth_track(track, MODEL, engine="gtsam")
    with pytest.raises(InputError, match="Wider"):
        smooth_track(walk(5), Model("position", terms=[Wider]), engine="chain")
    with pytest.raises(InputError, match="LooksAtWindow"):
        fit(gt.TrackSet((walk(30), walk(30, seed=1, track_id=2))), MODEL)


def test_parameters_and_fields_that_nobody_knows_are_told() -> None:
    class Mistaken(LooksAtWindow):
        kernels = (Kernel(look, gate="window_kappa", variables=("head",), names={"window_cos": "precise"}),)
        fields = LooksAtWindow.fields

    class Doubled(LooksAtWindow):
        fields = (*LooksAtWindow.fields, Field("motion_information", "another"))
        kernels = LooksAtWindow.kernels

    class Gateless(LooksAtWindow):
        fields = LooksAtWindow.fields
        kernels = (Kernel(look, gate="nowhere", variables=("head",)),)

    for kind, said in ((Mistaken, "'precise'"), (Doubled, "motion_information"), (Gateless, "'nowhere'")):
        terms = [Contribution.of(one.__name__, one) for one in (*every_term(), kind)]
        with pytest.raises(ValueError, match=said):
            FrameProgram(terms, "a test").source()


def test_frames_are_packed_anew_unless_the_term_says_that_they_repeat() -> None:
    """A cached frame would keep the first frame's bearing of the window."""
    track = replace(walk(20, seed=2), body=None, head=None, body_kappa=None, head_kappa=None)
    whole, rows = pack([track], MODEL).records, FrameRows(MODEL)
    rows.make(len(track), np.zeros(2), np.zeros((N + 2, N)))
    for k, step in enumerate(chain(track)):
        rows.put(k, step)
    assert np.ptp(whole["window_cos"]) > 0.01
    for name in ("window_cos", "window_sin", "window_kappa", "x", "y", "position_information"):
        np.testing.assert_allclose(rows.problem.records[name], whole[name], rtol=1e-12, err_msg=name)


SCRIPT = """
import numpy as np
import graphtrack as gt

def headwind(now, strength):
    return strength * (now.vx + 1)

people = gt.simulate(n_tracks=1, n_steps=20, rng=np.random.default_rng(0))
model = gt.Model("position", terms=[gt.term(headwind, strength=5.0)])
(chain,) = gt.solve(people, model, engine="chain")
(graph,) = gt.solve(people, model, engine="gtsam")
online = gt.track_online(people, model, engine="chain", lag=1.0).tracks[0]
print(abs(chain.cost - graph.cost) < 1e-6 * graph.cost, np.isfinite(online.velocity).all())
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", ["script", "prompt"])
def test_it_may_stand_in_a_script_or_at_the_prompt(how: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(SCRIPT)
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "mine.py"] if how == "script" else [sys.executable, "-"],
            input=None if how == "script" else SCRIPT,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=900,
        )
        assert done.stdout.strip() == "True True", done.stderr
