"""TrajNet++ files."""

import json

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputError

SCENE = {"scene": {"id": 0, "p": 7, "s": 0, "e": 20, "fps": 2.5, "tag": [1, []]}}


def position(frame, person, x=0.0, y=0.0, **more):
    return {"track": {"f": frame, "p": person, "x": x, "y": y, **more}}


def written(path, *lines):
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_scenes_have_the_rate_and_predictions_are_refused(tmp_path):
    lines = [position(10 * k, person, 0.5 * k) for k in range(3) for person in (7, 9)]
    predicted = position(30, 7, prediction_number=0, scene_id=0)
    found = gt.read(written(tmp_path / "a.ndjson", SCENE, *lines, predicted))
    assert [track.track_id for track in found] == [7, 9] and found.summary.format == "trajnet"
    np.testing.assert_allclose(found.tracks[0].t, [0.0, 0.4, 0.8])
    assert found.summary.refused == {"predictions of a scene": 1}


def test_what_is_written_comes_back(tmp_path):
    noisy = gt.simulate("position", n_tracks=3, n_steps=12, rng=np.random.default_rng(0))
    gt.write(noisy, tmp_path / "a.trajnet.ndjson")
    again = gt.read(tmp_path / "a.trajnet.ndjson")
    for one, other in zip(noisy, again, strict=True):
        known = np.isfinite(one.position).all(axis=1)
        np.testing.assert_array_equal(one.position[known], other.position)
        np.testing.assert_array_equal(one.frame[known], other.frame)
        np.testing.assert_allclose(one.t[known], other.t, atol=1e-9)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ({"track": {"f": 0.5, "p": 1, "x": 0, "y": 0}}, "0.5, expected an integer"),
        ({"track": {"f": 0, "p": 1, "x": None, "y": 0}}, "None, expected metres"),
        ({"track": 3}, "expected a line"),
        ({"scene": {}, "track": {}}, "expected a line"),
    ],
)
def test_errors_name_the_line(tmp_path, line, found):
    with pytest.raises(InputError, match="line 2.*" + found):
        gt.read(written(tmp_path / "a.ndjson", SCENE, line), format="trajnet")


def test_a_rate_is_needed(tmp_path):
    path = written(tmp_path / "a.ndjson", position(0, 1), position(1, 1))
    with pytest.raises(InputError, match="--fps"):
        gt.read(path)
    assert gt.read(path, fps=10.0).tracks[0].t[1] == pytest.approx(0.1)
