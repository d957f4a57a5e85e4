"""Frames that somebody waits for: how far their decoding came is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from perception.images.frames import Frame, FrameSource, of_one_size

Progress = Callable[[int, str], AbstractContextManager[Callable[[int], None]]]
"""Begins to tell of so many things of a kind; yields the function that is told how many more are done."""


@contextmanager
def told_frames(
    frames: FrameSource,
    wanted: Callable[[int], bool],
    count: int,
    progress: Progress,
    *,
    unit: str = "frames",
    one_size: bool = False,
) -> Iterator[Iterator[Frame]]:
    """The frames whose numbers are wanted, ``count`` of them.

    Parameters
    ----------
    unit : what ``progress`` calls them
    one_size : whether a frame of another size than the first is an `InputError`
    """
    found = frames.where(wanted)
    with progress(count, unit) as advance:

        def told() -> Iterator[Frame]:
            for frame in of_one_size(found) if one_size else found:
                advance(1)
                yield frame

        yield told()
