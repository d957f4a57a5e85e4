"""Identities and estimates of large crowds: times, memory and accuracy, each measure by itself.

    python tests/load/crowds.py offline PEOPLE FRAMES        association of a recording at 5 Hz
    python tests/load/crowds.py online PEOPLE FRAMES HZ PRESET
    python tests/load/crowds.py track PEOPLE FRAMES          at 5 Hz, default model, first answers
    python tests/load/crowds.py score PEOPLE FRAMES          `graphtrack score` of a recording's tracks
    python tests/load/crowds.py day FOLDER HOURS             detections of HOURS hours, a Parquet file each

People of 1.3 m/s wander in a square, 9 m² each; 10 % of detections are missed, σ is 0.1 m, and there is one
false detection a frame for 50 people. Times are of the processor and on the clock; compiling is left out.
On one processor: ``taskset -c 0 python …``. A day has 3,000 people an hour who cross a square of 50 m, at
2.5 Hz, for ``graphtrack smooth FOLDER -o smoothed.parquet``.
"""

import resource
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from crossing_people import idf1, packed_square

import graphtrack as gt
from graphtrack.association.offline import associate_detections
from graphtrack.association.online import OnlineAssociation
from graphtrack.tracks.track import Track

STEP = 0.2  # seconds between frames


def report(name: str, start: tuple[float, float], rows: int, **more: object) -> None:
    """Print times since a start (processor, clock), of a row, and the greatest memory of this process."""
    spent, elapsed = time.process_time() - start[0], time.perf_counter() - start[1]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    each = 1e6 * spent / max(rows, 1)
    told = "".join(f", {key} {value}" for key, value in more.items())
    print(
        f"{name}: processor {spent:.1f} s, clock {elapsed:.1f} s, {each:.0f} µs a row, {memory:.2f} GiB{told}"
    )


def begin() -> tuple[float, float]:
    return time.process_time(), time.perf_counter()


def offline(people: int, frames: int) -> None:
    associate_detections(packed_square(np.random.default_rng(1), people=10, frames=30)[0])  # compiles
    detections, whose = packed_square(np.random.default_rng(0), people=people, frames=frames)
    start = begin()
    found = associate_detections(detections)
    report(f"offline {people} × {frames}", start, len(detections), IDF1=f"{idf1(found.identity, whose):.4f}")


