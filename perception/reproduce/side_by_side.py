"""Independent runs of an experiment, on all processors."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from graphtrack.evaluation.reproduce.experiment import Progress

Task = TypeVar("Task")
Answer = TypeVar("Answer")


def run_all(
    function: Callable[[Task], Answer],
    jobs: Sequence[Task],
    progress: Progress,
    *,
    processes: int | None = None,
) -> list[Answer]:
    """What a function of a module gives for each job, in their order.

    Parameters
    ----------
    processes : how many at once; by default a process for each processor. With 1, none is started.
    """
    count = min(os.cpu_count() or 1 if processes is None else processes, len(jobs))
    results = []
    if count <= 1:
        for job in jobs:
            results.append(function(job))
            progress(1)
        return results
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, mp_context=context, initializer=_alone) as pool:
        for result in pool.map(function, jobs):
            results.append(result)
            progress(1)
    return results


def _alone() -> None:
    """One thread for each process: more would wait for each other."""
    import cv2
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(1)
    threadpool_limits(1)
