"""Options that several commands share."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_type_hints

import typer

from graphtrack.cli.of_tables import OfTables
from graphtrack.errors import InputError
from graphtrack.remote import place_of

if TYPE_CHECKING:
    from graphtrack.io.options import ReadOptions
    from graphtrack.io.places import Paths
    from graphtrack.scene import GivenScene
    from graphtrack.table.rows import Rows
    from graphtrack.tracks import TrackSet

_CAMERA_FILES = ("homography", "point_pairs", "calibration")
_READING = "Reading the input"
_FILE = {"exists": True, "dir_okay": False}

Inputs = Annotated[
    list[Path],
    typer.Argument(
        help="Files with tracks, their URLs, or bags; the format is recognised.",
        metavar="FILE...",
        parser=place_of,
        show_default=False,
    ),
]
Output = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        help="File to write: .csv, .csv.gz, .parquet, .ndjson, .txt (MOT), .nc and others; see 'graphtrack "
        "formats'.",
    ),
]
ModelName = Annotated[
    str,
    typer.Option(
        "--model",
        help="position, separate, joint-body, joint, intentional, joint-intentional, full, social, "
        "joint-place, or a model file (.toml).",
    ),
]
BestModelName = Annotated[
    str | None,
    typer.Option(
        "--model",
        help="position, separate, joint-body, joint, intentional, joint-intentional, full, social, "
        "joint-place, or a model file (.toml); by default full.",
        show_default=False,
    ),
]
FormatName = Annotated[
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
    Literal["m", "cm"],
    typer.Option("--point-pairs-unit", help="Unit of X and Y there.", rich_help_panel=_READING),
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
Associate = Annotated[
    Literal["auto", "never", "always", "repair"],
    typer.Option(
        "--associate",
        help="Who is who: auto, where the file has no identities; always, forgetting those it has; repair, "
        "parting and joining the tracks it has where they are wrong; never.",
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
TrustNoise = Annotated[
    Literal["declared", "check", "learn"] | None,
    typer.Option(
        "--trust",
        help="What the noise that the file or the model declares is worth: declared, it is taken as it is; "
        "check, a note says where the data contradict it; learn, it is corrected there. By default check; "
        "declared of what is streamed.",
        show_default=False,
    ),
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the numbers as JSON too.")]
Places = Annotated[
    Path | None,
    typer.Option(
        "--places",
        help="CSV of what else may be looked at: name and x, y, radius, or name and polygon (x y x y …).",
        show_default=False,
    ),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers.")]


@dataclass(frozen=True)
class _OfAnyFile:
    fps: Fps = None
    format: FormatName = None
    select: Select = None


@dataclass(frozen=True)
class Reading(OfTables, _OfAnyFile):
    """What can be said of an input that is already in metres; see `expanded`."""

    _associate: ClassVar[Literal["auto", "never"]] = "never"

    def inputs(self, paths: Iterable[Path], model: str | None = None) -> dict[str, Paths]:
        """What a command reads, by the names of its options, for `check_outputs`.

        Parameters
        ----------
        paths : files with tracks, or folders of them
        model : a preset's name, or a model file
        """
        from graphtrack.io.folders import table_in
        from graphtrack.io.registry import files_beside

        paths, given = [table_in(path) for path in paths], self.given()
        named: dict[str, Paths] = {"the input": paths, "--model": model_file(model)}
        named |= {option_name(name): given[name] for name in _CAMERA_FILES if name in given}
        named["a file beside the input"] = [place for path in paths for place in files_beside(path)]
        return named

    def given(self) -> dict[str, Any]:
        """What was said, without what was left at its default."""
        return {f.name: value for f in fields(self) if (value := getattr(self, f.name)) != f.default}

    def options(self) -> ReadOptions:
        """What a reader is told."""
        from graphtrack.io.options import ReadOptions

        told = {name: value for name, value in self.given().items() if name not in _NOT_TOLD}
        return ReadOptions(**{"associate": self._associate, **told})

    def tracks(
        self,
        paths: list[Path],
        rows: Rows | None = None,
        scene: GivenScene = None,
        beside: TrackSet | None = None,
    ) -> TrackSet:
        """Read and select tracks, and print the summary.

        Parameters
        ----------
        paths : of the files
        rows : those of the one file, where they have been read
        scene : what is known of it where people are without identities
        beside : tracks with which these are compared: times and local metres count from the same

        Raises
        ------
        InputError
            If nothing can be read or nothing matches the selection.
        """
        from graphtrack.association.reading import tracks_of_rows
        from graphtrack.cli.console import console, print_summary, quiet_input_warnings
        from graphtrack.io.reading import read_with

        told = replace(self.options(), beside=None if beside is None else beside.as_read)
        to_tracks = partial(tracks_of_rows, scene=scene)
        with quiet_input_warnings():
            tracks = read_with(paths, self.format, told, to_tracks) if rows is None else to_tracks(rows, told)
        print_summary(tracks, ", ".join(str(path) for path in paths))
        unused = [option_name(name) for name in (*_CAMERA_FILES, "metres_per_pixel") if name in self.given()]
        if unused and tracks.camera is None:
            console.print(f"  note: {', '.join(unused)} not used: the input has no pixels", markup=False)
        if self.select:
            if not all(self.select):
                expected = "a label, an id or a pattern such as '*walk*'"
                raise InputError("an empty pattern for --select", expected)
            chosen = tracks.select(*self.select)
            if not len(chosen):
                wanted = " or ".join(self.select)
                raise InputError(f"no track that matches {wanted}", "a label or id that is there")
            console.print(f"  selected {len(chosen)} of {len(tracks)} tracks", markup=False)
            tracks = chosen
        return tracks


@dataclass(frozen=True)
class CameraReading(Reading):
    """What can be said of an input that may have to be brought to the ground first; see `expanded`."""

    homography: Homography = None
    point_pairs: PointPairs = None
    point_pairs_unit: PointPairsUnit = "m"
    point_pairs_rows: PointPairsRows = None
    calibration: Calibration = None
    metres_per_pixel: MetresPerPixel = None
    image_scale: ImageScale = None
    classes: Classes = None


@dataclass(frozen=True)
class SceneReading(CameraReading):
    """What can be said of an input in which people may be without identities; see `expanded`."""

    _associate: ClassVar[Literal["auto", "never"]] = "auto"

    associate: Associate = "auto"

    def rows(self, path: Path) -> tuple[Rows, bool]:
        """The rows of a file, and whether it has to be found out whose they are."""
        from graphtrack.association.reading import has_detections
        from graphtrack.io.reading import rows_of_file

        rows = rows_of_file(path, self.format, self.options())
        return rows, has_detections(rows, self.options())


_NOT_TOLD = ("format", "select")
"""Options of an input that are no field of `ReadOptions`."""


def option_name(name: str) -> str:
    """An option as it is written, from the name of its field."""
    return "--class" if name == "classes" else f"--{name.replace('_', '-')}"


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """The command for typer: in place of a parameter that is a dataclass it has an option for each field."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name in groups:
            of_field = get_type_hints(groups[parameter.name], include_extras=True)
            options = {f.name: (of_field[f.name], f.default) for f in fields(groups[parameter.name])}
        else:
            options = {parameter.name: (hints[parameter.name], parameter.default)}
        parameters += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)
            for name, (hint, default) in options.items()
        ]

    @wraps(command)
    def run(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{f.name: given.pop(f.name) for f in fields(group)})
        command(**given)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def check_outputs(
    outputs: Mapping[str, Paths],
    inputs: Mapping[str, Paths] | None = None,
    *,
    folders: Mapping[str, Path | None] | None = None,
    table: Path | None = None,
    to_make: Iterable[Path] = (),
) -> None:
    """Refuse, before anything is read, what could not be written in the end, or not without a loss.

    Parameters
    ----------
    outputs, inputs, folders, to_make : as in `check_distinct`, by the names of their options
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
    check_distinct(outputs, inputs or {}, folders=folders, to_make=to_make)


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
