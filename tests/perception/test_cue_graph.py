"""The tracker whose cues are factors of the graph: its likelihood on a grid, reliabilities, and videos."""

from itertools import chain, combinations

import cv2
import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.trackers.cue_graph import (
    CueGraphParameters,
    CueGraphTracker,
    factor_input,
    log_likelihood,
    place_model,
    ratio,
    responsibility,
)
from perception.trackers.registry import make_tracker, parameters_of
from perception.trackers.sigma_pi_network import TERMS

CUES = ("motion", "colour", "shape")
SIZE = (200, 150)
PERSON_SIZE = (32, 36)
GTSAM = CueGraphParameters(engine="fixed-lag")
"""Without compilation."""


def grain(width: int, height: int, colour: tuple[int, int, int], size: float, seed: int) -> Image:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (height, width)), (0, 0), size)
    return np.clip(np.array(colour) + 25.0 * (noise / noise.std())[..., None], 0, 255).astype(np.uint8)


ROOM = grain(*SIZE, (130, 120, 120), 8.0, 0)
PERSON = grain(*PERSON_SIZE, (60, 60, 170), 1.5, 1)


def frame(place: tuple[float, float] | None, seed: int) -> Image:
    """The room, with the person's middle at a place, and noise."""
    image = ROOM.copy()
    if place is not None:
        left, top = round(place[0] - PERSON_SIZE[0] / 2), round(place[1] - PERSON_SIZE[1] / 2)
        shown = min(PERSON_SIZE[0], max(SIZE[0] - left, 0))
        image[top : top + PERSON_SIZE[1], left : left + shown] = PERSON[:, :shown]
    return np.clip(image + np.random.default_rng(seed).normal(0, 2, image.shape), 0, 255).astype(np.uint8)


def solved(frames: list[dict[str, tuple[float, ...]]], engine: str = "gtsam") -> FloatArray:
    """Return the places (n, 2) of a person who starts near the origin and is given cues in each frame."""
    n = len(frames)
    position, std = np.full((n, 2), np.nan), np.full(n, np.nan)
    position[0], std[0] = 0.0, 0.3
    nothing = (np.nan,) * 6
    inputs = {name: np.array([one.get(name, nothing) for one in frames]) for name in CUES}
    track = gt.Track(1, np.arange(n), np.arange(n) / 25.0, position, position_std=std, inputs=inputs)
    return gt.smooth(track, place_model(20.0, 3.0), engine=engine, fill=False).position


def at(x: float, y: float, std: float, odds: float) -> tuple[float, ...]:
    return x, y, 1.0 / std, 0.0, 1.0 / std, odds


