"""The particle filter with the modes of the couplings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import special
from walks import walk

from graphtrack.baselines.particle_filter import ParticleOptions, particle_filter, particle_smoother
from graphtrack.baselines.particle_kernels import FIRST, POSITION, run, steering_share
from graphtrack.baselines.particle_model import mode_table, prepare, transition
from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, wrap
from graphtrack.model import (
    CouplingParameters,
    GaitParameters,
    LikelihoodParameters,
    Model,
    MotionParameters,
    OrientationParameters,
    Parameters,
)
from graphtrack.model.model import default_parameters
from graphtrack.model.terms.couplings import BASE, BINS, ROW, gait_of
from graphtrack.tracks.track import Track


def aside(n: int = 60, *, seed: int = 0, offset: float = 1.4) -> Track:
    """A person who walks straight, body and head at a constant offset from the direction of motion."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(n)
    position = np.stack([1.2 * t, np.zeros(n)], axis=1)
    angles = {f"true_{name}": np.full(n, offset) for name in ("body", "head")}
    seen = {name: wrap(offset + rng.vonmises(0.0, 4.0, n)) for name in ("body", "head")}
    noisy = position + 0.05 * rng.standard_normal((n, 2))
    return Track(1, np.arange(n), t, noisy, true_position=position, **seen, **angles)


# -- tables ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", ["body", "head", "classified_head"])
def test_tables_are_of_probabilities(side: str) -> None:
    modes = getattr(gait_of(default_parameters("full").gait), side)
    table = mode_table(modes)
    assert table.initial.sum() == pytest.approx(1.0)
    aligned = (1.0 - modes.glance_share) * modes.aligned
    assert table.initial @ table.aligned == pytest.approx(aligned)
    assert ((table.doubt >= 0.0) & (table.doubt <= 1.0)).all()
    # After a very long time nothing is left of where it began.
    np.testing.assert_allclose(transition(modes, 1e4), np.tile(table.initial, (ROW, 1)), atol=1e-9)


def test_couplings_are_as_strong_as_their_modes() -> None:
    gait = GaitParameters(body_strength=2.0, body_free_strength=0.5)
    table = mode_table(gait_of(gait).body)
    size = np.hypot(table.cos, table.sin)
    np.testing.assert_allclose(size[:BASE], np.where(table.aligned > 0.0, 2.0, 0.5)[:BASE])
    np.testing.assert_allclose(np.hypot(table.held_cos, table.held_sin), 1.0)
    # The body has no glances; a glance of the head does not steer.
    assert (table.initial[BASE:] == 0.0).all()
    head = mode_table(gait_of(gait).head)
    np.testing.assert_allclose(np.hypot(head.cos, head.sin)[BASE:], GaitParameters().glance_strength)
    assert (np.hypot(head.held_cos, head.held_sin)[BASE:] == 0.0).all()
    free = np.arctan2(table.sin, table.cos)[:BINS]
    np.testing.assert_allclose(difference(free, 2.0 * np.pi * np.arange(BINS) / BINS), 0.0, atol=1e-12)


# -- the filter --------------------------------------------------------------------------------------------


def test_modes_that_are_all_alike_are_no_modes() -> None:
    gait = GaitParameters(
        body_aligned=1.0,
        body_spread=0.0,
        body_strength=1.0,
        body_lead=0.0,
        head_aligned=1.0,
        head_spread=0.0,
        head_strength=1.0,
        head_lead=0.0,
        head_rate_observed=1.0,
        glance_share=0.0,
    )
    parameters = replace(default_parameters("joint-intentional"), gait=gait)
    track = walk(25, angle_kappa=4.0)
    found = {}
    for preset in ("joint-intentional", "full"):
        rows = []
        for seed in range(24):
            one = particle_filter(
                track, Model(preset, parameters), options=ParticleOptions(particles=600), seed=seed
            )
            last = one.track
            rows.append([np.nansum(one.log_evidence), *last.position[-1], last.body[-1], last.head[-1]])
        found[preset] = np.array(rows)
        if preset == "full":
            np.testing.assert_allclose(last.aligned_p, 1.0)
    difference_of_means = found["full"].mean(axis=0) - found["joint-intentional"].mean(axis=0)
    spread = np.sqrt(sum(rows.var(axis=0, ddof=1) / len(rows) for rows in found.values()))
    assert (np.abs(difference_of_means) < 4.0 * spread).all()


