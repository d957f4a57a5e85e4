"""The corpus of the intentional tracker's paper, and strollers of another model than the estimator's."""

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, direction, wrap
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour, simulate_corpus
from graphtrack.simulation.crowd import StrollerParameters, full_turns_too_many, standing, strollers

SMALL = CorpusParameters(tracks=40)


def test_the_default_is_the_papers_size() -> None:
    corpus = simulate_corpus(rng=np.random.default_rng(0))
    assert len(corpus) == 7
    assert sum(len(part) for part in corpus) == 3500
    assert all(part.truth.shape == (500, 200, 2) for part in corpus)
    assert len({part.name for part in corpus}) == 7


def test_noise_is_what_the_paper_says() -> None:
    corpus = simulate_behaviour(3, rng=np.random.default_rng(0))
    assert np.std(corpus.position - corpus.truth) == pytest.approx(0.5, rel=0.02)
    error = difference(corpus.head, corpus.travel)
    assert np.degrees(np.mean(error)) == pytest.approx(4.0, abs=0.3)
    assert np.degrees(np.std(error)) == pytest.approx(20.0, rel=0.02)
    # The noise of a straight path is the residual across it.
    straight = simulate_behaviour(0, replace(SMALL, tracks=100), rng=np.random.default_rng(1))
    residual = []
    for path in straight.truth:
        centred = path - path.mean(axis=0)
        _, _, axes = np.linalg.svd(centred, full_matrices=False)
        residual.append(centred @ axes[1])
    assert np.std(residual) == pytest.approx(0.1, rel=0.03)


def test_without_noise_the_head_points_where_the_person_will_be() -> None:
    quiet = replace(SMALL, path_std=0.0, head_std=0.0, head_offset=0.0)
    corpus = simulate_behaviour(6, quiet, rng=np.random.default_rng(0))
    ahead = direction(corpus.truth[:, 5:] - corpus.truth[:, :-5])
    np.testing.assert_allclose(difference(corpus.head[:, :-5], ahead), 0.0, atol=1e-9)
    length = np.linalg.norm(np.diff(corpus.truth, axis=1), axis=2)
    np.testing.assert_allclose(length, 0.3, atol=1e-12)


@pytest.mark.parametrize("behaviour", range(7))
def test_a_manoeuvre_comes_back_to_its_line(behaviour: int) -> None:
    quiet = replace(SMALL, path_std=0.0)
    corpus = simulate_behaviour(behaviour, quiet, rng=np.random.default_rng(behaviour))
    step = np.diff(corpus.truth, axis=1)
    course = direction(step)
    # Out and back by the same steps: it ends on the line along which it began, on the same course.
    begun, ended = course[:, 0], course[:, -1]
    whole = np.abs(difference(begun, ended)) < 1e-6
    assert whole.mean() > 0.6
    across = np.stack([-np.sin(begun), np.cos(begun)], axis=1)
    off = np.einsum("mi,mni->mn", across, corpus.truth - corpus.truth[:, :1])
    inside = whole & (np.abs(difference(course[:, 1], begun)) < 1e-9)
    np.testing.assert_allclose(off[inside][:, -1], 0.0, atol=0.05)
    assert (np.abs(off).max() > 0.5) == (behaviour > 0)


@pytest.mark.parametrize("rate", [1.0, 0.8, 0.6])
def test_detection_rates(rate: float) -> None:
    corpus = simulate_behaviour(2, replace(SMALL, tracks=200), rng=np.random.default_rng(0))
    found = corpus.detected(rate, np.random.default_rng(1))
    seen = np.isfinite(found.position[..., 0])
    assert seen[:, 0].all()
    assert seen[:, 1:].mean() == pytest.approx(rate, abs=0.01)
    np.testing.assert_array_equal(np.isfinite(found.head), seen)
    np.testing.assert_array_equal(found.position[seen], corpus.position[seen])


def test_tracks_are_the_arrays_in_seconds() -> None:
    corpus = simulate_behaviour(4, replace(SMALL, tracks=5), rng=np.random.default_rng(0))
    tracks = corpus.detected(0.7, np.random.default_rng(2)).tracks(3)
    assert len(tracks) == 3
    track = tracks.tracks[1]
    assert track.has_truth
    np.testing.assert_array_equal(track.true_position, corpus.truth[1])
    np.testing.assert_allclose(np.diff(track.t), 0.25)
    speed = np.linalg.norm(corpus.truth[1, 100] - corpus.truth[1, 60]) / (track.t[100] - track.t[60])
    assert speed < 1.3
    everyone = [simulate_behaviour(b, replace(SMALL, tracks=5), rng=np.random.default_rng(0)) for b in (0, 6)]
    ids = [track.track_id for part in everyone for track in part.tracks()]
    assert len(set(ids)) == 10


