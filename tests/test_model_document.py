"""The pages about the model agree with the code, where that can be checked."""

import importlib.util
import inspect
import re
from dataclasses import fields

import numpy as np
import pytest
from documents import ROOT

from graphtrack.learning.scene import SET
from graphtrack.model import Model, Parameters, factors, presets
from graphtrack.model.model import default_parameters
from graphtrack.model.observation import chain
from graphtrack.model.parameters import range_of
from graphtrack.model.terms import couplings, motion, orientation, position
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.scene import SceneParameters

DOCUMENT = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
EXPLANATIONS = DOCUMENT + "".join(
    path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs" / "model").glob("*.md"))
)


def hook(name):
    """Import a hook of the documentation site."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "hooks" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


PARAMETERS = hook("parameters").page()


def rows(heading, text):
    section = text.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return [
        [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))]
        for line in section.splitlines()
        if line.startswith("|") and not line.startswith("|---")
    ][1:]


def number(text):
    """A number as the tables have it, such as 0.15, 10⁻⁵, 5·10⁻⁴ or π."""
    factor, _, power = text.rpartition("·")
    plain = power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    if plain != power:
        sign, _, exponent = plain.replace("−", "-").partition("10")
        return float(factor or 1) * float(f"{sign}1") * 10.0 ** float(exponent)
    return np.pi if text == "π" else float(text)


@pytest.mark.parametrize("group", [field.name for field in fields(Parameters)])
def test_every_parameter_stands_there_with_its_default_and_range(group):
    values = getattr(Parameters(), group)
    found = {cells[0].strip("`"): cells[1:] for cells in rows(group, PARAMETERS)}
    assert list(found) == [one.name for one in fields(values)]
    for name, (meaning, _, default, limits, _) in found.items():
        assert len(meaning) > 3, name
        allowed = range_of(values, name)
        assert [number(cell) for cell in limits.split(" to ") if cell] == pytest.approx(allowed or []), name
        value = getattr(values, name)
        if isinstance(value, bool | str):
            assert default == str(value).lower(), name
        else:
            assert number(default) == pytest.approx(value), name


def test_every_parameter_of_a_scene_stands_there_with_its_unit_default_and_range():
    found = {cells[0].strip("`"): cells[2:] for cells in rows("scene", PARAMETERS)}
    assert list(found) == [one.name for one in fields(SceneParameters)]
    for one in fields(SceneParameters):
        unit, default, limits, learned = found[one.name]
        assert unit == (one.metadata["unit"] or "–")
        assert number(default) == pytest.approx(one.default)
        assert [number(cell) for cell in limits.split(" to ")] == pytest.approx(one.metadata["range"])
        assert (learned == "yes") == (one.name not in SET)


def test_the_defaults_of_presets_that_differ_are_named():
    found = {cells[0].strip("`"): cells[1] for cells in rows("Defaults of presets", PARAMETERS)}
    assert set(found) == set(presets)
    motion_of = {name: default_parameters(name).motion for name in presets}
    for name, parameters in motion_of.items():
        density = parameters.acceleration_density
        differs = density != Parameters().motion.acceleration_density
        assert (f"`motion.acceleration_density` = {density:g}" in found[name]) == differs
    assert found["separate"] == "–"


def test_every_preset_stands_there():
    assert {name.strip("`") for name, _ in rows("Presets", DOCUMENT)} == set(presets)


def test_every_term_of_the_presets_stands_there():
    found = " ".join(row[1] for row in rows("Terms", DOCUMENT))
    for terms in presets.values():
        for term in terms:
            assert f"`{term.__name__}`" in found


def test_native_factors_are_those_that_are_named():
    rng = np.random.default_rng(0)
    track = next(iter(simulate("joint", n_tracks=1, n_steps=3, rng=rng)))
    made = {type(factor).__name__ for step in chain(track) for factor in Model("joint").factors(step)}
    named = set(re.findall(r"native: `(\w+)`", DOCUMENT))
    # Robust noise models and mixtures aside, an ordinary track needs one derived factor: the coupling.
    assert made == named | {"CustomFactor"}
    for module in (factors, couplings, motion, orientation, position):
        for name in re.findall(r"gtsam\.((?:Frobenius|Wnoa|Prior)\w+)", inspect.getsource(module)):
            assert name in named


def test_robust_defaults_are_those_that_are_stated():
    social = default_parameters("social").likelihood
    assert f"$\\varepsilon = {social.body_outliers:g}$ for angles" in EXPLANATIONS
    assert {default_parameters(name).likelihood.robust for name in presets} == {"none"}
