"""Angles against the direction of motion: rotations, mirrors, and the convention that fits."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import ran
from hypothesis import example, given, settings
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.constants.declared import declared_noise
from graphtrack.constants.directions import angle_fit, proposed_convention, shared_offset
from graphtrack.errors import InputWarning
from graphtrack.geometry.angles import difference, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import AngleConvention, converted
from graphtrack.tracks.track import Track, TrackSet

MODEL = gt.Model("joint")
SEEDS = st.integers(0, 10_000)


def walkers(
    seed: int, n: int = 14, noise: float = 30.0, sideways: float = 0.0, seconds: float = 12.0
) -> TrackSet:
    """People who walk in curves, with angles that err by ``noise`` degrees for about a second each.

    A share ``sideways`` of them walk sideways all the time.
    """
    rng, tracks = np.random.default_rng(seed), []
    t = np.arange(0.0, seconds, 0.1)
    aside = np.arange(n) < round(sideways * n)
    for m in range(n):
        way = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.2, 0.2) * t
        step = 0.13 * np.column_stack([np.cos(way), np.sin(way)])
        position = np.cumsum(step, axis=0) + 0.03 * rng.normal(size=(len(t), 2))
        facing = way + aside[m] * np.pi / 2.0
        angles = {}
        for name in ("body", "head"):
            held = np.radians(noise) * rng.normal(size=int(seconds) + 2)
            angles[name] = wrap(
                facing + 0.8 * np.interp(t, np.arange(len(held)), held) + 0.2 * rng.normal(size=len(t))
            )
        tracks.append(Track(m, np.arange(len(t)), t, position, **angles, true_body=wrap(facing)))
    return TrackSet(tuple(tracks))


def read_as(tracks: TrackSet, convention: AngleConvention, *names: str) -> TrackSet:
    """The tracks of a file written in a convention, and read in that of the native table."""

    def changed(track: Track) -> Track:
        given = {name: getattr(track, name) for name in names or ("body", "head")}
        return replace(track, **converted({**given, "position": track.position}, convention, None, back=True))

    return tracks.map(changed)


ZEROS = st.sampled_from(["right", "up", "left", "down"])


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@given(SEEDS, ZEROS, st.sampled_from(["ccw", "cw"]), st.sampled_from([3, 5, 20]))
def test_the_convention_of_a_file_is_found(seed: int, zero: str, sense: str, people: int) -> None:
    convention = AngleConvention(zero, sense)
    tracks = read_as(walkers(seed, people, seconds=30.0), convention)
    fit = angle_fit(tracks, "head")
    assert fit is not None
    if convention.headings([0.0, 1.0]).tolist() == [0.0, 1.0]:
        assert not fit.is_wrong
        return
    assert fit.is_wrong and fit.is_mirrored == (sense == "cw")
    assert proposed_convention(tracks)[0] == fit.convention == convention


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@given(SEEDS, st.integers(50, 310), st.booleans())
def test_any_rotation_of_a_mirror_is_corrected(seed: int, degrees: int, is_mirrored: bool) -> None:
    convention = AngleConvention(degrees, "cw" if is_mirrored else "ccw")
    tracks = walkers(seed, 12, seconds=20.0)
    noise = declared_noise(read_as(tracks, convention), MODEL)
    with_angles, _ = noise.corrected(read_as(tracks, convention), MODEL)
    errors = [difference(one.head, true.head) for one, true in zip(with_angles, tracks, strict=True)]
    assert abs(np.degrees(np.median(np.concatenate(errors)))) < 12.0
    assert np.degrees(np.median(np.abs(np.concatenate(errors)))) < 15.0
    assert sum("--angles" in line for line in noise.lines()) == 2


@pytest.mark.slow
@settings(deadline=None, max_examples=25)
@given(SEEDS, st.sampled_from([1, 2, 4, 14, 40]), st.floats(0.0, 40.0), st.sampled_from([0.0, 0.25]))
@example(3, 1, 40.0, 0.0)
def test_right_angles_are_left_alone(seed: int, people: int, noise: float, sideways: float) -> None:
    tracks = walkers(seed, people, noise, sideways)
    for name in ("body", "head"):
        fit = angle_fit(tracks, name)
        assert fit is None or not fit.is_wrong
    assert proposed_convention(tracks) == (None, ())


def along_one_line(tracks: TrackSet, degrees: float) -> TrackSet:
    """The same people, who all walk along one line, to and fro."""

    def straight(track: Track) -> Track:
        way = np.radians(degrees) + np.pi * (track.track_id % 2)
        angles = {name: wrap(getattr(track, name) - track.true_body + way) for name in ("body", "head")}
        return replace(track, position=1.3 * track.t[:, None] * [np.cos(way), np.sin(way)], **angles)

    return tracks.map(straight)


@pytest.mark.parametrize(
    ("line", "convention"),
    [(90.0, AngleConvention("right", "cw")), (0.0, AngleConvention("up", "cw"))],
)
def test_of_a_corridor_the_usual_convention_is_proposed(line: float, convention: AngleConvention) -> None:
    """A rotation by 180° or 90° fits as well: the ends of a line do not tell it from a mirror."""
    tracks = along_one_line(walkers(5), line)
    assert proposed_convention(tracks) == (None, ())
    assert proposed_convention(read_as(tracks, convention))[0] == convention


def test_directions_in_an_oblique_image_are_found_for_its_camera() -> None:
    homography = np.array([[0.01, 0.001, -4.0], [0.0005, -0.02, 9.0], [0.00001, -0.0012, 1.0]])
    camera = GroundCamera.from_homography(homography, visible=np.array([[300.0, 500.0]]))
    up = AngleConvention("up", "cw")

    def placed(track: Track) -> Track:
        """The same walk about a pixel, half as far and at twice the rate."""
        away = 0.5 * (track.position - track.position.mean(axis=0))
        position = camera.image_to_ground(np.array([320.0, 600.0])) + away
        pixel = camera.ground_to_image(position)
        assert np.isfinite(pixel).all()
        return replace(track, t=0.5 * track.t, position=position, pixel=pixel)

    def in_image(track: Track) -> Track:
        given = {"head": track.head, "pixel": track.pixel}
        return replace(track, **converted(given, up, camera, back=True))

    people = walkers(11, 6, noise=15.0).map(placed)
    read = replace(people.map(in_image), camera=camera)
    fit = angle_fit(read, "head")
    assert fit is not None and fit.is_wrong and fit.convention == up
    for one, true in zip(read, people, strict=True):
        found = fit.corrected(one, "head", camera)["head"]
        np.testing.assert_allclose(difference(found, true.head), 0.0, atol=1e-4)


def turned(track: Track, degrees: float) -> Track:
    return replace(track, body=wrap(track.body + np.radians(degrees)))


@pytest.mark.slow
def test_a_detector_that_turns_everybody_is_found_out_and_corrected() -> None:
    off = walkers(0).map(lambda track: turned(track, 30.0))
    noise = declared_noise(off, MODEL)
    body, head = (next(one for one in noise.channels if one.name == name) for name in ("body", "head"))
    assert body.wrong_angles is not None and head.wrong_angles is None
    assert np.degrees(body.wrong_angles.value) == pytest.approx(30.0, abs=4.0)
    assert any(line.startswith("body") and "to the left" in line for line in noise.lines())
    again, _ = noise.corrected(off, MODEL)
    assert all(one.wrong_angles is None for one in declared_noise(again, MODEL).channels)
    few = walkers(2, 5).map(lambda track: turned(track, 34.0))
    assert all(one.wrong_angles is None for one in declared_noise(few, MODEL).channels)


@pytest.mark.slow
def test_people_who_all_side_step_are_left_alone_as_the_note_on_them_proposes() -> None:
    """The note of a mirror, or of a detector's bias, has no such option: no gait is that."""
    people = walkers(6, 12, sideways=1.0)
    option = "--trust declared"
    with pytest.warns(InputWarning, match=f"turned by 9.°.*--trust learn corrects it; {option} keeps"):
        checked = gt.smooth(people)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kept = gt.smooth(people, trust="declared")
    for one, true in zip(kept, people, strict=True):
        assert np.degrees(np.abs(difference(one.body, true.true_body)).mean()) < 30.0
    np.testing.assert_array_equal(kept[0].body, checked[0].body)
    mirrored = read_as(walkers(6, 12), AngleConvention("right", "cw"))
    biased = walkers(2, 40).map(lambda track: turned(track, 34.0))
    for off in (mirrored, biased):
        lines = declared_noise(off, MODEL).lines()
        assert lines and not any(option in line for line in lines)


