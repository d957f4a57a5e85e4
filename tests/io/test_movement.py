"""Datasets of movement, DeepLabCut and SLEAP: poses as observations, and tracks there and back."""

import contextlib
import gzip
import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from format_samples import made_tracks
from hypothesis import given, settings
from hypothesis import strategies as st
from same_tracks import assert_same

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from graphtrack.io.formats.movement import DEEPLABCUT, SLEAP
from graphtrack.tracks.track import TrackSet

xarray = pytest.importorskip("xarray", reason="the extra movement has it")
h5py = pytest.importorskip("h5py", reason="the extra movement has it")
pytest.importorskip("h5netcdf", reason="the extra movement has it")

POSES = Path(__file__).parent / "made_elsewhere" / "movement.nc.gz"
"""By movement 0.15: two people seen from above who walk on circles of 50 pixels, counter-clockwise
and 0.1 rad a frame, and look ahead. In frame 5 anna's right shoulder is missing."""


def estimates() -> TrackSet:
    """Two people in different frames, with all output of an engine."""
    rng, made = np.random.default_rng(0), made_tracks()
    people = gt.smooth(made.with_tracks([made.by_id(3)[:4], made.by_id(8)[2:]]))
    return people.map(
        lambda one: replace(one, pixel=rng.uniform(0.0, 99.0, (4, 2)), inputs={"near": rng.uniform(size=4)})
    )


@pytest.mark.parametrize("make", [made_tracks, estimates])
def test_tracks_come_back_to_the_last_bit(make: Any, tmp_path: Path) -> None:
    tracks = make()
    assert_same(tracks, gt.from_movement(gt.to_movement(tracks)))
    gt.write(tracks, tmp_path / "tracks.nc")
    assert_same(tracks, gt.read(tmp_path / "tracks.nc"))


def test_what_is_written_is_a_dataset_of_poses_with_deviations() -> None:
    dataset = gt.to_movement(estimates())
    assert set(dataset["position"].dims) == {"time", "space", "keypoints", "individuals"}
    assert dataset.attrs["ds_type"] == "poses" and dataset.attrs["fps"] == 10.0
    one = dataset.sel(individuals="8").dropna("time", subset=["body"])
    track = estimates().by_id(8)
    np.testing.assert_array_equal(one["time"], track.t)
    np.testing.assert_array_equal(one["position"].sel(keypoints="centroid"), track.position)
    for name in ("x", "vy", "body", "head"):
        np.testing.assert_allclose(one["std"].sel(state=name), track.std(name))


def test_movement_takes_what_is_written() -> None:
    datasets = pytest.importorskip("movement.validators.datasets", reason="movement is not installed")
    kinematics = pytest.importorskip("movement.kinematics")
    dataset = gt.to_movement(estimates())
    datasets.ValidPosesInputs.validate(dataset)
    velocity = kinematics.compute_velocity(dataset["position"])
    assert velocity.shape == dataset["position"].shape


