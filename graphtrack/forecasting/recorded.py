"""Forecasts for recorded tracks, each from the frames up to it, and their tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.associate import tracks_of
from graphtrack.errors import InputError
from graphtrack.forecasting.forecaster import Forecast, Forecaster, times_ahead
from graphtrack.forecasting.motion import ForecastParameters
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.walkable import AreaLike
from graphtrack.io.formats.native import read_parquet
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import cells_of_file
from graphtrack.io.source import Source
from graphtrack.model.parameters import LikelihoodParameters
from graphtrack.model.same_time import with_merged_rows
from graphtrack.tracks.cells import numbers
from graphtrack.tracks.given import warn_unused
from graphtrack.tracks.time import TIME_TOLERANCE, distinct_times
from graphtrack.tracks.track import STATE, Track, TrackSet
from graphtrack.tracks.validation import check_integer, check_positive, check_within

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.io.read_write import Given


_NOT_READ: dict[str, Any] = {
    **dict.fromkeys(("pixel", "body", "body_kappa", "body_axis", "body_likelihood", "head_likelihood")),
    **dict.fromkeys(("observed_velocity", "observed_velocity_covariance")),
    "inputs": {},
}
"""Channels that forecasts do not read, and which may have no product at one time."""

_LONGEST = 86400.0
_MOST_ROWS = 20_000_000
_MOST_SAMPLES = 1000


@dataclass(frozen=True, eq=False)
class PeopleOfFrame:
    """Observed people of a frame at ``t`` seconds, as for `Forecaster.update`."""

    t: float
    frame: int
    track_id: NDArray[np.int64]
    position: FloatArray
    std: FloatArray
    head: FloatArray


@dataclass(frozen=True, eq=False)
class Forecasts:
    """Forecasts of a recording, as a table.

    Attributes
    ----------
    columns : name → (rows,): ``track_id, frame, t, ahead, x, y, x_std, y_std, xy_cov, radius_50, radius_90``;
        ``sample_<k>_x, sample_<k>_y`` if samples were requested
    people : number of predicted people
    too_short : ids of people whose history is too short
    """

    columns: dict[str, NDArray[np.float64] | NDArray[np.int64]]
    people: int
    too_short: tuple[int, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.columns["ahead"])

    def __repr__(self) -> str:
        return f"Forecasts({len(self)} rows of {self.people} people)"

    def to_table(self) -> pd.DataFrame:
        """The columns as a DataFrame."""
        import pandas as pd

        return pd.DataFrame(self.columns)

    def write(self, path: str | Path) -> None:
        """Write the table in the format of the ending (.csv, .csv.gz, .parquet, .ndjson)."""
        from graphtrack.io.read_write import write_table

        write_table(self.columns, path)


_NOISE = ("pos_std", "x_std", "y_std", "observed_x_std", "observed_y_std", "observed_xy_corr")
_USED = ("t", "x", "y", *_NOISE, "head_deg", "observed")
"""Columns that forecasts are made from."""


def frames_of(tracks: Iterable[Track]) -> Iterator[PeopleOfFrame]:
    """Return the observed people, time by time; rows without a position are left out.

    Observations of one person at one time are merged, as smoothers do.
    """
    parts: list[tuple[FloatArray, ...]] = []
    used = TrackSet(tuple(replace(track, **_NOT_READ) for track in tracks))
    for track in with_merged_rows(used, LikelihoodParameters())[0]:
        has_position = np.isfinite(track.position).all(axis=1)
        if track.observed is not None:
            has_position &= ~(track.observed == 0.0)
        unknown = np.full(len(track), np.nan)
        std = unknown if track.axis_std is None else track.axis_std
        if track.covariance is not None:
            columns = [STATE.index("x"), STATE.index("y")]
            std = np.sqrt(track.covariance[:, columns, columns].mean(axis=1))
        head = unknown if track.head is None else track.head
        track_ids = np.full(len(track), track.track_id)
        values = (track.t, track.frame, track_ids, *track.position.T, std, head)
        parts.append(tuple(np.asarray(one)[has_position] for one in values))
    if not parts:
        return
    t, frame, track_ids, x, y, std, head = (np.concatenate(one) for one in zip(*parts, strict=True))
    times, place = distinct_times(t)
    order = np.lexsort((track_ids, place))
    edges = np.flatnonzero(np.diff(place[order], prepend=-1))
    for at, rows in zip(times.tolist(), np.split(order, edges[1:]) if len(order) else [], strict=True):
        yield PeopleOfFrame(
            t=at,
            frame=int(frame[rows[0]]),
            track_id=track_ids[rows].astype(np.int64),
            position=np.stack([x[rows], y[rows]], axis=1),
            std=std[rows],
            head=head[rows],
        )


def forecast(
    tracks: Given,
    *,
    horizon: float = 4.8,
    step: float = 0.4,
    every: float | None = None,
    history: float | None = None,
    samples: int = 0,
    parameters: ForecastParameters | str | Path | None = None,
    seed: int = 0,
    walkable: AreaLike | None = None,
) -> Forecasts:
    """Predict all people at each time from the frames up to it.

    Parameters
    ----------
    tracks : tracks of one scene, with observed positions. Tracks smoothed offline contain information from
        the future, which would leak into the forecasts.
    horizon, step : predictions are for every ``step`` seconds up to ``horizon``
    every : seconds between forecasts; None: one at each frame
    history : shortest observed history in seconds; None: two frames
    samples : paths to sample for each forecast
    parameters : parameters or their file; by default the learned parameters
    seed : seed of the samples
    walkable : area that no predicted path leaves: a file of GeoJSON or well-known text, or a polygon

    Raises
    ------
    InputError
        For invalid settings, and if no person was observed for long enough.
    """
    ahead = times_ahead(horizon, step)
    check_positive("every", every, _LONGEST)
    check_within(0.0, _LONGEST, history=history)
    check_integer("samples", samples, 0, _MOST_SAMPLES)
    check_integer("seed", seed, 0, 2**63 - 1)
    tracks = tracks_of(tracks)
    warn_unused(tracks, _USED, "forecasts")
    if isinstance(parameters, str | Path):
        parameters = ForecastParameters.load(parameters)
    if not (parameters is None or isinstance(parameters, ForecastParameters)):
        raise InputError(
            f"parameters of type {type(parameters).__name__}", "ForecastParameters or their file"
        )
    forecaster, random = Forecaster(parameters, walkable), np.random.default_rng(seed)
    made: list[tuple[int, Forecast]] = []
    last, rows = -math.inf, 0
    for present in frames_of(tracks):
        forecaster.update(present.t, present.track_id, present.position, present.std, present.head)
        if every is not None and present.t - last < every - TIME_TOLERANCE:
            continue
        last = present.t
        people = forecaster.people(history or 0.0)
        if len(people):
            made.append((present.frame, forecaster.forecast(ahead, people, samples=samples, random=random)))
            rows += len(people) * len(ahead)
            if rows > _MOST_ROWS:
                raise InputError(
                    f"more than {_MOST_ROWS} rows", "forecasts less often (every), or longer steps"
                )
    reported = set(np.concatenate([one.track_id for _, one in made]).tolist()) if made else set()
    short = tuple(track.track_id for track in tracks if track.track_id not in reported)
    if not made:
        needed = "two frames" if history is None else f"{history:g} s, the history"
        raise InputError(f"none of {len(tracks)} people observed for {needed}", "longer tracks")
    return Forecasts(columns_of(made), len(reported), short)


def columns_of(made: list[tuple[int, Forecast]]) -> dict[str, NDArray[np.float64] | NDArray[np.int64]]:
    """Return the table of forecasts and their frames."""
    parts = [_columns(frame, one) for frame, one in made]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _columns(frame: int, made: Forecast) -> dict[str, NDArray[Any]]:
    people, times = made.position.shape[:2]
    values = made.columns()
    for k in range(made.samples.shape[1]):
        values |= {f"sample_{k}_x": made.samples[:, k, :, 0], f"sample_{k}_y": made.samples[:, k, :, 1]}
    return {
        "track_id": np.repeat(made.track_id, times),
        "frame": np.full(people * times, frame),
        "t": np.full(people * times, made.t),
        "ahead": np.tile(made.ahead, people),
        **{name: one.reshape(-1) for name, one in values.items()},
    }


COLUMNS = ("track_id", "frame", "t", "ahead", "x", "y", "x_std", "y_std", "xy_cov", "radius_50", "radius_90")
"""Columns of a table of forecasts; ``sample_<k>_x`` and ``sample_<k>_y`` may follow."""

_TELLING = ("track_id", "t", "ahead", "radius_50", "radius_90")
_PARQUET = b"PAR1"


def is_forecast(path: Path) -> bool:
    """Return True if a file is a table of forecasts.

    Raise InputError if it cannot be read at all.
    """
    return set(_TELLING) <= set(_names(Source.open(path)))


def read_forecasts(path: str | Path) -> dict[str, FloatArray]:
    """Return the columns (rows,) of a table of forecasts.

    Raise InputError with the invalid line and column.
    """
    path = Path(path)
    cells = cells_of_file(path, ReadOptions())
    missing = [name for name in COLUMNS if name != "frame" and name not in cells.columns]
    if missing:
        raise InputError(f"no column {missing[0]}", f"the columns {', '.join(COLUMNS)}", path=path)
    found: dict[str, FloatArray] = {}
    for name in cells.columns:
        if name in COLUMNS or name.startswith("sample_"):
            found[name] = numbers(cells, name)
            cells.refuse(np.isnan(found[name]), name, "a finite number")
    if not len(found["t"]):
        raise InputError("no rows", "forecasts", path=path)
    for name in ("x_std", "y_std", "radius_50", "radius_90", "ahead"):
        cells.refuse(found[name] <= 0.0, name, "a number above 0")
    return found


def _names(source: Source) -> list[str]:
    if source.head.startswith(_PARQUET):
        return list(read_parquet(source).columns)
    first = next((line for line in source.head.decode("utf-8", "replace").splitlines() if line.strip()), "")
    if first.lstrip().startswith("{"):
        return [name for name in COLUMNS if f'"{name}"' in first]
    return [name.strip().strip('"') for name in first.removeprefix("\ufeff").split(",")]