def test_classes_are_mirrored_back_too() -> None:
    centres = 2.0 * np.pi * np.arange(8) / 8.0

    def classes(angle: np.ndarray) -> np.ndarray:
        return np.exp(4.0 * (np.cos(angle[:, None] - centres) - 1.0))

    people = walkers(4)
    spoilt = people.map(lambda track: replace(track, body=None, body_likelihood=classes(-track.body)))
    (body,) = (one for one in declared_noise(spoilt, MODEL).channels if one.name == "body")
    assert body.wrong_angles is not None and body.wrong_angles.is_mirrored
    corrected, _ = declared_noise(spoilt, MODEL).corrected(spoilt, MODEL)
    for one, true in zip(corrected, people, strict=True):
        np.testing.assert_allclose(one.body_likelihood, classes(true.body), atol=1e-12)


def test_gaits_of_their_own_are_no_bias() -> None:
    """The interval of an offset that is shared holds it."""
    rng = np.random.default_rng(5)
    found = [shared_offset(wrap(0.5 + 0.2 * rng.normal(size=20))) for _ in range(100)]
    assert sum(one.low < 0.5 < one.high for one in found) >= 97

    def own(track: Track) -> Track:
        return turned(track, float(np.random.default_rng(track.track_id).uniform(-180.0, 180.0)))

    (body, _) = (angle_fit(walkers(1).map(own), name) for name in ("body", "head"))
    assert body is not None and not body.is_wrong


