"""Simulated people who walk straight or around an obstacle: the corpus of Baxter et al. (2014, §IV-A).

The paper gives the numbers of tracks and steps, and all noise. Walking speed and manoeuvres are
parameters here. As in its Fig. 4, the course turns by an angle, is held, turns back, passes the obstacle, and
then repeats this to the other side; later behaviours turn further and faster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, unit, wrap
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import check_numbers, number

NUMERALS = ("i", "ii", "iii", "iv", "v", "vi", "vii")
"""Behaviours as numbered by Baxter et al. (2014): i is straight, ii–vii avoid an obstacle."""


@dataclass(frozen=True)
class CorpusParameters:
    """Parameters of the corpus. Starred values are from Baxter et al., the others are choices.

    Attributes
    ----------
    tracks : * number of tracks of each behaviour
    steps : * number of steps of each track
    speed : metres a step; 0.3 is a pedestrian of 1.2 m/s observed at 4 Hz
    step_seconds : seconds a step, for methods that need them
    path_std : * metres, noise of the true positions, independent at every step
    observation_std : * metres, noise of the observed positions
    head_offset, head_std : * radians, mean and 1-σ of the noise of the head
    look_ahead : * steps: the head points in the direction of travel from t to t + look_ahead
    turn_angles : radians by which the course turns in behaviours ii–vii
    turn_steps : steps that such a turn takes in behaviours ii–vii
    aside_steps : steps that the new course is held, on the way out and on the way back
    passing_steps : steps alongside the obstacle
    """

    tracks: int = number(500, 1, 1e9)
    steps: int = number(200, 1, 1e9)
    speed: float = number(0.3, 1e-6, 1e6, "m")
    step_seconds: float = number(0.25, 1e-6, 1e6, "s")
    path_std: float = number(0.1, 0.0, 1e6, "m")
    observation_std: float = number(0.5, 0.0, 1e6, "m")
    head_offset: float = number(float(np.radians(4.0)), -np.pi, np.pi, "rad")
    head_std: float = number(float(np.radians(20.0)), 0.0, 1e6, "rad")
    look_ahead: int = number(5, 1, 1e9)
    turn_angles: tuple[float, ...] = tuple(np.radians([15.0, 30.0, 45.0, 60.0, 75.0, 90.0]).tolist())
    turn_steps: tuple[int, ...] = (20, 16, 12, 8, 5, 3)
    aside_steps: int = number(12, 0, 1e9)
    passing_steps: int = number(10, 0, 1e9)

    def __post_init__(self) -> None:
        check_numbers(self)
        if len(self.turn_angles) != len(NUMERALS) - 1 or len(self.turn_steps) != len(NUMERALS) - 1:
            raise InputError(
                f"{len(self.turn_angles)} turn_angles and {len(self.turn_steps)} turn_steps", "6 of each"
            )
        if min(self.turn_steps) < 1:
            raise InputError(f"turn_steps = {self.turn_steps}", "integers, at least 1")
        longest = max(self.manoeuvre_steps(b) for b in range(1, len(NUMERALS)))
        if longest > self.steps:
            raise InputError(f"{self.steps} steps", f"at least {longest}, for the longest manoeuvre")

    def manoeuvre_steps(self, behaviour: int) -> int:
        """Steps from the beginning of a manoeuvre to its end; 0 for the straight behaviour."""
        if behaviour == 0:
            return 0
        return 4 * self.turn_steps[behaviour - 1] + 2 * self.aside_steps + self.passing_steps


@dataclass(frozen=True, eq=False)
class Corpus:
    """The tracks of one behaviour, as arrays: m tracks of n steps."""

    behaviour: int  # 0 … 6
    name: str  # its numeral and description
    truth: FloatArray  # (m, n, 2) metres
    position: FloatArray  # (m, n, 2) observed; NaN if not detected
    travel: FloatArray  # (m, n) radians, the direction from t to t + look_ahead that the head follows
    head: FloatArray  # (m, n) observed, radians; NaN if not detected
    parameters: CorpusParameters  # parameters of the simulation

    def __len__(self) -> int:
        return len(self.truth)

    def detected(self, rate: float, rng: np.random.Generator) -> Corpus:
        """Return the same people, detected at a share ``rate`` of evenly spaced steps, including the first.

        An undetected person has no head observation either. Raise InputError unless the rate is in (0, 1].
        """
        if not 0.0 < rate <= 1.0:
            raise InputError(f"rate = {rate!r}", "a share in (0, 1]")
        lost = rng.random(self.head.shape) >= rate
        lost[:, 0] = False
        return replace(
            self,
            position=np.where(lost[..., None], np.nan, self.position),
            head=np.where(lost, np.nan, self.head),
        )

    def tracks(self, count: int | None = None) -> TrackSet:
        """Return the first ``count`` people as tracks, in metres and seconds, with their truth."""
        parameters, n = self.parameters, self.truth.shape[1]
        frame = np.arange(n)
        t = np.asarray(frame * parameters.step_seconds, dtype=np.float64)
        std = np.full(n, parameters.observation_std) if parameters.observation_std > 0.0 else None
        kappa = np.full(n, 1.0 / parameters.head_std**2) if parameters.head_std > 0.0 else None
        return TrackSet(
            tuple(
                Track(
                    len(self) * self.behaviour + i,
                    frame,
                    t,
                    self.position[i],
                    position_std=std,
                    head=self.head[i],
                    head_kappa=kappa,
                    true_position=self.truth[i],
                    true_head=self.travel[i],
                    label=self.name,
                )
                for i in range(len(self) if count is None else min(count, len(self)))
            )
        )


def courses(behaviour: int, parameters: CorpusParameters, rng: np.random.Generator) -> FloatArray:
    """Return courses (tracks, steps + look_ahead − 1) in radians: directions of the steps from t to t + 1.

    Start positions, passing side and first step of the manoeuvre are random.
    """
    m, length = parameters.tracks, parameters.steps + parameters.look_ahead - 1
    base, side = rng.uniform(-np.pi, np.pi, (m, 1)), rng.choice([-1.0, 1.0], (m, 1))
    duration = parameters.manoeuvre_steps(behaviour)
    start = rng.integers(0, parameters.steps - duration + 1, (m, 1))
    if behaviour == 0:
        return np.repeat(base, length, axis=1)
    angle, turn = parameters.turn_angles[behaviour - 1], parameters.turn_steps[behaviour - 1]
    durations = [turn, parameters.aside_steps, turn, parameters.passing_steps]
    durations += [turn, parameters.aside_steps, turn]
    corners = np.concatenate([[0], np.cumsum(durations)])
    offsets = angle * np.array([0.0, 1.0, 1.0, 0.0, 0.0, -1.0, -1.0, 0.0])
    # The course at the middle of each step.
    elapsed = np.arange(length) + 0.5 - start
    return base + side * np.interp(elapsed, corners, offsets)


def simulate_behaviour(
    behaviour: int, parameters: CorpusParameters | None = None, *, rng: np.random.Generator
) -> Corpus:
    """Simulate the tracks of one behaviour, 0 (straight) … 6 (the sharpest turns), all detected.

    Raise InputError if there is no such behaviour.
    """
    if behaviour not in range(len(NUMERALS)):
        raise InputError(f"behaviour {behaviour!r}", f"an integer from 0 to {len(NUMERALS) - 1}")
    parameters = CorpusParameters() if parameters is None else parameters
    steps = parameters.speed * unit(courses(behaviour, parameters, rng))
    path = np.concatenate([np.zeros((len(steps), 1, 2)), np.cumsum(steps, axis=1)], axis=1)
    walked = path + parameters.path_std * rng.standard_normal(path.shape)
    n = parameters.steps
    truth = walked[:, :n]
    travel = direction(walked[:, parameters.look_ahead :][:, :n] - truth)
    noise = parameters.head_offset + parameters.head_std * rng.standard_normal(travel.shape)
    if behaviour == 0:
        name = "i straight"
    else:
        name = f"{NUMERALS[behaviour]} {np.degrees(parameters.turn_angles[behaviour - 1]):.0f}°"
    return Corpus(
        behaviour,
        name,
        truth,
        truth + parameters.observation_std * rng.standard_normal(truth.shape),
        travel,
        wrap(travel + noise),
        parameters,
    )


def simulate_corpus(
    parameters: CorpusParameters | None = None, *, rng: np.random.Generator
) -> tuple[Corpus, ...]:
    """Simulate all seven behaviours: 3,500 tracks of 200 steps with the default parameters."""
    return tuple(simulate_behaviour(b, parameters, rng=rng) for b in range(len(NUMERALS)))
