"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.io.places import Paths
    from graphtrack.tracks import TrackSet

_CAMERA = ("homography", "point_pairs", "calibration", "metres_per_pixel")
_READING = "Reading the input"
_FILE = {"exists": True, "dir_okay": False}

Inputs = Annotated[
    list[Path],
    typer.Argument(
        help="Files with tracks; the format is recognised.", metavar="FILE...", show_default=False
    ),
]
Output = Annotated[
    Path,
    typer.Option("--output", "-o", help="File to write: .csv, .csv.gz, .parquet, .ndjson or .txt (MOT)."),
]
ModelName = Annotated[
    str,
    typer.Option(
        "--model",
        help="position, separate, joint, intentional, joint-intentional, full, or a model file (.toml).",
    ),
]
BestModelName = Annotated[
    str | None,
    typer.Option(
        "--model",
        help="position, separate, joint, intentional, joint-intentional, full, or a model file (.toml); by "
        "default full, or joint with an engine of GTSAM's, which do not have its modes.",
        show_default=False,
    ),
]
Format = Annotated[
    str | None,
    typer.Option(
        "--format", help="Force the input's format; see 'graphtrack formats'.", rich_help_panel=_READING
    ),
]
Fps = Annotated[
    float | None,
    typer.Option("--fps", help="Frames a second, where the file has no times.", rich_help_panel=_READING),
]
Homography = Annotated[
    Path | None,
    typer.Option(
        "--homography",
        help="File with 3×3 numbers: image → ground in metres.",
        rich_help_panel=_READING,
        **_FILE,
    ),
]
PointPairs = Annotated[
    Path | None,
    typer.Option(
        "--point-pairs",
        help="File with rows 'u v X Y'; a homography is fitted (DLT).",
        rich_help_panel=_READING,
        **_FILE,
    ),
]
PointPairsUnit = Annotated[
    str,
    typer.Option("--point-pairs-unit", help="Unit of X and Y there: m or cm.", rich_help_panel=_READING),
]
PointPairsRows = Annotated[
    str | None,
    typer.Option(
        "--point-pairs-rows",
        help="Rows of that file to use, from 1, such as 5-8.",
        rich_help_panel=_READING,
    ),
]
Calibration = Annotated[
    Path | None,
    typer.Option("--calibration", help="Camera calibration (.ci).", rich_help_panel=_READING, **_FILE),
]
MetresPerPixel = Annotated[
    float | None,
    typer.Option(
        "--metres-per-pixel",
        help="Scale of a view from above, without a homography.",
        rich_help_panel=_READING,
    ),
]
ImageScale = Annotated[
    float | None,
    typer.Option(
        "--image-scale",
        help="Factor from the file's pixels to the calibrated image.",
        rich_help_panel=_READING,
    ),
]
Classes = Annotated[
    list[str] | None,
    typer.Option(
        "--class",
        help="Class of object to read (KITTI, MOT); repeat for more.",
        metavar="NAME",
        rich_help_panel=_READING,
    ),
]
Select = Annotated[
    list[str] | None,
    typer.Option(
        "--select",
        help="Only tracks whose label or id matches this pattern, such as '*walk*'; repeat for more.",
        metavar="PATTERN",
        rich_help_panel=_READING,
    ),
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the numbers as JSON too.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")]


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
    from graphtrack.cli.console import console, print_summary, quiet_input_warnings
    from graphtrack.io import read

    if classes:
        options["classes"] = tuple(classes)
    with quiet_input_warnings():
        tracks = read(paths if len(paths) != 1 else paths[0], format=format, **options)
    print_summary(tracks, ", ".join(str(path) for path in paths))
    unused = [f"--{name.replace('_', '-')}" for name in _CAMERA if options.get(name) is not None]
    if unused and tracks.camera is None:
        console.print(f"  note: {', '.join(unused)} not used: the input has no pixels", markup=False)
    if select:
        chosen = tracks.select(*select)
        if not len(chosen):
            raise InputError(f"no track that matches {' or '.join(select)}", "a label or id that is there")
        console.print(f"  selected {len(chosen)} of {len(tracks)} tracks", markup=False)
        tracks = chosen
    return tracks


def check_outputs(
    outputs: Mapping[str, Paths],
    inputs: Mapping[str, Paths] | None = None,
    *,
    folders: Mapping[str, Path | None] | None = None,
    table: Path | None = None,
) -> None:
    """Refuse, before anything is read, what could not be written in the end, or not without a loss.

    Parameters
    ----------
    outputs, inputs, folders : as in `check_distinct`, by the names of their options
    table : the output that is a file with tracks, whose format is chosen by its name

    Raises
    ------
    InputError
        For a name without a known format, a folder that does not exist or that stands where a file should
        be, and for outputs that are one file with each other or with an input.
    """
    from graphtrack.io.places import check_distinct

    if table is not None:
        from graphtrack.io.registry import format_for_writing

        format_for_writing(table)
    check_distinct(outputs, inputs or {}, folders=folders)


def inputs_of(paths: Iterable[Path], *, model: str | None = None, **files: Path | None) -> dict[str, Paths]:
    """What a command reads, by the names of its options, for `check_outputs`.

    Parameters
    ----------
    paths : files with tracks, or folders of them
    model : a preset's name, or a model file
    files : keyword of an option → the file that it names
    """
    from graphtrack.io.registry import files_beside

    paths = list(paths)
    named: dict[str, Paths] = {"the input": paths, "--model": model_file(model)}
    named |= {f"--{keyword.replace('_', '-')}": path for keyword, path in files.items()}
    named["a file beside the input"] = [place for path in paths for place in files_beside(path)]
    return named


def model_file(model: str | None) -> Path | None:
    """The file that ``--model`` names, if it is not a preset."""
    return Path(model) if model is not None and model.endswith(".toml") else None


def files_in(folder: Path | None, names: Iterable[str]) -> list[Path]:
    """The files of those names in a folder; none where it is still to be made."""
    return [folder / name for name in names] if folder is not None and folder.is_dir() else []


def make_folder(path: Path) -> None:
    """Make a folder for results, unless it is there.

    Raises
    ------
    InputError
        If that cannot be done.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{error.strerror or error} when making the folder", "a place that can be written to", path=path
        ) from error
