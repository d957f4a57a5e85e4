"""Rendered pictures against geometry that was worked out otherwise."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from graphtrack.geometry.angles import unit
from perception.pose.classes import PoseClasses
from perception.synthetic import (
    Camera,
    Furniture,
    HeadVariation,
    PedestrianVariation,
    Person,
    Scene,
    contact_sheet,
    draw_poses,
    make_heads,
    make_pedestrians,
    render_frame,
)
from perception.synthetic.cameras import Sensor
from perception.synthetic.clips import walking_clip
from perception.synthetic.head_clips import HeadClipParameters, head_clip
from perception.synthetic.people import Appearance, Posture, head_solids, random_appearance
from perception.synthetic.raycast import Ground, Light, cast
from perception.synthetic.solids import Builder, rotation_up, rotation_z

OVERHEAD = Light((0.0, 0.0, 1.0), (0.6, 0.6, 0.6), (0.4, 0.4, 0.4))
FRONT = Camera((6.0, 0.0, 0.0), np.pi, 0.0, 1200.0, (96, 96))
STREET = Camera((0.0, -9.0, 3.5), np.pi / 2, -0.35, 420.0, (192, 144))
CEILING = Camera((0.0, 0.0, 5.0), 0.3, -np.pi / 2, 80.0, (192, 144), "fisheye")
QUIET = Sensor(gamma=1.0)


def plain(**changes: object) -> Appearance:
    """A person without texture or anything one-sided."""
    look = random_appearance(np.random.default_rng(1))
    values = {**vars(look), "hair": "bald", "hat": "none", "beard": False, "top_texture": (0, 0.0, 0.0)}
    return Appearance(**{**values, "backpack": False, **changes})


def head_picture(pan: float, tilt: float = 0.0, hat: str = "hood") -> np.ndarray:
    turn = rotation_z(pan) @ rotation_up(tilt)
    head = head_solids(plain(hat=hat, glasses=True)).moved(turn, (0.0, 0.0, 0.0))
    return cast(np.array(FRONT.position), FRONT.rays(), head, OVERHEAD).colour


@pytest.mark.parametrize("camera", [STREET, CEILING, FRONT])
def test_a_ray_through_a_pixel_meets_the_point_seen_there(camera: Camera) -> None:
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(0, camera.size[1], 50), rng.integers(0, camera.size[0], 50)
    ray = camera.rays()[rows, columns]
    point = np.array(camera.position) + rng.uniform(2.0, 9.0, (50, 1)) * ray
    np.testing.assert_allclose(camera.project(point), np.column_stack([columns, rows]) + 0.5, atol=1e-6)


def test_a_ball_covers_the_disc_it_should() -> None:
    make = Builder()
    make.ellipsoid((0.0, 0.1, 0.05), (0.1, 0.1, 0.1), (1.0, 1.0, 1.0))
    shown = cast(np.array(FRONT.position), FRONT.rays(), make.build(), OVERHEAD)
    # Tangent rays to a ball of radius r at distance d: tan of the half angle is r / √(d² − r²).
    centre = FRONT.project((0.0, 0.1, 0.05))
    radius = 1200.0 * 0.1 / np.sqrt(6.0**2 - 0.1**2)
    disc = np.hypot(*(np.indices((96, 96))[::-1] + 0.5 - centre[:, None, None])) < radius
    assert np.mean(shown.covered != disc) < 0.005
    assert shown.covers[0] == shown.shows[0] == shown.covered.sum()


@pytest.mark.parametrize(("pan", "tilt"), [(0.6, 0.0), (1.5, 0.4), (2.8, -0.5)])
def test_opposite_pans_are_mirror_images(pan: float, tilt: float) -> None:
    left, right = head_picture(-pan, tilt), head_picture(pan, tilt)
    assert np.abs(left - right).mean() > 0.001
    # The rounding of the half-open pixel grid may flip single pixels of the outline.
    assert np.mean(np.abs(left - right[:, ::-1]).max(axis=-1) > 1e-4) < 0.002


def test_skin_shows_from_the_front_and_not_from_behind() -> None:
    rng = np.random.default_rng(0)
    shares = []
    for pan in (0.0, np.pi):
        heads = make_heads(15, rng, pan=np.full(15, pan), tilt=np.zeros(15))
        shares.append(np.mean([mask.mean() for mask in heads.skin]))
    assert shares[0] > 2.0 * shares[1]


@pytest.mark.parametrize(
    "make",
    [
        lambda rng: make_heads(3, rng).images,
        lambda rng: head_clip(rng, HeadClipParameters(frames=2)).images,
        lambda rng: walking_clip(rng, people=2, steps=3).images,
    ],
)
def test_the_same_seed_gives_the_same_images_and_another_seed_others(make: Callable[..., list]) -> None:
    first, again, other = (make(np.random.default_rng(seed)) for seed in (5, 5, 6))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_few_drawn_poses_have_some_of_every_class() -> None:
    """With 36 classes, 24 of them at one in a hundred each, 200 drawn poses usually lack one."""
    classes = PoseClasses.circle(12, 3)
    for seed in range(5):
        pan, tilt = draw_poses(200, np.random.default_rng(seed), HeadVariation(), classes)
        of_class = np.bincount(classes.index(pan, tilt), minlength=len(classes))
        assert of_class.min() >= 2 and of_class.sum() == 200
        # Most of them look ahead still.
        assert of_class[12:24].sum() > 120


@pytest.mark.parametrize("camera", [STREET, CEILING])
def test_boxes_are_those_of_the_pixels_that_change(camera: Camera) -> None:
    scene = Scene(
        camera, Light((0.0, 0.0, 1.0), (0.0,) * 3, (1.0,) * 3), Ground((1.0, 1.0, 1.0), contrast=0.0)
    )
    person = Person(plain(height=1.8), Posture((0.8, 0.6), 0.4, 0.9, stride=0.7, phase=1.0))
    rng = np.random.default_rng(0)
    frame = render_frame(scene, [person], QUIET, rng)
    empty = render_frame(scene, [], QUIET, rng)
    rows, columns = np.nonzero(np.abs(frame.image.astype(int) - empty.image).max(axis=-1) > 1)
    left, top, width, height = frame.labels[0].body_box
    seen = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    np.testing.assert_allclose((left, top, left + width, top + height), seen, atol=1.5)
    head = frame.labels[0].head_box
    assert left - 0.01 <= head[0] and head[0] + head[2] <= left + width + 0.01
    top_of_head = camera.project((0.8, 0.6, 1.7))
    assert head[0] - 2 <= top_of_head[0] <= head[0] + head[2] + 2
    assert head[1] - 2 <= top_of_head[1] <= head[1] + head[3] + 2


def test_a_wall_in_front_hides_and_a_wall_behind_does_not() -> None:
    person = Person(plain(), Posture((0.0, 0.0), 0.0, 0.0))

    def visibility(*furniture: Furniture) -> float:
        scene = Scene(STREET, OVERHEAD, furniture=furniture)
        return render_frame(scene, [person], QUIET, np.random.default_rng(0)).labels[0].visibility

    assert visibility() == 1.0
    assert visibility(Furniture((0.0, 1.5), (3.0, 0.2, 2.5))) == 1.0
    assert visibility(Furniture((0.0, -1.5), (3.0, 0.2, 2.5))) == 0.0
    assert 0.2 < visibility(Furniture((0.0, -1.0), (3.0, 0.2, 1.0))) < 0.9


def test_the_shadow_falls_away_from_the_light() -> None:
    make = Builder()
    make.ellipsoid((0.0, 0.0, 1.0), (0.3, 0.3, 0.3), (0.5, 0.5, 0.5))
    above = Camera((0.0, 0.0, 9.0), 0.0, -np.pi / 2, 100.0, (160, 160))
    slanted = Light((*(np.cos(0.8) * unit(0.7)), np.sin(0.8)), (0.6,) * 3, (0.4,) * 3)
    args = np.array(above.position), above.rays(), make.build(), slanted
    colour = cast(*args, ground=Ground((1.0, 1.0, 1.0), contrast=0.0)).colour[..., 0]
    shade = above.project((*(-unit(0.7) / np.tan(0.8)), 0.0)).astype(int)
    lit = above.project((*(unit(0.7) / np.tan(0.8)), 0.0)).astype(int)
    assert colour[shade[1], shade[0]] == pytest.approx(0.4, abs=1e-6)
    assert colour[lit[1], lit[0]] == pytest.approx(0.4 + 0.6 * np.sin(0.8), abs=1e-6)


def test_light_and_noise_do_what_they_say() -> None:
    scene = Scene(STREET, OVERHEAD, Ground((0.5, 0.5, 0.5), contrast=0.0))
    rng = np.random.default_rng(0)
    dim = render_frame(scene, [], Sensor(gain=0.5, gamma=1.0), rng, oversampling=1).image.astype(float)
    bright = render_frame(scene, [], Sensor(gain=1.0, gamma=1.0), rng, oversampling=1).image
    noisy = render_frame(scene, [], Sensor(gain=0.5, gamma=1.0, noise=5.0), rng, oversampling=1).image
    np.testing.assert_allclose(bright, 2.0 * dim, atol=2.0)
    assert np.std(noisy - dim) == pytest.approx(5.0, rel=0.1)


def test_pedestrians_have_their_head_on_top_and_its_box_in_the_crop() -> None:
    made = make_pedestrians(12, np.random.default_rng(0), PedestrianVariation(offset=0.0, scale=0.0))
    assert len(made) == 12 and made.head_box.shape == (12, 4)
    for image, (left, top, width, height) in zip(made.images, made.head_box, strict=True):
        assert left >= 0 and left + width <= image.shape[1]
        assert top >= 0 and top + height < 0.4 * image.shape[0]
    assert (np.abs(made.head) <= np.pi).all()


def test_a_contact_sheet_shows_every_crop() -> None:
    images = [np.full((8, 6, 3), value, np.uint8) for value in (50, 100, 150)]
    sheet = contact_sheet(images, 2, cell=(12, 16), titles=["a", "b"])
    assert sheet.shape == (18 + 2 * 16, 24, 3)
    assert {50, 100, 150} <= set(np.unique(sheet))
    assert cv2.imencode(".png", sheet)[0]