@pytest.mark.slow
@pytest.mark.parametrize(("convention", "word"), [("cw from right", "mirrored"), ("ccw from up", "turned")])
def test_heads_of_people_who_stand_are_compared_with_their_bodies(convention: str, word: str) -> None:
    standing = walkers(8, 10, noise=10.0).map(lambda track: replace(track, position=0.0 * track.position))
    assert declared_noise(standing, MODEL).relation is not None
    lines = {
        "both": declared_noise(read_as(standing, AngleConvention.of(convention)), MODEL).lines(),
        "head": declared_noise(read_as(standing, AngleConvention.of(convention), "head"), MODEL).lines(),
    }
    assert not any("head, body" in line for line in lines["both"])
    assert any("head, body" in line and word in line for line in lines["head"])


@pytest.mark.slow
def test_the_shell_proposes_and_corrects(tmp_path: Path) -> None:
    path = tmp_path / "people.csv"
    convention = AngleConvention("up", "cw")
    people = read_as(walkers(9, 6, seconds=20.0), convention)
    gt.write(people.map(lambda track: replace(track, true_body=None)), path)
    done = ran("info", path, "--suggest", program="graphtrack")
    assert "--angles 'clockwise from up'" in done.stdout and "mirrored" in done.stderr
    with pytest.warns(InputWarning, match="mirrored.*--angles 'clockwise from up'.*--trust learn"):
        checked = gt.smooth(path)
    with pytest.warns(InputWarning, match="corrected"):
        learned = gt.smooth(path, trust="learn")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        right = gt.smooth(gt.read(path, angles=convention))
    for one, other, wrong in zip(learned, right, checked, strict=True):
        np.testing.assert_allclose(difference(one.head, other.head), 0.0, atol=1e-6)
        assert np.degrees(np.abs(difference(wrong.head, other.head))).max() > 60.0


def test_a_rotation_that_is_no_convention_may_be_how_people_walk() -> None:
    people = walkers(3, 12).map(lambda track: turned(track, 70.0))
    found = angle_fit(people, "body")
    assert found is not None and found.is_wrong and not isinstance(found.convention.zero, str)
    assert "go sideways" in found.described()
    quarter = angle_fit(walkers(3, 12).map(lambda track: turned(track, 90.0)), "body")
    assert quarter is not None and f"they fit --angles '{quarter.convention}'" in quarter.described()
