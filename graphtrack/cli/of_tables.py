"""Options of tables with names and units of their own, and of recordings, which all commands share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import typer

_TABLES = "Tables with names and units of their own"
_RECORDINGS = "ROS 2 recordings"


@dataclass(frozen=True)
class OfTables:
    """What can be said of tables and recordings, by the names of `graphtrack.io.ReadOptions`."""

    columns: Annotated[
        str | None,
        typer.Option(
            "--columns",
            metavar="KEY=NAME,...",
            help="Which column is which, such as id=agent,t=timestamp,x=pos_x,y=pos_y; also lat, lon, or any "
            "of the native table. Numbers count the columns of a file without a header; * stands for who it "
            "is, where each has columns of their own.",
            rich_help_panel=_TABLES,
        ),
    ] = None
    time_unit: Annotated[
        Literal["s", "ms", "us", "ns", "iso"] | None,
        typer.Option(
            "--time-unit", help="Unit of the times; iso: text of ISO 8601.", rich_help_panel=_TABLES
        ),
    ] = None
    units: Annotated[
        Literal["m", "cm", "mm", "ft"] | None,
        typer.Option("--units", help="Unit of the lengths.", rich_help_panel=_TABLES),
    ] = None
    crs: Annotated[
        str | None,
        typer.Option(
            "--crs",
            help="Coordinate reference system of the places, such as EPSG:4326; needs the extra geo.",
            rich_help_panel=_TABLES,
        ),
    ] = None
    delimiter: Annotated[
        str | None,
        typer.Option(
            "--delimiter", help="Mark between the cells: such as ';', or tab, space.", rich_help_panel=_TABLES
        ),
    ] = None
    decimal: Annotated[
        str | None,
        typer.Option("--decimal", help="Mark before the decimals: a comma.", rich_help_panel=_TABLES),
    ] = None
    encoding: Annotated[
        str | None,
        typer.Option(
            "--encoding",
            help="Of text that is not UTF-8, such as cp1252 or utf-16-le.",
            rich_help_panel=_TABLES,
        ),
    ] = None
    topic: Annotated[
        str | None,
        typer.Option(
            "--topic",
            help="Of a ROS 2 bag or MCAP file: the topic that tells of people, where there are several; a "
            "pattern such as '/person*/pose' for topics of one person each.",
            rich_help_panel=_RECORDINGS,
        ),
    ] = None
    fixed_frame: Annotated[
        str | None,
        typer.Option(
            "--fixed-frame",
            metavar="FRAME",
            help="Of a ROS 2 bag or MCAP file: the frame of reference, such as map, to which tf brings "
            "places.",
            rich_help_panel=_RECORDINGS,
        ),
    ] = None
