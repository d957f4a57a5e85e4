"""Files of a rendered street, as the command line names them."""

from pathlib import Path

import cv2
import numpy as np

from perception.detection.boxes import write_boxes
from perception.synthetic.clips import FPS, PastedStreet


def write_frames(street: PastedStreet, folder: Path) -> Path:
    """Write the frames of a street as images."""
    folder.mkdir(parents=True)
    for frame in street.frames:
        assert frame.image is not None
        cv2.imwrite(str(folder / f"{frame.number:04d}.png"), frame.image)
    return folder


def write_street(street: PastedStreet, folder: Path) -> list[object]:
    """Write frames, boxes and a homography; return the arguments of a command that name them."""
    frames = write_frames(street, folder / "frames")
    write_boxes(street.boxes, folder / "boxes.txt")
    np.savetxt(folder / "homography.txt", street.camera.homography)
    boxes, homography = folder / "boxes.txt", folder / "homography.txt"
    return [frames, "--boxes", boxes, "--homography", homography, "--fps", FPS]
