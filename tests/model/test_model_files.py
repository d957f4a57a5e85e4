"""Model files: parameters, presets and known scene parameters, saved and loaded."""

from __future__ import annotations

import dataclasses
import pickle
import tomllib
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from selection import others_slow
from walks import walk

import graphtrack as gt
from graphtrack.constants.online import OnlineSmoother
from graphtrack.constants.population import Population
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.interaction.attention import AttentionParameters
from graphtrack.model import CouplingParameters, Model, Parameters, presets
from graphtrack.model.parameters import range_of
from graphtrack.model.terms.orientation import BodyDynamics
from graphtrack.streaming.saved_state import settings_of

TABLES = {table.name: getattr(Parameters(), table.name) for table in dataclasses.fields(Parameters)}
NUMBERS = {
    (table, key.name): limits
    for table, group in TABLES.items()
    for key in dataclasses.fields(group)
    if (limits := range_of(group, key.name)) is not None
}
PARAMETERS = st.builds(
    Parameters,
    **{
        table: st.builds(
            type(group),
            **{key: st.floats(*limits) for (of, key), limits in NUMBERS.items() if of == table},
            **({"robust": st.sampled_from(["none", "huber", "cauchy"])} if table == "likelihood" else {}),
        )
        for table, group in TABLES.items()
    },
)


RANGES = {one.name: one.metadata["range"] for one in fields(gt.SceneParameters)}
SCENES = st.fixed_dictionaries({}, optional={name: st.floats(*limits) for name, limits in RANGES.items()})


def load(folder: Path, text: str) -> Model:
    path = folder / "model.toml"
    path.write_text(text, encoding="utf-8")
    return Model.load(path)


def refused(folder: Path, text: str) -> InputError:
    with pytest.raises(InputError) as caught:
        load(folder, text)
    assert str(folder / "model.toml") in str(caught.value)
    return caught.value


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(preset=st.sampled_from(sorted(presets)), parameters=PARAMETERS, scene=SCENES)
def test_a_saved_model_loads_as_it_was(
    tmp_path: Path, preset: str, parameters: Parameters, scene: dict[str, float]
) -> None:
    path = tmp_path / "model.toml"
    model = Model(preset, parameters, scene=scene)
    model.save(path)
    copies = Model.load(path), pickle.loads(pickle.dumps(model)), Model.from_dict(model.to_dict())
    for copy in (*copies, Model.named(path), Model.named(str(path))):
        assert (copy.preset, copy.parameters, dict(copy.scene)) == (preset, parameters, scene)
        assert [type(term) for term in copy.terms] == [type(term) for term in model.terms]
    assert Model.named(model) is model and Model.named(preset).preset == preset
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    assert content == {"preset": preset, **dataclasses.asdict(parameters)} | (
        {"scene": scene} if scene else {}
    )


