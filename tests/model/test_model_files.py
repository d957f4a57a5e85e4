from __future__ import annotations

import dataclasses
import pickle
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from walks import walk

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import OnlineSmoother
from graphtrack.model import CouplingParameters, Model, Parameters, presets
from graphtrack.model.parameters import range_of
from graphtrack.model.terms.turning import BodyDynamics
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


def load(folder: Path, text: str) -> Model:
    path = folder / "model.toml"
    path.write_text(text, encoding="utf-8")
    return Model.load(path)


def refused(folder: Path, text: str) -> InputError:
    with pytest.raises(InputError) as caught:
        load(folder, text)
    assert str(folder / "model.toml") in str(caught.value)
    return caught.value


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(preset=st.sampled_from(sorted(presets)), parameters=PARAMETERS)
def test_a_saved_model_loads_as_it_was(tmp_path: Path, preset: str, parameters: Parameters) -> None:
    path = tmp_path / "model.toml"
    Model(preset, parameters).save(path)
    loaded = Model.load(path)
    assert loaded.preset == preset
    assert loaded.parameters == parameters


@given(preset=st.sampled_from(sorted(presets)), parameters=PARAMETERS)
def test_models_pickle_and_convert_to_dictionaries(preset: str, parameters: Parameters) -> None:
    model = Model(preset, parameters)
    for copy in (pickle.loads(pickle.dumps(model)), Model.from_dict(model.to_dict())):
        assert (copy.preset, copy.parameters) == (preset, parameters)
        assert [type(term) for term in copy.terms] == [type(term) for term in model.terms]


def test_a_saved_model_is_plain_toml_with_every_parameter(tmp_path: Path) -> None:
    Model("separate").save(tmp_path / "model.toml")
    content = tomllib.loads((tmp_path / "model.toml").read_text(encoding="utf-8"))
    assert content.pop("preset") == "separate"
    assert content == dataclasses.asdict(Parameters())


@pytest.mark.parametrize("preset", sorted(presets))
def test_named_takes_presets_files_and_models(tmp_path: Path, preset: str) -> None:
    model = Model.named(preset)
    assert model.preset == preset
    assert Model.named(model) is model
    model.save(tmp_path / "model.toml")
    assert Model.named(tmp_path / "model.toml").preset == preset
    assert Model.named(str(tmp_path / "model.toml")).preset == preset


