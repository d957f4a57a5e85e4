"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.tracks import TrackSet

Inputs = Annotated[
    list[Path], typer.Argument(help="Files with tracks; the format is recognised.", show_default=False)
]
Input = Annotated[
    Path, typer.Argument(help="File with tracks; the format is recognised.", show_default=False)
]
Output = Annotated[
    Path, typer.Option("--output", "-o", help="File to write: .csv, .csv.gz, .parquet or .txt (MOT).")
]
ModelName = Annotated[
    str, typer.Option("--model", help="position, separate, joint, or a model file (.toml).")
]
Format = Annotated[
    str | None, typer.Option("--format", help="Force the input's format; see 'graphtrack formats'.")
]
Fps = Annotated[float | None, typer.Option("--fps", help="Frames a second, where the file has no times.")]
Homography = Annotated[
    Path | None, typer.Option("--homography", help="File with 3×3 numbers: image → ground in metres.")
]
PointPairs = Annotated[
    Path | None, typer.Option("--point-pairs", help="File with rows 'u v X Y'; a homography is fitted (DLT).")
]
PointPairsUnit = Annotated[str, typer.Option("--point-pairs-unit", help="Unit of X and Y there: m or cm.")]
PointPairsRows = Annotated[
    str | None, typer.Option("--point-pairs-rows", help="Rows of that file to use, from 1, such as 5-8.")
]
Calibration = Annotated[Path | None, typer.Option("--calibration", help="Camera calibration (.ci).")]
MetresPerPixel = Annotated[
    float | None, typer.Option("--metres-per-pixel", help="Scale of a view from above, without a homography.")
]
ImageScale = Annotated[
    float | None, typer.Option("--image-scale", help="Factor from the file's pixels to the calibrated image.")
]
Classes = Annotated[
    list[str] | None, typer.Option("--class", help="Class of object to read (KITTI); repeat for more.")
]
Select = Annotated[
    list[str] | None,
    typer.Option("--select", help="Only tracks whose label or id matches this pattern; repeat for more."),
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the figures as JSON too.")]
Seed = Annotated[int, typer.Option("--seed", help="Seed of the random numbers.")]


def read_tracks(
    paths: list[Path],
    *,
    format: str | None = None,
    select: list[str] | None = None,
    classes: list[str] | None = None,
    **options: Any,
) -> TrackSet:
    """Read and select tracks, and print the summary.

    Raises
    ------
    InputError
        If nothing can be read or nothing matches the selection.
    """
    from graphtrack.cli.console import print_summary, quiet_input_warnings
    from graphtrack.io import read

    if classes:
        options["classes"] = tuple(classes)
    with quiet_input_warnings():
        tracks = read(paths if len(paths) != 1 else paths[0], format=format, **options)
    print_summary(tracks, ", ".join(str(path) for path in paths))
    if select:
        tracks = tracks.select(*select)
        if not len(tracks):
            raise InputError(f"no track that matches {' or '.join(select)}", "a label or id that is there")
    return tracks
