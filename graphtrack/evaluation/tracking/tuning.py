"""The best parameters of a tracker on made-up crowds.

``python -m graphtrack.evaluation.tracking.tuning hungarian bytetrack ocsort`` prints them. So each tracker
that others are compared with does as well as it can, and none has seen the recordings that judge it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from graphtrack.baselines.hungarian import HungarianParameters, track_detections
from graphtrack.errors import InputError
from graphtrack.evaluation.tracking.detections import estimated_detections, true_detections
from graphtrack.evaluation.tracking.judge import judge, threshold_of
from graphtrack.evaluation.tracking.peers import TUNED, PeerParameters, load, track_boxes
from graphtrack.evaluation.tracking.scores import SequenceScore
from graphtrack.simulation.crowd import Place, crowd
from graphtrack.simulation.detector import Detector, detect
from graphtrack.table.detections import Detections
from graphtrack.tracks import TrackSet

Parameters = TypeVar("Parameters")

PLACES = (
    Place(),
    Place(arrivals=0.25, stops=0.3),
    Place(width=20.0, depth=10.0, arrivals=0.8, pairs=0.5),
    Place(speed=1.0, sway=0.25, stops=0.3),
)
"""The places of the crowds of `made_up_scenes`, one each."""

FAULTS = Detector(missed=0.15, occluded_share=0.5, occluded_seconds=2.0, clutter=1.0, clutter_count="fixed")

GRIDS: dict[str, Mapping[str, Sequence[Any]]] = {
    "hungarian": {
        "gate": (2.0, 2.5, 3.0, 3.5, 4.0, 5.0),
        "longest_gap": (1.2, 2.0, 2.4, 2.8, 3.2, 4.0),
        "acceleration_density": (0.03, 0.06, 0.1, 0.2, 0.4),
        "position_std": (0.07, 0.1, 0.14, 0.2),
        "speed_std": (0.5, 0.7, 1.0, 1.4),
        "hits": (2, 3, 4),
        "frames": (2, 3, 4, 5, 6),
        "coasting": (0.0, 0.4, 0.8, 1.2, 2.0, 2.8),
    },
    "bytetrack": {
        "side": (0.7, 1.0, 1.4, 2.0, 2.8),
        "scale": (3.0, 10.0, 30.0, 100.0),
        "minimum_iou": (0.02, 0.05, 0.1, 0.2, 0.3),
        "minimum_frames": (1, 2, 3),
        "longest_gap": (0.8, 1.6, 2.4, 3.2),
    },
}
GRIDS["ocsort"] = GRIDS["bytetrack"]
"""Method → parameter → the values that are tried."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Detections without identities, and where everybody was."""

    detections: Detections
    truth: TrackSet


def made_up_scenes(seed: int = 0, *, seconds: float = 90.0) -> tuple[Scene, ...]:
    """A crowd in each of `PLACES` at 2.5 Hz, detected with a noise of 0.1 m and `FAULTS`."""
    scenes = []
    for k, place in enumerate(PLACES):
        rng = np.random.default_rng([seed, k])
        found = detect(crowd(rng, place=place, seconds=seconds), FAULTS, position_std=0.1, rng=rng)
        table = found.anonymous(rng)
        position = np.column_stack([table["x"], table["y"]])
        scenes.append(Scene(Detections(table["frame"], table["t"], position), found.truth))
    return tuple(scenes)


def worth(score: SequenceScore) -> float:
    """The objective that is maximised: the mean of HOTA, IDF1 and MOTA."""
    return (score.hota + score.idf1 + score.mota) / 3.0


def judged(track: Callable[[Detections], TrackSet], scenes: Sequence[Scene]) -> SequenceScore:
    """The figures of a tracker on all scenes together, within 1 m."""
    pairs = (
        (str(k), estimated_detections(track(scene.detections)), true_detections(scene.truth))
        for k, scene in enumerate(scenes)
    )
    return judge(pairs, threshold_of()).together


def tuned(
    start: Parameters,
    grid: Mapping[str, Sequence[Any]],
    value: Callable[[Parameters], float],
    report: Callable[[Parameters, float], None] = lambda parameters, value: None,
) -> Parameters:
    """The parameters from which no step along one of them leads to a greater value.

    Parameters
    ----------
    start : a frozen dataclass
    grid : field → the values that are tried; combinations that it refuses are passed over
    value : of parameters
    report : is told of each improvement
    """
    best, highest = start, value(start)
    improved = True
    while improved:
        improved = False
        for name, values in grid.items():
            for one in values:
                if one == getattr(best, name):
                    continue
                try:
                    candidate = replace(best, **{name: one})  # type: ignore[type-var]
                except InputError:
                    continue
                found = value(candidate)
                if found > highest:
                    best, highest, improved = candidate, found, True
                    report(best, highest)
    return best


def _runner(name: str) -> tuple[Any, Callable[[Any, Detections], TrackSet]]:
    """The parameters that a method starts from, and how it runs."""
    if name == "hungarian":
        return HungarianParameters(), lambda parameters, detections: track_detections(detections, parameters)
    if name not in TUNED:
        raise InputError(f"method {name!r}", f"hungarian, {', '.join(TUNED)}")
    make, boxes_of = load(name)
    return PeerParameters(), lambda parameters, detections: track_boxes(
        detections, parameters, make, boxes_of
    )


def main(names: Sequence[str]) -> None:
    """Print the best parameters of methods, and what they are worth on crowds that were not used."""
    scenes, others = made_up_scenes(0), made_up_scenes(1)
    for name in names:
        start, run = _runner(name)

        def value(parameters: Any, run: Any = run) -> float:
            return worth(judged(partial(run, parameters), scenes))

        best = tuned(start, GRIDS[name], value, lambda found, worth: print(f"{worth:.4f} {found}"))
        other = judged(partial(run, best), others)
        print(f"{name}: {best}")
        print(f"  other crowds: HOTA {other.hota:.3f}, IDF1 {other.idf1:.3f}, MOTA {other.mota:.3f}")


if __name__ == "__main__":
    main(sys.argv[1:])
