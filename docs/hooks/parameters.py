"""Write the tables of the model's parameters from the code, when the site is built."""

from __future__ import annotations

import re
from dataclasses import Field, fields
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from graphtrack.learning.scene import SET
from graphtrack.model import Parameters, presets
from graphtrack.model.model import default_parameters
from graphtrack.tracks.scene import SceneParameters

ENTRY = re.compile(r"^    (?P<names>\w+(?:, \w+)*) : (?P<text>.*(?:\n        .*)*)", flags=re.M)
INTRODUCTION = """# Parameters

A model file is TOML. `preset` names a preset (default: `joint`); each table below is a table of the file.
A key that is left out keeps the default of its preset. A value outside its range is an error. Symbols
are those of [the model](../model.md).

```toml
preset = "joint"

[motion]
acceleration_density = 0.3

[scene]
detection_probability = 0.85
```

`gt.Model(preset, parameters).save("model.toml")` writes a file and `gt.Model.load` reads it; a model
with terms of your own cannot be saved. *Learned* says if `graphtrack fit` can fit the parameter to
a truth. One that is 0 in the starting model is switched off and stays 0.
"""
SCENE = """
## scene

Birth, death, detection and clutter of people, for [detections without
identities](../tracking.md#detections-without-identities): used by `smooth`, `info`, `track` and `compare
--truth` with `--model`, and by `gt.smooth`, `gt.associate(…, model=…)` and `gt.OnlineTracker(…)`. A
value in the file is kept; a missing one is learned from the recording if it can be, else it has the
default below. `scene=` in Python overrides the file. How birth, death and clutter rates vary over the
ground is always learned from the recording. Probabilities and rates of a frame hold at the detector's
frame rate.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page."""
    files.append(File.generated(config, "reference/parameters.md", content=page()))
    return files


def page() -> str:
    """Return a table for each group of parameters, and one of the defaults that presets change."""
    parts = [INTRODUCTION]
    for group in fields(Parameters):
        values = getattr(Parameters(), group.name)
        summary = (type(values).__doc__ or "").partition("\n")[0].partition(" (docs/")[0].rstrip(".")
        parts += [f"\n## {group.name}\n", f"{summary}.\n", *table(values)]
    parts += ["\n## Defaults of presets\n", *differences(), SCENE, *table(SceneParameters())]
    return "\n".join(parts) + "\n"


def table(values: Any) -> list[str]:
    """Return the lines of the table of one group."""
    meanings = described(values)
    lines = ["| parameter | meaning | unit | default | range | learned |", "|---|---|---|---|---|---|"]
    for one in fields(values):
        limits, unit = one.metadata.get("range"), one.metadata.get("unit")
        shown = f"{number(limits[0])} to {number(limits[1])}" if limits else ""
        cells = [
            f"`{one.name}`",
            meanings[one.name].replace(f", {unit}", "", 1) if unit else meanings[one.name],
            unit or "–",
            number(getattr(values, one.name)),
            shown,
            "yes" if is_learned(values, one) else "",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def is_learned(values: Any, one: Field[Any]) -> bool:
    """Return True if `graphtrack fit` can fit a parameter to a truth, or learn it of a scene."""
    if isinstance(values, SceneParameters):
        return one.name not in SET
    return bool(one.metadata.get("learned"))


def described(values: Any) -> dict[str, str]:
    """Return the meaning of each field, from the section Attributes of the class's docstring."""
    found = {}
    for entry in ENTRY.finditer(type(values).__doc__ or ""):
        for name in entry["names"].split(", "):
            found[name] = " ".join(entry["text"].split()).replace("``", "`").replace("|", r"\|")
    return found


def differences() -> list[str]:
    """Return a table of the defaults that differ from those above, for each preset."""
    lines = ["| preset | differs in |", "|---|---|"]
    for preset in presets:
        changed = [
            f"`{group.name}.{one.name}` = {number(getattr(getattr(own, group.name), one.name))}"
            for own in [default_parameters(preset)]
            for group in fields(own)
            for one in fields(getattr(own, group.name))
            if getattr(getattr(own, group.name), one.name)
            != getattr(getattr(Parameters(), group.name), one.name)
        ]
        lines.append(f"| `{preset}` | {', '.join(changed) or '–'} |")
    return lines


def number(value: Any) -> str:
    """Return a number as tables have it, such as 0.15, 10⁻⁵ or π."""
    if isinstance(value, bool | str):
        return str(value).lower()
    if value == 0.0 or 1e-3 < abs(value) < 1e3:
        return "π" if abs(value - 3.141592653589793) < 1e-12 else f"{value:g}"
    mantissa, _, exponent = f"{value:e}".partition("e")
    power = "10" + str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    digits = f"{float(mantissa):g}".replace("-", "−")
    return {"1": power, "−1": f"−{power}"}.get(digits, f"{digits}·{power}")
