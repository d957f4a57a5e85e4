"""Shared options of the commands, and conversion of functions into commands."""

from __future__ import annotations

import inspect
import math
import os
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial, reduce, wraps
from importlib import import_module
from operator import or_
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import typer

from graphtrack.cli.console import emit, option_name, print_summary, quiet_input_warnings
from graphtrack.errors import InputError
from graphtrack.io.source import place_of

if TYPE_CHECKING:
    from graphtrack.io.atomic import Paths
    from graphtrack.io.options import ReadOptions
    from graphtrack.tracks.scene import GivenScene
    from graphtrack.tracks.table import Rows
    from graphtrack.tracks.track import TrackSet
    from graphtrack.viewer.recording import Target

_CAMERA_FILES = ("homography", "point_pairs", "calibration")
CAMERA = (*_CAMERA_FILES, "metres_per_pixel")
"""Options that map pixels to the ground."""

ANGLES = ("angles", "angle_zero", "angle_sense")
"""Options of the convention of angles."""

InputFile = Annotated[Path, typer.Option(exists=True, dir_okay=False)]
Walkable = Annotated[
    Path | None,
    typer.Option(
        exists=True, dir_okay=False, help="Area in which people walk: polygons in metres, GeoJSON or WKT."
    ),
]
OutputPath = Annotated[Path, typer.Option("--output", "-o")]
Seconds = Annotated[float, typer.Option(metavar="SECONDS")]

