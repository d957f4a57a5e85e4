"""A smoother that is saved and built again goes on as if nothing had happened, to the last bit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from selection import others_slow
from walks import walk

from graphtrack.geometry.angles import difference, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import Estimate, OnlineSmoother
from graphtrack.model import Observation
from graphtrack.model.observation import observations
from graphtrack.saved import from_text, to_text
from graphtrack.tracks.track import Track

CAMERA = GroundCamera.from_homography([[0.02, 0.001, -6.0], [0.0, -0.03, 14.0], [0.0, 0.0012, 1.0]])


def bits(estimate: Estimate) -> bytes:
    """Every number of an estimate, as it stands in memory."""
    angles = [estimate.body, estimate.head, estimate.aligned_p, estimate.gait_offset]
    numbers = np.concatenate(
        [estimate.position, estimate.velocity, angles, estimate.covariance.ravel(), [estimate.t]]
    )
    return numbers.tobytes() + f"{estimate.frame} {estimate.status} {estimate.reason}".encode()


def through_json(state: dict[str, Any]) -> dict[str, Any]:
    return json.loads(json.dumps(state, allow_nan=False))


def spinning(track: Track) -> Track:
    """Somebody who turns round and round, so that angles are known in turns that nobody writes down."""
    turn = 4.0 * (track.t - track.t[0])
    return replace(track, body=wrap(track.body + turn), head=wrap(track.head + turn))


def seen_by_camera(track: Track) -> Track:
    position = track.position - track.position.mean(axis=0)
    noise = np.random.default_rng(2).normal(0.0, 2.0, position.shape)
    return replace(track, position=position, pixel=CAMERA.ground_to_image(position) + noise)


def rows(track: Track, seed: int) -> list[Observation]:
    """Its observations as a bad line brings them: with gaps, outliers, and late, repeated and old ones."""
    rng = np.random.default_rng(seed)
    seen = list(observations(track))
    for k, chance in enumerate(rng.random(len(seen)).tolist()):
        if chance < 0.1 or (track.pixel is not None and chance < 0.6):
            seen[k] = replace(seen[k], position=None)
        elif chance > 0.9:
            seen[k] = replace(seen[k], body=None, head=None)
        elif chance > 0.85:
            seen[k] = replace(seen[k], position=(50.0, 5.0))
    for k, chance in enumerate(rng.random(len(seen) - 3).tolist()):
        if chance < 0.1:
            seen[k], seen[k + 1] = seen[k + 1], seen[k]
        elif chance < 0.15:
            seen.insert(k, seen[k + 1])
        elif chance < 0.2:
            seen.insert(k, seen[max(0, k - 40)])
    half = len(seen) // 2
    return seen[:half] + [replace(one, t=one.t + 5.0) for one in seen[half:]]


SCENES: dict[str, Callable[[int], Track]] = {
    "angles": lambda n: spinning(walk(n, seed=1, dt=0.04, noise=0.1, angle_kappa=3.0)),
    "classes": lambda n: walk(n, seed=2, dt=0.04, uneven=True, noise=0.1, classes=True),
    "pixels": lambda n: seen_by_camera(walk(n, seed=3, dt=0.04, noise=0.0)),
}


KEPT = [
    ("chain", "full", 120),
    ("chain", "position", 80),
    ("fixed-lag", "joint", 60),
    ("fixed-lag", "full", 60),
]
QUICK = [
    (*KEPT[0], "classes"),
    (*KEPT[0], "pixels"),
    (*KEPT[1], "pixels"),
    (*KEPT[2], "pixels"),
    (*KEPT[3], "classes"),
]


@pytest.mark.parametrize(
    ("engine", "preset", "n", "scene"),
    others_slow([(*one, scene) for one in KEPT for scene in SCENES], QUICK),
)
def test_it_goes_on_to_the_last_bit(engine: Any, preset: str, n: int, scene: str) -> None:
    options: dict[str, Any] = {"engine": engine, "lag": 0.5, "camera": CAMERA}
    whole, stopped = OnlineSmoother(preset, **options), OnlineSmoother(preset, **options)
    rng, statuses = np.random.default_rng(4), set()
    for k, observation in enumerate(rows(SCENES[scene](n), seed=5)):
        expected = whole.update(observation)
        assert bits(stopped.update(observation)) == bits(expected), k
        statuses.add(expected.status)
        if rng.random() < 0.3:
            saved = through_json(stopped.state())
            stopped = OnlineSmoother.from_state(saved, preset, **options)
            assert through_json(stopped.state()) == saved
    assert statuses >= {"new", "late", "duplicate", "too-late"}


@pytest.mark.parametrize(
    ("engine", "preset", "scene"), [("chain", "full", "classes"), ("fixed-lag", "joint", "angles")]
)
def test_a_state_that_is_asked_for_later_is_that_of_now(engine: Any, preset: str, scene: str) -> None:
    smoother = OnlineSmoother(preset, engine=engine, lag=0.5)
    taken: list[tuple[dict[str, Any], Callable[[], dict[str, Any]]]] = []
    for observation in rows(SCENES[scene](60), seed=5):
        smoother.update(observation)
        taken.append((through_json(smoother.state()), smoother.later_state()))
    assert all(through_json(later()) == now for now, later in taken)


@pytest.mark.parametrize("preset", ["separate", "joint"])
@pytest.mark.parametrize("scene", SCENES)
def test_that_settled_frames_are_not_factored_anew_does_not_show(preset: str, scene: str) -> None:
    options: dict[str, Any] = {"engine": "chain", "lag": 2.0, "camera": CAMERA}
    smoother, anew = OnlineSmoother(preset, **options), OnlineSmoother(preset, **options)
    differ = False
    for observation in observations(SCENES[scene](90)):
        found = smoother.update(observation)
        state = through_json(anew.state())
        arrays = state["arrays"]
        if "factored" in arrays:
            arrays["factored"] = to_text(from_text(arrays["factored"]) + 1.0)  # so far away
        anew = OnlineSmoother.from_state(state, preset, **options)
        expected = anew.update(observation)
        np.testing.assert_allclose(found.position, expected.position, atol=1e-4)
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=0.02, atol=1e-4)
        for one, other in ((found.body, expected.body), (found.head, expected.head)):
            assert abs(difference(one, other)) < 1e-3
        differ = differ or bits(found) != bits(expected)
    assert differ


def test_what_is_remembered_of_intervals_does_not_show() -> None:
    """Frames are packed once for all intervals that round to the same; the first of them must not decide."""
    moments = [0.0, 0.1 + 3e-10, 5.0, 5.1, 5.2, 5.3, 5.4 + 1e-11]
    seen = [Observation(t=t, position=(t, 0.0), body=0.1 * t, head=0.2) for t in moments]
    whole = OnlineSmoother("joint", engine="chain", lag=0.15)
    for observation in seen[:3]:
        whole.update(observation)
    resumed = OnlineSmoother.from_state(through_json(whole.state()), "joint", engine="chain", lag=0.15)
    assert all(bits(resumed.update(one)) == bits(whole.update(one)) for one in seen[3:])
