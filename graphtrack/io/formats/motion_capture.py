"""Motion capture: exports of OptiTrack Motive, Vicon and Qualisys, and tables of one clip a track.

The exports have several header rows: names of markers, rigid bodies and segments above their axes. Each is
read into a `Take`; one conversion makes tracks of it.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.io.format import MOCAP_COLUMNS, Format
from graphtrack.io.formats.movement import SPACE_UNITS, keypoint_indices, middle, orientations
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import csv_rows, is_blank, read_numbers
from graphtrack.tracks.cells import EMPTY_WORDS, METRES, is_missing, numbered_names
from graphtrack.tracks.table import AsRead, Rows
from graphtrack.tracks.validation import FIELDS, LARGEST_SECONDS, parse_number

_AXES = ("X", "Y", "Z")
_MISSING = [word for word in EMPTY_WORDS if word.isalpha()]


@dataclass(frozen=True, eq=False)
class Take:
    """A recording of n frames.

    Attributes
    ----------
    frame, t : (n,) numbers and seconds
    line : (n,) lines of the file
    points : name of a marker → (n, 3) metres, NaN where missing
    bodies : name of a rigid body or segment → (n, 3) metres, and (n, 4) quaternions x, y, z, w
    up : the axis of the file that points up
    forward : the own axis of bodies that points forward
    """

    frame: NDArray[np.int64]
    t: FloatArray
    line: NDArray[np.int64]
    up: str
    forward: str = "x"
    points: Mapping[str, FloatArray] = field(default_factory=dict)
    bodies: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)


# -- numbers below header rows -------------------------------------------------------------------------------


def _rows(source: Source) -> tuple[str, list[list[str]]]:
    """Return the delimiter, and the cells of the first lines."""
    mark = "\t" if "\t" in source.lines[0] else ","
    found = [row for _, row in csv_rows(source.path, source.lines[:100], mark)]
    return mark, [[cell.strip() for cell in row] for row in found]


def _numbers(source: Source, mark: str, first: int, width: int) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the numbers (n, width) from a line on to a blank one, NaN where empty, and their lines."""
    import pandas as pd

    lines = list(takewhile(lambda line: line.strip(mark + " "), source.lines[first:]))
    for k, line in enumerate(lines):
        count = len(line.rstrip(mark).split(mark))
        if count > width or line.count(mark) + 1 < min(width, 3):
            raise source.fail(f"{count} columns", f"{width}, as in the header", line=first + k + 1)
    if not lines:
        raise source.fail("a header and no rows", "at least one frame", line=first)
    text = io.StringIO("\n".join(line.rstrip(mark) for line in lines))
    layout = {
        "sep": mark,
        "header": None,
        "names": range(width),
        "index_col": False,
        "quoting": csv.QUOTE_NONE,
    }
    try:
        table = pd.read_csv(text, na_values=_MISSING, dtype=float, **layout)  # type: ignore[call-overload]
    except ValueError as error:
        cells = ((k, j, cell) for k, line in enumerate(lines) for j, cell in enumerate(line.split(mark)))
        wrong = (
            (k, j, cell.strip())
            for k, j, cell in cells
            if not is_missing(cell) and parse_number(cell) is None
        )
        row, column, cell = next(wrong, (0, 0, str(error)))
        found = repr(cell[:40])
        raise source.fail(found, "a finite number or an empty cell", first + row + 1, column + 1) from None
    values: FloatArray = table.to_numpy()
    if np.isinf(values).any():
        row, column = np.argwhere(np.isinf(values))[0].tolist()
        raise source.fail("inf", "a finite number or an empty cell", first + row + 1, column + 1)
    return values, first + 1 + np.arange(len(lines))


def _frames(source: Source, values: FloatArray, line: NDArray[np.int64]) -> NDArray[np.int64]:
    bad = ~(np.abs(values) < 2**31) | (values != np.rint(values))
    if bad.any():
        row = int(np.argmax(bad))
        raise source.fail(f"{values[row]:g}", "the number of a frame", int(line[row]), "Frame")
    return values.astype(np.int64)