def timed(spent: dict[str, float], name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, whose processor time is added to ``spent``."""

    @wraps(function)
    def wrapped(*args: Any, **options: Any) -> Any:
        start = time.process_time()
        try:
            return function(*args, **options)
        finally:
            spent[name] += time.process_time() - start

    return wrapped


def online(people: int, frames: int, rate: float, preset: str) -> None:
    """Track a crowd, and print the shares of the processor time of a frame."""
    spent: dict[str, float] = defaultdict(float)
    parts = (
        (OnlineAssociation, "move", "matches"),
        (OnlineAssociation, "filter_from", "filters of candidates"),
        (OnlineAssociation, "_prepare", "duplicates"),
        (OnlineAssociation, "_learn", "parameters"),
        (OnlineAssociation, "update", "association in all"),
        (gt.OnlineTracker, "_follow", "smoothers"),
        (gt.OnlineTracker, "on_the_ground", "checks of observations"),
        (gt.OnlineTracker, "_reported", "reports"),
    )
    for kind, name, part in parts:
        setattr(kind, name, timed(spent, part, getattr(kind, name)))
    for n, size in ((10, 20), (people, frames)):  # the first compiles
        spent.clear()
        detections, whose = packed_square(np.random.default_rng(0), people=n, frames=size, step=1.0 / rate)
        tracker, identity = gt.OnlineTracker(preset), np.full(len(detections), -1)
        slowest, start = 0.0, begin()
        for k in range(size):
            rows, before = np.flatnonzero(detections.frame == k), time.perf_counter()
            for person in tracker.update(k / rate, detections.position[rows]):
                if person.observed:
                    identity[rows[person.detection]] = person.track_id
            slowest = max(slowest, time.perf_counter() - before)
        whole = time.process_time() - start[0]
    name = f"online {people} × {frames} at {rate:g} Hz, {preset}, {frames / rate:g} s of recording"
    report(name, start, len(detections), IDF1=f"{idf1(identity, whose):.4f}", slowest=f"{slowest:.3f} s")
    for part, seconds in spent.items():
        print(f"  {part}: {100.0 * seconds / whole:.0f} %")


def score(people: int, frames: int) -> None:
    from graphtrack.cli import main

    detections, whose = packed_square(np.random.default_rng(0), people=people, frames=frames)
    tracks = []
    for person in range(people):
        own = np.flatnonzero(whose == person)
        tracks.append(Track(person, detections.frame[own], detections.t[own], detections.position[own]))
    with tempfile.TemporaryDirectory() as folder:
        truth, found = Path(folder) / "truth.parquet", Path(folder) / "found.parquet"
        gt.write(gt.TrackSet(tuple(tracks)), truth)
        rng = np.random.default_rng(1)
        table = pd.read_parquet(truth)
        table[["x", "y"]] += rng.normal(0.0, 0.1, (len(table), 2))
        table["track_id"] += people * (table["frame"] // 100)  # three tracks a person
        table.sort_values(["track_id", "frame"]).to_parquet(found, index=False)
        start = begin()
        sys.argv = ["graphtrack", "score", str(found), "--truth", str(truth), "--metres", "0.5"]
        try:
            main()
        except SystemExit:
            report(f"score {people} × {frames}", start, len(table))


def day(folder: str, hours: int) -> None:
    rng, step, side = np.random.default_rng(0), 0.4, 50.0
    frames, frame = round(3600.0 / step), 0
    position, course, speed = np.zeros((0, 2)), np.zeros(0), np.zeros(0)
    Path(folder).mkdir(parents=True, exist_ok=True)
    for hour in range(hours):
        rows = []
        for _ in range(frames):
            n = rng.poisson(3000.0 / frames)
            edge, along = rng.integers(4, size=n), rng.uniform(0.0, side, n)
            across = np.where(edge % 2, side - 0.01, 0.01)
            start = np.where(
                edge[:, None] < 2, np.column_stack([across, along]), np.column_stack([along, across])
            )
            goal = rng.uniform(0.2 * side, 0.8 * side, (n, 2)) - start
            position = np.concatenate([position, start])
            course = np.concatenate([course, np.arctan2(goal[:, 1], goal[:, 0])])
            speed = np.concatenate([speed, np.clip(rng.normal(1.3, 0.2, n), 0.6, 2.0)])
            course = course + rng.normal(0.0, 0.1 * np.sqrt(step), len(course))
            position = position + step * speed[:, None] * np.column_stack([np.cos(course), np.sin(course)])
            inside = ((position > 0.0) & (position < side)).all(axis=1)
            position, course, speed = position[inside], course[inside], speed[inside]
            detected = position[rng.random(len(position)) >= 0.1]
            detected = detected + rng.normal(0.0, 0.1, detected.shape)
            rows.append((frame, np.concatenate([detected, rng.uniform(0.0, side, (rng.poisson(1.0), 2))])))
            frame += 1
        table = pd.DataFrame(np.concatenate([place for _, place in rows]), columns=["x", "y"])
        table["frame"] = np.repeat([number for number, _ in rows], [len(place) for _, place in rows])
        table["t"] = step * table["frame"]
        table.to_parquet(Path(folder) / f"{hour:02d}.parquet", index=False)
        print(f"hour {hour}: {len(table):,} detections")


if __name__ == "__main__":
    task, *values = sys.argv[1:] or ["none"]
    if task == "online":
        online(int(values[0]), int(values[1]), float(values[2]), values[3])
    elif task == "track":
        online(int(values[0]), int(values[1]), 1.0 / STEP, "joint")
    elif task == "day":
        day(values[0], int(values[1]))
    elif task in ("offline", "score"):
        {"offline": offline, "score": score}[task](int(values[0]), int(values[1]))
    else:
        sys.exit(__doc__)
