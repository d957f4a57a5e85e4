"""Files of poses, and tracks of moving sensors that are read into the world with them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command import run
from hypothesis import given, settings
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.io.options import ReadOptions
from graphtrack.io.poses import read_poses

STEP, N = 0.1, 41
EPOCH = 1_763_892_000
SEEN = np.array([[4.0, 1.0], [-2.0, 5.0]])
"""People who stand in the world."""
_TURN = 0.5  # rad/s


def robot(t):
    """A robot that drives 1 m/s on a circle about (0, 2): x, y and yaw (n,)."""
    return np.sin(_TURN * t) / _TURN, (1.0 - np.cos(_TURN * t)) / _TURN, _TURN * t


def times():
    return STEP * np.arange(N)


def rows(shift=0.0, **further):
    """Rows in the robot's frame."""
    t = times()
    x, y, yaw = robot(t)
    parts = []
    for k, place in enumerate(SEEN):
        east, north = place[0] - x, place[1] - y
        parts.append(
            {
                "track_id": np.full(N, k + 1),
                "frame": np.arange(N),
                "t": t + shift,
                "x": np.cos(yaw) * east + np.sin(yaw) * north,
                "y": np.cos(yaw) * north - np.sin(yaw) * east,
                "body_deg": np.rad2deg(0.7 - yaw),
            }
        )
    table = pd.concat([pd.DataFrame(part) for part in parts], ignore_index=True)
    return table.assign(**further)


def table(shift=0.0, **further):
    t = times()
    x, y, yaw = robot(t)
    return pd.DataFrame({"t": t + shift, "x": x, "y": y, "yaw_deg": np.rad2deg(yaw)} | further)


def csv(folder, frame, name="poses.csv"):
    frame.to_csv(folder / name, index=False)
    return folder / name


def matrices(t, camera=False):
    """Poses (n, 4, 4) of the robot, or of a camera on it in the frame of its first pose."""
    x, y, yaw = robot(t)
    found = np.tile(np.eye(4), (len(t), 1, 1))
    c, s = np.cos(yaw), np.sin(yaw)
    if camera:  # z forward, x right: a turn to the left is one from z to −x
        found[:, 0, 0], found[:, 0, 2], found[:, 2, 0], found[:, 2, 2] = c, -s, s, c
        found[:, 0, 3], found[:, 2, 3] = -y, x
    else:
        found[:, 0, 0], found[:, 0, 1], found[:, 1, 0], found[:, 1, 1] = c, -s, s, c
        found[:, 0, 3], found[:, 1, 3] = x, y
    return found


def quaternions(poses):
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(poses[:, :3, :3]).as_quat()


def numbers(path, values, header="", mark=" "):
    lines = [mark.join(repr(v) for v in row) for row in np.asarray(values, dtype=object).tolist()]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n")
    return path


def tum(folder, shift=0.0, camera=False):
    poses = matrices(times(), camera)
    values = np.column_stack([times() + shift, poses[:, :3, 3], quaternions(poses)])
    return numbers(folder / "tum.txt", values, "# timestamp tx ty tz qx qy qz qw")


def odometry(folder):
    return numbers(folder / "00.txt", matrices(times(), camera=True)[:, :3].reshape(N, 12))


def euroc(folder):
    poses = matrices(times())
    q = quaternions(poses)[:, [3, 0, 1, 2]]
    stamps = [EPOCH * 10**9 + k * 10**8 for k in range(N)]
    values = [[t, *p, *o] for t, p, o in zip(stamps, poses[:, :3, 3].tolist(), q.tolist(), strict=True)]
    header = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
    lines = [",".join(map(repr, row)) for row in values]
    (folder / "data.csv").write_text("\n".join([header, *lines]) + "\n")
    return folder / "data.csv"


def oxts_lines():
    x, y, yaw = robot(times())
    radius = 6378137.0
    line = np.zeros((N, 30))
    line[:, 0], line[:, 1] = (
        np.rad2deg(2.0 * np.arctan(np.exp(y / radius)) - np.pi / 2),
        np.rad2deg(x / radius),
    )
    line[:, 5] = yaw
    return line


def quaternion_table(folder):
    poses = matrices(times())
    columns = dict(zip(("qx", "qy", "qz", "qw"), quaternions(poses).T, strict=True))
    frame = table().drop(columns="yaw_deg").assign(z=0.0, **columns)
    return csv(folder, frame)


def parquet(folder):
    table().to_parquet(folder / "poses.parquet")
    return folder / "poses.parquet"


def ndjson(folder):
    (folder / "poses.ndjson").write_text(
        "".join(json.dumps(row) + "\n" for row in table().to_dict("records"))
    )
    return folder / "poses.ndjson"


