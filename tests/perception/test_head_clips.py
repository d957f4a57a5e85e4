"""Rendered heads in motion against the pixels themselves: a person of colours that nothing else has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.synthetic.people import Appearance, random_appearance

QUIET = HeadClipParameters(frames=40, clutter=0.0, jitter=0.0)


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
        np.random.default_rng(4), replace(QUIET, frames=40, all_around=True, tilt=0.0), look=red_headed()
    )


@pytest.fixture(scope="module")
def hidden() -> HeadClip:
    return head_clip(
        np.random.default_rng(1), replace(QUIET, frames=60, occlusion=(25, 12)), look=red_headed()
    )


def test_boxes_enclose_the_pixels_of_the_head(around: HeadClip) -> None:
    away = []
    for image, box in zip(around.images, around.boxes, strict=True):
        # Below the chin there are neck and hands; sides and top are the head's alone.
        rows, columns = np.nonzero(head_pixels(image)[: round(box[1] + 0.8 * box[3])])
        found = [columns.min(), columns.max() + 1.0, rows.min()]
        away.append(np.abs(found - np.array([box[0], box[0] + box[2], box[1]])))
    assert np.max(away) < 2.6
    assert np.mean(away, axis=0).max() < 1.0


def test_the_face_is_where_the_pan_says(around: HeadClip) -> None:
    skin = [inside(red(image), box) for image, box in zip(around.images, around.boxes, strict=True)]
    share = np.array([mask.mean() for mask in skin])
    assert share[np.cos(around.pan) > 0.7].min() > share[np.cos(around.pan) < -0.7].max()
    aside = np.array([np.nonzero(mask)[1].mean() / mask.shape[1] - 0.5 for mask in skin])
    turned = np.abs(np.sin(around.pan)) > 0.5
    assert (np.sign(aside[turned]) == np.sign(np.sin(around.pan[turned]))).all()
    assert {-1.0, 1.0} <= set(np.sign(np.sin(around.pan[turned])))


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
            np.random.default_rng(2), replace(QUIET, frames=1, clutter=clutter), look=red_headed()
        )
        mask = red(clip.images[0])
        left = max(int(clip.boxes[0, 0] - 80), 0)
        mask[:, left : left + 190] = False
        shares.append(mask.mean())
    assert shares[0] == 0.0 and shares[1] > 0.01


@pytest.mark.parametrize(
    "change", [{"frames": 0}, {"clutter": -1.0}, {"occlusion": (0, 5)}, {"occlusion": (90, 25)}]
)
def test_what_cannot_be_rendered_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(InputError):
        HeadClipParameters(**change)  # type: ignore[arg-type]


def test_an_occlusion_too_long_for_the_image_is_refused() -> None:
    with pytest.raises(InputError, match="walk behind"):
        head_clip(np.random.default_rng(0), replace(QUIET, frames=400, occlusion=(20, 370)))