Inputs = Annotated[
    list[Path],
    typer.Argument(
        help="Files with tracks, their URLs, or bags; the format is recognised.",
        metavar="FILE...",
        parser=place_of,
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
_MODELS = (
    "position, separate, joint-body, joint, intentional, joint-intentional, social, or a model file (.toml); "
    "by default joint."
)
BestModelName = Annotated[str | None, typer.Option("--model", help=_MODELS)]
TrustNoise = Annotated[
    Literal["declared", "check", "learn"] | None,
    typer.Option(
        "--trust",
        help="Use of the noise that the file or the model declares: declared, unchanged; check, with a note "
        "where the data contradict it; learn, corrected where the data contradict it. By default check; "
        "declared for streams.",
    ),
]
Constants = Annotated[
    str | None,
    typer.Option(
        metavar="<default|learn|FILE>",
        help="Constants of motion, turning and couplings: learn, each person's, from the observations; FILE, "
        "the same, with the population of a file; default, the model's. By default learn with the default "
        "model, else default.",
    ),
]
Intervals = Annotated[
    float | None,
    typer.Option(
        metavar="PERCENT",
        min=1.0,
        max=99.99,
        help="Write the intervals of speed, heading, body and head with this probability too: columns "
        "speed_low, speed_high, heading_deg_low and so on.",
    ),
]
SHOWN_CONSTANTS = 10  # People whose learned constants are printed
Json = Annotated[Path | None, typer.Option("--json", help="Write the numbers as JSON too.")]
Places = Annotated[
    Path | None,
    typer.Option(help="CSV of other gaze targets: name and x, y, radius, or name and polygon (x y x y …)."),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]


@dataclass(frozen=True)
class MetricReading:
    """Options of an input that is already in metres, by the names of `graphtrack.io.ReadOptions`.

    Reading the input
    -----------------
    fps : Frames a second, if the file has no times.
    format : Force the input's format; see 'graphtrack formats'.
    select : Only tracks whose label or id matches this pattern, such as '*walk*'; repeat for more.
    sensors : Description of the sensors (.toml); their rows are corrected for the known errors.
    max_memory : GiB that the content of a file may take; by default 4, and no more than 200 times the file's
        size (or 64 MiB), since a small file can unpack to any size.

    Tables with other column names and units
    ----------------------------------------
    columns : Map of columns, such as id=agent,t=timestamp,x=pos_x,y=pos_y; also lat, lon, or any of
        the native table. Numbers count the columns of a file without a header; * stands for the person's id
        if each person has separate columns.
    time_unit : Unit of the times; iso: text of ISO 8601.
    units : Unit of the lengths.
    crs : Coordinate reference system of the positions, such as EPSG:4326; needs the extra geo.
    angles : Convention of the angles, such as 'clockwise from image up', compass, or 'radians, clockwise from
        y'; by default counter-clockwise from x, and compass bearings in tables with lat and lon.
    angle_zero : In place of --angles: direction of the angle 0, in the image, on the ground or by compass.
    angle_sense : In place of --angles: sense of rotation, ccw counter-clockwise, cw clockwise.
    delimiter : Separator of the cells, such as ';', or tab, space.
    decimal : Decimal separator: a comma.
    encoding : Encoding of text that is not UTF-8, such as cp1252 or utf-16-le.

    ROS 2 recordings
    ----------------
    topic : Topic with people in a ROS 2 bag or MCAP file, or a pattern such as '/person*/pose'; repeat for
        more. By default all, if they are of one type.
    fixed_frame : Frame of reference, such as map, into which tf transforms positions (ROS 2 bag or MCAP).
    """

    _associate: ClassVar[Literal["auto", "never"]] = "never"

    fps: float | None = None
    format: str | None = None
    select: Annotated[list[str] | None, typer.Option(metavar="PATTERN")] = None
    sensors: Annotated[Path | None, typer.Option(metavar="FILE")] = None
    max_memory: Annotated[float | None, typer.Option(metavar="GIB")] = None
    columns: Annotated[str | None, typer.Option(metavar="KEY=NAME,...")] = None
    time_unit: Literal["s", "ms", "us", "ns", "iso"] | None = None
    units: Literal["m", "cm", "mm", "ft"] | None = None
    crs: str | None = None
    angles: Annotated[str | None, typer.Option(metavar="TEXT")] = None
    angle_zero: (
        Literal["right", "up", "left", "down", "x", "y", "-x", "-y", "north", "east", "south", "west"] | None
    ) = None
    angle_sense: Literal["cw", "ccw"] | None = None
    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    topic: Annotated[list[str] | None, typer.Option(metavar="TOPIC")] = None
    fixed_frame: Annotated[str | None, typer.Option(metavar="FRAME")] = None

    def inputs(self, paths: Iterable[Path], model: str | None = None) -> dict[str, Paths]:
        """Return the files that a command reads, by option name, for `check_outputs`.

        Parameters
        ----------
        paths : files with tracks, or folders of them
        model : a preset's name, or a model file
        """
        from graphtrack.io.format import companion_files
        from graphtrack.io.source import table_in

        paths, given = [table_in(path) for path in paths], self.given()
        named: dict[str, Paths] = {"the input": paths, "--model": model_file(model)}
        files = (*_CAMERA_FILES, "sensors", "poses")
        named |= {option_name(name): given[name] for name in files if name in given}
        named["a companion file of the input"] = [place for path in paths for place in companion_files(path)]
        return named

    def given(self) -> dict[str, Any]:
        """Return options that differ from their defaults, by name."""
        return {f.name: value for f in fields(self) if (value := getattr(self, f.name)) != f.default}

    def options(self) -> ReadOptions:
        """Return the fields of `ReadOptions` among these options."""
        from graphtrack.io.options import ReadOptions

        named = {name: value for name, value in self.given().items() if name not in ("format", "select")}
        return ReadOptions(**{"associate": self._associate, **named})

    def tracks(
        self,
        paths: list[Path],
        rows: Rows | None = None,
        scene: GivenScene = None,
        reference: TrackSet | None = None,
        missed_rows: bool = True,
        camera_used: bool = False,
    ) -> TrackSet:
        """Read and select tracks, and print the summary.

        Parameters
        ----------
        paths : paths of the files
        rows : rows of the single file, if already read
        scene : scene model, for people without identities
        reference : tracks to compare with; times and local metres share its origin
        missed_rows : as in `ReadOptions`
        camera_used : whether the camera has a use, although the input has no pixels
        """
        from graphtrack.association.associate import tracks_of_rows
        from graphtrack.io.read_write import NO_PIXELS, read_with

        origin = None if reference is None else reference.as_read
        named = replace(self.options(), reference=origin, missed_rows=missed_rows)
        to_tracks = partial(tracks_of_rows, scene=scene)
        with quiet_input_warnings():
            tracks = (
                read_with(paths, self.format, named, to_tracks) if rows is None else to_tracks(rows, named)
            )
        if camera_used:
            used = tuple(note for note in tracks.summary.notes if not note.endswith(NO_PIXELS))
            tracks = replace(tracks, summary=replace(tracks.summary, notes=used))
        print_summary(tracks, ", ".join(str(path) for path in paths))
        if self.select:
            if not all(self.select):
                expected = "a label, an id or a pattern such as '*walk*'"
                raise InputError("an empty pattern for --select", expected)
            chosen = tracks.select(*self.select)
            if not len(chosen):
                wanted = " or ".join(self.select)
                raise InputError(f"no track that matches {wanted}", "an existing label or id")
            emit(f"  selected {len(chosen)} of {len(tracks)} tracks")
            tracks = chosen
        return tracks


@dataclass(frozen=True)
class CameraReading(MetricReading):
    """Options of an input that may have to be mapped to the ground first.

    Reading the input
    -----------------
    homography : File with 3×3 numbers: image → ground in metres.
    point_pairs : File with rows 'u v X Y', X and Y in metres; a homography is fitted (DLT).
    calibration : Camera calibration (.ci).
    metres_per_pixel : Scale of a view from above, without a homography.
    image_size : Width and height of the images in pixels, such as 1920x1080, for boxes relative to them.
    classes : Class of object to read, where a file has several; repeat for more.
    """

    homography: InputFile | None = None
    point_pairs: InputFile | None = None
    calibration: InputFile | None = None
    metres_per_pixel: float | None = None
    image_size: Annotated[str | None, typer.Option(metavar="WxH")] = None
    classes: Annotated[list[str] | None, typer.Option("--class", metavar="NAME")] = None


@dataclass(frozen=True)
class MovingReading(CameraReading):
    """Options of an input whose sensors may move.

    Sensors that move
    -----------------
    poses : File with the poses of the sensors, whose rows are in their frame (x forward, y left): a table
        with t, x, y, yaw_deg or a quaternion, text of TUM, KITTI or EuRoC, or a ROS 2 bag with tf. A column
        sensor in both says whose.
    pose_axes : Axes of a sensor with poses in space: robot, x forward and z up; camera, z forward and y down.
        By default camera for KITTI odometry, else robot.
    """

    poses: Annotated[Path | None, typer.Option(metavar="FILE", parser=place_of)] = None
    pose_axes: Literal["robot", "camera"] | None = None


@dataclass(frozen=True)
class SceneReading(MovingReading):
    """Options of an input that may lack identities.

    Reading the input
    -----------------
    associate : Data association: auto, if the file has no identities; always, discarding existing identities;
        repair, splitting and joining existing tracks where they are wrong; never.
    """

    _associate: ClassVar[Literal["auto", "never"]] = "auto"

    associate: Literal["auto", "never", "always", "repair"] = "auto"

    def rows(self, path: Path) -> tuple[Rows, bool]:
        """Return the rows of a file, and True if they need data association."""
        from graphtrack.association.associate import has_detections
        from graphtrack.io.read_write import rows_of_file

        rows = rows_of_file(path, self.format, self.options())
        return rows, has_detections(rows, self.options())


@dataclass(frozen=True)
class Showing:
    """Options for the destination of a view.

    Destination; by default a new window
    ------------------------------------
    save : Write a recording (.rrd), for 'rerun FILE'.
    connect : Show it in a running viewer, such as rerun+http://127.0.0.1:9876/proxy.
    """

    save: Path | None = None
    connect: Annotated[str | None, typer.Option(metavar="URL")] = None

    def target(self) -> Target:
        """Return the checked target."""
        from graphtrack.viewer.recording import Target

        found = Target(self.save, self.connect)
        found.check()
        if self.connect is not None:
            # Report a viewer that does not answer in one line, without Rerun's log.
            os.environ.setdefault("RUST_LOG", "off")
        return found


def documented(*texts: str | None) -> tuple[str, dict[str, tuple[str, str]]]:
    """Return the text of docstrings before their sections, and parameter → section title and text."""
    about, found = "", dict[str, tuple[str, str]]()
    for text in texts:
        before, *parts = re.split(r"\n*^(.+)\n-+\n", inspect.cleandoc(text or ""), flags=re.MULTILINE)
        about = about or before
        for title, body in zip(parts[::2], parts[1::2], strict=True):
            entries = re.split(r"^(\w+) : ", body, flags=re.MULTILINE)[1:]
            for name, help_text in zip(entries[::2], entries[1::2], strict=True):
                found[name] = title, " ".join(help_text.split())
    return about, found


def _parts(hint: Any) -> tuple[Any, Any]:
    """Return the type of a parameter, and the declaration of its option or argument."""
    if get_origin(hint) is Annotated:
        return get_args(hint)[:2]
    if get_origin(hint) in (Union, types.UnionType):
        parts = [_parts(one) for one in get_args(hint)]
        return reduce(or_, [kind for kind, _ in parts]), next((one for _, one in parts if one), None)
    return hint, None


def _parameters(given: Mapping[str, tuple[Any, Any]], *texts: str | None) -> Iterator[inspect.Parameter]:
    """Return parameters for typer, from name → hint and default, and the docstrings that describe them."""
    _, help_text = documented(*texts)
    for name, (hint, default) in given.items():
        kind, info = _parts(hint)
        info = copy(info or typer.Option())
        title, info.help = help_text.get(name, ("Parameters", info.help))
        info.rich_help_panel = None if title == "Parameters" else title
        info.show_default = default not in (None, False, inspect.Parameter.empty)
        if isinstance(info, typer.models.OptionInfo) and not isinstance(info.default, str):
            own = option_name(name)
            info.param_decls = (f"{own}/--no-{own[2:]}" if kind == bool | None else own,)
        if kind is float or float in get_args(kind):
            info.callback = _finite
        hint = Annotated[kind, info]
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def _finite(value: float | None) -> float | None:
    """Refuse infinity and NaN, which satisfy most bounds, as the value of an option."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number.")
    return value


def command_of(function: Callable[..., None]) -> Callable[..., None]:
    """Return the function as a typer command: options from its signature, help from its docstring.

    A dataclass parameter becomes one option for each field. A docstring section other than "Parameters" is a
    group of options in the help.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        if (group := groups.get(parameter.name)) is None:
            given = {parameter.name: (hints[parameter.name], parameter.default)}
            parameters += _parameters(given, function.__doc__)
        else:
            of_field = get_type_hints(group, include_extras=True)
            given = {f.name: (of_field[f.name], f.default) for f in fields(group)}
            parameters += _parameters(given, *[one.__doc__ for one in reversed(group.__mro__)])

    @wraps(function)
    def run(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{f.name: given.pop(f.name) for f in fields(group)})
        function(**given)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run.__doc__ = documented(function.__doc__)[0]
    return run


def _show_version(wanted: bool) -> None:
    if wanted:
        import graphtrack

        print(graphtrack.__version__)
        raise typer.Exit


def program_of(name: str, about: str, commands: Mapping[str, str], wanted: str | None = None) -> typer.Typer:
    """Create a program of commands; ``--version`` prints the package version.

    Parameters
    ----------
    commands : name of a command → its ``module:function``
    wanted : the only command to import; all, if it is none of them
    """
    program = typer.Typer(
        name=name, help=about, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False
    )

    @program.callback()
    def start(
        version: Annotated[
            bool,
            typer.Option(
                "--version", is_eager=True, callback=_show_version, help="Print the version and end."
            ),
        ] = False,
    ) -> None:
        pass

    for command, place in commands.items():
        if wanted in commands and command != wanted:
            continue
        module, function = place.split(":")
        program.command(command)(command_of(getattr(import_module(module), function)))
    return program


def check_outputs(
    outputs: Mapping[str, Paths],
    inputs: Mapping[str, Paths] | None = None,
    *,
    folders: Mapping[str, Path | None] | None = None,
    table: Path | None = None,
    to_make: Iterable[Path] = (),
) -> None:
    """Refuse outputs that could not be written, or would overwrite an input, before anything is read.

    Parameters
    ----------
    outputs, inputs, folders, to_make : as in `check_distinct`, by option name
    table : output file with tracks, whose name determines the format
    """
    from graphtrack.io.atomic import check_distinct

    if table is not None:
        from graphtrack.io.registry import format_for_writing

        format_for_writing(table)
    check_distinct(outputs, inputs or {}, folders=folders, to_make=to_make)


def refuse(given: Mapping[str, object], where: str, expected: str) -> None:
    """Refuse options that do not apply."""
    for name, value in given.items():
        if value is not None and value is not False and value != []:
            raise InputError(f"{name} {where}", expected)


def model_file(model: str | None) -> Path | None:
    """Return the file that ``--model`` names, if it is not a preset."""
    return Path(model) if model is not None and model.endswith(".toml") else None


def files_in(folder: Path | None, names: Iterable[str]) -> list[Path]:
    """Return the files of those names in a folder; none if the folder does not exist yet."""
    return [folder / name for name in names] if folder is not None and folder.is_dir() else []


def make_folder(path: Path) -> None:
    """Create a folder for results, unless it exists."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{error.strerror or error} when creating the folder", "a writable path", path=path
        ) from error