def circle(frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions of anna (metres, 0.01 a pixel, y up) and her heading."""
    angle = 0.1 * frame
    return np.array([3.0, -2.4]) + 0.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1), angle + np.pi / 2.0


def test_poses_that_movement_wrote_are_positions_bodies_and_heads() -> None:
    tracks = gt.read(POSES, metres_per_pixel=0.01)
    assert [track.label for track in tracks] == ["anna", "bob"]
    anna = tracks.by_id(1)
    np.testing.assert_allclose(anna.t, 0.1 * np.arange(12))
    position, heading = circle(anna.frame)
    assert anna.body is not None and anna.head is not None
    # The middle of the hips, which lie two pixels behind.
    np.testing.assert_allclose(np.linalg.norm(anna.position - position, axis=1), 0.02, atol=1e-4)
    assert list(np.flatnonzero(np.isnan(anna.body))) == [5]
    np.testing.assert_allclose(difference(anna.head, heading), 0.0, atol=1e-4)
    np.testing.assert_allclose(np.delete(difference(anna.body, heading), 5), 0.0, atol=1e-4)
    np.testing.assert_allclose(anna.score, 0.75)


def poses_in_metres() -> Any:
    """The poses in metres with y up, without a unit."""
    poses = xarray.load_dataset(BytesIO(gzip.decompress(POSES.read_bytes())), engine="h5netcdf")
    poses["position"] = poses["position"] * xarray.DataArray([0.01, -0.01], dims="space")
    return poses


def test_units_cameras_and_the_order_of_dimensions_make_no_difference() -> None:
    expected = gt.read(POSES, metres_per_pixel=0.01)
    poses = poses_in_metres()
    shuffled = poses.transpose("individuals", "keypoints", "space", "time").sel(space=["y", "x"])
    in_centimetres = poses.assign(position=100.0 * poses["position"])
    up = xarray.DataArray([1.0, -1.0], dims="space")
    in_pixels = poses.assign(position=100.0 * poses["position"] * up)
    told = in_centimetres.assign(position=in_centimetres["position"].assign_attrs(space_unit="cm"))
    for found in (
        gt.from_movement(poses, units="m"),
        gt.from_movement(shuffled, units="m"),
        gt.from_movement(in_centimetres, units="cm"),
        gt.from_movement(told),
        gt.from_movement(poses.rename(keypoints="keypoint", individuals="individual"), units="m"),
        gt.from_movement(poses.drop_vars("space"), units="m"),
        gt.from_movement(in_pixels, homography=np.diag([0.01, -0.01, 1.0])),
    ):
        for track, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(track.position, other.position, atol=1e-9)
            assert track.body is not None and other.body is not None
            np.testing.assert_allclose(track.body, other.body, atol=1e-6)
    one = gt.from_movement(poses.sel(individuals="bob"), units="m")
    assert [track.label for track in one] == ["bob"]


def test_boxes_stand_on_their_lower_edge() -> None:
    dims = ("time", "space", "individuals")
    boxes = xarray.Dataset(
        {
            "position": (dims, np.array([[[50.0], [80.0]], [[60.0], [80.0]]])),
            "shape": (dims, np.full((2, 2, 1), 40.0)),
            "confidence": (("time", "individuals"), np.full((2, 1), np.nan)),
        },
        {"time": [3, 4], "space": ["x", "y"], "individuals": ["id_7"]},
        {"ds_type": "bboxes", "time_unit": "frames"},
    )
    (track,) = gt.from_movement(boxes, fps=2.0, metres_per_pixel=0.1)
    np.testing.assert_allclose(track.position, [[5.0, -10.0], [6.0, -10.0]])
    assert list(track.frame) == [3, 4] and list(track.t) == [1.5, 2.0] and track.score is None


def in_space(poses: Any) -> Any:
    high = xarray.concat(
        [poses["position"], poses["position"].sel(space=["x"]).assign_coords(space=["z"])], "space"
    )
    return poses.drop_dims("space").assign(position=high)


@pytest.mark.parametrize(
    ("change", "options", "told"),
    [
        (lambda poses: poses.drop_vars("position"), {"units": "m"}, "no variable position.*load_dataset"),
        (in_space, {"units": "m"}, "space x, y, z.*--columns"),
        (lambda poses: in_space(poses).drop_vars("space"), {"units": "m"}, "space 0, 1, 2.*--columns"),
        (lambda poses: poses, {}, "unknown unit.*--units m.*--metres-per-pixel"),
        (lambda poses: poses.assign_coords(space=["rho", "phi"]), {"units": "m"}, "space rho, phi"),
        (lambda poses: poses.expand_dims(view=["left"]), {"units": "m"}, r"dimension view.*dataset\.sel"),
        (lambda poses: poses.drop_attrs().assign_coords(time=np.arange(12)), {"units": "m"}, "--fps"),
        (lambda poses: poses.isel(time=[0, 2, 1]), {"units": "m"}, None),
        (lambda poses: poses.assign_coords(time=np.zeros(12)), {"units": "m"}, "again in frame 0"),
        (lambda poses: poses.assign_coords(individuals=["a", "a"]), {"units": "m"}, "'a' twice"),
        (lambda poses: poses * np.nan, {"units": "m"}, "no positions"),
        (lambda poses: poses, {"units": "m", "crs": "EPSG:25832"}, "crs"),
        (lambda poses: poses.map(lambda one: one.astype(str) + "x"), {"units": "m"}, "no array"),
        (lambda poses: poses.assign(position=1e12 * poses["position"]), {"units": "m"}, "within"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_told_with_what_would_help(
    change: Any, options: Any, told: str | None
) -> None:
    poses = change(poses_in_metres())
    if told is None:
        with pytest.warns(gt.InputWarning, match="sorted"):
            gt.from_movement(poses, **options)
        return
    with pytest.raises(InputError, match=told):
        gt.from_movement(poses, **options)


def test_the_two_axes_of_the_ground_can_be_named() -> None:
    expected = gt.from_movement(poses_in_metres(), units="m")
    poses = in_space(poses_in_metres()).assign_coords(space=["z", "x", "y"])
    found = gt.from_movement(poses, units="m", columns="x=z,y=x")
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.position, other.position)


def test_damaged_files_and_numbers_beside_names_are_refused(tmp_path: Path) -> None:
    poses_in_metres().to_netcdf(tmp_path / "named.nc", engine="h5netcdf")
    whole = (tmp_path / "named.nc").read_bytes()
    (tmp_path / "cut.nc").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.nc: found a netCDF file that cannot be read"):
        gt.read(tmp_path / "cut.nc", units="m")
    poses_in_metres().assign_coords(individuals=["3", "9"]).to_netcdf(tmp_path / "n.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="identities that are numbers"):
        gt.read([tmp_path / "named.nc", tmp_path / "n.nc"], units="m")


FRAMES = 12
POINTS = ("nose", "left_ear", "right_ear", "left_hip", "right_hip")


def places(person: int) -> np.ndarray:
    """(frames, keypoints, 2) pixels of a person who walks to the right and looks there."""
    at = np.array([[8.0, 0.0], [0.0, -6.0], [0.0, 6.0], [-2.0, -9.0], [-2.0, 9.0]])
    walk = np.column_stack([20.0 + 5.0 * np.arange(FRAMES), np.full(FRAMES, 50.0 + 100.0 * person)])
    return walk[:, None, :] + at


def deeplabcut(path: Path) -> Path:
    """Two people in the layout of DeepLabCut's multi-animal CSV."""
    header: list[list[str]] = [["scorer"], ["individuals"], ["bodyparts"], ["coords"]]
    for person in ("anna", "ben"):
        for point in POINTS:
            for name in ("x", "y", "likelihood"):
                for row, cell in zip(header, ("made", person, point, name), strict=True):
                    row.append(cell)
    rows = [",".join(row) for row in header]
    for k in range(FRAMES):
        cells = [f"{value:.1f}" for person in (0, 1) for x, y in places(person)[k] for value in (x, y, 0.9)]
        rows.append(",".join([str(k), *cells]))
    path.write_text("\n".join(rows) + "\n")
    return path


def sleap(path: Path) -> Path:
    """The same people in the layout of SLEAP's analysis files."""
    tracks = np.stack([places(person) for person in (0, 1)])  # tracks, frames, nodes, 2
    with h5py.File(path, "w") as file:
        file["tracks"] = tracks.transpose(0, 3, 2, 1)
        file["node_names"] = [name.encode() for name in POINTS]
        file["track_names"] = [b"anna", b"ben"]
        file["point_scores"] = np.full((2, len(POINTS), FRAMES), 0.9)
        file["track_occupancy"] = np.ones((FRAMES, 2))
    return path


WRITERS = {DEEPLABCUT: (deeplabcut, "poses.csv"), SLEAP: (sleap, "poses.h5")}


@pytest.mark.parametrize("software", WRITERS)
def test_poses_are_tracks(software: str, tmp_path: Path) -> None:
    pytest.importorskip("movement", reason="the extra poses has it")
    write, name = WRITERS[software]
    tracks = gt.read(write(tmp_path / name), fps=10.0, metres_per_pixel=0.02)
    assert [track.label for track in tracks] == ["anna", "ben"]
    assert (tracks.summary.rows_read, tracks.summary.rows_used) == (2 * FRAMES, 2 * FRAMES)
    for person, track in enumerate(tracks):
        hips = places(person)[:, 3:].mean(axis=1)
        np.testing.assert_allclose(track.position, 0.02 * hips * [1.0, -1.0], atol=1e-5)
        np.testing.assert_allclose(track.t, np.arange(FRAMES) / 10.0)
        assert track.head is not None
        np.testing.assert_allclose(track.head, 0.0, atol=1e-5)


@pytest.mark.parametrize("software", WRITERS)
def test_without_the_package_the_way_is_named(
    software: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "movement", None)
    monkeypatch.setitem(sys.modules, "movement.io", None)
    write, name = WRITERS[software]
    with pytest.raises(InputError) as told:
        gt.read(write(tmp_path / name), fps=10.0, metres_per_pixel=0.02)
    for words in (software, "graphtrack[poses]", "movement.io.load_dataset", name):
        assert words in str(told.value)


@pytest.mark.parametrize(
    ("options", "said"), [({"fps": 10.0}, "--units m"), ({"metres_per_pixel": 1}, "--fps")]
)
def test_what_such_files_do_not_say_is_asked_for(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    pytest.importorskip("movement", reason="the extra poses has it")
    with pytest.raises(InputError, match=said):
        gt.read(sleap(tmp_path / "poses.h5"), **options)


def test_a_damaged_file_is_told(tmp_path: Path) -> None:
    pytest.importorskip("movement", reason="the extra poses has it")
    path = tmp_path / "poses.csv"
    path.write_text("scorer,made,made,made\nbodyparts,nose,nose,nose\n0,1.0,2.0,0.9\n")
    with pytest.raises(InputError, match="a file of DeepLabCut that movement cannot read"):
        gt.read(path, fps=10.0, metres_per_pixel=0.02)


@given(
    st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=20)
)
@settings(max_examples=25)
def test_changed_bytes_are_read_or_one_error(changes):
    with TemporaryDirectory() as folder:
        path = sleap(Path(folder) / "poses.h5")
        content = bytearray(path.read_bytes())
        dataset = xarray.Dataset({"position": (("time",), np.arange(9.0))})
        for data in (content, bytearray(dataset.to_netcdf(engine="h5netcdf"))):
            for place, change in changes:
                data[8 + int(place * (len(data) - 8))] ^= change
            path = Path(folder) / "changed.nc"
            path.write_bytes(data)
            with contextlib.suppress(InputError):  # KeyError and others of HDF5 were tracebacks
                gt.read(path, metres_per_pixel=0.01)
