"""Well-known names of columns: those that are read automatically, and those that are only proposed."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.options import SHORT, ReadOptions
from graphtrack.io.source import Source
from graphtrack.tracks.cells import WILD
from graphtrack.tracks.display import shortened
from graphtrack.tracks.schema import CLASS, box_form, is_column

SYNONYMS: Mapping[str, tuple[str, ...]] = {
    key: tuple(names.split())
    for key, names in {
        "track_id": "id trackid tid person personid agent agentid ped pedid pid pedestrian pedestrianid "
        "object objectid objid subject subjectid participant participantid identity trackerid targetid "
        "trajectoryid",
        "frame": "frameid frameno framenumber framenum framenr frameindex frameidx",
        "t": "time times timestamp timestamps datetime seconds sec secs",
        "x": "posx positionx xpos xposition xcoord xcoordinate coordx worldx xworld",
        "y": "posy positiony ypos yposition ycoord ycoordinate coordy worldy yworld",
    }.items()
}
"""Native column → synonyms, in lower case without punctuation and units.

Each has this meaning in published tables of people; it is read so where the native column is absent.
"""

_BOX_PREFIXES = ("", "bb", "bbox", "box", "bndbox", "boundingbox")
_OF_BOXES: Mapping[str, frozenset[str]] = {
    key: frozenset(prefix + name for prefix in _BOX_PREFIXES for name in names.split())
    for key, names in {
        "left": "left xmin minx x1 xtl xleft lefttopx topleftx",
        "top": "top ymin miny y1 ytl ytop lefttopy toplefty",
        "right": "right xmax maxx x2 xbr xright rightbottomx bottomrightx",
        "bottom": "bottom ymax maxy y2 ybr ybottom rightbottomy bottomrighty",
        "width": "width w",
        "height": "height h",
        "center_x": "centerx xcenter centrex xcentre cx xc",
        "center_y": "centery ycenter centrey ycentre cy yc",
    }.items()
} | {
    "confidence": frozenset(
        ["confidence", "conf", "detscore", "detectionscore", "boxconfidence", "bbconf", "probability"]
    ),
    CLASS: frozenset(
        ["class", "classname", "cls", "classid", "category", "categoryname", "categoryid", "objecttype"]
    ),
}
"""Columns of boxes → their names in tables of detectors and trackers, as those of `SYNONYMS`."""

_CORNER = {"left": "bboxx", "top": "bboxy"}  # of bbox_x, bbox_y, bbox_w, bbox_h

PIXELS = frozenset(("px", "pix", "pixel", "pixels"))
"""Units in names of columns that are pixels."""

_POSSIBLE = {
    "track_id": "track obj individual individualid target trajectory trajid traj uid uuid userid user player "
    "playerid deviceid device tagid tag mac entity entityid who name",
    "frame": "timestep timestepid timestepindex step stepid tick framecount scan scanid imageid imageindex",
    "t": "ts datetimeutc timeutc utc unixtime epoch unix second elapsed elapsedtime date stamp clock "
    "milliseconds microseconds nanoseconds millis",
    "x": "px coordinatex groundx gx locx locationx centerx centrex easting east",
    "y": "py coordinatey groundy gy locy locationy centery centrey northing north",
}
"""Further synonyms: proposed by `graphtrack info --suggest`, never read automatically."""

LENGTHS = {"m": "m", "metre": "m", "meter": "m", "metres": "m", "meters": "m", "cm": "cm", "mm": "mm"}
LENGTHS |= {"ft": "ft", "feet": "ft"}
TIMES = {"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "msec": "ms", "milliseconds": "ms", "millis": "ms"}
TIMES |= {"us": "us", "µs": "us", "microseconds": "us", "ns": "ns", "nanoseconds": "ns"}
_UNITS: Mapping[str, Mapping[str, str]] = {"x": LENGTHS, "y": LENGTHS, "t": TIMES}

_KEYS = {native: short for short, native in SHORT.items() if native == "track_id"}
_MEANINGS = {
    _KEYS.get(key, key): (key.replace("_", ""), *names, *_POSSIBLE.get(key, "").split())
    for key, names in SYNONYMS.items()
} | {"lat": ("lat", "latitude"), "lon": ("lon", "lng", "long", "longitude")}
"""Key of ``--columns`` → all names that may mean it, the likeliest first."""

_WORDS = re.compile(r"[^\W_]+")

READ_AS = "read column"
"""Beginning of the note that names the columns that were read by their well-known names."""

UNREAD_IDENTITY = "may be an identity and was not read"
"""Part of the note on a column whose name is proposed, and not read automatically."""

UNSURE_UNIT = (
    "times were read as seconds, though they lie 5 and more apart: --time-unit ms if they are milliseconds"
)
"""Note on a column of times without a unit in its name."""

_LONGEST_NAME = 200  # characters of a name, above which it has no well-known meaning

_NO_METRES = frozenset(("u", "v", "lat", "lon"))  # with these columns no other column is taken for metres


def plain(name: str) -> tuple[str, str]:
    """Return a name in lower case without punctuation, brackets and unit, and the unit, "" for none."""
    if len(name) > _LONGEST_NAME:
        return "", ""
    outside, unit = _without_brackets(name)
    unit = unit.lower()
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", outside)  # agentId: agent Id
    words = [word.lower() for word in _WORDS.findall(spaced)]
    if len(words) > 1 and not unit and (words[-1] in LENGTHS or words[-1] in TIMES or words[-1] in PIXELS):
        unit = words.pop()
    return "".join(words), unit


def _without_brackets(name: str) -> tuple[str, str]:
    """Return a name with a space for each pair of brackets, and the content of the first pair."""
    outside, content, found = "", "", list[str]()
    opened = False
    for character in name:
        if opened and character in "])}":
            found.append(content.strip())
            outside, content, opened = f"{outside} ", "", False
        elif opened:
            content += character
        elif character in "[({":
            opened = True
        else:
            outside += character
    return outside + (f" {content}" if opened else ""), next(iter(found), "")


def meanings(names: Iterable[str]) -> dict[str, str]:
    """Return key of ``--columns`` → name, for the columns with well-known names."""
    known = {name: plain(name) for name in names}
    if any(word in _OF_BOXES[CLASS] for word, _ in known.values()):
        known = {name: word for name, word in known.items() if word[0] != "name"}  # that of the class
    found: dict[str, str] = {}
    for key, words in _MEANINGS.items():
        units = _UNITS.get(key, {})
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
    """Return ``x`` and ``y`` patterns with the identity's placeholder, for x_1, y_1 or anna_x, anna_y."""
    there = dict.fromkeys(names)
    counted: dict[tuple[str, str], int] = {}
    for name in there:
        if len(name) > _LONGEST_NAME:
            continue
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
    """Return the name with the prefix or suffix of its x replaced by the identity's placeholder."""
    patterns = []
    before, after = name[:start], name[end:]
    if after and not before:
        mark = "" if after[0].isalnum() else after[0]
        patterns.append(f"{name[start:end]}{mark}{WILD}")
    if before and not after:
        mark = "" if before[-1].isalnum() else before[-1]
        patterns.append(f"{WILD}{mark}{name[start:end]}")
    return patterns


