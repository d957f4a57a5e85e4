"""Speed of the trackers: frames a second, against OpenCV's SIFT or equalisation, and by particles."""

import time
from collections.abc import Callable, Iterable

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from perception.images.pixels import Image
from perception.synthetic.ceiling import KINDS, ceiling_sequence
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.trackers.mixed_state import MixedStateTracker
from perception.trackers.sigma_pi import SigmaPiTracker
from perception.trackers.sigma_pi_network import SigmaPiParameters

pytestmark = pytest.mark.benchmark
REPEATS, FRAMES = 3, 60
HEAD_FRAMES = 20


@pytest.fixture(scope="module")
def frames() -> list[Image]:
    """Frames of 320 × 240 with a person who walks."""
    kind, rng = KINDS["person moving 1"], np.random.default_rng(0)
    sequence = ceiling_sequence(kind, rng, frames=40 + FRAMES, oversampling=1)
    return [frame.image for frame in sequence]


@pytest.fixture(scope="module", autouse=True)
def one_core() -> Iterable[None]:
    # Threads that wait for each other count as processor time.
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    with threadpool_limits(1):
        yield
    cv2.setNumThreads(threads)


def seconds(run: Callable[[], float]) -> float:
    return min(run() for _ in range(REPEATS)) / FRAMES


def tracking(frames: list[Image], particles: int) -> float:
    """Seconds of processor time that the frames with the person take."""
    tracker = SigmaPiTracker(SigmaPiParameters(particles=particles), seed=0)
    tracker.start(frames[0], None)
    for image in frames[1:-FRAMES]:
        tracker.step(image)
    start = time.process_time()
    found = [tracker.step(image).found for image in frames[-FRAMES:]]
    spent = time.process_time() - start
    assert np.mean(found) > 0.9
    return spent


def features(frames: list[Image]) -> float:
    sift = cv2.SIFT_create()  # type: ignore[attr-defined]
    grey = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in frames[-FRAMES:]]
    start = time.process_time()
    for image in grey:
        sift.detectAndCompute(image, None)
    return time.process_time() - start


def test_sigma_pi(frames: list[Image], record: Callable[[str, float], None]) -> None:
    own = {n: seconds(lambda n=n: tracking(frames, n)) for n in (50, 100, 200, 400)}  # type: ignore[misc]
    base = seconds(lambda: features(frames))
    for n, spent in own.items():
        print(f"\nsigma-pi, {n} particles: {1.0 / spent:.0f} frames a second", end="")
    print(f"\nSIFT of the whole frame alone: {1.0 / base:.0f} frames a second")
    record("sigma-pi with 50 particles / SIFT of the frame, processor time", own[50] / base)
    record("sigma-pi with 400 particles / with 50, processor time", own[400] / own[50])


def head_tracking(clip: HeadClip, particles: int) -> float:
    """Seconds of processor time of a frame."""
    tracker = MixedStateTracker(particles=particles, seed=0)
    tracker.start(clip.images[0], tuple(clip.boxes[0]))
    start = time.process_time()
    for image in clip.images[1:]:
        tracker.step(image)
    return (time.process_time() - start) / (len(clip) - 1)


def resizing(clip: HeadClip) -> float:
    """Seconds that OpenCV takes to resize and equalise 200 patches, one by one."""
    grey = cv2.cvtColor(clip.images[0], cv2.COLOR_BGR2GRAY)
    start = time.process_time()
    for _ in range(200):
        cv2.equalizeHist(cv2.resize(grey[60:100, 60:100], (64, 64)))
    return time.process_time() - start


def test_mixed_state(record: Callable[[str, float], None]) -> None:
    clip = head_clip(np.random.default_rng(0), HeadClipParameters(frames=HEAD_FRAMES))
    own = {n: min(head_tracking(clip, n) for _ in range(REPEATS)) for n in (50, 100, 200, 400)}
    base = min(resizing(clip) for _ in range(5 * REPEATS))
    for n, spent in own.items():
        print(f"\nmixed-state, {n} particles: {1.0 / spent:.0f} frames a second", end="")
    print(f"\nresizing and equalising 200 patches alone: {1.0 / base:.0f} a second")
    record("mixed-state with 200 particles / patches by OpenCV, processor time", own[200] / base)
    record("mixed-state with 400 particles / with 50, processor time", own[400] / own[50])
