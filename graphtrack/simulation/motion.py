"""Motion, body and head sampled from the graph's own density.

The density of angles is Π exp(κ_k·cos(θ_k − θ_{k−1}))·Π exp(Re(conj(z_k)·e^{iθ_k})): it is not normalised
step by step. Messages are passed backward from the last frame on a grid around the circle; then angles are
sampled forward, each given the previous angle and all later factors.
"""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction, unit, wrap
from graphtrack.model import Model, MotionParameters, Parameters
from graphtrack.model.terms.couplings import BodyFollowsMotion, HeadFollowsBody
from graphtrack.model.terms.motion import smooth_speed, steered_step
from graphtrack.packages import special

SCENE_SIZE = 20.0  # metres: tracks begin anywhere in a square of this side around the origin
PACE_SPREAD = 0.23  # 1-σ of the logarithm of people's own paces: 0.3 m/s at 1.3 m/s
PACE_RATE = 0.7  # 1/s at which a speed returns to the person's own pace: slow compared to a few frames
_SUBSTEP = 0.05


def sample_velocity(
    t: FloatArray,
    n_tracks: int,
    motion: MotionParameters,
    rng: np.random.Generator,
    *,
    pace: float | None = None,
    head: FloatArray | None = None,
) -> FloatArray:
    """Velocities (n_tracks, n, 2) in m/s at the times ``t`` (n,) seconds.

    Parameters
    ----------
    pace : m/s, the median over people of the speed that each returns to at `PACE_RATE`; None:
        white-noise acceleration, whose speeds diverge from the initial speeds
    head : (n_tracks, n) radians of heads that steer the motion; None: nothing steers it
    """
    velocity = np.empty((n_tracks, len(t), 2))
    velocity[:, 0], own = first_velocity(n_tracks, motion, rng, pace)
    for k, dt in enumerate(np.diff(t).tolist(), start=1):
        before = velocity[:, k - 1]
        aim = np.zeros_like(before) if head is None else smooth_speed(before)[:, None] * unit(head[:, k - 1])
        rate = 0.0 if head is None else motion.head_rate
        velocity[:, k] = next_velocity(before, aim, rate, dt, own, motion, rng)
    return velocity


def first_velocity(
    n_tracks: int, motion: MotionParameters, rng: np.random.Generator, pace: float | None
) -> tuple[FloatArray, FloatArray | None]:
    """Sample first velocities (n_tracks, 2) and, given a median ``pace`` in m/s, people's own (n_tracks,)."""
    if pace is None:
        return motion.initial_speed_std * rng.standard_normal((n_tracks, 2)), None
    own = pace * np.exp(PACE_SPREAD * rng.standard_normal(n_tracks))
    wander = math.sqrt(motion.acceleration_density / (2.0 * PACE_RATE))
    speed = own + wander * rng.standard_normal(n_tracks)
    return speed[:, None] * unit(rng.uniform(-np.pi, np.pi, n_tracks)), own


def next_velocity(
    before: FloatArray,
    aim: FloatArray,
    rate: FloatArray | float,
    dt: float,
    pace: FloatArray | None,
    motion: MotionParameters,
    rng: np.random.Generator,
) -> FloatArray:
    """Return velocities (n_tracks, …, 2) ``dt`` later, relaxed to the ``aim`` at the ``rate`` λ in 1/s."""
    now = before
    parts = 1 if pace is None else math.ceil(dt / _SUBSTEP)
    step = steered_step(dt / parts, rate)
    keep, size = step.keep[..., None], np.sqrt(motion.acceleration_density * step.spread)[..., None]
    for _ in range(parts):
        now = keep * now + (1.0 - keep) * aim + size * rng.standard_normal(now.shape)
        if pace is not None:
            now = _paced(now, pace, dt / parts, motion.acceleration_density)
    return now


def _paced(velocity: FloatArray, own: FloatArray, dt: float, density: float) -> FloatArray:
    """Velocities (m, …, 2) whose speeds have returned towards the people's own for ``dt`` seconds."""
    speed = np.linalg.norm(velocity, axis=-1)
    own = own.reshape(-1, *(1,) * (speed.ndim - 1))
    # Noise across the motion makes the speed grow by q/2s a second.
    rest = np.maximum(own - density / (2.0 * PACE_RATE * own), 0.0)
    wanted = rest + (speed - rest) * math.exp(-PACE_RATE * dt)
    return velocity * (wanted / np.maximum(speed, 1e-9))[..., None]