_IN_IMAGE = ("px", "pixel", "pix", "image", "img", "pixels")


def pixel_columns(names: Iterable[str]) -> dict[str, str]:
    """Return u and v → name of the columns of positions that their names call pixels; none without both.

    px and py are pixels, unless a column pz shows them to be a position in space.
    """
    known = {name: plain(name) for name in names}
    words = {word for word, _ in known.values()}
    found: dict[str, str] = {}
    for key, axis in (("u", "x"), ("v", "y")):
        of_axis = {*SYNONYMS[axis], *_POSSIBLE[axis].split(), axis} - {f"p{axis}"}
        fitting = {
            key,
            *(f"{mark}{axis}" for mark in _IN_IMAGE[1:]),
            *(f"{axis}{mark}" for mark in _IN_IMAGE),
        }
        fitting |= set() if "pz" in words else {f"p{axis}"}
        for name, (word, unit) in known.items():
            if word in fitting or (word in of_axis and unit in PIXELS):
                found.setdefault(key, name)
    return found if len(found) == 2 else {}


_ANGLES = dict.fromkeys(("deg", "degree", "degrees", "°"), "deg")
_ANGLES |= dict.fromkeys(("rad", "radian", "radians"), "rad")
_OF_ANGLES: Mapping[str, tuple[str, ...]] = {
    "head": ("head", "gaze", "face", "look"),
    "body": ("body", "torso", "shoulder", "", "person"),
}
_TURNED = ("angle", "yaw", "orientation", "heading", "direction", "theta", "rotation", "dir", "ori")


def angle_columns(names: Iterable[str]) -> dict[str, str]:
    """Return head and body → name of the columns of their orientations."""
    found: dict[str, str] = {}
    for name in names:
        word = plain(name)[0]
        unit = next((one for one in _ANGLES if word.endswith(one) and one != word), "")
        word = word.removesuffix(unit)
        for part, prefixes in _OF_ANGLES.items():
            if word in {f"{prefix}{turned}" for prefix in prefixes for turned in _TURNED} | {*prefixes[:2]}:
                found.setdefault(part, name)
    return found