def _quaternions(rotation: FloatArray, make: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return quaternions (n, 4) of rotations (n, …); NaN where one is not complete, or is null."""
    found = np.full((len(rotation), 4), np.nan)
    flat = rotation.reshape(len(rotation), -1)
    known = np.isfinite(flat).all(axis=1) & (np.abs(flat).sum(axis=1) > 1e-9 if flat.shape[1] > 3 else True)
    if known.any():
        found[known] = make(rotation[known])
    return found


def _of_euler(order: str, degrees: bool = True) -> Callable[[FloatArray], FloatArray]:
    from scipy.spatial.transform import Rotation

    return lambda angles: Rotation.from_euler(order, angles, degrees=degrees).as_quat()


def _unit_quaternions(given: FloatArray) -> FloatArray:
    return given / np.linalg.norm(given, axis=1, keepdims=True)


# -- the three exports ---------------------------------------------------------------------------------------


def read_motive(source: Source) -> Take:
    """Read a CSV export of OptiTrack Motive: rigid bodies and skeletons, or else labelled markers.

    Y points up. The header has the unit of length, and the order of Euler angles if these were exported.
    """
    mark, rows = _rows(source)
    head = next((k for k, row in enumerate(rows) if row[:1] == ["Frame"]), None)
    settings = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    titles = [row for row in rows[1:head] if not is_blank(row)]
    if head is None or len(titles) < 3:
        raise source.fail("no row Frame, Time below rows of types and names", "a CSV export of Motive")
    named = {row[1].lower(): row for row in titles if len(row) > 1 and row[1]}
    kinds, names, parts = named.get("type", titles[0]), named.get("name", titles[1]), titles[-1]
    values, line = _numbers(source, mark, head + 1, len(rows[head]))
    unit = SPACE_UNITS.get(settings.get("Length Units", "Meters").lower())
    if unit is None:
        raise source.fail(f"lengths in {settings['Length Units']}", "metres, centimetres or millimetres", 1)
    order = settings.get("Rotation Type", "Quaternion")
    if order != "Quaternion" and sorted(order) != [*_AXES]:
        raise source.fail(f"the rotation type {order[:40]!r}", "Quaternion, or an order such as XYZ", 1)
    if settings.get("Coordinate Space", "Global") == "Local" and "Bone" in kinds:
        raise source.fail("bones in local coordinates", "an export with the coordinate space Global", 1)
    places: dict[tuple[str, str], dict[str, dict[str, int]]] = {}
    for k, (kind, name, part, axis) in enumerate(zip(kinds, names, parts, rows[head], strict=False)):
        if part in ("Position", "Rotation"):
            places.setdefault((kind, name), {}).setdefault(part, {})[axis] = k
    points, bodies = {}, {}
    for (kind, name), found in places.items():
        if any(axis not in found.get("Position", {}) for axis in _AXES):
            continue
        position = METRES[unit] * values[:, [found["Position"][axis] for axis in _AXES]]
        if kind in ("Rigid Body", "Bone") and "Rotation" in found:
            axes = [axis for axis in (*_AXES, "W") if axis in found["Rotation"]]
            rotation = values[:, [found["Rotation"][axis] for axis in axes]]
            if len(axes) == 4:
                bodies[name] = position, _quaternions(rotation, _unit_quaternions)
            elif len(axes) != 3 or order == "Quaternion":
                found_axes = f"a rotation {', '.join(axes)} of {name[:40]!r}"
                raise source.fail(found_axes, "X, Y, Z and W, or three angles", head + 1)
            else:
                by_order = rotation[:, ["XYZ".index(axis) for axis in order]]
                bodies[name] = position, _quaternions(by_order, _of_euler(order))
        elif kind in ("Rigid Body", "Bone", "Marker"):
            points[name] = position
    frame = _frames(source, values[:, 0], line)
    forward = "z" if "Bone" in kinds else "x"
    return Take(frame, values[:, 1], line, "y", forward, {} if bodies else points, bodies)


_SECTIONS = ("Objects", "Trajectories", "Segments")
"""Sections of Vicon's exports that have positions, the best one first."""


def read_vicon(source: Source) -> Take:
    """Read a CSV export of Vicon Nexus, Tracker or Shogun: objects, trajectories of markers, or segments.

    Z points up. Angles of three numbers are rotation vectors; frames below the first are sub frames.
    """
    begins = {line.strip(" ,\t"): k for k, line in reversed([*enumerate(source.lines)]) if len(line) < 40}
    section = next((name for name in _SECTIONS if name in begins), None)
    if section is None:
        raise source.fail("none of " + ", ".join(_SECTIONS), "one of these sections with positions")
    first = begins[section]
    mark = "\t" if "\t" in source.lines[min(first + 2, len(source.lines) - 1)] else ","
    head = [row for _, row in csv_rows(source.path, source.lines[first : first + 5], mark)]
    rate = parse_number(head[1][0]) if len(head) == 5 and head[1] else None
    if rate is None or rate <= 0.0 or head[3][:1] != ["Frame"]:
        expected = "below it the rate, a row of names, Frame, Sub Frame and axes, and units"
        raise source.fail(f"the section {section}", expected, line=first + 1)
    names, axes, units = ([cell.strip() for cell in row] for row in head[2:])
    values, line = _numbers(source, mark, first + 5, len(axes))
    is_frame = np.nan_to_num(values[:, 1]) == 0.0
    values, line = values[is_frame], line[is_frame]
    points, bodies = {}, {}
    begin = [k for k, name in enumerate(names) if name and k > 1]
    for k, end in zip(begin, [*begin[1:], len(axes)], strict=True):
        place = {axis: k + j for j, axis in enumerate(axes[k:end]) if axis}
        name = names[k].removeprefix("Global Angle ").strip()
        prefix = "T" if "TX" in place else ""
        if any(prefix + axis not in place for axis in _AXES):
            continue
        unit = SPACE_UNITS.get(units[place[f"{prefix}X"]] if place[f"{prefix}X"] < len(units) else "")
        if unit is None:
            continue  # angles, forces
        position = METRES[unit] * values[:, [place[prefix + axis] for axis in _AXES]]
        turned = [place[f"R{axis}"] for axis in (*_AXES, "W") if f"R{axis}" in place]
        if len(turned) == 4:
            bodies[name] = position, _quaternions(values[:, turned], _unit_quaternions)
        elif turned:
            scale = np.pi / 180.0 if units[turned[0]].startswith("deg") else 1.0
            bodies[name] = position, _quaternions(scale * values[:, turned], _of_vectors)
        else:
            points[name] = position
    frame = _frames(source, values[:, 0], line)
    return Take(frame, frame / rate, line, "z", "x", {} if bodies else points, bodies)


def _of_vectors(given: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    found: FloatArray = Rotation.from_rotvec(given).as_quat()
    return found


_KEYWORD = re.compile(r"[A-Z][A-Z_0-9]{3,}$")


def read_qualisys(source: Source) -> Take:
    """Read a TSV export of Qualisys Track Manager: 3D markers, 6DOF bodies or segments of skeletons.

    Z points up, lengths are millimetres, and three zeros are a missing position. Orientations are rotation
    matrices, quaternions, or roll, pitch and yaw about x, y and z.
    """
    mark, rows = _rows(source)
    head = next((k for k, row in enumerate(rows) if not _KEYWORD.match(row[0] if row else "")), len(rows))
    settings = {row[0]: row[1:] for row in rows[:head]}
    rate = parse_number((settings.get("FREQUENCY") or [""])[0])
    if rate is None or rate <= 0.0:
        raise source.fail("no FREQUENCY", "a line FREQUENCY with frames a second")
    names = [name for key in ("MARKER_NAMES", "BODY_NAMES") for name in settings.get(key, []) if name]
    titled = head < len(rows) and any(parse_number(cell) is None for cell in rows[head] if cell)
    titles = rows[head] if titled else [f"{name} {axis}" for name in names for axis in _AXES]
    first = head + titled
    if first >= len(rows):
        raise source.fail("a header and no rows", "at least one frame")
    width = len(rows[first]) - (rows[first][-1:] == [""])
    if not titled and width == len(titles) + 2:
        titles = ["Frame", "Time", *titles]
    while titles and not titles[-1]:
        titles.pop()
    values, line = _numbers(source, mark, first, max(len(titles), width))
    places: dict[str, dict[str, int]] = {}
    name, count = "", 0
    for k, title in enumerate(titles):
        words = title.rsplit(" ", 1)
        axis = words[-1].upper()
        if axis == "X":
            name, count = words[0] if len(words) == 2 else next(iter(names[count:]), ""), count + 1
        if name:
            places.setdefault(name, {})[axis] = k
    numbered = titles[:1] == ["Frame"]
    frame = _frames(source, values[:, 0], line) if numbered else np.arange(1, len(values) + 1)
    t = values[:, 1] if titles[1:2] == ["Time"] else (frame - 1) / rate
    points, bodies = {}, {}
    for name, place in places.items():
        if any(axis not in place for axis in _AXES):
            continue
        position = 1e-3 * values[:, [place[axis] for axis in _AXES]]
        position[(position == 0.0).all(axis=1)] = np.nan
        for axes, make in _ORIENTATIONS.items():
            if set(axes) <= place.keys():
                rotation = values[:, [place[axis] for axis in axes]]
                rotation[np.isnan(position[:, 0])] = np.nan
                bodies[name] = position, _quaternions(rotation, make)
                break
        else:
            points[name] = position
    return Take(frame, t, line, "z", "x", {} if bodies else points, bodies)


def _of_matrices(given: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    found: FloatArray = Rotation.from_matrix(given.reshape(-1, 3, 3).transpose(0, 2, 1)).as_quat()
    return found


_ORIENTATIONS: Mapping[tuple[str, ...], Callable[[FloatArray], FloatArray]] = {
    tuple(f"ROT[{k}]" for k in range(9)): _of_matrices,  # column by column
    ("QX", "QY", "QZ", "QW"): _unit_quaternions,
    ("ROLL", "PITCH", "YAW"): lambda angles: _of_euler("XYZ")(angles),
}


# -- people --------------------------------------------------------------------------------------------------

_PARTS = {
    "head": "head helmet hat cap glasses hmd headset face skull",
    "chest": "chest torso trunk thorax body back vest spine upperbody",
    "pelvis": "pelvis hip hips root waist belt lowerback",
}
_PART_OF = {word: part for part, words in _PARTS.items() for word in words.split()}
_TOKENS = re.compile(r"[A-Za-z]+?(?=[A-Z][a-z]|[^A-Za-z]|$)|\d+")

_UNLABELLED = re.compile(r"(unlabell?ed|new|\*)\W*\d", re.IGNORECASE)
_MARKERS = (
    ("ear", re.compile(r"HD$|HEAD")),
    ("shoulder", re.compile(r"SHO|ACR")),
    ("hip", re.compile(r"ASI|PSI|IAS|IPS|WAIST|PELV|HIP")),
    ("torso", re.compile(r"^C7$|^T10$|CLAV|STRN|CHEST|SPINE|BACK|ANK|HEE|TOE|KNE|THI|TIB|ELB|WR")),
)
"""Part of the body, as a pair of keypoints → labels of its markers, such as LFHD, RASI, LShoulderTop."""


def _split(name: str) -> tuple[str, str]:
    """Return the person and the part of ``anna:Head`` or ``anna_head``; the part is "" without one."""
    if ":" in name:
        person, _, part = name.rpartition(":")
        return person, "" if part == person else part
    for mark in ("_", " ", "-", "."):
        for person, part in (name.rpartition(mark)[::2], name.partition(mark)[2::-2]):
            if person and part.lower() in _PART_OF:
                return person, part
    return name, ""


def _part(name: str) -> str:
    """Return the part of a person, head, chest or pelvis, that a body of that name is; "" for others."""
    words = [word.lower() for word in _TOKENS.findall(name)]
    found = [_PART_OF[word] for word in ("".join(words), *words) if word in _PART_OF]
    return found[0] if found else ""


@dataclass(frozen=True, eq=False)
class _Person:
    position: FloatArray
    body: FloatArray | None = None
    head: FloatArray | None = None


def _people_of_bodies(take: Take, ground: FloatArray, axes: Mapping[str, str]) -> dict[str, _Person]:
    """Return people by their rigid bodies or segments; a single body of a person keeps its whole name."""
    of_person: dict[str, dict[str, str]] = {}
    for name in take.bodies:
        person, part = _split(name)
        of_person.setdefault(person, {})[part] = name
    found = {}
    for person, names in of_person.items():
        if len(names) == 1:
            (part, name), *_ = names.items()
            kind = _part(part or name) or "chest"
            by_kind = {kind: name}
            person = name if ":" not in name else person
        else:
            by_kind = {}
            for part, name in names.items():
                if (kind := _part(part)) and kind not in by_kind:
                    by_kind[kind] = name
            if not by_kind:
                by_kind = {"chest": next(iter(names.values()))}
        standing = next(by_kind[kind] for kind in ("pelvis", "chest", "head") if kind in by_kind)
        body = next((by_kind[kind] for kind in ("chest", "pelvis") if kind in by_kind), None)
        head = by_kind.get("head")
        found[person] = _Person(
            take.bodies[standing][0] @ ground,
            None if body is None else _yaw(take.bodies[body][1], axes["body_deg"], ground),
            None if head is None else _yaw(take.bodies[head][1], axes["head_deg"], ground),
        )
    return found


def _yaw(quaternion: FloatArray, forward: str, ground: FloatArray) -> FloatArray:
    """Return the directions (n,) of an own axis on the ground (3, 2); NaN within 6° of upright."""
    from scipy.spatial.transform import Rotation

    ahead = np.full((len(quaternion), 2), np.nan)
    known = np.isfinite(quaternion).all(axis=1)
    if known.any():
        ahead[known] = Rotation.from_quat(quaternion[known]).apply(_axis(forward)) @ ground
    with np.errstate(invalid="ignore"):
        return np.where(np.linalg.norm(ahead, axis=1) > 0.1, np.arctan2(ahead[:, 1], ahead[:, 0]), np.nan)


def _people_of_markers(take: Take, ground: FloatArray) -> dict[str, _Person]:
    """Return people by their labelled markers: each marker is one, unless labels name parts of the body."""
    of_person: dict[str, dict[str, FloatArray]] = {}
    labelled = {name: one for name, one in take.points.items() if not _UNLABELLED.match(name)}
    prefixes = Counter(name.partition("_")[0] for name in labelled if ":" not in name)
    by_prefix = all(n > 2 and not _part(prefix) and len(prefix) > 0 for prefix, n in prefixes.items())
    for name, points in labelled.items():
        mark = name.rfind(":") if ":" in name else name.find("_") if by_prefix else -1
        of_person.setdefault(name[: max(mark, 0)], {})[name[mark + 1 :]] = points @ ground
    found: dict[str, _Person] = {}
    for person, markers in of_person.items():
        keypoints = _keypoints(markers)
        if len(keypoints) < 2:
            found |= {
                f"{person}{':' if person else ''}{label}": _Person(one) for label, one in markers.items()
            }
            continue
        names = list(keypoints)
        stacked = np.stack(list(keypoints.values()), axis=1)
        facing = orientations(stacked, keypoint_indices(names), mirrored=False, nose_is_on_ground=True)
        found[person or "1"] = _Person(middle(stacked, names, in_image=False)[0], **facing)
    return found


def _keypoints(points: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return keypoints of a person as `middle` and `orientations` use them, from labelled markers."""
    parts: dict[str, list[FloatArray]] = {}
    for label, one in points.items():
        upper = label.upper().replace("_", "")
        kind = next((kind for kind, pattern in _MARKERS if pattern.search(upper)), None)
        if kind is None:
            continue
        side = _side(upper, "L", "LEFT") - _side(upper, "R", "RIGHT")
        is_front = "FRONT" in upper or upper in ("LFHD", "RFHD")
        if kind == "ear" and is_front:
            parts.setdefault("nose", []).append(one)
        name = f"{'left' if side > 0 else 'right'}_{kind}" if side and kind != "torso" else "torso"
        parts.setdefault(name, []).append(one)
    if "left_shoulder" not in parts or "right_shoulder" not in parts:
        parts |= {
            f"{side}_shoulder": parts[f"{side}_hip"] for side in ("left", "right") if f"{side}_hip" in parts
        }
    with np.errstate(invalid="ignore"):
        return {name: np.mean(ones, axis=0) for name, ones in parts.items()}


def _side(label: str, letter: str, word: str) -> bool:
    return label.startswith(letter) or label.endswith(letter) or word in label


def _axis(name: str) -> FloatArray:
    return (-1.0 if name.startswith("-") else 1.0) * np.eye(3)["xyz".index(name[-1])]


def _of_take(read: Callable[[Source], Take], format: str, source: Source, options: ReadOptions) -> Rows:
    """Return the rows of people of an export; see `Take` and the module's readers.

    ``columns`` of the options may name the axes of the ground, and the own axes of bodies that point forward.
    """
    take = read(source)
    axes = {"x": "x", "y": "-z" if take.up == "y" else "y"}
    axes |= dict.fromkeys(("body_deg", "head_deg"), take.forward)
    layout = options.layout()
    given = {} if layout is None else dict(layout.columns)
    for key, name in given.items():
        if key not in axes or not re.fullmatch(r"-?[xyz]", name.lower()):
            expected = "axes of the ground, such as x=z,y=x, and those that point forward, such as head_deg=z"
            raise source.fail(f"--columns {key}={name} for motion capture", expected)
        axes[key] = name.lower()
    ground = np.column_stack([_axis(axes["x"]), _axis(axes["y"])])
    if axes["x"][-1] == axes["y"][-1]:
        raise source.fail(f"--columns x={axes['x']},y={axes['y']}", "two different axes of the ground")
    people = _people_of_bodies(take, ground, axes) if take.bodies else _people_of_markers(take, ground)
    kept = [(name, one, np.isfinite(one.position).all(axis=1)) for name, one in people.items()]
    kept = [entry for entry in kept if entry[2].any()]
    if not kept:
        raise source.fail("no positions of markers, rigid bodies or segments", "an export with some")
    for name, one, known in kept:
        if (place := FIELDS["position"].first_outside(one.position[known])) is not None:
            line = int(take.line[known][place[0]])
            raise source.fail(
                f"{one.position[known][place]:g} m of {name}", FIELDS["position"].expected, line
            )
    ids, names = numbered_names([name for name, _, _ in kept])
    rows = np.concatenate([np.flatnonzero(known) for _, _, known in kept])
    channels = {"t": take.t[rows], "position": np.concatenate([one.position[k] for _, one, k in kept])}
    for channel in ("body", "head"):
        if any(getattr(one, channel) is not None for _, one, _ in kept):
            nothing = np.full(len(take.t), np.nan)
            angles = [(getattr(one, channel), known) for _, one, known in kept]
            channels[channel] = np.concatenate([(nothing if a is None else a)[known] for a, known in angles])
    return Rows(
        source.path,
        format,
        np.concatenate([np.full(known.sum(), k) for k, (_, _, known) in zip(ids, kept, strict=True)]),
        take.frame[rows],
        channels,
        lambda row: int(take.line[rows[row]]),
        names,
        notes=tuple(_notes(take, axes)),
        as_read=AsRead({"track_id": "track_id"}, names=names) if names else None,
    )


_HIGHEST = 1.5  # metres by which the height of a marker may vary


def _notes(take: Take, axes: Mapping[str, str]) -> list[str]:
    up = np.cross(_axis(axes["x"]), _axis(axes["y"]))
    notes = [f"the ground is {axes['x']} and {axes['y']} of the file (--columns x=…,y=… names others)"]
    if take.bodies:
        notes.append(
            f"heads point along their own axis {axes['head_deg']}, other bodies along {axes['body_deg']} "
            "(--columns head_deg=…,body_deg=… names others): a wrong axis is a constant error of the angles"
        )
    placed = [position for position, _ in take.bodies.values()] or list(take.points.values())
    heights = [one[np.isfinite(one)] for one in (position @ up for position in placed)]
    varies = max((float(np.ptp(one)) for one in heights if len(one)), default=0.0)
    if varies > _HIGHEST:
        notes.append(f"heights vary by {varies:.3g} m, as if another axis pointed up (--columns x=…,y=…)")
    return notes


MOTIVE, VICON, QUALISYS = (
    Format(name, description, (), read=partial(_of_take, read, name), takes=("columns",))
    for name, description, read in (
        ("motive", "CSV of OptiTrack Motive: rigid bodies, skeletons, markers", read_motive),
        ("vicon", "CSV of Vicon: objects, trajectories, segments", read_vicon),
        ("qualisys", "TSV of Qualisys: markers, 6DOF bodies", read_qualisys),
    )
)


# -- tables of clips -----------------------------------------------------------------------------------------

_LARGEST_YAW = 1e4


def read_clips(source: Source, options: ReadOptions) -> Rows:
    """Read a table ``clip,frame,t_s,x_m,y_m,…,shoulder_yaw_rad,head_yaw_rad,…``.

    Body is the yaw of the shoulders, head that of the head, both in the world; tracks are numbered from 0 in
    the order of the clips and have the clip as their label. Times are those of the file.
    """
    header = source.lines[0].split(",")
    for name in MOCAP_COLUMNS:
        if name not in header:
            raise source.fail("no such column", f"a column {name}", line=1, column=name)
    column = header.index("clip")
    table = read_numbers(
        source, delimiter=",", widths=(len(header),), names=tuple(header), text=(column,), skip=1
    )
    clips = [clip.strip() for clip in table.text[column]]
    if "" in clips:
        line = table.line_of(clips.index(""))
        raise source.fail("an empty cell", "a clip", line=line, column="clip")
    number_of = {clip: k for k, clip in enumerate(dict.fromkeys(clips))}

    def yaw(name: str) -> np.ndarray:
        return wrap(table.bounded(header.index(name), -_LARGEST_YAW, _LARGEST_YAW))

    notes = ["body is the yaw of the shoulders"]
    if options.fps is not None:
        notes.append("the frame rate was not used: the file has times")
    return Rows(
        source.path,
        "mocap",
        np.array([number_of[clip] for clip in clips], dtype=np.int64),
        table.integers(header.index("frame")),
        {
            "t": table.bounded(header.index("t_s"), -LARGEST_SECONDS, LARGEST_SECONDS),
            "position": np.column_stack([table.metres(header.index(name)) for name in ("x_m", "y_m")]),
            "body": yaw("shoulder_yaw_rad"),
            "head": yaw("head_yaw_rad"),
        },
        table.line_of,
        labels={number: clip for clip, number in number_of.items()},
        notes=tuple(notes),
    )


MOCAP = Format(
    name="mocap",
    description="motion-capture table, a clip a track",
    suffixes=(),
    read=read_clips,
)
