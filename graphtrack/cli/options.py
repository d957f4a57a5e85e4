"""Options that several commands share, and how a function becomes a command."""

from __future__ import annotations

import inspect
import os
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial, reduce, wraps
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
"""Options of how pixels come to the ground."""

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
    "position, separate, joint-body, joint, intentional, joint-intentional, full, social, joint-place, or a "
    "model file (.toml); by default full."
)
BestModelName = Annotated[str | None, typer.Option("--model", help=_MODELS)]
TrustNoise = Annotated[
    Literal["declared", "check", "learn"] | None,
    typer.Option(
        "--trust",
        help="What the noise that the file or the model declares is worth: declared, it is taken as it is; "
        "check, a note says where the data contradict it; learn, it is corrected there. By default check; "
        "declared of what is streamed.",
    ),
]
Json = Annotated[Path | None, typer.Option("--json", help="Write the numbers as JSON too.")]
Places = Annotated[
    Path | None,
    typer.Option(
        help="CSV of what else may be looked at: name and x, y, radius, or name and polygon (x y x y …)."
    ),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]


@dataclass(frozen=True)
class Reading:
    """Options of an input that is already in metres, by the names of `graphtrack.io.ReadOptions`.

    Reading the input
    -----------------
    fps : Frames a second, where the file has no times.
    format : Force the input's format; see 'graphtrack formats'.
    select : Only tracks whose label or id matches this pattern, such as '*walk*'; repeat for more.

    Tables with names and units of their own
    ----------------------------------------
    columns : Which column is which, such as id=agent,t=timestamp,x=pos_x,y=pos_y; also lat, lon, or any of
        the native table. Numbers count the columns of a file without a header; * stands for who it is, where
        each has columns of their own.
    time_unit : Unit of the times; iso: text of ISO 8601.
    units : Unit of the lengths.
    crs : Coordinate reference system of the places, such as EPSG:4326; needs the extra geo.
    delimiter : Mark between the cells: such as ';', or tab, space.
    decimal : Mark before the decimals: a comma.
    encoding : Of text that is not UTF-8, such as cp1252 or utf-16-le.

    ROS 2 recordings
    ----------------
    topic : Of a ROS 2 bag or MCAP file: the topic that tells of people, where there are several; a pattern
        such as '/person*/pose' for topics of one person each.
    fixed_frame : Of a ROS 2 bag or MCAP file: the frame of reference, such as map, to which tf brings places.
    """

    _associate: ClassVar[Literal["auto", "never"]] = "never"

    fps: float | None = None
    format: str | None = None
    select: Annotated[list[str] | None, typer.Option(metavar="PATTERN")] = None
    columns: Annotated[str | None, typer.Option(metavar="KEY=NAME,...")] = None
    time_unit: Literal["s", "ms", "us", "ns", "iso"] | None = None
    units: Literal["m", "cm", "mm", "ft"] | None = None
    crs: str | None = None
    delimiter: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    topic: str | None = None
    fixed_frame: Annotated[str | None, typer.Option(metavar="FRAME")] = None

    def inputs(self, paths: Iterable[Path], model: str | None = None) -> dict[str, Paths]:
        """Files that a command reads, by the names of its options, for `check_outputs`.

        Parameters
        ----------
        paths : files with tracks, or folders of them
        model : a preset's name, or a model file
        """
        from graphtrack.io.registry import files_beside
        from graphtrack.io.source import table_in

        paths, given = [table_in(path) for path in paths], self.given()
        named: dict[str, Paths] = {"the input": paths, "--model": model_file(model)}
        named |= {option_name(name): given[name] for name in _CAMERA_FILES if name in given}
        named["a file beside the input"] = [place for path in paths for place in files_beside(path)]
        return named

    def given(self) -> dict[str, Any]:
        """Options that differ from their defaults, by name."""
        return {f.name: value for f in fields(self) if (value := getattr(self, f.name)) != f.default}

    def options(self) -> ReadOptions:
        """The fields of `ReadOptions` among these options."""
        from graphtrack.io.options import ReadOptions

        told = {name: value for name, value in self.given().items() if name not in ("format", "select")}
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
        """
        from graphtrack.association.associate import tracks_of_rows
        from graphtrack.cli.console import emit, print_summary, quiet_input_warnings
        from graphtrack.io.read_write import read_with

        told = replace(self.options(), beside=None if beside is None else beside.as_read)
        to_tracks = partial(tracks_of_rows, scene=scene)
        with quiet_input_warnings():
            tracks = read_with(paths, self.format, told, to_tracks) if rows is None else to_tracks(rows, told)
        print_summary(tracks, ", ".join(str(path) for path in paths))
        unused = [option_name(name) for name in CAMERA if name in self.given()]
        if unused and tracks.camera is None:
            emit(f"  note: {', '.join(unused)} not used: the input has no pixels")
        if self.select:
            if not all(self.select):
                expected = "a label, an id or a pattern such as '*walk*'"
                raise InputError("an empty pattern for --select", expected)
            chosen = tracks.select(*self.select)
            if not len(chosen):
                wanted = " or ".join(self.select)
                raise InputError(f"no track that matches {wanted}", "a label or id that is there")
            emit(f"  selected {len(chosen)} of {len(tracks)} tracks")
            tracks = chosen
        return tracks


@dataclass(frozen=True)
class CameraReading(Reading):
    """Options of an input that may have to be brought to the ground first.

    Reading the input
    -----------------
    homography : File with 3×3 numbers: image → ground in metres.
    point_pairs : File with rows 'u v X Y', X and Y in metres; a homography is fitted (DLT).
    calibration : Camera calibration (.ci).
    metres_per_pixel : Scale of a view from above, without a homography.
    classes : Class of object to read (KITTI, MOT); repeat for more.
    """

    homography: InputFile | None = None
    point_pairs: InputFile | None = None
    calibration: InputFile | None = None
    metres_per_pixel: float | None = None
    classes: Annotated[list[str] | None, typer.Option("--class", metavar="NAME")] = None


@dataclass(frozen=True)
class SceneReading(CameraReading):
    """Options of an input in which people may be without identities.

    Reading the input
    -----------------
    associate : Who is who: auto, where the file has no identities; always, forgetting those it has; repair,
        parting and joining the tracks it has where they are wrong; never.
    """

    _associate: ClassVar[Literal["auto", "never"]] = "auto"

    associate: Literal["auto", "never", "always", "repair"] = "auto"

    def rows(self, path: Path) -> tuple[Rows, bool]:
        """The rows of a file, and whether it has to be found out whose they are."""
        from graphtrack.association.associate import has_detections
        from graphtrack.io.read_write import rows_of_file

        rows = rows_of_file(path, self.format, self.options())
        return rows, has_detections(rows, self.options())


@dataclass(frozen=True)
class Showing:
    """Options that say where a view goes.

    Where it is shown; by default in a window that opens
    ----------------------------------------------------
    save : Write a recording (.rrd), for 'rerun FILE'.
    connect : Show it in a viewer that runs, such as rerun+http://127.0.0.1:9876/proxy.
    """

    save: Path | None = None
    connect: Annotated[str | None, typer.Option(metavar="URL")] = None

    def target(self) -> Target:
        """Return the checked target."""
        from graphtrack.viewer.recording import Target

        found = Target(self.save, self.connect)
        found.check()
        if self.connect is not None:
            # A viewer that does not answer is one error, without the lines of Rerun's own log before it.
            os.environ.setdefault("RUST_LOG", "off")
        return found


def option_name(name: str) -> str:
    """An option as it is written, from the name of its field."""
    return "--class" if name == "classes" else f"--{name.replace('_', '-')}"


def documented(*texts: str | None) -> tuple[str, dict[str, tuple[str, str]]]:
    """The text of docstrings before their sections, and parameter → title of its section and text."""
    about, found = "", dict[str, tuple[str, str]]()
    for text in texts:
        before, *parts = re.split(r"\n*^(.+)\n-+\n", inspect.cleandoc(text or ""), flags=re.MULTILINE)
        about = about or before
        for title, body in zip(parts[::2], parts[1::2], strict=True):
            entries = re.split(r"^(\w+) : ", body, flags=re.MULTILINE)[1:]
            for name, said in zip(entries[::2], entries[1::2], strict=True):
                found[name] = title, " ".join(said.split())
    return about, found


def _parts(hint: Any) -> tuple[Any, Any]:
    """The type of a parameter, and what is declared of its option or argument."""
    if get_origin(hint) is Annotated:
        return get_args(hint)[:2]
    if get_origin(hint) in (Union, types.UnionType):
        parts = [_parts(one) for one in get_args(hint)]
        return reduce(or_, [kind for kind, _ in parts]), next((one for _, one in parts if one), None)
    return hint, None


def _parameters(given: Mapping[str, tuple[Any, Any]], *texts: str | None) -> Iterator[inspect.Parameter]:
    """Parameters as typer takes them, from name → hint and default, and the docstrings that tell of them."""
    _, said = documented(*texts)
    for name, (hint, default) in given.items():
        kind, info = _parts(hint)
        info = copy(info or typer.Option())
        title, info.help = said.get(name, ("Parameters", info.help))
        info.rich_help_panel = None if title == "Parameters" else title
        info.show_default = default not in (None, False, inspect.Parameter.empty)
        if isinstance(info, typer.models.OptionInfo) and not isinstance(info.default, str):
            own = option_name(name)
            info.param_decls = (f"{own}/--no-{own[2:]}" if kind == bool | None else own,)
        hint = Annotated[kind, info]
        yield inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hint)


def command_of(function: Callable[..., None]) -> Callable[..., None]:
    """The function as a command for typer: its options by its signature, their help by its docstring.

    A parameter that is a dataclass stands for an option for each of its fields. A section of a docstring
    other than "Parameters" is a group of options in the help.
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


def program_of(name: str, about: str, commands: Mapping[str, Callable[..., None]]) -> typer.Typer:
    """A program of commands; ``--version`` tells that of the package."""
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

    for command, function in commands.items():
        program.command(command)(command_of(function))
    return program


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
    """
    from graphtrack.io.atomic import check_distinct

    if table is not None:
        from graphtrack.io.registry import format_for_writing

        format_for_writing(table)
    check_distinct(outputs, inputs or {}, folders=folders, to_make=to_make)


def refuse(given: Mapping[str, object], where: str, expected: str) -> None:
    """Refuse options that mean nothing here."""
    for name, value in given.items():
        if value not in (None, False, []):
            raise InputError(f"{name} {where}", expected)


def model_file(model: str | None) -> Path | None:
    """The file that ``--model`` names, if it is not a preset."""
    return Path(model) if model is not None and model.endswith(".toml") else None


def files_in(folder: Path | None, names: Iterable[str]) -> list[Path]:
    """The files of those names in a folder; none where it is still to be made."""
    return [folder / name for name in names] if folder is not None and folder.is_dir() else []


def make_folder(path: Path) -> None:
    """Make a folder for results, unless it is there."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{error.strerror or error} when making the folder", "a place that can be written to", path=path
        ) from error
