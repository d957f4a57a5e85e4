"""Rendered pictures, rooms under a ceiling camera and moving heads against other geometry."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, unit
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
from perception.synthetic.cameras import ImageSensor
from perception.synthetic.ceiling import ALL_KINDS, KINDS, SIZE, CeilingSequence, ceiling_sequence
from perception.synthetic.clips import walking_clip
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.synthetic.people import Appearance, Posture, head_solids, person_solids, random_appearance
from perception.synthetic.raycast import Light, TiledFloor, cast
from perception.synthetic.scene import StillScene
from perception.synthetic.solids import Builder, rotation_up, rotation_z

OVERHEAD = Light((0.0, 0.0, 1.0), (0.6, 0.6, 0.6), (0.4, 0.4, 0.4))
FRONT = Camera((6.0, 0.0, 0.0), np.pi, 0.0, 1200.0, (96, 96))
STREET = Camera((0.0, -9.0, 3.5), np.pi / 2, -0.35, 420.0, (192, 144))
CEILING = Camera((0.0, 0.0, 5.0), 0.3, -np.pi / 2, 80.0, (192, 144), "fisheye")
QUIET = ImageSensor(gamma=1.0)


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


@pytest.mark.slow
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
        camera, Light((0.0, 0.0, 1.0), (0.0,) * 3, (1.0,) * 3), TiledFloor((1.0, 1.0, 1.0), contrast=0.0)
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
    colour = cast(*args, ground=TiledFloor((1.0, 1.0, 1.0), contrast=0.0)).colour[..., 0]
    shade = above.project((*(-unit(0.7) / np.tan(0.8)), 0.0)).astype(int)
    lit = above.project((*(unit(0.7) / np.tan(0.8)), 0.0)).astype(int)
    assert colour[shade[1], shade[0]] == pytest.approx(0.4, abs=1e-6)
    assert colour[lit[1], lit[0]] == pytest.approx(0.4 + 0.6 * np.sin(0.8), abs=1e-6)


def test_light_and_noise_do_what_they_say() -> None:
    scene = Scene(STREET, OVERHEAD, TiledFloor((0.5, 0.5, 0.5), contrast=0.0))
    rng = np.random.default_rng(0)
    dim = render_frame(scene, [], ImageSensor(gain=0.5, gamma=1.0), rng, oversampling=1).image.astype(float)
    bright = render_frame(scene, [], ImageSensor(gain=1.0, gamma=1.0), rng, oversampling=1).image
    noisy = render_frame(scene, [], ImageSensor(gain=0.5, gamma=1.0, noise=5.0), rng, oversampling=1).image
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
    sheet = contact_sheet(images, 2, cell=(12, 16))
    assert sheet.shape == (2 * 16, 24, 3)
    assert {50, 100, 150} <= set(np.unique(sheet))
    assert cv2.imencode(".png", sheet)[0]


FRAMES = 100


def drawn(name: str, frames: int = FRAMES) -> CeilingSequence:
    return ceiling_sequence(ALL_KINDS[name], np.random.default_rng(1), frames=frames, oversampling=1)


@pytest.mark.parametrize("oversampling", [1, 2])
def test_casting_only_near_what_moves_gives_the_same_frame(oversampling: int) -> None:
    scene = drawn("changed environment").scene
    look = random_appearance(np.random.default_rng(2))
    people = [
        Person(look, Posture((1.0, 0.5), 0.3, 0.2, phase=1.0, stride=1.0)),
        Person(look, Posture((-2, 1), 1, 2)),
    ]
    moving = (Furniture((-0.5, -0.8), (0.9, 0.6, 0.7), 0.4),)
    sensor = ImageSensor(noise=2.0, jpeg_quality=80)
    fast = StillScene(scene, oversampling=oversampling)
    fast.render(people[1:], sensor, np.random.default_rng(0))  # nothing of one frame may stay in the next
    frame = fast.render(people, sensor, np.random.default_rng(0), moving=moving)
    whole = replace(scene, furniture=(*scene.furniture, *moving))
    expected = render_frame(whole, people, sensor, np.random.default_rng(0), oversampling=oversampling)
    np.testing.assert_array_equal(frame.image, expected.image)
    assert frame.labels == expected.labels


@pytest.mark.parametrize("name", ["person moving and sitting 1", "robot moving"])
def test_the_label_encloses_the_pixels_of_the_target(name: str) -> None:
    sequence = drawn(name)
    # Without a key light there are no shadows: only the person differs from the empty room.
    light = sequence.scene.light._replace(key=(0.0, 0.0, 0.0))
    scene = replace(sequence.scene, light=light)
    room = StillScene(scene, oversampling=1)
    empty = room.render((), ImageSensor(), np.random.default_rng(0)).image
    for k in range(30, FRAMES, 12):
        posture = sequence.walks[0].posture(k)
        assert posture is not None
        frame = room.render(
            [Person(sequence.appearances[0], posture)], ImageSensor(), np.random.default_rng(0)
        )
        box = frame.labels[0].body_box
        assert box is not None
        rows, columns = np.nonzero((frame.image != empty).any(axis=2))
        left, top, width, height = box
        seen = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
        outer = np.array([left, top, left + width, top + height])
        assert (np.sign([-1, -1, 1, 1]) * (seen - outer) <= 0.0).all()
        # Furniture may hide some of the person, but not in all of the frames.
        if frame.labels[0].visibility == 1.0:
            np.testing.assert_allclose(seen, outer, atol=2.0)


@pytest.mark.parametrize("name", KINDS)
def test_what_happens_in_each_kind(name: str) -> None:
    kind, sequence = KINDS[name], drawn(name, 400)
    walk = sequence.walks[0]
    assert not walk.there[:15].any() and walk.there[15:].all()
    assert len(sequence) == 400
    assert (walk.sitting.max() > 0.99) == bool(kind.sits)
    speeds = np.linalg.norm(np.diff(walk.position, axis=0), axis=1) * sequence.fps
    assert speeds.max() < 1.05 * kind.speed
    assert speeds[walk.sitting[1:] > 0.0].max(initial=0.0) == 0.0
    assert len(sequence.moved) == len(kind.moves)
    for (_, places), (first, last) in zip(sequence.moved, kind.moves, strict=True):
        moving = np.flatnonzero(np.abs(np.diff(places, axis=0)).max(axis=1) > 0.0)
        assert first * 400 - 1 <= moving.min() and moving.max() <= last * 400 + 1
    assert len(sequence.walks) == (1 if kind.distracter is None else 2)


@pytest.mark.slow
def test_the_person_is_in_view_and_everything_repeats() -> None:
    sequence = drawn("changed environment and distracter", 60)
    frames = list(sequence)
    for frame, other in zip(frames[:3], sequence, strict=False):
        np.testing.assert_array_equal(frame.image, other.image)
    assert frames[0].image.shape == (SIZE[1], SIZE[0], 3)
    assert all(frame.target is None for frame in frames[:15])
    boxes = [frame.target.body_box for frame in frames[40:] if frame.target is not None]
    assert len(boxes) == 20 and None not in boxes
    assert {frame.distracter is None for frame in frames} == {True, False}


def test_who_sits_is_lower_by_the_thighs_and_keeps_the_feet_on_the_ground() -> None:
    look = random_appearance(np.random.default_rng(0))
    up, head_up = person_solids(look, Posture((0.0, 0.0), 0.0, 0.0))
    down, head_down = person_solids(look, Posture((0.0, 0.0), 0.0, 0.0, sitting=1.0))
    dropped = 0.42 * look.height / 1.72
    np.testing.assert_allclose(head_up.centre[:, 2] - head_down.centre[:, 2], dropped)
    assert up.centre[:, 2].max() - down.centre[:, 2].max() == pytest.approx(dropped)
    assert up.centre[:, 2].min() == pytest.approx(down.centre[:, 2].min(), abs=1e-9)


QUIET_CLIP = HeadClipParameters(frames=40, clutter=0.0, jitter=0.0)


def red_headed(seed: int = 0) -> Appearance:
    """Red skin, yellow hair, and everything else blue."""
    look = random_appearance(np.random.default_rng(seed))
    blue = (0.8, 0.3, 0.05)
    clothes = {"top": blue, "shirt": blue, "trousers": blue, "shoes": blue, "hat_colour": blue}
    return replace(
        look,
        skin=(0.03, 0.03, 0.8),
        hair_colour=(0.03, 0.6, 0.6),
        hair="short",
        hat="none",
        glasses=False,
        beard=False,
        backpack=False,
        bare_arms=False,
        top_texture=(0, 0.0, 0.0),
        **clothes,
    )


def red(image: np.ndarray) -> np.ndarray:
    b, g, r = np.moveaxis(image.astype(int), -1, 0)
    return (r > 1.4 * b + 12) & (r > 1.4 * g + 12)


def head_pixels(image: np.ndarray) -> np.ndarray:
    """Red or yellow."""
    b, _, r = np.moveaxis(image.astype(int), -1, 0)
    return r > 1.4 * b + 12


def inside(mask: np.ndarray, box: np.ndarray) -> np.ndarray:
    left, top, right, bottom = np.round([box[0], box[1], box[0] + box[2], box[1] + box[3]]).astype(int)
    return mask[top:bottom, left:right]


@pytest.fixture(scope="module")
def around() -> HeadClip:
    return head_clip(
        np.random.default_rng(4), replace(QUIET_CLIP, frames=40, all_around=True, tilt=0.0), look=red_headed()
    )


@pytest.fixture(scope="module")
def hidden() -> HeadClip:
    return head_clip(
        np.random.default_rng(1), replace(QUIET_CLIP, frames=60, occlusion=(25, 12)), look=red_headed()
    )


@pytest.mark.slow
def test_boxes_enclose_the_pixels_of_the_head(around: HeadClip) -> None:
    away = []
    for image, box in zip(around.images, around.boxes, strict=True):
        # Below the chin there are neck and hands; sides and top are the head's alone.
        rows, columns = np.nonzero(head_pixels(image)[: round(box[1] + 0.8 * box[3])])
        found = [columns.min(), columns.max() + 1.0, rows.min()]
        away.append(np.abs(found - np.array([box[0], box[0] + box[2], box[1]])))
    assert np.max(away) < 2.6
    assert np.mean(away, axis=0).max() < 1.0


@pytest.mark.slow
def test_the_face_is_where_the_pan_says(around: HeadClip) -> None:
    skin = [inside(red(image), box) for image, box in zip(around.images, around.boxes, strict=True)]
    share = np.array([mask.mean() for mask in skin])
    assert share[np.cos(around.pan) > 0.7].min() > share[np.cos(around.pan) < -0.7].max()
    aside = np.array([np.nonzero(mask)[1].mean() / mask.shape[1] - 0.5 for mask in skin])
    turned = np.abs(np.sin(around.pan)) > 0.5
    assert (np.sign(aside[turned]) == np.sign(np.sin(around.pan[turned]))).all()
    assert {-1.0, 1.0} <= set(np.sign(np.sin(around.pan[turned])))


@pytest.mark.slow
def test_a_wall_hides_exactly_the_frames_asked_for(hidden: HeadClip) -> None:
    asked = np.zeros(60, bool)
    asked[25:37] = True
    np.testing.assert_array_equal(hidden.visible == 0.0, asked)
    shown = [
        inside(head_pixels(image), box).mean() for image, box in zip(hidden.images, hidden.boxes, strict=True)
    ]
    assert np.max(np.array(shown)[asked]) < 0.01
    np.testing.assert_array_equal(np.array(shown)[~asked] > 0.01, hidden.visible[~asked] > 0.02)
    # The person goes on behind the wall and is seen again.
    assert abs(hidden.boxes[37, 0] - hidden.boxes[24, 0]) > 10.0
    assert hidden.visible[0] == hidden.visible[-1] == 1.0


@pytest.mark.slow
def test_motion_is_smooth_and_stays_in_the_image(around: HeadClip, hidden: HeadClip) -> None:
    for clip in (around, hidden):
        right, bottom = (clip.boxes[:, :2] + clip.boxes[:, 2:]).T
        assert clip.boxes[:, :2].min() > 0.0 and right.max() < 320 and bottom.max() < 240
        centre = clip.boxes[:, :2] + clip.boxes[:, 2:] / 2.0
        assert np.linalg.norm(np.diff(centre, axis=0), axis=1).max() < 7.0
        assert np.abs(difference(clip.pan[1:], clip.pan[:-1])).max() < 0.4
    assert np.abs(hidden.pan).max() <= np.pi / 2.0


def test_clutter_has_the_colours_of_the_person() -> None:
    shares = []
    for clutter in (0.0, 1.0):
        clip = head_clip(
            np.random.default_rng(2), replace(QUIET_CLIP, frames=1, clutter=clutter), look=red_headed()
        )
        mask = red(clip.images[0])
        left = max(int(clip.boxes[0, 0] - 80), 0)
        mask[:, left : left + 190] = False
        shares.append(mask.mean())
    assert shares[0] == 0.0 and shares[1] > 0.01


def test_an_occlusion_too_long_for_the_image_is_refused() -> None:
    with pytest.raises(InputError, match="walk behind"):
        head_clip(np.random.default_rng(0), replace(QUIET_CLIP, frames=400, occlusion=(20, 370)))