@pytest.mark.parametrize("preset", presets)
def test_what_a_file_leaves_out_is_the_presets_own(tmp_path: Path, preset: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text(f'preset = "{preset}"\n[motion]\ninitial_speed_std = 0.7\n', encoding="utf-8")
    found, own = Model.load(path).parameters, Model(preset).parameters
    assert found == replace(own, motion=replace(own.motion, initial_speed_std=0.7))


@pytest.mark.parametrize("name", ["jiont", "model.json", "", "folder/position"])
def test_an_unknown_name_is_answered_with_the_known_ones(name: str) -> None:
    with pytest.raises(InputError, match="position, separate, joint") as caught:
        Model.named(name)
    assert repr(name) in str(caught.value)
    with pytest.raises(InputError, match="position, separate, joint"):
        Model(name)


@pytest.mark.parametrize("text", ["", "[motion]\ninitial_speed_std = 0.7\n"])
def test_a_file_without_a_preset_has_the_one_that_no_file_at_all_has(tmp_path: Path, text: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    default = Model.named(None)
    found = Model.named(path)
    assert found.preset == default.preset
    assert found.parameters.likelihood == default.parameters.likelihood
    assert Model.load(path).preset == Model.named(None).preset == "joint"


KNOWN = "position, separate, joint"
WRONG = [
    ("preset = 7\n", "7", KNOWN),
    ('preset = "unknown"\n', "'unknown'", KNOWN),
    ('preset = ["joint"]\n', "['joint']", KNOWN),
    ("[motoin]\n", "the unknown table 'motoin'", "motion, orientation, coupling, likelihood"),
    ("[place]\nx = 1.0\n", "the unknown table 'place'", "motion, orientation, coupling, likelihood"),
    ("foo = 1\n", "the unknown key 'foo'", "preset"),
    ("motion = 3\n", "", "a table [motion]"),
    ("[[motion]]\nacceleration_density = 1.0\n", "", "a table [motion]"),
    ("[motion]\nspeling = 1.0\n", "motion.speling", "acceleration_density"),
    ("[motion]\nacceleration_density = 1e-300\n", "density = 1e-300", "a number in [1e-05, 10000] m²/s³"),
    ('[likelihood]\nrobust = "tukey"\n', "likelihood.robust = ", "huber"),
    ("[likelihood]\nrobust = []\n", "likelihood.robust = ", "huber"),
    ("[likelihood]\nimage_frame = 1\n", "likelihood.image_frame = ", "true"),
    ("[scene]\ndeath_rat = 1.0\n", "key scene.death_rat", "death_rate"),
    ("[scene]\ndetection_probability = 1.5\n", "scene.detection_probability = 1.5", "[0.01, 0.999]"),
    ("[scene]\nlongest_gap = -1\n", "scene.longest_gap = -1", "[0.05, 60] s"),
    ("[scene]\nposition_std = nan\n", "scene.position_std = nan", "m"),
    ("[scene]\nclutter_density = 'low'\n", "scene.clutter_density = 'low'", "1/m²"),
    ("scene = 3\n", "scene = 3", "a table [scene]"),
    ("[scnee]\n", "the unknown table 'scnee'", "scene"),
]


@pytest.mark.parametrize(("text", "found", "expected"), WRONG)
def test_what_is_wrong_in_a_file_is_named(tmp_path: Path, text: str, found: str, expected: str) -> None:
    error = refused(tmp_path, text)
    assert found in error.found and expected in error.expected


KINDS: dict[str, Any] = {
    "--model": (Model("joint"), Model.load),
    "--constants": (Population(), Population.load),
    "graphtrack forecast --parameters": (gt.ForecastParameters(), gt.ForecastParameters.load),
    "graphtrack groups --parameters": (gt.GroupParameters(), gt.GroupParameters.load),
    "graphtrack attention --parameters": (AttentionParameters(), AttentionParameters.load),
}
"""All that ``graphtrack fit`` writes, by the option that takes it."""


@pytest.mark.parametrize("option", KINDS)
def test_a_file_of_another_kind_is_answered_with_its_option(tmp_path: Path, option: str) -> None:
    content, own = KINDS[option]
    content.save(tmp_path / "learned.toml")
    own(tmp_path / "learned.toml")
    for load in (load for _, load in KINDS.values() if load is not own):
        with pytest.raises(InputError, match=f"for {option}") as caught:
            load(tmp_path / "learned.toml")
        assert "\n" not in str(caught.value) and "learned.toml" in str(caught.value)


def small_tracks() -> gt.TrackSet:
    """People observed by angles and by classes, at even and uneven times, in metres and pixels, with gaps."""
    camera = GroundCamera.from_homography(np.array([[0.02, 0, -5], [0, -0.02, 30], [0, 0.002, 0.2]]))
    tracks = [walk(20, seed=1), walk(20, seed=2, classes=True, uneven=True, dt=0.04, track_id=2)]
    tracks.append(walk(20, seed=3, dt=0.4, track_id=3))
    tracks[2] = replace(tracks[2], pixel=camera.ground_to_image(tracks[2].position))
    unseen = (np.arange(20) > 7) & (np.arange(20) < 12)
    hidden = [replace(track, position=np.where(unseen[:, None], np.nan, track.position)) for track in tracks]
    return gt.TrackSet(tuple(hidden), camera=camera)


@pytest.mark.slow
@pytest.mark.parametrize("preset", others_slow(sorted(presets), ["joint-intentional", "social"]))
def test_estimates_are_finite_where_a_parameter_is_as_low_or_as_high_as_it_may_be(preset: str) -> None:
    tracks, own = small_tracks(), Model(preset).parameters
    for (table, key), limits in NUMBERS.items():
        for value in limits:
            changed = replace(getattr(own, table), **{key: value})
            for track in gt.smooth(tracks, Model(preset, replace(own, **{table: changed})), engine="chain"):
                angles = [name for name in ("body", "head") if getattr(track, name) is not None]
                states = [track.position, track.velocity, *(getattr(track, name) for name in angles)]
                spreads = [track.std(name) for name in ("x", "y", "vx", "vy", *angles)]
                assert all(np.isfinite(values).all() for values in (*states, *spreads)), (table, key, value)


def test_a_value_that_is_no_number_in_range_is_named(tmp_path: Path) -> None:
    for (table, key), (low, high) in NUMBERS.items():
        outside = [repr(value) for value in (low - 1e-3 * (1.0 + abs(low)), 2.0 * high)]
        for value in (*outside, "nan", "inf", "-inf", "1e300", "true", '"1.0"', "[1.0]", "{}"):
            error = refused(tmp_path, f"[{table}]\n{key} = {value}\n")
            assert f"{table}.{key} = " in error.found, value
            assert "a number in " in error.expected
        zero = f"[{table}]\n{key} = 0.0\n"
        if low > 0.0:
            assert f"{table}.{key}" in refused(tmp_path, zero).found
        else:
            assert getattr(getattr(load(tmp_path, zero).parameters, table), key) == 0.0


@pytest.mark.parametrize(
    "content", [b"\x00\xff\xfe\x80", b"[motion", b"a = 1\na = 2\n", b"\x89PNG\r\n\x1a\n"]
)
def test_a_file_that_is_no_toml_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "model.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match="TOML") as caught:
        Model.load(path)
    assert caught.value.path == str(path)


def test_a_missing_file_and_a_folder_are_named(tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    for path in (tmp_path / "missing.toml", tmp_path / "folder.toml"):
        with pytest.raises(InputError, match="a readable file: a model file") as caught:
            Model.named(path)
        assert caught.value.path == str(path)


class OfOnesOwn(BodyDynamics):
    """A term that no preset has."""


def test_terms_of_ones_own_are_not_left_out_in_silence(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    Model("joint").save(path)
    before, model = path.read_bytes(), Model("joint", terms=[OfOnesOwn])
    for save in (
        lambda: model.save(path),
        model.to_dict,
        lambda: settings_of(model, "auto", 1.0, None, None),
    ):
        with pytest.raises(InputError, match="OfOnesOwn"):
            save()
    assert path.read_bytes() == before
    assert [type(term) for term in pickle.loads(pickle.dumps(model)).terms][-1] is OfOnesOwn
    state = OnlineSmoother(model).state()
    assert OnlineSmoother.from_state(state, model).model is model
    with pytest.raises(InputError, match="OfOnesOwn"):
        OnlineSmoother.from_state(state, "joint")


@given(st.floats(0.0, 10.0), st.floats(1e-6, 10.0))
def test_the_weight_of_a_coupling_is_a_share_of_the_correlation_time(correlation: float, step: float) -> None:
    coupling = CouplingParameters(correlation_time=correlation)
    weight = float(coupling.weights(step))
    assert 0.0 < weight <= 1.0
    assert weight == pytest.approx(min(1.0, step / correlation) if correlation else 1.0)
    assert coupling.weights(None) == 1.0


def test_a_scene_stays_with_a_model_whose_parameters_change() -> None:
    scene = gt.SceneParameters(detection_probability=0.7)
    assert gt.Model(scene=scene).scene == asdict(scene)
    model = gt.Model("position", scene={"death_rate": 0.2})
    assert model.with_parameters(gt.Parameters()).scene == {"death_rate": 0.2}
    assert model.with_scene(None).scene == {} and "scene.death_rate=0.2" in repr(model)


def test_a_stream_goes_on_with_the_scene_that_it_began_with() -> None:
    known = gt.Model("position", scene={"death_rate": 0.2})
    assert settings_of(known, "chain", 2.0, None, None)["model.scene.death_rate"] == 0.2
