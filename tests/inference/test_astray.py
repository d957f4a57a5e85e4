"""Ten false frames at one place: their cost, and the time to recover the path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.geometry.camera import GroundCamera
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks.track import Track

STD, FPS, BEGINS, ENDS = 0.05, 30.0, 45, 55


def with_loss(preset: str, robust: str, threshold: float) -> gt.Model:
    parameters = gt.Model(preset).parameters
    likelihood = replace(parameters.likelihood, robust=robust, robust_threshold=threshold)
    return gt.Model(preset, replace(parameters, likelihood=likelihood))


def walker(seed: int, *, stays: bool = True) -> Track:
    """A person who walks straight, observed 1.5 m aside for ten frames, at one place or along the path."""
    rng = np.random.default_rng(seed)
    t = np.arange(75) / FPS
    path = np.column_stack([1.3 * t, np.zeros_like(t)])
    position = path + STD * rng.standard_normal(path.shape)
    position[BEGINS:ENDS] = (path[BEGINS] if stays else path[BEGINS:ENDS]) + (0.0, 1.5)
    std = np.full(len(t), STD)
    return Track(seed, np.arange(len(t)), t, position, position_std=std, true_position=path)


@pytest.mark.parametrize("seed", range(3))
def test_the_path_is_found_again_online_as_soon_as_it_costs_less(seed: int) -> None:
    """Newton's method alone stays in its basin, up to 2 m off, for three frames more."""
    track = walker(seed)
    estimate = gt.track_online(track, with_loss("separate", "cauchy", 5.0))
    off = np.linalg.norm(estimate.position - track.true_position, axis=1)
    assert off[ENDS - 2] > 1.0  # it had been followed
    assert off[ENDS + 5 :].max() < 0.25


@pytest.mark.parametrize("axes", [[0, 1], [1, 0]], ids=["false down the image", "false across it"])
def test_it_is_found_again_as_soon_in_pixels_as_in_metres(axes: list[int]) -> None:
    """A camera that looks straight down: whichever way its image lies, pixels are scaled metres."""
    track, model = walker(0, stays=False), with_loss("separate", "cauchy", 5.0)
    metres_per_pixel = STD / model.parameters.likelihood.pixel_std
    homography = np.eye(3)
    homography[:2, :2] = metres_per_pixel * np.eye(2)[axes]
    camera = GroundCamera.from_homography(homography)
    seen = replace(track, pixel=camera.ground_to_image(track.position), position_std=None)
    found, expected = gt.track_online(seen, model, camera=camera), gt.track_online(track, model)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-6)
    off = np.linalg.norm(found.position - track.true_position, axis=1)
    assert off[ENDS - 2] > 1.0 > 0.25 > off[ENDS + 5 :].max()


@pytest.mark.slow
def test_ten_frames_at_one_place_on_motion_capture(data_dir: Path) -> None:
    """Positions off, offline and online, by the loss; root mean squares."""
    clips = gt.read(data_dir / "mocap" / "tracks_30hz.csv.gz")
    held = [track for track in clips.tracks[1::2] if len(track) >= 60][::6]
    losses = {"huber": with_loss("full", "huber", 3.0), "cauchy": gt.Model("full")}
    for std in (0.05, 0.1):
        for metres in (0.0, 1.0, 1.5, 3.0):
            seen, where = [], []
            for seed in (0, 1):
                rng = np.random.default_rng(seed)
                noise = {"position_std": std, "body_kappa": 1.2, "head_kappa": 2.3}
                for track in add_noise(clips.with_tracks(held), **noise, rng=rng):
                    begins, turn = rng.integers(len(track) // 4, len(track) // 2), rng.uniform(-np.pi, np.pi)
                    ten, position = slice(begins, begins + 10), track.position.copy()
                    if metres:
                        aside = metres * np.array([np.cos(turn), np.sin(turn)])
                        position[ten] = track.true_position[begins] + aside
                    seen.append(replace(track, track_id=len(seen), position=position))
                    where.append(track.true_position)
            found, scene = {}, clips.with_tracks(seen)
            for loss, model in losses.items():
                for way, solve in (("offline", gt.smooth), ("online", gt.track_online)):
                    pairs = zip(solve(scene, model), where, strict=True)
                    squares = [np.mean(np.sum((one.position - true) ** 2, axis=1)) for one, true in pairs]
                    found[loss, way] = float(np.sqrt(np.mean(squares)))
            print(std, metres, {key: round(value, 3) for key, value in found.items()})
            # A near position that lasts for ten frames is plausible given the past.
            assert found["cauchy", "offline"] < (0.9 if metres else 1.02) * found["huber", "offline"]
            assert found["cauchy", "online"] < (0.6 if metres == 3.0 else 1.1) * found["huber", "online"]