def raw(folder):
    """KITTI's raw data: a file a frame, and their times as text."""
    (folder / "oxts" / "data").mkdir(parents=True)
    for k, line in enumerate(oxts_lines()):
        numbers(folder / "oxts" / "data" / f"{k:010}.txt", [line])
    stamps = [f"2025-11-23 10:00:{k // 10:02}.{k % 10}00000000" for k in range(N)]
    (folder / "oxts" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    return folder / "oxts"


FILES = {
    "csv": (lambda folder: csv(folder, table()), 0.0, {}),
    "csv with well-known names": (
        lambda folder: csv(folder, table().rename(columns={"t": "timestamp", "x": "pos_x", "y": "pos_y"})),
        0.0,
        {},
    ),
    "csv in milliseconds since 1970": (
        lambda folder: csv(folder, table().assign(t=EPOCH * 1000 + 100 * np.arange(N))),
        EPOCH,
        {},
    ),
    "quaternions": (quaternion_table, 0.0, {}),
    "parquet": (parquet, 0.0, {}),
    "ndjson": (ndjson, 0.0, {}),
    "tum": (tum, 0.0, {}),
    "tum since 1970": (lambda folder: tum(folder, EPOCH), EPOCH, {}),
    "tum of a camera": (lambda folder: tum(folder, camera=True), 0.0, {"pose_axes": "camera"}),
    "kitti odometry": (odometry, 0.0, {"fps": 10.0}),
    "euroc": (euroc, EPOCH, {}),
    "oxts": (lambda folder: numbers(folder / "0000.txt", oxts_lines()), 0.0, {}),
    "raw oxts": (raw, EPOCH, {}),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("as_dates", [False, True])
def test_people_who_stand_do_so_in_the_world(tmp_path, name, as_dates):
    make, shift, options = FILES[name]
    seen = rows(shift)
    if as_dates and shift:  # of another time scale: seconds from midnight
        seen["t"] = pd.to_datetime(np.rint(seen["t"] * 1e6).astype(np.int64), unit="us", utc=True)
    tracks = gt.read(seen, poses=make(tmp_path), **options)
    for track, place in zip(tracks, SEEN, strict=True):
        assert len(track) == N
        np.testing.assert_allclose(track.position, np.tile(place, (N, 1)), atol=2e-5)
        np.testing.assert_allclose(track.body, 0.7, atol=2e-5)
    assert any("turned into the world" in note for note in tracks.summary.notes)


def test_times_next_to_poses_of_odometry_are_found(tmp_path):
    path = odometry(tmp_path)
    with pytest.raises(
        InputError, match=r"00\.txt: found poses without times, expected a frame rate \(--fps\)"
    ):
        read_poses(path)
    numbers(tmp_path / "times.txt", times()[:, None])
    assert read_poses(path).paths[""].t.tolist() == times().tolist()


def test_a_path_in_python_is_in_the_time_of_the_tracks():
    path = gt.PosePath(times(), *robot(times()))
    for poses in (path, {"laser": path}):
        tracks = gt.read(rows(sensor="laser"), poses=poses)
        np.testing.assert_allclose(tracks[0].position, np.tile(SEEN[0], (N, 1)), atol=1e-9)


def test_each_sensor_has_its_poses_and_the_others_stand(tmp_path):
    moving, static = rows(sensor="laser"), rows(sensor="camera")
    static[["x", "y"]] = np.repeat(SEEN, N, axis=0)
    poses = csv(tmp_path, pd.concat([table(sensor="laser"), table(sensor="front").assign(x=3.0)]))
    tracks = gt.read(pd.concat([moving, static]), poses=poses)
    np.testing.assert_allclose(tracks[0].position, np.tile(SEEN[0], (2 * N, 1)), atol=1e-9)
    assert any("'camera' have no poses" in note for note in tracks.summary.notes)
    with pytest.raises(InputError, match="poses of laser, front, and rows without a column sensor"):
        gt.read(rows(), poses=poses)


def test_the_pose_makes_rows_uncertain_and_the_noise_that_nobody_declares_is_said(tmp_path):
    poses = csv(tmp_path, table(x_std=0.03, y_std=0.04, yaw_std_deg=1.0))
    track = gt.read(rows(), poses=poses)[0]
    far = np.linalg.norm(track.position[0]) * np.deg2rad(1.0)
    # The poses' errors do not scatter: they are shared by the five times of the first half second.
    of_pose = 5.0 * (0.03**2 + 0.04**2 + far**2)
    np.testing.assert_allclose(np.trace(track.position_covariance[0]), 0.02 + of_pose, rtol=1e-6)
    assert (np.linalg.eigvalsh(track.position_covariance[0]) > 0.1**2).all()
    notes = gt.read(rows(), poses=poses).summary.notes
    assert any("82 rows declare no noise of positions: 0.1 m" in note for note in notes)
    declared = gt.read(rows(pos_std=0.2), poses=poses)
    assert not any("declare no noise" in note for note in declared.summary.notes)
    np.testing.assert_allclose(np.trace(declared[0].position_covariance[0]), 0.08 + of_pose, rtol=1e-6)
    assert gt.read(rows(), poses=csv(tmp_path, table()))[0].position_covariance is None


@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.93), (0.9, 0.87)])
def test_estimates_of_people_seen_by_two_lasers_of_a_turning_robot_hold_what_they_state(correlation, least):
    """12.5 Hz each and out of step, errors of poses of 0.03 m and 1°, independent or first-order Markov."""
    inside = []
    for seed in range(6):
        rng, t = np.random.default_rng(seed), np.arange(0.0, 10.0, 0.08)
        noise = np.array([0.03, 0.03, np.deg2rad(1.0)])
        errors = rng.standard_normal((len(t), 3))
        for k in range(1, len(t)):
            errors[k] = correlation * errors[k - 1] + np.sqrt(1.0 - correlation**2) * errors[k]
        drawn = np.column_stack([np.sin(t), 1.0 - np.cos(t), t]) + noise * errors
        path = gt.PosePath(t, *drawn.T, np.tile(np.diag(noise**2), (len(t), 1, 1)))
        parts = []
        for person in gt.simulate("position", n_tracks=2, n_steps=500, fps=50.0, rng=rng):
            for sensor, begin in (("a", 0.1), ("b", 0.13)):
                at = np.arange(begin, 9.5, 0.08)
                place = [np.interp(at, person.t - person.t[0], person.true_position[:, k]) for k in (0, 1)]
                east, north = place[0] - np.sin(at), place[1] - 1.0 + np.cos(at)
                ahead = np.cos(at) * east + np.sin(at) * north + 0.05 * rng.standard_normal(len(at))
                left = np.cos(at) * north - np.sin(at) * east + 0.05 * rng.standard_normal(len(at))
                seen = {"track_id": person.track_id, "frame": np.arange(len(at)), "t": at, "sensor": sensor}
                seen |= {"x": ahead, "y": left, "pos_std": 0.05, "true_x": place[0], "true_y": place[1]}
                parts.append(pd.DataFrame(seen)[np.hypot(ahead, left) < 12.0])
        tracks = gt.read(pd.concat(parts), poses=path)
        for track in gt.smooth(tracks, "position"):
            error, covariance = track.position - track.true_position, track.covariance[:, :2, :2]
            inside.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) < 5.991)
    assert least < np.concatenate(inside).mean() < 0.97


