"""Answers of every engine on random tracks, written to a file or compared with one.

A rewrite of the solver is compared with the version before it::

    export PYTHONPATH=.:tests/support
    python tests/golden.py write before.npz      # in a checkout of the version before
    python tests/golden.py compare before.npz    # in this one

Offline answers are to agree to 1e-8 and online answers to 1e-6 (m, m/s, rad and their covariances).
"""

import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from random_tracks import contradicted, hard_models, lens_camera, random_parameters, random_track
from walks import walk, without

from graphtrack.geometry.angles import difference
from graphtrack.inference import Solution
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Model, Parameters
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.smoothing import solve
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

PRESETS = ("position", "separate", "joint", "joint-intentional")
OFFLINE, ONLINE = 1e-8, 1e-6


def walks() -> list[Track]:
    """Angles, class likelihoods, gaps, uneven times, no body, turned heads."""
    plain = [walk(60, seed=seed, uneven=bool(seed % 2)) for seed in range(4)]
    no_body = replace(walk(60, seed=5), body=None)
    heads = np.array(walk(60, seed=6).head)
    heads[20:30] += np.pi
    gaps = without(without(walk(60, seed=7), "position", slice(20, 32)), "head", slice(10, 40))
    tracks = [*plain, no_body, replace(walk(60, seed=6), head=heads), gaps, walk(60, seed=8, classes=True)]
    return [replace(track, track_id=k) for k, track in enumerate(tracks)]


def cases() -> Iterator[tuple[str, TrackSet, Model]]:
    """Name, tracks and model of each case."""
    for preset in PRESETS:
        yield f"walks {preset}", TrackSet(tuple(walks())), Model(preset)
    for robust in ("huber", "cauchy"):
        likelihood = LikelihoodParameters(robust=robust, robust_threshold=2.0)
        for preset in ("joint", "joint-intentional"):
            model = Model(preset, Parameters(likelihood=likelihood))
            yield f"{robust} {preset}", TrackSet(tuple(walks())), model
    for seed in range(30):
        rng = np.random.default_rng(seed)
        camera = lens_camera() if seed % 3 == 0 else None
        track = random_track(rng, camera)
        preset = PRESETS[1 + seed % 4]
        yield f"random {seed}", TrackSet((track,), camera=camera), Model(preset, random_parameters(rng))
    for name, model in hard_models().items():
        for kind in ("flipped", "classes"):
            tracks = [contradicted(np.random.default_rng(seed), kind) for seed in range(3)]
            numbered = tuple(replace(track, track_id=k) for k, track in enumerate(tracks))
            yield f"{kind} {name}", TrackSet(numbered), model


def numbers_of(track: Track) -> dict[str, np.ndarray]:
    """Estimated channels of a track."""
    names = ("position", "velocity", "body", "head", "covariance")
    return {name: value for name in names if (value := getattr(track, name)) is not None}


def answers() -> Iterator[tuple[str, np.ndarray]]:
    """Every estimated channel of every case, by name."""
    from graphtrack.inference.chain import batch

    large = batch.LARGE
    for name, tracks, model in cases():
        for way, least in (("offline", large), ("side by side", 0)):
            batch.LARGE = least
            for k, found in enumerate(solve(tracks, model, engine="chain", jobs=1)):
                assert isinstance(found, Solution), (name, found)
                for channel, values in numbers_of(found.track).items():
                    yield f"{way}/{name}/{k}/{channel}", values
        batch.LARGE = large
        for k, track in enumerate(tracks):
            online = track_online(track, model, camera=tracks.camera, engine="chain", lag=1.0)
            for channel, values in numbers_of(online).items():
                yield f"online/{name}/{k}/{channel}", values
    for preset in PRESETS:
        for k, track in enumerate(walks()[:5:2]):
            found = solve(TrackSet((track,)), Model(preset), engine="gtsam")[0]
            assert isinstance(found, Solution), (preset, found)
            for channel, values in numbers_of(found.track).items():
                yield f"gtsam/{preset}/{k}/{channel}", values
            engines: tuple[OnlineEngine, ...] = ("isam2", "fixed-lag")
            for engine in engines:
                online = track_online(track, Model(preset), engine=engine, lag=1.0)
                for channel, values in numbers_of(online).items():
                    yield f"{engine}/{preset}/{k}/{channel}", values


def compare(path: str) -> int:
    """Print the differences beyond their bounds; return the number of such channels."""
    failed, worst = 0, dict[str, float]()
    with np.load(path) as before:
        left = set(before.files)
        for name, values in answers():
            if name not in left:
                print(f"{name}: new")
                continue
            left.discard(name)
            way, _, _, channel = name.split("/")
            turned = channel in ("body", "head")
            apart = difference(values, before[name]) if turned else values - before[name]
            same_gaps = np.array_equal(np.isnan(values), np.isnan(before[name]))
            scale = 1.0 if turned else np.maximum(1.0, np.abs(before[name]))
            most = float(np.nanmax(np.abs(apart / scale), initial=0.0)) if same_gaps else np.inf
            worst[way] = max(worst.get(way, 0.0), most)
            if most > (OFFLINE if way in ("offline", "side by side", "gtsam") else ONLINE):
                failed += 1
                print(f"{name}: {most:.3g}")
    print(f"{failed} channels differ, {len(left)} are missing; greatest difference", worst)
    return failed + len(left)


if __name__ == "__main__":
    if sys.argv[1] == "write":
        np.savez_compressed(sys.argv[2], **dict(answers()))
    else:
        sys.exit(min(compare(sys.argv[2]), 1))