def sample_positions(
    t: FloatArray,
    velocity: FloatArray,
    motion: MotionParameters,
    rng: np.random.Generator,
    *,
    head: FloatArray | None = None,
    rate: FloatArray | float = 0.0,
) -> FloatArray:
    """Sample positions (n_tracks, n, 2) in metres given the velocities (n_tracks, n, 2).

    Parameters
    ----------
    head : (n_tracks, n) radians of heads that steer the motion
    rate : λ in 1/s, of all steps or of each, (n_tracks, n − 1)
    """
    n_tracks, n, _ = velocity.shape
    position = np.empty((n_tracks, n, 2))
    position[:, 0] = rng.uniform(-0.5 * SCENE_SIZE, 0.5 * SCENE_SIZE, (n_tracks, 2))
    before, dt = velocity[:, :-1], np.broadcast_to(np.diff(t), (n_tracks, n - 1))
    step = steered_step(dt, rate)
    keep, reach, place, cross, spread = (moment[..., None] for moment in step)
    aim = np.zeros_like(before)
    if head is not None:
        aim = smooth_speed(before)[..., None] * unit(head[:, :-1])
    turn = velocity[:, 1:] - keep * before - (1.0 - keep) * aim
    left = motion.acceleration_density * np.maximum(place - cross**2 / spread, 0.0)
    moved = reach * before + (dt[..., None] - reach) * aim + cross / spread * turn
    moved += np.sqrt(left) * rng.standard_normal(moved.shape)
    position[:, 1:] = position[:, :1] + np.cumsum(moved, axis=1)
    return position


FEWEST_BINS, MOST_BINS = 240, 3840
_FEWEST_CELLS = 240
_REACH = 8.0  # standard deviations of a turn to each side that the candidates of the next angle lie in
_FLOOR = 1e-14
"""Smallest relative value of a message; below it is the noise of the Fourier transform."""
_MEMORY = 2**28  # bytes of messages in memory


