"""Parameters of forecasts, with units and ranges, and their file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import tomli_w

from graphtrack.bounds import check_numbers, number, with_table
from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from graphtrack.io.toml import read_toml

TABLE = "forecast"
"""The table of a parameter file."""


@dataclass(frozen=True)
class ForecastParameters:
    """Parameters of forecasts; the defaults are learned (docs/forecast.md says on what).

    Attributes
    ----------
    stop_speed : speeds well below it count as standing, m/s
    companion_weight : how much a companion's velocity counts beside one's own, at most
    companion_distance, companion_velocity : how near in position (m) and velocity (m/s) companions are
    head_share : of the angle from the direction of motion to the visible head, how much the motion follows
    head_seconds : time constant of that, s
    head_limit : angles well beyond it lead nowhere, rad
    place_distance, place_velocity : how near in position (m) and velocity (m/s) somebody earlier must have
        been for what they did there to count
    place_prior : people without news that what was seen in a place is weighed against
    spread_standing, spread_walking : 1-σ a second ahead, on each axis, of what people do that nobody could
        know: at rest (m), and for each m/s of speed (m)
    spread_power : the power of time with which it grows
    spread_along : the spread along the direction of motion over that across it, for people who walk
    spread_prior : people that the spread seen in a place is weighed against
    tail_share, tail_scale : share of people who do something else altogether, and how much wider they spread
    scene_prior : forecasts whose outcome is known that it takes to trust the scene's own errors half
    """

    stop_speed: float = number(0.3, 0.0, 1.0, "m/s")
    companion_weight: float = number(2.0, 0.0, 100.0)
    companion_distance: float = number(1.0, 0.05, 20.0, "m")
    companion_velocity: float = number(0.2, 0.01, 5.0, "m/s")
    head_share: float = number(1.0, 0.0, 1.5)
    head_seconds: float = number(0.3, 0.01, 10.0, "s")
    head_limit: float = number(1.2, 0.1, 10.0, "rad")
    place_distance: float = number(2.7, 0.05, 20.0, "m")
    place_velocity: float = number(0.15, 0.01, 5.0, "m/s")
    place_prior: float = number(3.0, 0.01, 1000.0)
    spread_standing: float = number(0.02, 0.02, 5.0, "m")
    spread_walking: float = number(0.203, 1e-3, 5.0, "m/(m/s)")
    spread_power: float = number(1.379, 0.3, 3.0)
    spread_along: float = number(0.722, 0.1, 10.0)
    spread_prior: float = number(0.435, 0.1, 1000.0)
    tail_share: float = number(0.299, 0.0, 0.9)
    tail_scale: float = number(3.216, 1.0, 5.0)
    scene_prior: float = number(100.0, 1.0, 1e9)

    def __post_init__(self) -> None:
        check_numbers(self)

    def save(self, path: str | Path) -> None:
        """Write a parameter file (TOML), whole or not at all."""
        content = tomli_w.dumps({TABLE: asdict(self)})
        with atomic_path(path) as temporary:
            Path(temporary).write_text(content, encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> ForecastParameters:
        """Read a parameter file; what it does not have is as by default.

        Raise InputError with the file and the key that cannot be used.
        """
        expected = f"a file of graphtrack fit --forecast, with a table [{TABLE}]"
        content = read_toml(path, expected)
        if list(content) != [TABLE]:
            raise InputError(f"the keys {', '.join(content) or 'none'}", expected, path=path)
        try:
            return with_table(cls(), TABLE, content[TABLE])
        except InputError as error:
            raise InputError(error.found, error.expected, path=path) from error
