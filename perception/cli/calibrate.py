"""`perception calibrate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from graphtrack.cli.console import console
from graphtrack.cli.options import Seed
from perception.cli.common import FILE, VideoOrFolder, check_places, print_skipped

if TYPE_CHECKING:
    from perception.ground.calibrating import FoundView

PersonHeight = Annotated[
    float,
    typer.Option("--person-height", min=0.5, max=3.0, help="Metres that people's boxes are high on average."),
]


def calibrate(
    source: VideoOrFolder,
    boxes: Annotated[
        Path,
        typer.Option(
            "--boxes", help="MOT text or CAVIAR XML with people's boxes, with identities or without.", **FILE
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Calibration to write (.ci).")],
    person_height: PersonHeight = 1.7,
    seed: Seed = 0,
) -> None:
    """Find out how a camera looks at the ground, from how high people's boxes are at each place.

    `--calibration` takes the file. Of the frames only the size is used.
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
    console.print(f"wrote {output}", markup=False)


def print_view(found: FoundView) -> None:
    """How the camera looks at the ground, and how sure that is."""
    view, std = found.view, found.std
    console.print(
        f"from {found.boxes} boxes of {found.people} people, of which {100 * found.inliers:.0f} % agree:\n"
        f"  focal length {view.focal:.0f} ± {std['focal']:.0f} pixels, "
        f"{np.degrees(view.tilt):.1f} ± {np.degrees(std['tilt']):.1f}° down, "
        f"roll {np.degrees(view.roll):.1f} ± {np.degrees(std['roll']):.1f}°, "
        f"{view.height:.2f} ± {std['height']:.2f} m above the ground\n"
        f"  distances on the ground ± {100 * found.distance_std:.0f} %",
        markup=False,
    )
    for note in found.notes:
        console.print(f"  note: {note}", markup=False)
