"""Rendered ceiling-camera sequences: the images agree with the labels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from perception.synthetic.cameras import Sensor
from perception.synthetic.ceiling import ALL_KINDS, KINDS, SIZE, CeilingSequence, ceiling_sequence
from perception.synthetic.people import Posture, person_solids, random_appearance
from perception.synthetic.scene import Furniture, Person, StillScene, render_frame

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
    sensor = Sensor(noise=2.0, jpeg_quality=80)
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
    light = replace(sequence.scene.light, key=(0.0, 0.0, 0.0))
    scene = replace(sequence.scene, light=light)
    room = StillScene(scene, oversampling=1)
    empty = room.render((), Sensor(), np.random.default_rng(0)).image
    for k in range(30, FRAMES, 12):
        posture = sequence.walks[0].posture(k)
        assert posture is not None
        frame = room.render([Person(sequence.appearances[0], posture)], Sensor(), np.random.default_rng(0))
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