def test_the_posterior_of_modes_is_that_of_the_exact_forward_filter() -> None:
    """Known motion, bodies redrawn in each frame: a hidden Markov chain over modes and offsets.

    The chain of the test is written from docs/model/modes.md; without drift, a mode stays or is drawn again.
    """
    aligned, switching, spread, free_kappa = 0.4, 0.15, 0.1, 0.5
    strengths, pull, seen_kappa, speed = (3.0, 1.5), 2.0, 3.0, 1.4
    parameters = Parameters(
        motion=MotionParameters(acceleration_density=1e-5, head_rate=0.0),
        orientation=OrientationParameters(body_diffusion=1e4, head_diffusion=1e4),
        coupling=CouplingParameters(motion_body_kappa=pull, speed_threshold=0.0, correlation_time=0.0),
        gait=GaitParameters(
            body_aligned=aligned,
            body_switching=switching,
            body_spread=spread,
            body_drift=0.0,
            body_strength=strengths[0],
            body_free_strength=strengths[1],
            body_offset_kappa=free_kappa,
            body_lead=0.0,
        ),
        likelihood=LikelihoodParameters(body_kappa=seen_kappa, position_std=1.0),
    )
    n, count, rng = 14, 60_000, np.random.default_rng(3)
    seen = wrap(np.r_[np.full(5, 0.1), np.full(5, 1.9), np.full(4, 0.0)] + rng.vonmises(0.0, 8.0, n))
    t = np.arange(float(n))
    track = Track(1, np.arange(n), t, np.stack([speed * t, np.zeros(n)], axis=1), body=seen)

    steps, bins = np.linspace(-2.0, 2.0, 7), 2.0 * np.pi * np.arange(36) / 36
    offsets = np.r_[bins, spread * steps]
    slab, spike = np.exp(free_kappa * np.cos(bins)), np.exp(-0.5 * steps**2)
    initial = np.r_[(1.0 - aligned) * slab / slab.sum(), aligned * spike / spike.sum()]
    kept = np.exp(-switching)
    step = kept * np.eye(43) + (1.0 - kept) * initial
    kappa = np.r_[np.full(36, strengths[1]), np.full(7, strengths[0])] * pull * speed**2
    both = np.abs(kappa + seen_kappa * np.exp(1j * (seen[:, None] - offsets)))
    # ∫ VM(θ; offset, κ)·VM(seen; θ, κ') dθ, up to a common factor.
    likelihood = special.i0e(both) / special.i0e(kappa) * np.exp(both - kappa - seen_kappa)
    exact, now = [], initial
    for k in range(n):
        now = likelihood[k] * (now if k == 0 else now @ step)
        now /= now.sum()
        exact.append((now[36:].sum(), np.angle(now @ np.exp(1j * offsets))))

    job = prepare(track, Model("full", parameters), None, "smooth", False)
    particles = np.zeros((2, count, 6))
    particles[0, :, 2] = speed
    means = np.full((n, 2), np.nan)
    begun = (particles, np.zeros((2, count, 2), np.int64), np.full(count, -np.log(count)))
    packed = (job.motion, job.modes, job.position, job.body, job.head, job.camera)
    written = [np.empty((n, 6)), np.empty((n, 6, 6)), np.empty(n), np.empty(n), means]
    kept = np.empty((0, count, 6)), np.empty((0, count))
    frames, _ = run(rng, 0, FIRST, POSITION, *begun, *packed, 0.5, *written, *kept)
    assert frames == n
    exact_p, exact_offset = np.array(exact).T
    assert exact_p.max() > 0.7 and exact_p.min() < 0.1
    np.testing.assert_allclose(means[:, 0], exact_p, atol=0.03)
    np.testing.assert_allclose(difference(means[:, 1], exact_offset), 0.0, atol=0.06)


def test_the_head_steers_as_far_as_it_points_where_the_motion_goes() -> None:
    job = prepare(walk(3), Model("full"), None, "smooth", False)
    bins = 2.0 * np.pi * np.arange(BINS) / BINS
    for body in (0, 5, 17, 30):
        for head in (0, 9, 22):
            share = steering_share(np.array([body, head]), False, job.modes)
            assert share == pytest.approx(max(0.0, np.cos(bins[body] + bins[head])), abs=1e-9)
    seen = steering_share(np.zeros(2, np.int64), True, job.modes)
    assert seen == pytest.approx(default_parameters("full").gait.head_rate_observed)


def test_heads_that_are_a_classifiers_mistake_are_doubted() -> None:
    """Likelihoods of a class that is turned from the body all along draw the head less than angles do."""
    n = 40
    track = replace(aside(n, offset=0.0), body=np.zeros(n), head=None)
    classes = np.full((n, 12), 0.02)
    classes[:, 4] = 0.78  # 120° from the body
    classed = replace(track, head_likelihood=classes)
    heads = {}
    for bias in (0.0, 0.9):
        parameters = default_parameters("full")
        gait = replace(parameters.gait, head_class_bias=bias, head_strength=6.0, glance_share=0.0)
        model = Model("full", replace(parameters, gait=gait))
        head = particle_filter(classed, model, options=ParticleOptions(particles=3000)).track.head
        assert np.isfinite(head).all()
        heads[bias] = np.degrees(np.abs(head[20:])).mean()
    assert heads[0.9] < heads[0.0] - 20.0


def test_the_smoother_refuses_modes() -> None:
    with pytest.raises(InputError, match="modes"):
        particle_smoother(walk(12), "full")