def test_no_such_behaviour_and_rate() -> None:
    with pytest.raises(InputError, match="behaviour 7"):
        simulate_behaviour(7, rng=np.random.default_rng(0))
    corpus = simulate_behaviour(0, SMALL, rng=np.random.default_rng(0))
    for rate in (0.0, 1.1, float("nan")):
        with pytest.raises(InputError, match="rate"):
            corpus.detected(rate, np.random.default_rng(0))


PLAIN = StrollerParameters(stops_per_minute=0.0, glances_per_minute=0.0)


def test_heads_lead_the_course_and_bodies_follow_it() -> None:
    people = strollers(np.random.default_rng(1), replace(PLAIN, head_lead=0.4), people=20, fps=25.0)
    leads = np.arange(-20, 21)
    for angle, lead in (("true_body", -0.15), ("true_head", 0.3)):
        errors = np.zeros(len(leads))
        for track in people:
            course = direction(np.gradient(track.true_position, track.t, axis=0))
            values = getattr(track, angle)
            for i, shift in enumerate(leads):
                there = np.clip(np.arange(len(track)) + shift, 0, len(track) - 1)
                errors[i] += np.mean(np.abs(difference(values, course[there])))
        assert leads[errors.argmin()] / 25.0 == pytest.approx(lead, abs=0.09)


def test_stops_and_glances_have_their_lengths() -> None:
    habits = StrollerParameters(turns_per_minute=0.0, stop_low=3.0, stop_high=3.5, glances_per_minute=0.0)
    people = strollers(np.random.default_rng(2), habits, people=20, fps=25.0)
    lengths = [
        track.t[end - 1] - track.t[begin]
        for track in people
        for begin, end in standing(track, slowest=0.02)
        if begin > 0 and end < len(track)
    ]
    assert len(lengths) > 20 and min(lengths) > 2.7 and max(lengths) < 3.6
    aside = strollers(np.random.default_rng(3), replace(PLAIN, glances_per_minute=10.0), people=20)
    off = np.abs(np.concatenate([difference(t.true_head, t.true_body) for t in aside]))
    none = strollers(np.random.default_rng(3), PLAIN, people=20)
    off_none = np.abs(np.concatenate([difference(t.true_head, t.true_body) for t in none]))
    assert np.mean(off > np.radians(30.0)) > np.mean(off_none > np.radians(30.0)) + 0.08


def test_noise_is_as_declared() -> None:
    people = strollers(np.random.default_rng(4), PLAIN, people=10, turned=0.1, position_std=0.2)
    off = np.concatenate([difference(t.head, t.true_head) for t in people])
    turned = np.abs(off) > np.radians(120.0)
    assert turned.mean() == pytest.approx(0.1, abs=0.02)
    kappa = 1.0 / np.radians(30.0) ** 2
    assert all(np.allclose(t.head_kappa, kappa) for t in people)
    assert np.concatenate([t.position - t.true_position for t in people]).std() == pytest.approx(
        0.2, rel=0.05
    )
    (bare,) = strollers(np.random.default_rng(5), PLAIN, people=1, body_std=None, declared=False, seconds=5.0)
    assert bare.body is None and bare.head_kappa is None and bare.true_body is not None


def test_a_turn_too_many_is_counted() -> None:
    people = strollers(np.random.default_rng(6), people=10)
    track = next(t for t in people if any(b > 0 and e < len(t) for b, e in standing(t)))
    right = replace(track, body=track.true_body)
    assert full_turns_too_many(right, track) == (0, len(standing(track)))
    begin, end = next((b, e) for b, e in standing(track) if b > 0 and e < len(track))
    ramp = np.clip((np.arange(len(track)) - begin) / (end - begin), 0.0, 1.0)
    wound = replace(track, body=wrap(track.true_body + 2.0 * np.pi * ramp))
    assert full_turns_too_many(wound, track)[0] == 1
    assert full_turns_too_many(replace(track, body=None), track) == (0, 0)


@pytest.mark.parametrize("wrong", [{"people": 0}, {"fps": -1.0}, {"turned": 1.5}, {"seconds": np.nan}])
def test_numbers_out_of_range_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        strollers(np.random.default_rng(0), **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        StrollerParameters(speed=-1.0)