def sample_course(t: FloatArray, diffusion: float, pull: np.ndarray, rng: np.random.Generator) -> FloatArray:
    """Angles (n_tracks, n) in radians, in (−π, π], at the times ``t`` (n,) seconds.

    ``diffusion``: rad²/s; ``pull``: (n_tracks, n) complex, concentration · e^{i·angle} of the von Mises that
    pulls each frame. Without any pull the first angle is uniform.
    """
    n_tracks, n = pull.shape
    kappa = 1.0 / (diffusion * np.diff(t))
    if not np.any(pull):
        turns = rng.vonmises(0.0, np.broadcast_to(kappa, (n_tracks, n - 1)))
        first = rng.uniform(-np.pi, np.pi, (n_tracks, 1))
        return wrap(np.cumsum(np.hstack([first, turns]), axis=1))
    bins = _bins(np.abs(pull), kappa)
    together = max(1, _MEMORY // (4 * n * bins))
    parts = [pull[a : a + together] for a in range(0, n_tracks, together)]
    return np.concatenate([_sample(part, kappa, bins, rng) for part in parts])


def _bins(pull: FloatArray, kappa: FloatArray) -> int:
    """Return the number of bins for the narrowest message: one per standard deviation suffices."""
    narrowest = float(pull.max())
    if len(kappa):
        # Pulls at a steady rate give messages as narrow as √(pull·κ).
        narrowest += math.sqrt(float((pull[:, 1:] * kappa).max()))
    wanted = 2.0 * np.pi * math.sqrt(narrowest)
    return int(min(FEWEST_BINS * 2 ** max(0, math.ceil(math.log2(wanted / FEWEST_BINS))), MOST_BINS))


def _sample(pull: np.ndarray, kappa: FloatArray, bins: int, rng: np.random.Generator) -> FloatArray:
    messages = _messages(pull, kappa, bins)
    n_tracks, n = pull.shape
    width = 2.0 * np.pi / bins
    angles = np.empty((n_tracks, n))
    place = _drawn(messages[0], rng)
    angles[:, 0] = width * place
    rows = np.arange(n_tracks)[:, None]
    for k in range(1, n):
        reach = min(np.pi, _REACH / math.sqrt(kappa[k - 1]))
        count = max(_FEWEST_CELLS, round(bins * reach / np.pi))
        turn = reach * ((2.0 * np.arange(count) + 1.0) / count - 1.0)
        at = (angles[:, k - 1, None] + turn) / width
        below = np.floor(at)
        share = at - below
        index = below.astype(np.int64) % bins
        row = messages[k]
        ahead = (1.0 - share) * row[rows, index] + share * row[rows, (index + 1) % bins]
        chosen = _drawn(ahead + kappa[k - 1] * (np.cos(turn) - 1.0), rng)
        angles[:, k] = angles[:, k - 1] + reach * ((2.0 * chosen + 1.0) / count - 1.0)
    return wrap(angles)


def _drawn(log_weight: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Sample a cell of each row (m, cells), and a position within it: its index ± 0.5."""
    reached = np.cumsum(np.exp(log_weight - log_weight.max(axis=1, keepdims=True)), axis=1)
    chosen = (reached < rng.random((len(reached), 1)) * reached[:, -1:]).sum(axis=1)
    return chosen + rng.uniform(-0.5, 0.5, len(chosen))


def _messages(pull: np.ndarray, kappa: FloatArray, bins: int) -> np.ndarray:
    """Return log messages (n, n_tracks, bins) to each frame's angle from it and all later frames."""
    n_tracks, n = pull.shape
    angle = 2.0 * np.pi * np.arange(bins) / bins
    circle = np.stack([np.cos(angle), np.sin(angle)])
    messages = np.empty((n, n_tracks, bins), np.float32)
    order = np.arange(bins // 2 + 1)
    damping = {one: _fourier(order, one) for one in np.unique(kappa).tolist()}
    ahead = np.zeros((n_tracks, bins))
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            spread = np.fft.irfft(np.fft.rfft(np.exp(ahead)) * damping[float(kappa[k])], bins)
            ahead = np.log(np.maximum(spread, _FLOOR * spread.max(axis=1, keepdims=True)))
        ahead = ahead + np.stack([pull[:, k].real, pull[:, k].imag], axis=1) @ circle
        ahead -= ahead.max(axis=1, keepdims=True)
        messages[k] = ahead
    return messages


def _fourier(order: np.ndarray, kappa: float) -> FloatArray:
    """Fourier coefficients I_m(κ)/I_0(κ) of a von Mises density."""
    if kappa > 1e5:  # a wrapped normal, where Bessel functions of high orders are unavailable
        return np.exp(-0.5 * order**2 / kappa)
    return np.asarray(special.ive(order, kappa) / special.ive(0, kappa))


_SWEEPS = 2
"""Gibbs sweeps: few suffice, since head and body are weakly coupled compared to the other terms."""


def sample_orientations(
    t: FloatArray,
    velocity: FloatArray,
    model: Model,
    rng: np.random.Generator,
    *,
    rate: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Body and head (n_tracks, n) in radians, given the velocities (n_tracks, n, 2) in m/s.

    The body is drawn from the density of its turns and of its coupling to the motion, over the whole chain;
    then the head, from that of its turns, of its coupling to the body, and of the motion that it steers; then
    both once more, the body given the head as well.

    Parameters
    ----------
    model : model whose terms define the couplings
    rate : λ in 1/s with which the head steers the motion, of all steps or of each, (n_tracks, n − 1)
    """
    parameters, (n_tracks, n) = model.parameters, velocity.shape[:2]
    turning, coupling = parameters.orientation, parameters.coupling
    weights = coupling.weights(np.concatenate([[0.0], np.diff(t)]))
    of_motion, of_body = np.zeros((n_tracks, n), complex), np.zeros((n_tracks, n))
    if model.has_term(BodyFollowsMotion):
        excess = np.maximum(np.linalg.norm(velocity, axis=-1) - coupling.speed_threshold, 0.0) ** 2
        kappa = coupling.motion_body_kappa * excess
        of_motion = weights * kappa * np.exp(1j * direction(velocity))
    if model.has_term(HeadFollowsBody):
        of_body = np.tile(weights * coupling.head_body_kappa, (n_tracks, 1))
    steering = np.zeros((n_tracks, n), complex)
    rate = np.broadcast_to(rate, (n_tracks, n - 1))
    steering[:, :-1] = _steering(t, velocity, rate, parameters.motion.acceleration_density)

    of_head = np.zeros((n_tracks, n), complex)
    for _ in range(_SWEEPS if of_body.any() else 1):
        body = sample_course(t, turning.body_diffusion, of_motion + of_head, rng)
        head = sample_course(t, turning.head_diffusion, of_body * np.exp(1j * body) + steering, rng)
        of_head = of_body * np.exp(1j * head)
    return body, head


def _steering(t: FloatArray, velocity: FloatArray, rate: FloatArray, density: float) -> np.ndarray:
    """Return the pulls of velocities on the heads that steered them, (n_tracks, n − 1)."""
    before = velocity[:, :-1]
    step = steered_step(np.broadcast_to(np.diff(t), rate.shape), rate)
    gain = 1.0 - step.keep
    turn = velocity[:, 1:] - step.keep[..., None] * before
    strength = gain * smooth_speed(before) / (density * step.spread)
    return strength * (turn[..., 0] + 1j * turn[..., 1])


_CANDIDATES = 32


def sample_coupled_velocity(
    t: FloatArray,
    parameters: Parameters,
    rng: np.random.Generator,
    *,
    pace: float | None,
    rate: FloatArray,
    head_coupled: bool = True,
) -> FloatArray:
    """Sample velocities (n_tracks, n, 2) in m/s that are coupled to the body and steered by the head.

    A velocity is chosen among candidates of the motion terms, weighted by the density of a body that follows
    it. Later factors are approximated by the stationary von Mises that balances pulls and diffusion. Body and
    head are discarded, as `sample_orientations` draws them given all velocities. Couplings act on the
    direction of motion alone: they do not slow people down, as their density would.

    ``rate``: λ in 1/s (n_tracks, n − 1) with which the head steers each step
    """
    motion, turning, coupling = parameters.motion, parameters.orientation, parameters.coupling
    n_tracks, n = len(rate), len(t)
    velocity = np.empty((n_tracks, n, 2))
    velocity[:, 0], own = first_velocity(n_tracks, motion, rng, pace)
    body = direction(velocity[:, 0])
    head = body
    of_head = coupling.head_body_kappa if head_coupled else 0.0
    rows = np.arange(n_tracks)
    for k, dt in enumerate(np.diff(t).tolist(), start=1):
        before = velocity[:, k - 1]
        aim = (smooth_speed(before)[:, None] * unit(head))[:, None]
        before = np.broadcast_to(before[:, None], (n_tracks, _CANDIDATES, 2))
        found = next_velocity(before, aim, rate[:, k - 1, None], dt, own, motion, rng)
        weight = float(coupling.weights(dt))
        body_kappa, head_kappa = 1.0 / (turning.body_diffusion * dt), 1.0 / (turning.head_diffusion * dt)
        head_pull = _held(weight * of_head, turning.head_diffusion * dt)
        # The previous head and its turn inform the body.
        offset_kappa = np.divide(1.0, 1.0 / np.maximum(head_pull, 1e-12) + 1.0 / head_kappa)
        past = body_kappa * np.exp(1j * body) + offset_kappa * np.exp(1j * head)
        speed = np.linalg.norm(found, axis=-1)
        excess = np.maximum(speed - coupling.speed_threshold, 0.0)
        pull = weight * coupling.motion_body_kappa * excess**2
        relative = turning.body_diffusion + motion.acceleration_density / np.maximum(speed, 0.1) ** 2
        pull = _held(pull, relative * dt)
        resultant = past[:, None] + pull * np.exp(1j * direction(found))
        size, known = np.abs(resultant), np.abs(past)[:, None]
        # Relative to a body aligned with the motion: the coupling does not act on speed.
        fit = np.log(special.i0e(size)) + size - np.log(special.i0e(known + pull)) - known - pull
        best = np.cumsum(np.exp(fit - fit.max(axis=1, keepdims=True)), axis=1)
        one = (best < rng.random((n_tracks, 1)) * best[:, -1:]).sum(axis=1)
        velocity[:, k] = found[rows, one]
        chosen = resultant[rows, one]
        body = rng.vonmises(np.angle(chosen), np.abs(chosen))
        chosen = head_kappa * np.exp(1j * head) + head_pull * np.exp(1j * body)
        head = rng.vonmises(np.angle(chosen), np.abs(chosen))
    return velocity


def _held(pull: FloatArray | float, turned: FloatArray | float) -> FloatArray:
    """Return the fixed point P of P = pull + 1/(1/P + turned): concentration of this and all later pulls."""
    return 0.5 * pull + np.sqrt(0.25 * pull**2 + pull / turned)
