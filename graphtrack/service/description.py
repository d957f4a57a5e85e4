"""OpenAPI description of the service, with JSON Schemas of rows and answers, and pages made of it.

``assets/openapi.json`` has all that no column of a row or an answer decides.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any, get_args

from jinja2 import Environment, PackageLoader, select_autoescape

from graphtrack import __version__
from graphtrack.inference.state import Status
from graphtrack.model.observation import CHANNELS
from graphtrack.service.client import STREAM_NAME
from graphtrack.tracks.schema import BY_NAME, INTEGERS, Column
from graphtrack.tracks.validation import SMALLEST

_ANSWERED = ("position", "velocity", "covariance")
_ANGLES = ("body_deg", "head_deg")


@cache
def openapi() -> dict[str, Any]:
    """Return the description of the service as an OpenAPI 3.1 document."""
    document: dict[str, Any] = json.loads((files(__package__) / "assets" / "openapi.json").read_text("utf-8"))
    document["info"]["version"] = __version__
    (name,) = document["paths"]["/v1/streams/{name}"]["parameters"]
    name["schema"]["pattern"] = f"^{STREAM_NAME.pattern}$"
    row, answer = (document["components"]["schemas"][kind]["properties"] for kind in ("Row", "Answer"))
    columns = BY_NAME.values()
    row |= {key: {"type": "integer", "minimum": -most, "maximum": most} for key, most in INTEGERS.items()}
    row |= {column.name: _number(column) for column in columns if column.field in CHANNELS}
    answer |= {key: {"type": ["integer", "null"]} for key in INTEGERS}
    row["track_id"]["type"], answer["track_id"]["type"] = ["integer", "string"], ["integer", "string", "null"]
    answer |= {column.name: _number(column) for column in columns if column.field in _ANSWERED}
    answer |= {key: _number(BY_NAME[key]) for key in _ANGLES}
    answer["status"] = {"type": "string", "enum": list(get_args(Status))}
    return document


def _number(column: Column) -> dict[str, Any]:
    bounds = column.bounds
    least = {"exclusiveMinimum": 0.0} if bounds.low == SMALLEST else {"minimum": bounds.low}
    return {"type": ["number", "null"], **least, "maximum": bounds.high}


def text() -> str:
    """Return the addresses as text, for the root."""
    return _rendered("addresses.txt")


def page() -> str:
    """Return the description as an HTML page that loads nothing else."""
    return _rendered("page.html")


def addresses() -> list[tuple[str, str, str]]:
    """Return the method, the path and the summary of each address."""
    return [
        (method.upper() if "101" not in call["responses"] else "WS", path, call["summary"])
        for path, calls in openapi()["paths"].items()
        for method, call in calls.items()
        if method != "parameters"
    ]


@cache
def _rendered(template: str) -> str:
    loader = PackageLoader("graphtrack.service", "assets")
    made = Environment(
        loader=loader,
        autoescape=select_autoescape(),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return made.get_template(template).render(openapi(), addresses=addresses())
