"""netCDF files of datasets of the package movement."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from graphtrack.errors import InputError
from graphtrack.io.format import Format
from graphtrack.io.movement.dataset import EXTRA, to_movement
from graphtrack.io.movement.rows import rows_of_dataset
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.later import package
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet

_HDF5 = b"\x89HDF\r\n\x1a\n"
_CLASSIC = (b"CDF\x01", b"CDF\x02")


def looks_like(head: bytes, path: Path) -> bool:
    """Return whether the file begins with the signature of netCDF, or of HDF5, which netCDF 4 is."""
    return head.startswith((_HDF5, *_CLASSIC))


def read(source: Source, options: ReadOptions) -> Rows:
    """Read a dataset; see `rows_of_dataset`."""
    xarray = package("xarray", EXTRA)
    engine = "scipy" if source.data.startswith(_CLASSIC) else "h5netcdf"
    if engine == "h5netcdf":
        _check_packages()
    return rows_of_dataset(_loaded(xarray, source, engine), options, source.path)


def _check_packages() -> None:
    for name in ("h5netcdf", "h5py"):
        package(name, EXTRA)


def _loaded(xarray: Any, source: Source, engine: str) -> Any:
    try:
        if engine == "h5netcdf":
            # Which complains once more, at its end, of a file that cannot be opened.
            with package("h5py", EXTRA).File(io.BytesIO(source.data), "r") as file:
                file.visititems(lambda name, item: list(item.attrs) and None)
                list(file.attrs.items())
        with xarray.open_dataset(io.BytesIO(source.data), engine=engine, decode_timedelta=False) as dataset:
            return dataset.load()
    except Exception as error:  # what HDF5 says of files that are none is of many kinds
        said = " ".join(str(error).split()) or type(error).__name__
        found = f"a netCDF file that cannot be read ({said[:200]})"
        raise InputError(found, "a whole one, of movement's dataset.to_netcdf", path=source.path) from error


def write(tracks: TrackSet, path: Path) -> None:
    """Write `to_movement`'s dataset as netCDF 4."""
    _check_packages()
    # In memory first: HDF5 ends the process where the disk is full as it closes a file.
    path.write_bytes(to_movement(tracks).to_netcdf(engine="h5netcdf"))


MOVEMENT = Format(
    name="movement",
    description="netCDF of the package movement (extra movement)",
    suffixes=(".nc",),
    looks_like=looks_like,
    read=read,
    write=write,
    takes=("columns", "units"),
)