def test_truth_stays_and_a_written_table_reads_back(tmp_path):
    seen = rows(pos_std=0.2, true_x=1.0, true_y=2.0)
    poses = csv(tmp_path, table(x_std=0.03, y_std=0.04, yaw_std_deg=1.0))
    tracks = gt.read(seen, poses=poses)
    np.testing.assert_array_equal(tracks[0].true_position, np.tile([1.0, 2.0], (N, 1)))
    gt.write(tracks, tmp_path / "world.csv")
    again = gt.read(tmp_path / "world.csv")
    np.testing.assert_array_equal(again[1].position, tracks[1].position)
    np.testing.assert_allclose(again[1].position_covariance, tracks[1].position_covariance, rtol=1e-12)


def test_rows_without_a_pose_are_counted_and_clocks_that_differ_refused(tmp_path):
    poses = csv(tmp_path, table()[:21])
    tracks = gt.read(rows(), poses=poses)
    assert tracks.summary.refused == {"at a time without a pose of the sensor": 2 * (N - 22)}
    with pytest.raises(InputError) as error:
        gt.read(rows(EPOCH), poses=poses)
    assert "poses from 0 to 2 s, and rows from 1763892000 to 1763892004 s" in str(error.value)


WRONG = {
    "t,x,y\n0,0,0\n1,1,1\n": "poses.csv, column yaw_deg: found no column yaw_deg",
    "t,x,y,yaw_deg\n0,0,0,0\n1,,1,0\n": "poses.csv, line 3, column x: found an empty cell",
    "t,x,y,yaw_deg\n0,0,0,0\n1,b,1,0\n": "poses.csv, line 3, column x: found 'b'",
    "t,x,y,yaw_deg\n1,0,0,0\n\n1,1,1,0\n": "poses.csv, line 4, column t: found t = 1 after 1 s",
    "t,x,y,yaw_deg\n1,0,0,0\n": "poses.csv: found one pose",
    "t,x,y,yaw_deg,x_std\n1,0,0,0,0.1\n2,0,0,0,0.1\n": "found x_std alone",
    "t,x,y,yaw_deg,yaw_std_deg\n1,0,0,0,1\n2,0,0,0,-1\n": "line 3, column yaw_std_deg: found '-1'",
    "t,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,0\n": "line 3, column qw: found a quaternion",
    "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n": "line 3: found t = 1 after 1 s",
    "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2\n": "line 2, column qx: found 0",
    "1 0 0 0 0 2 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 0\n": "line 1, column 1: found 1",
    "0 0 0 0 0 0.7071 0 0.7071\n1 0 0 0 0 0.7071 0 0.7071\n": "x axis points up or down",
    "0 0 0 0 0 0 0 1\n1 0 0 9 0 0 0 1\n": "poses that rise by 9 m",
    "": "an empty file",
}


