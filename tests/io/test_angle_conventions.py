"""Files whose angles have another convention: read, written as read, and refused."""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from angle_conventions import CONVENTIONS
from command import ran
from format_samples import sample_of
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

import graphtrack as gt
from graphtrack.geometry.angles import difference
from graphtrack.geometry.conventions import AngleConvention

T = np.arange(6) / 5.0
HEADINGS = np.radians([-170.0, -95.0, -20.0, 0.0, 77.0, 180.0])


def table(convention: AngleConvention, body: np.ndarray = HEADINGS, head: np.ndarray = HEADINGS[::-1]):
    """Somebody's rows with orientations in a convention, as a program would write them."""
    unit = (lambda a: a) if convention.unit == "rad" else np.degrees
    zeros = {"right": 0, "up": 90, "left": 180, "down": 270, "x": 0, "y": 90, "-x": 180, "-y": 270}
    zeros |= {"east": 0, "north": 90, "west": 180, "south": 270}
    zero = np.radians(zeros.get(convention.zero, convention.zero))

    def written(heading: np.ndarray) -> np.ndarray:
        away = heading - zero
        return unit((away if convention.sense == "ccw" else -away) % (2.0 * np.pi))

    return pd.DataFrame(
        {
            "track_id": 3,
            "frame": np.arange(6),
            "t": T,
            "x": T,
            "y": 2.0 - T,
            "body_deg": written(body),
            "head_deg": written(head),
            "true_head_deg": written(head),
        }
    )


@given(CONVENTIONS, st.booleans())
def test_a_file_is_read_in_its_convention_and_written_in_it(
    convention: AngleConvention, by_text: bool
) -> None:
    given_table = table(convention)
    with tempfile.TemporaryDirectory() as folder:
        path, output = Path(folder, "in.csv"), Path(folder, "out.csv")
        given_table.to_csv(path, index=False)
        options = {"angles": str(convention) if by_text else convention}
        tracks = gt.read(path, **options)
        gt.write(tracks, output)
        again = gt.read(output, **options)
        written = pd.read_csv(output)
    for one in (*tracks, *again):
        np.testing.assert_allclose(difference(one.body, HEADINGS), 0.0, atol=1e-9)
        np.testing.assert_allclose(difference(one.head, HEADINGS[::-1]), 0.0, atol=1e-9)
        np.testing.assert_allclose(difference(one.true_head, HEADINGS[::-1]), 0.0, atol=1e-9)
    turn = 2.0 * np.pi if convention.unit == "rad" else 360.0
    away = (written.head_deg - given_table.head_deg + 0.5 * turn) % turn - 0.5 * turn
    np.testing.assert_allclose(away, 0.0, atol=1e-6)
    native = tracks.to_table()
    np.testing.assert_allclose(difference(np.radians(native.body_deg), HEADINGS), 0.0, atol=1e-9)


def test_zero_and_sense_name_the_same_conventions_in_the_shell(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    table(AngleConvention("up", "cw")).to_csv(path, index=False)
    outputs = []
    for k, options in enumerate(
        (["--angles", "clockwise from image up"], ["--angle-zero", "up", "--angle-sense", "cw"])
    ):
        outputs.append(tmp_path / f"{k}.parquet")
        ran("convert", path, "-o", outputs[-1], *options, program="graphtrack")
    first, second = (pd.read_parquet(one) for one in outputs)
    pd.testing.assert_frame_equal(first, second)
    np.testing.assert_allclose(first.body_deg % 360.0, table(AngleConvention("up", "cw")).body_deg, atol=1e-9)


def test_columns_in_radians_keep_their_unit_in_any_convention() -> None:
    given_table = table(AngleConvention("north", "cw", "rad")).drop(columns=["body_deg", "true_head_deg"])
    given_table = given_table.rename(columns={"head_deg": "yaw"})
    columns = {"id": "track_id", "t": "t", "head_rad": "yaw"}
    for convention in ("compass", "radians, compass"):
        (track,) = tracks = gt.read(given_table, columns=columns, angles=convention)
        np.testing.assert_allclose(difference(track.head, HEADINGS[::-1]), 0.0, atol=1e-9)
        np.testing.assert_allclose(tracks.to_table(as_read=True)["yaw"], given_table["yaw"], atol=1e-9)


def test_pixels_and_a_scale_are_a_view_from_above() -> None:
    clockwise = AngleConvention("up", "cw")
    given_table = table(clockwise).assign(u=lambda d: 100.0 * d.x, v=lambda d: -100.0 * d.y)
    (track,) = tracks = gt.read(given_table.drop(columns=["x", "y"]), metres_per_pixel=0.01, angles=clockwise)
    np.testing.assert_allclose(difference(track.body, HEADINGS), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        tracks.to_table(as_read=True).body_deg % 360.0, given_table.body_deg, atol=1e-6
    )


def test_bearings_are_usual_where_positions_are_latitudes() -> None:
    pytest.importorskip("pyproj")
    given_table = table(AngleConvention("north", "cw")).assign(
        lon=lambda d: 1e-5 * d.x, lat=lambda d: 48.0 + 1e-5 * d.y
    )
    given_table = given_table.drop(columns=["x", "y"])
    columns = {"id": "track_id", "t": "t", "lat": "lat", "lon": "lon"}
    (track,) = tracks = gt.read(given_table, columns=columns)
    np.testing.assert_allclose(difference(track.body, HEADINGS), 0.0, atol=1e-9)
    assert any("compass bearings" in note for note in tracks.summary.notes)
    np.testing.assert_allclose(tracks.to_table(as_read=True).body_deg, given_table.body_deg, atol=1e-9)
    (other,) = gt.read(given_table, columns=columns, angles="counter-clockwise from east")
    np.testing.assert_allclose(difference(other.body, np.radians(given_table.body_deg)), 0.0, atol=1e-9)


def test_other_formats_and_contradictions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "in.csv"
    table(AngleConvention()).to_csv(path, index=False)
    assert "angle_zero" in str(refused(path, angles="compass", angle_zero="up"))
    assert "clockwise" in str(refused(path, angles="leftwards"))
    mot = tmp_path / "mot.txt"
    mot.write_bytes(sample_of("mot").content())
    assert "--angles" in str(refused(mot, angles="compass", fps=10.0))
