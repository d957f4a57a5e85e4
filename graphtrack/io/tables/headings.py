"""What columns may mean by their names, as a proposal: nothing is read by it that was not asked for."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from graphtrack.io.layout import WILD

MEANINGS: Mapping[str, tuple[str, ...]] = {
    "id": (
        *("trackid", "track", "id", "personid", "person", "agentid", "agent", "pedestrianid", "pedestrian"),
        *(
            "pedid",
            "ped",
            "pid",
            "objectid",
            "object",
            "objid",
            "obj",
            "individual",
            "individualid",
            "subject",
        ),
        *("subjectid", "participant", "participantid", "targetid", "target", "identity", "trajectoryid"),
        *("trajectory", "trajid", "traj", "uid", "uuid", "userid", "user", "player", "playerid", "deviceid"),
        *("device", "tagid", "tag", "mac", "entity", "entityid", "who", "name"),
    ),
    "frame": ("frame", "frameid", "frameno", "framenumber", "framenr", "frameindex", "frameidx", "framenum"),
    "t": (
        *("t", "time", "timestamp", "ts", "datetime", "datetimeutc", "timeutc", "utc", "unixtime", "epoch"),
        *("unix", "seconds", "second", "secs", "sec", "elapsed", "elapsedtime", "date", "stamp", "clock"),
        *("milliseconds", "microseconds", "nanoseconds", "millis", "times"),
    ),
    "x": (
        *(
            "x",
            "posx",
            "positionx",
            "px",
            "xpos",
            "xposition",
            "xcoord",
            "coordx",
            "xcoordinate",
            "coordinatex",
        ),
        *("worldx", "xworld", "groundx", "gx", "locx", "locationx", "centerx", "centrex", "easting", "east"),
    ),
    "y": (
        *(
            "y",
            "posy",
            "positiony",
            "py",
            "ypos",
            "yposition",
            "ycoord",
            "coordy",
            "ycoordinate",
            "coordinatey",
        ),
        *(
            "worldy",
            "yworld",
            "groundy",
            "gy",
            "locy",
            "locationy",
            "centery",
            "centrey",
            "northing",
            "north",
        ),
    ),
    "lat": ("lat", "latitude"),
    "lon": ("lon", "lng", "long", "longitude"),
}
"""Key of ``--columns`` → names without marks and in lower case, the likeliest first."""

LENGTHS = {"m": "m", "metre": "m", "meter": "m", "metres": "m", "meters": "m", "cm": "cm", "mm": "mm"}
LENGTHS |= {"ft": "ft", "feet": "ft"}
TIMES = {"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "msec": "ms", "milliseconds": "ms", "millis": "ms"}
TIMES |= {"us": "us", "µs": "us", "microseconds": "us", "ns": "ns", "nanoseconds": "ns"}

_BRACKETS = re.compile(r"[\[({]\s*([^\])}]*?)\s*[\])}]")
_WORDS = re.compile(r"[^\W_]+")


def plain(name: str) -> tuple[str, str]:
    """A name without marks, brackets and unit, in lower case, and the unit, "" where there is none."""
    bracket = _BRACKETS.search(name)
    unit = bracket[1].lower() if bracket else ""
    words = [word.lower() for word in _WORDS.findall(_spaced(_BRACKETS.sub(" ", name)))]
    if len(words) > 1 and not unit and (words[-1] in LENGTHS or words[-1] in TIMES):
        unit = words.pop()
    return "".join(words), unit


def _spaced(name: str) -> str:
    """agentId as agent Id, posX as pos X."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)


def meanings(names: Iterable[str]) -> dict[str, str]:
    """Key of ``--columns`` → name, for the columns whose names say what they are."""
    known = {name: plain(name) for name in names}
    found: dict[str, str] = {}
    for key, words in MEANINGS.items():
        units = LENGTHS if key in ("x", "y") else TIMES if key == "t" else {}
        fitting = [
            (words.index(word), name)
            for name, (word, unit) in known.items()
            if word in words and name not in found.values() and (not unit or unit in units)
        ]
        if fitting:
            found[key] = min(fitting)[1]
    if "lat" in found and "lon" in found:
        found = {key: name for key, name in found.items() if key not in ("x", "y")}
    return {key: name for key, name in found.items() if key not in ("lat", "lon") or "x" not in found}


def wide(names: Iterable[str]) -> dict[str, str]:
    """``x`` and ``y`` with the mark for who it is, for columns such as x_1, y_1 or anna_x, anna_y."""
    there = list(names)
    counted: dict[tuple[str, str], int] = {}
    for name in there:
        for place in re.finditer(r"(?<![A-Za-z])[xX](?![A-Za-z])", name):
            other = name[: place.start()] + ("y" if place[0] == "x" else "Y") + name[place.end() :]
            if other not in there:
                continue
            for pattern in _patterns(name, place.start(), place.end()):
                pair = (pattern, pattern.replace("x", "y").replace("X", "Y"))
                counted[pair] = counted.get(pair, 0) + 1
    if not counted:
        return {}
    best = max(counted, key=lambda pair: (counted[pair], len(pair[0])))
    return {"x": best[0], "y": best[1]}


def _patterns(name: str, start: int, end: int) -> list[str]:
    """The name with what stands before or after its x, but for a mark between them, put for who it is."""
    patterns = []
    before, after = name[:start], name[end:]
    if after and not before:
        mark = re.match(r"[\W_]?", after)[0]  # type: ignore[index]
        patterns.append(f"{name[start:end]}{mark}{WILD}")
    if before and not after:
        mark = re.search(r"[\W_]?$", before)[0]  # type: ignore[index]
        patterns.append(f"{WILD}{mark}{name[start:end]}")
    return patterns
