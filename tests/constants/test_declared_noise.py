"""Tests of the declared noise: multipliers, biases, and their correction."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import ran, run

import graphtrack as gt
from graphtrack.constants.declared import declared_noise, shared_offset, turned
from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import wrap
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.tracks.track import Track, TrackSet

MODEL = gt.Model("joint")


def people(
    seed: int, n: int = 12, steps: int = 120, fps: float = 10.0, preset: str = "joint", std: float = 0.1
) -> TrackSet:
    simulated = gt.simulate(preset, n_tracks=n, n_steps=steps, fps=fps, rng=np.random.default_rng(seed))
    return gt.add_noise(
        simulated, position_std=std, body_kappa=3.0, head_kappa=5.0, rng=np.random.default_rng(seed)
    )


def misdeclared(tracks: TrackSet, position: float, body: float, head: float) -> TrackSet:
    """The same observations, declared that many times as noisy (1-σ) as they are."""

    def changed(track: Track) -> Track:
        return replace(
            track,
            position_std=position * track.position_std,
            body_kappa=track.body_kappa / body**2,
            head_kappa=track.head_kappa / head**2,
        )

    return tracks.map(changed)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_declared_rightly_is_not_contradicted(seed: int) -> None:
    setting = [(6, 60, 30.0), (12, 120, 10.0), (30, 30, 2.5)][seed % 3]
    preset = ["separate", "joint"][seed % 2]
    assert declared_noise(people(seed, *setting, preset), MODEL).lines() == []
    few = misdeclared(people(4, 1, 30), 0.1, 1.0, 1.0)
    assert declared_noise(few, MODEL).lines() == []


@pytest.mark.parametrize("factor", [1 / 3, 3.0])
def test_what_is_declared_wrongly_is_found_and_corrected(factor: float) -> None:
    tracks = misdeclared(people(1), factor, 0.5, 2.0)
    noise = declared_noise(tracks, MODEL)
    found = {one.name: one.multiplier for one in noise.channels}
    for name, wrong in (("position", factor), ("body", 0.5), ("head", 2.0)):
        one = found[name]
        assert one.low < one.value < one.high
        assert one.value == pytest.approx(1.0 / wrong, rel=0.12), name
    assert [line.split(":")[0] for line in noise.lines()] == ["position", "body", "head"]
    assert all("--trust learn" in line for line in noise.lines())
    _, model = noise.corrected(tracks, MODEL)
    assert model.parameters.likelihood.position_scale == pytest.approx(1.0 / factor, rel=0.12)
    assert declared_noise(tracks, model).lines() == []


def test_what_the_model_declares_is_looked_at_where_the_data_declare_nothing() -> None:
    tracks = people(2, std=0.3).map(lambda track: replace(track, position_std=None))
    (line,) = declared_noise(tracks, MODEL).lines()
    assert "likelihood.position_std" in line
    _, model = declared_noise(tracks, MODEL).corrected(tracks, MODEL)
    assert model.parameters.likelihood.position_std == pytest.approx(0.3, rel=0.1)


def test_gross_errors_do_not_count_as_noise() -> None:
    def spoilt(track: Track) -> Track:
        rng = np.random.default_rng(track.track_id)
        off = rng.random(len(track)) < 0.1
        return replace(track, position=track.position + off[:, None] * rng.normal(0.0, 2.0, (len(track), 2)))

    assert declared_noise(people(3).map(spoilt), MODEL).lines() == []


def walkers(seed: int, n: int = 14) -> TrackSet:
    """People who go straight, each in another direction, and face their direction of travel."""
    rng, tracks = np.random.default_rng(seed), []
    t = 0.1 * np.arange(40)
    for m in range(n):
        way = rng.uniform(-np.pi, np.pi)
        position = 1.3 * t[:, None] * [np.cos(way), np.sin(way)] + 0.05 * rng.normal(size=(40, 2))
        angles = {name: wrap(way + rng.vonmises(0.0, 4.0, 40)) for name in ("body", "head")}
        tracks.append(Track(m, np.arange(40), t, position, **angles))
    return TrackSet(tuple(tracks))


def test_a_detector_that_turns_everybody_is_found_out_and_corrected() -> None:
    off = walkers(0).map(lambda track: replace(track, **turned(track, "body", np.radians(30.0))))
    noise = declared_noise(off, MODEL)
    body = next(one for one in noise.channels if one.name == "body")
    assert np.degrees(body.turn) == pytest.approx(30.0, abs=3.0)
    assert any(line.startswith("body") and "to the left" in line for line in noise.lines())
    mended, _ = noise.corrected(off, MODEL)
    (again,) = (one for one in declared_noise(mended, MODEL).channels if one.name == "body")
    assert again.turn == 0.0 and not any(one.turn for one in noise.channels if one.name == "head")


def test_gaits_of_their_own_are_no_bias() -> None:
    """The interval of an offset that is shared holds it."""
    rng = np.random.default_rng(5)
    found = [shared_offset(wrap(0.5 + 0.2 * rng.normal(size=20))) for _ in range(100)]
    assert sum(one.low < 0.5 < one.high for one in found) >= 97

    def own(track: Track) -> Track:
        by = np.random.default_rng(track.track_id).uniform(-np.pi, np.pi)
        return replace(track, **turned(track, "body", by))

    assert not any(one.turn for one in declared_noise(walkers(1).map(own), MODEL).channels)
    few = walkers(2, 5).map(lambda track: replace(track, **turned(track, "body", 0.6)))
    assert not any(one.turn for one in declared_noise(few, MODEL).channels)


def test_smoothing_warns_or_corrects_as_it_is_told() -> None:
    tracks = misdeclared(people(6, preset="separate"), 1 / 3, 1.0, 1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plain = gt.smooth(tracks, "separate")
    with pytest.warns(InputWarning, match="position: the noise is 3"):
        checked = gt.smooth(tracks, "separate", trust="check")
    with pytest.warns(InputWarning, match="corrected"):
        learned = gt.smooth(tracks, "separate", trust="learn")

    def honesty(estimates: TrackSet) -> float:
        squares = []
        for track, one in zip(tracks, estimates, strict=True):
            error = one.position - track.true_position
            squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(one.covariance[:, :2, :2]), error))
        return float(np.concatenate(squares).mean() / 2.0)

    assert honesty(checked) == honesty(plain) > 3.0 and 0.8 < honesty(learned) < 1.3
    with pytest.raises(InputError, match="declared, check or learn"):
        gt.smooth(tracks, "separate", trust="blindly")


def test_scales_are_of_what_the_data_declare_alone() -> None:
    likelihood = LikelihoodParameters(position_scale=2.0, body_scale=3.0)
    given = np.array([0.2, np.nan])
    np.testing.assert_allclose(likelihood.position_stds(given, 2), [0.4, 0.1])
    assert replace(likelihood, position_std=1).position_stds(None, 2).dtype == float
    np.testing.assert_allclose(likelihood.kappas("body", np.array([9.0, np.nan]), 2), [1.0, 4.0])
    np.testing.assert_allclose(likelihood.kappas("head", None, 2), [4.0, 4.0])


def test_smooth_tells_of_a_wrong_sigma_and_corrects_it_where_it_is_told_to(tmp_path: Path) -> None:
    people = gt.simulate("position", n_tracks=8, n_steps=60, fps=10.0, rng=np.random.default_rng(0))
    overconfident, stds = tmp_path / "people.parquet", {}
    declared = people.map(lambda track: replace(track, position_std=np.full(len(track), 0.1 / 3.0)))
    gt.write(declared, overconfident)
    for trust in (None, "check", "declared", "learn"):
        output = tmp_path / f"{trust}.csv"
        given = [] if trust is None else ["--trust", trust]
        done = ran("smooth", overconfident, "-o", output, "--model", "position", *given, program="graphtrack")
        said = [line for line in done.stderr.splitlines() if "position: the noise is" in line]
        assert len(said) == (trust != "declared")
        assert all(("corrected" in line) == (trust == "learn") and "pos_std" in line for line in said)
        std = gt.read(output).tracks[0].std("x")
        stds[trust] = float(np.median(std))
    assert stds[None] == stds["check"] == stds["declared"] < 0.6 * stds["learn"]
    files = (overconfident, "-o", tmp_path / "out.parquet")
    done = run("smooth", *files, "--stream", "--trust", "learn", program="graphtrack")
    assert done.returncode == 2 and "--trust" in done.stderr