@pytest.mark.parametrize("preset", presets)
def test_what_a_file_leaves_out_is_the_presets_own(tmp_path: Path, preset: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text(f'preset = "{preset}"\n[motion]\ninitial_speed_std = 0.7\n', encoding="utf-8")
    found, own = Model.load(path).parameters, Model(preset).parameters
    assert found == replace(own, motion=replace(own.motion, initial_speed_std=0.7))


def test_presets_estimate_the_orientations_that_they_name() -> None:
    assert {name: (Model(name).has_body, Model(name).has_head) for name in presets} == {
        "position": (False, False),
        "separate": (True, True),
        "joint": (True, True),
        "intentional": (False, True),
        "joint-intentional": (True, True),
        "full": (True, True),
        "social": (True, True),
        "joint-place": (True, True),
        "joint-body": (True, True),
    }


@pytest.mark.parametrize("name", ["jiont", "model.json", "", "folder/position"])
def test_an_unknown_name_is_answered_with_the_known_ones(name: str) -> None:
    with pytest.raises(InputError, match="position, separate, joint") as caught:
        Model.named(name)
    assert repr(name) in str(caught.value)
    with pytest.raises(InputError, match="position, separate, joint"):
        Model(name)


@pytest.mark.parametrize("value", ["7", "true", '"unknown"', '["joint"]'])
def test_a_preset_that_is_none_is_named(tmp_path: Path, value: str) -> None:
    assert "position, separate, joint" in str(refused(tmp_path, f"preset = {value}\n"))


@pytest.mark.parametrize(
    ("text", "found"), [("[motoin]\n", "the unknown table 'motoin'"), ("foo = 1\n", "the unknown key 'foo'")]
)
def test_an_unknown_table_or_key_is_named(tmp_path: Path, text: str, found: str) -> None:
    error = refused(tmp_path, text)
    assert error.found == found
    assert "preset" in error.expected and "motion, orientation, coupling, gait, likelihood" in error.expected


@pytest.mark.parametrize("text", ["motion = 3\n", "[[motion]]\nacceleration_density = 1.0\n"])
def test_what_should_be_a_table_is_named(tmp_path: Path, text: str) -> None:
    assert refused(tmp_path, text).expected == "a table [motion]"


@pytest.mark.parametrize("text", ["", "[motion]\ninitial_speed_std = 0.7\n"])
def test_a_file_without_a_preset_has_the_one_that_no_file_at_all_has(tmp_path: Path, text: str) -> None:
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    default = Model.named(None)
    found = Model.named(path)
    assert found.preset == default.preset
    assert found.parameters.likelihood == default.parameters.likelihood
    assert Model.load(path).preset == Model.named(None).preset == "full"


def small_tracks() -> gt.TrackSet:
    """People seen by angles and by classes, at even and uneven times, in metres and pixels, with gaps."""
    camera = GroundCamera.from_homography(np.array([[0.02, 0, -5], [0, -0.02, 30], [0, 0.002, 0.2]]))
    tracks = [walk(20, seed=1), walk(20, seed=2, classes=True, uneven=True, dt=0.04, track_id=2)]
    tracks.append(walk(20, seed=3, dt=0.4, track_id=3))
    tracks[2] = replace(tracks[2], pixel=camera.ground_to_image(tracks[2].position))
    unseen = (np.arange(20) > 7) & (np.arange(20) < 12)
    hidden = [replace(track, position=np.where(unseen[:, None], np.nan, track.position)) for track in tracks]
    return gt.TrackSet(tuple(hidden), camera=camera)


@pytest.mark.parametrize("preset", sorted(presets))
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


def test_a_value_beyond_its_range_is_refused_with_the_range_and_its_unit(tmp_path: Path) -> None:
    error = refused(tmp_path, "[motion]\nacceleration_density = 1e-300\n")
    assert error.found == "motion.acceleration_density = 1e-300"
    assert error.expected == "a number in [1e-05, 10000] m²/s³"


@pytest.mark.parametrize("table", ["motion", "orientation", "coupling", "likelihood"])
def test_an_unknown_key_is_named_with_its_table(tmp_path: Path, table: str) -> None:
    error = refused(tmp_path, f"[{table}]\nspeling = 1.0\n")
    assert f"{table}.speling" in error.found
    assert all(f.name in error.expected for f in dataclasses.fields(getattr(Parameters(), table)))


def test_a_value_that_is_no_number_in_range_is_named(tmp_path: Path) -> None:
    for (table, key), (low, high) in NUMBERS.items():
        outside = [repr(value) for value in (low - 1e-3 * (1.0 + abs(low)), 2.0 * high)]
        for value in (*outside, "nan", "inf", "-inf", "1e300", "true", '"1.0"', "[1.0]", "{}"):
            error = refused(tmp_path, f"[{table}]\n{key} = {value}\n")
            assert f"{table}.{key} = " in error.found, value
            assert "a number in " in error.expected


def test_zero_is_refused_where_it_divides_and_taken_elsewhere(tmp_path: Path) -> None:
    for (table, key), (low, _) in NUMBERS.items():
        text = f"[{table}]\n{key} = 0.0\n"
        if low > 0.0:
            assert f"{table}.{key}" in refused(tmp_path, text).found
        else:
            assert getattr(getattr(load(tmp_path, text).parameters, table), key) == 0.0


@pytest.mark.parametrize(
    ("key", "value"), [("robust", '"tukey"'), ("robust", "true"), ("robust", "[]"), ("image_frame", "1")]
)
def test_options_that_are_no_numbers_are_checked_too(tmp_path: Path, key: str, value: str) -> None:
    assert f"likelihood.{key} = " in refused(tmp_path, f"[likelihood]\n{key} = {value}\n").found


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
