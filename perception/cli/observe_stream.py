"""`perception observe -o -`: rows on standard output, frame by frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

from graphtrack.cli.live import give
from perception.cli.common import print_camera_note, print_skipped

if TYPE_CHECKING:
    from perception.cli.own_networks import OwnNetworks
    from perception.detection.boxes import PersonBox
    from perception.images.frames import FrameSource
    from perception.observe.live import LiveObserver


def observe_stream(
    frames: FrameSource,
    boxes: list[PersonBox] | None,
    observer: LiveObserver,
    refused: dict[str, None],
    networks: OwnNetworks,
) -> None:
    """Give the rows of every frame as soon as it was looked at; what was left out is told in the end.

    Parameters
    ----------
    boxes : of all frames; None: people are detected
    refused : what was left out so far
    networks : of the user's own
    """
    from perception.observe.live import (
        boxes_of_keypoints,
        boxes_with_keypoints,
        detected_boxes,
        given_boxes,
        observe_live,
    )

    camera = observer.camera
    if boxes is None and networks.makes_boxes:
        find = boxes_of_keypoints(networks.look)
    else:
        find = detected_boxes(camera, networks.detector) if boxes is None else given_boxes(boxes)
        if networks.has_keypoints:
            find = boxes_with_keypoints(find, networks.look)
    for row in observe_live(frames.where(lambda number: True), find, observer, refused.setdefault):
        give(row)
    print_skipped(list(refused))
    print_camera_note(camera)
