"""Exports of OptiTrack Motive, Vicon and Qualisys: the same people, whose places and yaws are known."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.transform import Rotation

import graphtrack as gt
from graphtrack.geometry.angles import difference

N, RATE = 8, 50
STEPS = np.arange(N)
PEOPLE = {"Ada": (0.4, np.array([1.0, 2.0]), 0.3), "Ben": (-2.0, np.array([-3.0, 0.5]), -0.7)}
"""Name → heading of the walk and of the body, first place, and the head's yaw relative to the body."""


def place(person: str) -> np.ndarray:
    heading, first, _ = PEOPLE[person]
    return first + 0.03 * STEPS[:, None] * np.array([np.cos(heading), np.sin(heading)])


def yaws(person: str) -> tuple[np.ndarray, np.ndarray]:
    heading, _, relative = PEOPLE[person]
    return np.full(N, heading), heading + relative + 0.01 * STEPS


def points(person: str, offsets: list[float], yaw: np.ndarray) -> np.ndarray:
    """Points (n, 3), z up, at offsets (forward, left, up) of a part of that yaw."""
    turned = Rotation.from_euler("z", yaw[:, None]).apply(np.array(offsets))
    return np.column_stack([place(person), np.zeros(N)]) + turned


def check(tracks: gt.TrackSet, *, body: bool = True, head: bool = True, names: tuple = tuple(PEOPLE)) -> None:
    assert [track.label for track in tracks] == list(names)
    for track, person in zip(tracks, PEOPLE, strict=True):
        np.testing.assert_allclose(track.position, place(person), atol=1e-5)
        np.testing.assert_allclose(np.diff(track.t), 1 / RATE, atol=1e-6)
        for known, angle, expected in zip((body, head), (track.body, track.head), yaws(person), strict=True):
            assert known == (angle is not None)
            if known:
                np.testing.assert_allclose(difference(angle, expected), 0.0, atol=1e-4)


def y_up(values: np.ndarray) -> np.ndarray:
    """Coordinates (n, 3) with y up of those with z up."""
    return values[:, [0, 2, 1]] * [1.0, 1.0, -1.0]