def angle_unit(name: str) -> str:
    """Return deg or rad, if the name of a column of angles says so, else an empty text."""
    word, unit = plain(name)
    return _ANGLES.get(unit) or next((short for one, short in _ANGLES.items() if word.endswith(one)), "")


def box_columns(names: Iterable[str]) -> dict[str, str]:
    """Return key → name of the columns of boxes, confidence and class; none unless a box is complete."""
    known = {name: plain(name) for name in names}
    found: dict[str, str] = {}
    for key, words in _OF_BOXES.items():
        fitting = [name for name, (word, unit) in known.items() if word in words and unit in {"", *PIXELS}]
        fitting += [name for name, (word, _) in known.items() if word == _CORNER.get(key)]
        if fitting:  # a name of a class before its number
            found[key] = min(fitting, key=lambda name: (known[name][0].endswith("id"), fitting.index(name)))
    form = box_form(found)
    if not form:
        return {}
    return {key: name for key, name in found.items() if key in (*form, "confidence", CLASS)}


_MOST = 10_000  # number of columns above which names are not searched


def with_synonyms(
    names: Sequence[str], options: ReadOptions, path: Path | None = None
) -> tuple[ReadOptions, tuple[str, ...]]:
    """Add well-known names of columns to a reader's options.

    A name counts only where the native column is absent and no option names the column. With
    ``options.columns`` given, nothing is added.

    Parameters
    ----------
    names : of the table's columns
    path : of the table, for errors

    Returns
    -------
    tuple
        The options, and notes for the user: the columns read by a well-known name, and columns that may be
        identities and are not read.
    """
    if options.columns is not None or len(names) > _MOST:
        return options, ()
    native, found = set(names), {}
    for key, words in SYNONYMS.items():
        if key in native or (key in ("x", "y") and native & _NO_METRES):
            continue
        known_units = _UNITS.get(key, {})
        fitting = [
            name
            for name in names
            if not is_column(name)
            and (meaning := plain(name))[0] in words
            and (not meaning[1] or meaning[1] in known_units)
        ]
        # A column that bears the native name in other letters comes first: Track_ID before id.
        exact = [name for name in fitting if plain(name)[0] == key.replace("_", "")]
        if len(exact or fitting) > 1:
            both = " and ".join(shortened(name) for name in (exact or fitting)[:3])
            expected = f"one column {key}; name it with --columns {_KEYS.get(key, key)}=NAME"
            raise InputError(f"columns {both}", expected, path=path, line=1)
        if fitting:
            found[key] = (exact or fitting)[0]
    if ("x" in found) != ("y" in found):
        found.pop("x", None), found.pop("y", None)
    if not {"x", *_NO_METRES} & (native | found.keys()):
        found |= {key: name for key, name in box_columns(names).items() if key not in native}
    notes = []
    if found:
        renamed = ", ".join(f"{shortened(name)} as {key}" for key, name in found.items())
        notes.append(f"{READ_AS}{'s' * (len(found) > 1)} {renamed}")
        time_unit, units = (plain(found[key])[1] if key in found else "no unit" for key in ("t", "x"))
        options = replace(
            options,
            columns=found,
            time_unit=options.time_unit or TIMES.get(str(time_unit)),
            units=options.units or LENGTHS.get(str(units)),
        )
    if "track_id" not in native | found.keys():
        like = meanings(name for name in names if not is_column(name)).get("id")
        if like is not None:
            notes.append(f"column {shortened(like)} {UNREAD_IDENTITY}: --columns id={like}")
    return options, tuple(notes)


def unit_notes(options: ReadOptions, t: FloatArray) -> tuple[str, ...]:
    """Return the notes on times (n,) in seconds that were read by a well-known name of their column."""
    by_name = isinstance(options.columns, Mapping) and "t" in options.columns
    steps = np.diff(np.unique(t))
    unsure = by_name and options.time_unit is None and len(steps) > 0 and float(np.median(steps)) >= 5.0
    return (UNSURE_UNIT,) if unsure else ()


def names_of(source: Source) -> list[str]:
    """Return the cells of the first line of a text, none if it is no row of CSV."""
    first = next((line for line in source.lines if line.strip()), "")
    try:
        return [name.strip() for name in next(csv.reader([first]), [])]
    except csv.Error:
        return []


def names_tracks(source: Source, options: ReadOptions) -> bool:
    """Return whether a text of no known format has a header that names positions, and times or frames."""
    names = names_of(source)
    found, _ = with_synonyms(names, options, source.path)
    there = {*names, *(found.columns if isinstance(found.columns, Mapping) else ())}
    placed = {"x", "y"} <= there or bool(box_form(there))
    return found is not options and placed and bool({"t", "frame"} & there)