@pytest.mark.parametrize("text", WRONG)
def test_errors_have_the_place(tmp_path, text):
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(InputError) as error:
        read_poses(tmp_path / "poses.csv")
    assert WRONG[text] in str(error.value)


@settings(max_examples=25)
@given(data=st.data())
def test_a_file_of_poses_with_any_damage_is_read_or_refused(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    make = data.draw(st.sampled_from([tum, odometry, euroc, lambda f: csv(f, table())]))
    path: Path = make(folder)
    content = bytearray(path.read_bytes()[: data.draw(st.integers(1, 3000))])
    for _ in range(data.draw(st.integers(0, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.sampled_from(b"0-,. \n#ex\xff\0"))
    path.write_bytes(bytes(content))
    try:
        found = read_poses(path, ReadOptions(fps=10.0))
    except InputError as error:
        assert error.path is not None
    else:
        assert all(len(one) > 1 for one in found.paths.values())


def test_options_that_do_not_fit_are_refused(tmp_path):
    poses = csv(tmp_path, table())
    with pytest.raises(InputError, match="pose_axes without a file"):
        gt.read(rows(), pose_axes="camera")
    with pytest.raises(InputError, match="pose_axes = 'boat'"):
        gt.read(rows(), poses=poses, pose_axes="boat")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="poses of another type"):
        gt.read(rows(), poses=3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="camera = 'x', expected a GroundCamera; files are homography"):
        gt.read(rows(), camera="x")  # type: ignore[arg-type]


def test_commands_read_with_poses(tmp_path):
    seen, poses = csv(tmp_path, rows(pos_std=0.1), "seen.csv"), csv(tmp_path, table())
    for command in ("smooth", "track", "convert"):
        out = tmp_path / f"{command}.csv"
        further = [] if command == "convert" else ["--model", "position"]
        done = run(command, seen, "-o", out, "--poses", poses, *further, program="graphtrack")
        assert done.returncode == 0 and "turned into the world" in done.stderr, done.stderr
        for track, place in zip(gt.read(out), SEEN, strict=True):
            assert np.abs(track.position - place).max() < 0.01
    done = run("convert", seen, "-o", poses, "--poses", poses, program="graphtrack")
    assert done.returncode == 2 and "--poses" in done.stderr
    large = tmp_path / "large.parquet"
    rows().to_parquet(large)
    done = run(
        "smooth", large, "-o", tmp_path / "out.parquet", "--stream", "--poses", poses, program="graphtrack"
    )
    assert done.returncode == 2 and "--poses when streaming" in done.stderr


def test_kitti_through_poses_is_what_its_reader_makes_of_it(data_dir):
    """In sequence 0012 the vehicle stands: a parked car, which moves less than 0.1 m/s, and a pedestrian."""
    folder = data_dir / "kitti"
    if not folder.is_dir():
        pytest.skip("no recording of KITTI")
    labels = folder / "label_02" / "0012.txt"
    truth = gt.read(labels, classes=("Pedestrian", "Car"))
    from graphtrack.io.formats.kitti import _read_camera_to_imu

    lines = [line.split() for line in labels.read_text().splitlines()]
    lines = [line for line in lines if line[2] in ("Pedestrian", "Car")]
    camera = np.array([[float(cell) for cell in line[13:17]] for line in lines])
    to_imu = _read_camera_to_imu(folder / "calib" / "0012.txt")
    place = camera[:, :3] @ to_imu[:3, :3].T + to_imu[:3, 3]
    frame, identity = (np.array([int(line[k]) for line in lines]) for k in (0, 1))
    seen = {"track_id": identity, "frame": frame, "t": frame / 10.0, "x": place[:, 0], "y": place[:, 1]}
    seen["body_deg"] = np.rad2deg(-camera[:, 3] - np.pi / 2.0)
    found = gt.read(seen, poses=folder / "oxts" / "0012.txt")
    for one, other in zip(found, truth, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=0.3)  # roll and pitch, up to 60 m away
        np.testing.assert_allclose(np.cos(one.body - other.body), 1.0, atol=1e-9)
    parked = gt.smooth(found.select("3"), "joint-body")[0]
    assert np.linalg.norm(parked.velocity, axis=1).mean() < 0.1
