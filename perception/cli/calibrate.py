"""`perception calibrate`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit
from perception.cli.common import VideoOrFolder, check_places, print_skipped

if TYPE_CHECKING:
    from perception.ground.calibrating import FoundView

PersonHeight = Annotated[
    float,
    typer.Option("--person-height", min=0.5, max=3.0, help="Metres that people's boxes are high on average."),
]


def calibrate(
    source: VideoOrFolder,
    boxes: options.InputFile,
    output: options.OutputPath,
    person_height: PersonHeight = 1.7,
    seed: options.Seed = 0,
) -> None:
    """Find out how a camera looks at the ground, from how high people's boxes are at each place.

    `--calibration` takes the file. Of the frames only the size is used.

    Parameters
    ----------
    boxes : MOT text or CAVIAR XML with people's boxes, with identities or without.
    output : Calibration to write (.ci).
    """
    from perception.detection.boxes import read_boxes
    from perception.ground.calibrating import CalibrationParameters, found_view
    from perception.images.frames import FrameSource

    check_places({"--output": output}, None, source, {"--boxes": boxes})
    frames = FrameSource.open(source)
    refused: dict[str, None] = {}
    people = read_boxes(boxes, refused.setdefault)
    parameters = CalibrationParameters(person_height=person_height)
    found = found_view(people, frames.size(), np.random.default_rng(seed), parameters)
    found.write(output)
    print_skipped(list(refused))
    print_view(found)
    emit(f"wrote {output}")


def print_view(found: FoundView) -> None:
    """Print the view of the camera on the ground, with its uncertainty."""
    view, std = found.view, found.std
    emit(
        f"from {found.boxes} boxes of {found.people} people, of which {100 * found.inliers:.0f} % agree:\n"
        f"  focal length {view.focal:.0f} ± {std['focal']:.0f} pixels, "
        f"{np.degrees(view.tilt):.1f} ± {np.degrees(std['tilt']):.1f}° down, "
        f"roll {np.degrees(view.roll):.1f} ± {np.degrees(std['roll']):.1f}°, "
        f"{view.height:.2f} ± {std['height']:.2f} m above the ground\n"
        f"  distances on the ground ± {100 * found.distance_std:.0f} %"
    )
    for note in found.notes:
        emit(f"  note: {note}")
