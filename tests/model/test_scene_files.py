"""What is known of a scene, in a model and in its file."""

from __future__ import annotations

import pickle
import tomllib
from dataclasses import asdict, fields
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.streaming.saved_state import settings_of

RANGES = {one.name: one.metadata["range"] for one in fields(gt.SceneParameters)}
KNOWN = st.fixed_dictionaries({}, optional={name: st.floats(*limits) for name, limits in RANGES.items()})


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(known=KNOWN)
def test_what_is_known_of_a_scene_loads_as_it_was_saved(tmp_path: Path, known: dict[str, float]) -> None:
    path, model = tmp_path / "model.toml", gt.Model("joint", scene=known)
    model.save(path)
    for copy in (gt.Model.load(path), pickle.loads(pickle.dumps(model)), gt.Model.from_dict(model.to_dict())):
        assert dict(copy.scene) == known
    assert ("scene" in tomllib.loads(path.read_text("utf-8"))) == bool(known)


def test_a_scene_stays_with_a_model_whose_parameters_change() -> None:
    scene = gt.SceneParameters(detection_probability=0.7)
    assert gt.Model(scene=scene).scene == asdict(scene)
    model = gt.Model("position", scene={"death_rate": 0.2})
    assert model.with_parameters(gt.Parameters()).scene == {"death_rate": 0.2}
    assert model.with_scene(None).scene == {} and "scene.death_rate=0.2" in repr(model)


@pytest.mark.parametrize(
    ("text", "found", "expected"),
    [
        ("[scene]\ndeath_rat = 1.0\n", "key scene.death_rat", "death_rate"),
        ("[scene]\ndetection_probability = 1.5\n", "scene.detection_probability = 1.5", "[0.01, 0.999]"),
        ("[scene]\nlongest_gap = -1\n", "scene.longest_gap = -1", "[0.05, 60] s"),
        ("[scene]\nposition_std = nan\n", "scene.position_std = nan", "m"),
        ("[scene]\nclutter_density = 'low'\n", "scene.clutter_density = 'low'", "1/m²"),
        ("scene = 3\n", "scene = 3", "a table [scene]"),
        ("[scnee]\n", "the unknown table 'scnee'", "scene"),
    ],
)
def test_what_is_wrong_in_a_scene_is_named_with_its_file(
    tmp_path: Path, text: str, found: str, expected: str
) -> None:
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(gt.InputError) as caught:
        gt.Model.load(path)
    assert caught.value.path == str(path)
    assert caught.value.found == found and expected in caught.value.expected


def test_a_stream_goes_on_with_the_scene_that_it_began_with() -> None:
    known = gt.Model("position", scene={"death_rate": 0.2})
    assert settings_of(known, "chain", 2.0, None, None)["model.scene.death_rate"] == 0.2