def cost(inputs: tuple[float, ...], places: FloatArray) -> FloatArray:
    """Return the negative log likelihood (n,) of a cue at places (n, 2), written out."""
    x, y, xx, xy, yy, odds = inputs
    away = places - [x, y]
    squares = (xx * away[:, 0] + xy * away[:, 1]) ** 2 + (yy * away[:, 1]) ** 2
    return -np.log((1.0 + odds * np.exp(-squares / 2.0)) / (1.0 + odds))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_the_graph_has_the_place_of_a_grid_over_the_same_likelihoods(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = {
        name: (*rng.normal(0.0, 0.15, 2), 4.0, rng.normal(0.0, 1.0), 3.0, rng.uniform(1.0, 20.0))
        for name in CUES
    }
    axis = np.linspace(-0.6, 0.6, 601)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    total = (grid**2).sum(axis=1) / (2.0 * 0.3**2) + sum(cost(one, grid) for one in given.values())
    assert np.abs(solved([given])[0] - grid[total.argmin()]).max() < 0.004


def test_two_cues_that_agree_outvote_one() -> None:
    there, elsewhere = at(0.4, 0.2, 0.2, 9.0), at(-0.5, -0.3, 0.2, 9.0)
    for odd in CUES:
        given = {name: elsewhere if name == odd else there for name in CUES}
        assert np.linalg.norm(solved([given] * 8)[-1] - [0.4, 0.2]) < 0.1


def test_a_cue_far_away_pulls_no_longer() -> None:
    here = {name: at(0.1, 0.0, 0.2, 9.0) for name in CUES[:2]}
    alone = solved([here] * 5)
    np.testing.assert_allclose(solved([here | {"shape": at(5.0, 5.0, 0.2, 9.0)}] * 5), alone, atol=1e-3)


def test_the_likelihood_is_the_sigma_pi_network_with_reliabilities_of_products() -> None:
    rng = np.random.default_rng(0)
    ratios, reliable = rng.uniform(0.0, 10.0, (50, 3)), rng.uniform(0.05, 0.95, 3)
    sets = list(chain([()], *(combinations(range(3), size) for size in (1, 2, 3))))
    assert set(sets) == {(), *TERMS}
    network = np.zeros(50)
    for one in sets:
        alpha = np.prod([reliable[c] if c in one else 1.0 - reliable[c] for c in range(3)])
        network += alpha * ratios[:, list(one)].prod(axis=1)
    np.testing.assert_allclose(log_likelihood(ratios, reliable), np.log(network), rtol=1e-12)


def test_a_cue_of_noise_loses_its_reliability_and_one_on_the_person_gains_it() -> None:
    rng, mean = np.random.default_rng(1), np.array([0.05, 0.05, 0.5])
    reliable = np.full(3, 0.5)
    for _ in range(200):  # motion at the person, colour silent there, shape the same anywhere
        activities = np.array([rng.uniform(0.8, 1.0), 0.0, rng.uniform(0.0, 1.0)])
        right = responsibility(ratio(activities, mean), reliable)
        reliable = np.clip(reliable + 0.03 * (right - reliable), 0.05, 0.95)
    assert reliable[0] > 0.9 and reliable[1] < 0.1 and reliable[2] < 0.45


def test_the_place_of_a_cue_is_that_of_its_largest_activities() -> None:
    axis = np.linspace(-0.75, 0.75, 7)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    away = places - [0.2, -0.1]
    x, y, xx, xy, yy, odds = factor_input(places, np.exp(-4.0 * (away**2).sum(axis=1)), 3.0)
    assert np.hypot(x - 0.2, y + 0.1) < 0.02 and odds == 3.0
    root = np.array([[xx, xy], [0.0, yy]])
    covariance = np.linalg.inv(root.T @ root)
    np.testing.assert_allclose(covariance, (1.0 / 64.0 + 0.05**2) * np.eye(2), atol=0.004)


@pytest.mark.slow
def test_who_moves_is_found_and_followed_while_at_rest() -> None:
    tracker = CueGraphTracker(GTSAM)
    path = [None] * 3 + [(20.0 + 3.0 * k, 75.0) for k in range(35)]
    path += [path[-1]] * 30
    tracker.start(frame(path[0], 0))
    found = [tracker.step(frame(place, k)) for k, place in enumerate(path[1:], 1)]
    for place, one in list(zip(path[1:], found, strict=True))[14:]:
        assert place is not None and one.found
        assert np.abs(one.centre - place).max() < 12.0 and (one.spread < 20.0).all()


@pytest.mark.slow
def test_a_person_who_walks_out_is_lost() -> None:
    tracker = CueGraphTracker(GTSAM)
    path = [(20.0 + 4.0 * k, 75.0) for k in range(52)]
    tracker.start(frame(None, 0))
    found = [tracker.step(frame(place, k)) for k, place in enumerate(path, 1)]
    assert all(one.found for one in found[12:40])
    gone = [tracker.step(frame(None, k)) for k in range(100, 125)]
    assert not any(one.found for one in gone[15:])


def test_from_a_box_estimates_are_in_the_pixels_of_large_frames() -> None:
    path = [(60.0 + 2.0 * k, 75.0) for k in range(20)]
    tracker = make_tracker("cue-graph", parameters=GTSAM, rate=25.0)
    for k, (x, y) in enumerate(path):
        image = cv2.resize(frame((x, y), k), None, fx=4, fy=4)
        box = 4 * (x - 16.0), 4 * (y - 18.0), 128.0, 144.0
        one = tracker.step(image) if k else tracker.start(image, box)
        assert one.found and np.abs(one.centre - 4 * np.array([x, y])).max() < 40.0


def test_cues_that_are_not_used_have_the_least_reliability() -> None:
    tracker = CueGraphTracker(CueGraphParameters(cues=("motion",), engine="fixed-lag"))
    tracker.start(frame(None, 0))
    for k in range(1, 12):
        one = tracker.step(frame((30.0 + 3 * k, 70.0), k))
    assert one.cues["colour"] == one.cues["shape"] == 0.0
    np.testing.assert_allclose(tracker.reliabilities[1:], 0.05)


def test_what_it_does_not_take_is_refused() -> None:
    for wrong in ({"cues": ()}, {"cues": ("smell",)}, {"least": 0.0}, {"most": 1.0}):
        with pytest.raises(InputError):
            CueGraphParameters(**wrong)
    for rate in (0.0, float("nan")):
        with pytest.raises(InputError, match="frames a second"):
            CueGraphTracker(rate=rate)
    with pytest.raises(InputError, match="particles for cue-graph"):
        make_tracker("cue-graph", 50)
    with pytest.raises(InputError, match="sigma-pi"):
        parameters_of("cue-graph", as_in_the_paper=True)
