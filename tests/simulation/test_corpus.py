from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, direction
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour, simulate_corpus

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


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"tracks": 0}, "tracks"),
        ({"steps": 100}, "100 steps"),
        ({"speed": 0.0}, "speed"),
        ({"head_std": -1.0}, "head_std"),
        ({"turn_steps": (3, 3)}, "turn_steps"),
        ({"turn_steps": (0, 1, 1, 1, 1, 1)}, "turn_steps"),
    ],
)
def test_parameters_out_of_range(wrong: dict[str, object], named: str) -> None:
    with pytest.raises(InputError, match=named):
        CorpusParameters(**wrong)  # type: ignore[arg-type]


def test_no_such_behaviour_and_rate() -> None:
    with pytest.raises(InputError, match="behaviour 7"):
        simulate_behaviour(7, rng=np.random.default_rng(0))
    corpus = simulate_behaviour(0, SMALL, rng=np.random.default_rng(0))
    for rate in (0.0, 1.1, float("nan")):
        with pytest.raises(InputError, match="rate"):
            corpus.detected(rate, np.random.default_rng(0))
