"""docs/model.md says what the code does, where that can be checked."""

import inspect
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from graphtrack.learning.scene import SET
from graphtrack.model import Model, Parameters, factors, presets
from graphtrack.model.observation import chain
from graphtrack.model.parameters import range_of
from graphtrack.model.terms import head_follows_body, motion, pose, position, turning
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.scene import SceneParameters

DOCUMENT = (Path(__file__).resolve().parents[1] / "docs" / "model.md").read_text(encoding="utf-8")


def rows(heading):
    section = DOCUMENT.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in section.splitlines()
        if line.startswith("| ") and not line.startswith("|---")
    ][1:]


def number(text):
    """A number as the tables have it, such as 0.15, 10⁻⁵ or π."""
    power = text.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
    if power != text:
        sign, _, exponent = power.replace("−", "-").partition("10")
        return float(f"{sign}1") * 10.0 ** float(exponent)
    return np.pi if text == "π" else float(text)


def test_every_parameter_stands_there_with_its_default_and_range():
    parameters = Parameters()
    groups = [field.name for field in fields(parameters)]
    defaults = {
        f"`{group}.{field.name}`": getattr(getattr(parameters, group), field.name)
        for group in groups
        for field in fields(getattr(parameters, group))
    }
    told = {name: default for name, _, _, default, _ in rows("Parameters")}
    assert told.keys() == defaults.keys()
    for name, *_, limits in rows("Parameters"):
        group, key = name.strip("`").split(".")
        allowed = range_of(getattr(parameters, group), key)
        assert [number(cell) for cell in limits.split(" to ") if cell] == pytest.approx(allowed or []), name
    for name, default in defaults.items():
        if isinstance(default, bool | str):
            assert told[name] == str(default).lower(), name
        else:
            assert float(told[name]) == pytest.approx(default), name


def test_every_parameter_of_a_scene_stands_there_with_its_unit_default_and_range():
    told = {name.strip("`"): cells for name, _, *cells in rows("The scene")}
    assert list(told) == [f"scene.{one.name}" for one in fields(SceneParameters)]
    for one in fields(SceneParameters):
        unit, default, limits, learned = told[f"scene.{one.name}"]
        assert unit == (one.metadata["unit"] or "–") and number(default) == pytest.approx(one.default)
        assert [number(cell) for cell in limits.split(" to ")] == pytest.approx(one.metadata["range"])
        assert (learned == "yes") == (one.name not in SET)


def test_every_preset_and_term_stands_there():
    assert {name.strip("`") for name, _ in rows("Presets")} == set(presets)
    told = " ".join(row[1] for row in rows("Terms"))
    assert all(f"`{term.__name__}`" in told for terms in presets.values() for term in terms)


def test_native_factors_are_those_that_are_named():
    rng = np.random.default_rng(0)
    track = next(iter(simulate("joint", n_tracks=1, n_steps=3, rng=rng)))
    made = {type(factor).__name__ for step in chain(track) for factor in Model("joint").factors(step)}
    named = set(re.findall(r"native: `(\w+)`", DOCUMENT))
    # Robust noise models and mixtures aside, an ordinary track needs one derived factor: the coupling.
    assert made == named | {"CustomFactor"}
    for module in (factors, head_follows_body, motion, turning, pose, position):
        for name in re.findall(r"gtsam\.((?:Frobenius|Wnoa|Prior)\w+)", inspect.getsource(module)):
            assert name in named
