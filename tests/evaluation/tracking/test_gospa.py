"""GOSPA against Stone Soup."""

import datetime

import numpy as np
import pytest
from stonesoup.metricgenerator.ospametric import GOSPAMetric
from stonesoup.types.state import State

from graphtrack.evaluation.identities import gospa_counts
from graphtrack.evaluation.matching import ground_similarity, known_detections, share_frames

CUTOFF = 2.0


def crowd(rng, frames, most):
    counts = rng.integers(0, most, frames)
    frame = np.repeat(np.arange(frames), counts)
    identity = np.concatenate([np.arange(count) for count in counts])
    return known_detections(identity, frame, rng.uniform(0.0, 5.0, (len(frame), 2)))


def states(side, frame):
    at = datetime.datetime(2020, 1, 1) + datetime.timedelta(seconds=frame)
    return [State(place[:, None], timestamp=at) for place in side.place[side.frame == frame]]


def test_it_is_that_of_stone_soup():
    rng = np.random.default_rng(0)
    truth, estimates = crowd(rng, 12, 7), crowd(rng, 12, 7)
    metric = GOSPAMetric(p=2, c=CUTOFF, switching_penalty=0.0)
    squares = []
    for frame in range(12):
        pair = states(estimates, frame), states(truth, frame)
        if pair[0] or pair[1]:
            squares.append(metric.compute_gospa_metric(*pair)[0].value["distance"] ** 2)
    frames = share_frames(truth, estimates, lambda a, b: ground_similarity(a, b, CUTOFF))
    assert CUTOFF * gospa_counts(frames).gospa == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)