def motive(
    bodies: dict, *, kind: str, labelled: bool, unit: str = "Meters", order: str = "Quaternion"
) -> str:
    """Name → position (n, 3) with z up, and yaw (n,), as Motive writes them."""
    columns = [
        (name, "Rotation", axis) for name in bodies for axis in ("XYZW" if order == "Quaternion" else "XYZ")
    ]
    columns += [(name, "Position", axis) for name in bodies for axis in "XYZ"]
    columns.sort(key=lambda one: list(bodies).index(one[0]))
    columns += [("Unlabeled 12", "Position", axis) for axis in "XYZ"]
    titles = ["Type", "Name", "ID", "", "Time (Seconds)"] if labelled else ["", "", "", "", "Time (Seconds)"]
    kinds = [kind if name in bodies else "Marker" for name, _, _ in columns]
    rows = [
        kinds,
        [one[0] for one in columns],
        ["A"] * len(columns),
        *([p[k] for p in columns] for k in (1, 2)),
    ]
    lines = [
        f"Format Version,1.23,Take Name,w,Export Frame Rate,{RATE}.0,Rotation Type,{order},"
        f"Length Units,{unit},Coordinate Space,Global",
        "",
        *(",".join(["Frame" if k == 4 else "", titles[k], *row]) for k, row in enumerate(rows)),
    ]
    metre = {"Meters": 1.0, "Centimeters": 100.0, "Millimeters": 1000.0}[unit]
    for k in range(N):
        cells = [f"{k}", f"{k / RATE:.6f}"]
        for position, yaw in bodies.values():
            turn = Rotation.from_euler("y", yaw[k])
            rotation = (
                turn.as_quat()
                if order == "Quaternion"
                else turn.as_euler(order, degrees=True)[[order.index(axis) for axis in "XYZ"]]
            )
            cells += [f"{value:.7f}" for value in (*rotation, *(metre * y_up(position)[k]))]
        lines.append(",".join([*cells, "", "", ""]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("labelled", [False, True])
@pytest.mark.parametrize(
    ("unit", "order"), [("Meters", "Quaternion"), ("Millimeters", "XYZ"), ("Centimeters", "YZX")]
)
def test_rigid_bodies_of_motive(labelled: bool, unit: str, order: str, tmp_path: Path) -> None:
    bodies = {f"{name}_helmet": (points(name, [0, 0, 1.8], yaws(name)[1]), yaws(name)[1]) for name in PEOPLE}
    (tmp_path / "take.csv").write_text(
        motive(bodies, kind="Rigid Body", labelled=labelled, unit=unit, order=order)
    )
    check(gt.read(tmp_path / "take.csv"), body=False, names=("Ada_helmet", "Ben_helmet"))
    bodies |= {f"{name}_chest": (points(name, [0, 0, 1.3], yaws(name)[0]), yaws(name)[0]) for name in PEOPLE}
    (tmp_path / "take.csv").write_text(
        motive(bodies, kind="Rigid Body", labelled=labelled, unit=unit, order=order)
    )
    tracks = gt.read(tmp_path / "take.csv")
    check(tracks)
    gt.write(tracks, tmp_path / "out.csv")
    check(gt.read(tmp_path / "out.csv"))
    turned = gt.read(
        tmp_path / "take.csv", columns="head_deg=-x,x=z,y=x"
    )  # another ground, a quarter turn on
    for track, before in zip(turned, tracks, strict=True):
        np.testing.assert_allclose(track.position, before.position @ [[0.0, 1.0], [-1.0, 0.0]], atol=1e-9)
        np.testing.assert_allclose(difference(track.head, before.head - np.pi / 2), 0.0, atol=1e-9)


def test_skeletons_of_motive_have_z_ahead(tmp_path: Path) -> None:
    bodies = {}
    for name in PEOPLE:
        body, head = (angle + np.pi / 2 for angle in yaws(name))  # z of a bone lies a quarter turn behind x
        for part, yaw, height in (
            ("Hip", body, 1.0),
            ("Chest", body, 1.3),
            ("Head", head, 1.6),
            ("LHand", head, 1.0),
        ):
            bodies[f"{name}:{part}"] = (points(name, [0, 0, height], yaw), yaw)
    (tmp_path / "take.csv").write_text(motive(bodies, kind="Bone", labelled=True))
    check(gt.read(tmp_path / "take.csv"))
    local = (tmp_path / "take.csv").read_text().replace("Space,Global", "Space,Local")
    (tmp_path / "take.csv").write_text(local)
    assert "local" in refused(tmp_path / "take.csv").found


def vicon(section: str, columns: dict[str, dict[str, np.ndarray]], units: dict[str, str]) -> str:
    """Name → axis → (n,), as Vicon writes them, after a section of a device."""
    names = "".join(f"{name}{',' * len(axes)}" for name, axes in columns.items())
    axes = [axis for one in columns.values() for axis in one]
    lines = ["", section, f"{RATE}", f",,{names}", ",".join(["Frame", "Sub Frame", *axes])]
    lines.append(",".join(["", "", *(units[axis[0]] for axis in axes)]))
    for k in range(N):
        values = [f"{values[k]:.6f}" for one in columns.values() for values in one.values()]
        lines.append(",".join([f"{k + 1}", "0", *values]))
    return "\n".join(lines) + "\n\n"


MARKERS = {
    **{"LFHD": (1, [0.1, 0.07, 1.7]), "RFHD": (1, [0.1, -0.07, 1.7])},
    **{"LBHD": (1, [-0.1, 0.07, 1.7]), "RBHD": (1, [-0.1, -0.07, 1.7])},
    **{"LSHO": (0, [0.0, 0.2, 1.4]), "RSHO": (0, [0.0, -0.2, 1.4]), "C7": (0, [-0.1, 0.0, 1.4])},
    **{"LASI": (0, [0.1, 0.12, 1.0]), "RASI": (0, [0.1, -0.12, 1.0])},
    **{"LPSI": (0, [-0.1, 0.06, 1.0]), "RPSI": (0, [-0.1, -0.06, 1.0])},
}


def markers(separator: str) -> dict[str, np.ndarray]:
    return {
        f"{name}{separator}{label}": points(name, offsets, yaws(name)[part])
        for name in PEOPLE
        for label, (part, offsets) in MARKERS.items()
    }


def test_trajectories_of_vicon(tmp_path: Path) -> None:
    columns = {name: dict(zip("XYZ", 1000.0 * one.T, strict=True)) for name, one in markers(":").items()}
    path = tmp_path / "trial.csv"
    path.write_text(vicon("Trajectories", columns, dict.fromkeys("XYZ", "mm")))
    check(gt.read(path))
    angles = {"Ada:LHipAngles": {axis: np.full(N, 90.0) for axis in "XYZ"}}
    path.write_text(vicon("Model Outputs", angles, dict.fromkeys("XYZ", "deg")) + path.read_text())
    check(gt.read(path))


@pytest.mark.parametrize("kind", ["quaternion", "degrees", "radians"])
def test_objects_of_vicon(kind: str, tmp_path: Path) -> None:
    columns = {}
    for name in PEOPLE:
        for part, yaw in zip(("Head", "Torso"), reversed(yaws(name)), strict=True):
            turn = Rotation.from_euler("z", yaw[:, None])
            if kind == "quaternion":
                values = dict(zip(("RX", "RY", "RZ", "RW"), turn.as_quat().T, strict=True))
            else:
                scale = 180.0 / np.pi if kind == "degrees" else 1.0
                values = dict(zip(("RX", "RY", "RZ"), scale * turn.as_rotvec().T, strict=True))
            position = 1000.0 * points(name, [0, 0, 1.5], yaw).T
            columns[f"Global Angle {name}:{part}"] = values | dict(
                zip(("TX", "TY", "TZ"), position, strict=True)
            )
    units = {"R": {"degrees": "deg", "radians": "rad"}.get(kind, ""), "T": "mm"}
    (tmp_path / "trial.csv").write_text(vicon("Objects", columns, units))
    check(gt.read(tmp_path / "trial.csv"))


def qualisys(settings: dict[str, list], titles: list[str], values: np.ndarray) -> str:
    lines = [
        f"NO_OF_FRAMES\t{N}",
        "NO_OF_CAMERAS\t8",
        f"FREQUENCY\t{RATE}",
        "DESCRIPTION\t--",
        "DATA_INCLUDED\t3D",
    ]
    lines += ["\t".join([key, *names]) for key, names in settings.items()]
    lines += ["\t".join(titles)] if titles else []
    return "\n".join([*lines, *("\t".join(f"{one:.6f}" for one in row) for row in values)]) + "\n"


@pytest.mark.parametrize("titled", [False, True])
def test_markers_of_qualisys(titled: bool, tmp_path: Path) -> None:
    placed = markers("_")
    values = 1000.0 * np.column_stack(list(placed.values()))
    values[2, [*range(3 * len(MARKERS))]] = 0.0  # Ada is not seen
    titles = [f"{name} {axis}" for name in placed for axis in "XYZ"]
    numbers = np.column_stack([STEPS + 1, STEPS / RATE])
    path = tmp_path / "walk.tsv"
    settings = {"MARKER_NAMES": list(placed), "TRAJECTORY_TYPES": ["Measured"] * len(placed)}
    rows = np.column_stack([numbers, values]) if titled else values
    path.write_text(qualisys(settings, ["Frame", "Time", *titles] if titled else [], rows))
    ada, ben = gt.read(path)
    assert (ada.label, ben.label) == ("Ada", "Ben") and ada.frame.tolist() == [1, 2, *range(4, N + 1)]
    np.testing.assert_allclose(ben.position, place("Ben"), atol=1e-6)
    np.testing.assert_allclose(difference(ben.head, yaws("Ben")[1]), 0.0, atol=1e-4)
    np.testing.assert_allclose(ben.t, STEPS / RATE)


@pytest.mark.parametrize("matrix", [False, True])
def test_bodies_of_qualisys(matrix: bool, tmp_path: Path) -> None:
    parts, titles = [], []
    for name in PEOPLE:
        turn = Rotation.from_euler("z", yaws(name)[1][:, None])
        angles = turn.as_euler("XYZ", degrees=True) * (0.0 if matrix else 1.0)  # the matrix counts
        parts += [1000.0 * points(name, [0, 0, 1.7], yaws(name)[1]), angles, np.zeros(N)]
        titles += [f"{name} Head X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual"]
        if matrix:
            parts.append(turn.as_matrix().transpose(0, 2, 1).reshape(N, 9))
            titles += [f"Rot[{k}]" for k in range(9)]
    text = qualisys({"BODY_NAMES": [f"{name} Head" for name in PEOPLE]}, titles, np.column_stack(parts))
    (tmp_path / "walk.tsv").write_text(text)
    check(gt.read(tmp_path / "walk.tsv"), body=False, names=("Ada Head", "Ben Head"))


def test_markers_without_parts_of_the_body_are_people(tmp_path: Path) -> None:
    placed = {name: 1000.0 * points(name, [0, 0, 1.8], yaws(name)[0]).T for name in PEOPLE}
    columns = {name: dict(zip("XYZ", one, strict=True)) for name, one in placed.items()}
    path = tmp_path / "trial.csv"
    text = vicon("Trajectories", columns, dict.fromkeys("XYZ", "mm"))
    path.write_text(text)
    check(gt.read(path), body=False, head=False)
    for before, after, found in (
        ("\n3,0,", "\n2.5,0,", "2.5"),
        ("\n3,0,", "\n3,0,left", "'left"),
        ("\n3,0,", "\n3,0,1,2,3,4,5,6,7,", "columns"),
        ("mm,", "N,", "no positions"),
    ):
        path.write_text(text.replace(before, after) if before != "mm," else text.replace("mm", "N"))
        error = refused(path)
        assert found in error.found and (error.line == 9) == ("\n3" in before)
    path.write_text(text)
    for columns, found in (("x=x,y=-x", "x=x,y=-x"), ("id=x", "track_id=x"), ("x=w", "x=w")):
        assert found in refused(path, columns=columns).found
