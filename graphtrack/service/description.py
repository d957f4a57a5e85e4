"""OpenAPI description of the service, with JSON Schemas of rows and answers, and a page made of it."""

from __future__ import annotations

import html
from collections.abc import Sequence
from functools import cache
from typing import Any, get_args

from graphtrack import __version__
from graphtrack.inference.state import Status
from graphtrack.model.observation import CHANNELS
from graphtrack.service.settings import STREAM_NAME
from graphtrack.tracks.schema import BY_NAME, INTEGERS, Column
from graphtrack.tracks.validation import SMALLEST

_ESTIMATED = ("velocity", "covariance", "aligned_p", "gait_offset", "glance_p")
_NAME = {
    "name": "name",
    "in": "path",
    "required": True,
    "description": "the stream",
    "schema": {"type": "string", "pattern": f"^{STREAM_NAME.pattern}$"},
}
_NDJSON = "application/x-ndjson"
_TEXT = """graphtrack serve: streams of positions in, estimates out.

{}

  curl --data-binary @rows.ndjson http://HOST:PORT/v1/streams/hall

Documentation: docs/serve.md of the source; graphtrack serve --help
"""


def row_schema() -> dict[str, Any]:
    """JSON Schema of a row of a stream."""
    columns = [column for column in BY_NAME.values() if column.field in CHANNELS]
    return {
        "type": "object",
        "description": "Observation of one person in one frame; a key without a value was not observed.",
        "required": ["track_id", "frame"],
        "properties": {
            **{
                name: {"type": "integer", "minimum": -largest, "maximum": largest}
                for name, largest in INTEGERS.items()
            },
            "t": {"type": "number", "description": "seconds; needed without --fps"},
            **{column.name: _number(column) for column in columns},
        },
        "patternProperties": {"^(input_|appearance)": {"type": ["number", "null"]}},
    }


def answer_schema() -> dict[str, Any]:
    """JSON Schema of an answer to a row: an estimate, or an error."""
    columns = [column for column in BY_NAME.values() if column.field in ("position", *_ESTIMATED)]
    angles = [BY_NAME[name] for name in ("body_deg", "head_deg")]
    return {
        "type": "object",
        "description": "Estimate of the latest time of a person, or the error of a row that was not used.",
        "required": ["track_id", "frame"],
        "properties": {
            **{name: {"type": ["integer", "null"]} for name in INTEGERS},
            "t": {"type": "number", "description": "seconds"},
            **{column.name: _number(column) for column in (*columns, *angles)},
            "status": {"enum": list(get_args(Status))},
            "reason": {"type": "string", "description": "why the status is failed"},
            "error": {"type": "string"},
            "line": {"type": "integer", "description": "line of the row with the error, from 1"},
        },
    }


def _number(column: Column) -> dict[str, Any]:
    bounds = column.bounds
    least = {"exclusiveMinimum": 0.0} if bounds.low == SMALLEST else {"minimum": bounds.low}
    return {"type": ["number", "null"], **least, "maximum": bounds.high}


@cache
def openapi() -> dict[str, Any]:
    """Return the description of the service as an OpenAPI 3.1 document."""
    error = _content("application/json", {"$ref": "#/components/schemas/Error"})
    refused = {"4XX": {"description": "refused", **error}, "503": {"description": "stopping", **error}}
    rows, answers = ({"$ref": f"#/components/schemas/{name}"} for name in ("Row", "Answer"))
    stream = {
        "post": {
            "summary": "Send rows as NDJSON, receive answers as NDJSON.",
            "requestBody": {"required": True, **_content(_NDJSON, rows)},
            "responses": {"200": {"description": "answers", **_content(_NDJSON, answers)}, **refused},
        },
        "delete": {
            "summary": "Remove the state of a stream that has no connection.",
            "responses": {"204": {"description": "removed"}, **refused},
        },
        "get": {
            "summary": "WebSocket: a row or several lines a message in, an answer a message out.",
            "responses": {"101": {"description": "WebSocket"}, **refused},
        },
        "parameters": [_NAME],
    }
    plain = {
        "/": ("Addresses as text.", "text/plain", {}),
        "/docs": ("This description as a page.", "text/html", {}),
        "/openapi.json": ("This description.", "application/json", {}),
        "/health": ("Return that the process runs; no token.", "application/json", {}),
        "/ready": (
            "Return whether streams can be opened; no token.",
            "application/json",
            {"503": refused["503"]},
        ),
        "/version": ("Version of the service; no token.", "application/json", {}),
        "/metrics": ("Counters for Prometheus.", "text/plain", {"4XX": refused["4XX"]}),
        "/v1/streams": ("Names of the open streams.", "application/json", {"4XX": refused["4XX"]}),
    }
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "graphtrack serve",
            "version": __version__,
            "description": "Observations of people in; estimates of position, velocity, body and head out.",
        },
        "security": [{}, {"token": []}],
        "paths": {
            "/v1/streams/{name}": stream,
            **{
                path: {
                    "get": {
                        "summary": summary,
                        "responses": {"200": {"description": "as described", **_content(kind, {})}, **more},
                    }
                }
                for path, (summary, kind, more) in plain.items()
            },
        },
        "components": {
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
            "schemas": {
                "Row": row_schema(),
                "Answer": answer_schema(),
                "Error": {
                    "type": "object",
                    "required": ["error"],
                    "properties": {"error": {"type": "string"}},
                },
            },
        },
    }


def _content(kind: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {"content": {kind: {"schema": schema}}}


_STYLE = (
    ":root{color-scheme:light dark}"
    "body{font:16px/1.5 system-ui,sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;width:100%}"
    "td,th{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #8884}"
    "code{font-size:.9em}"
)


def addresses() -> list[tuple[str, str, str]]:
    """Return method, path and summary of each call."""
    return [
        (method.upper() if "101" not in call["responses"] else "WS", path, call["summary"])
        for path, calls in openapi()["paths"].items()
        for method, call in calls.items()
        if method != "parameters"
    ]


def text() -> str:
    """Return the addresses as text, for the root."""
    lines = (
        f"{method:6} {path.replace('{name}', 'NAME'):16}  {summary}" for method, path, summary in addresses()
    )
    return _TEXT.format("\n".join(lines))


@cache
def page() -> str:
    """Return the description as an HTML page that loads nothing else."""
    document = openapi()
    parts = [_table(("method", "address", ""), addresses())]
    for name, schema in document["components"]["schemas"].items():
        rows = [(key, _type(value), _range(value)) for key, value in schema["properties"].items()]
        parts.append(f"<h2>{name}</h2><p>{html.escape(schema.get('description', ''))}</p>")
        parts.append(_table(("key", "type", ""), rows))
    title = html.escape(f"{document['info']['title']} {document['info']['version']}")
    return (
        f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{title}</title><style>{_STYLE}</style>"
        f"<h1>{title}</h1><p>{html.escape(document['info']['description'])} "
        f"<a href='openapi.json'>openapi.json</a></p>{''.join(parts)}</html>"
    )


def _type(value: dict[str, Any]) -> str:
    kinds = value.get("type", "")
    return kinds if isinstance(kinds, str) else " or ".join(kinds)


def _range(value: dict[str, Any]) -> str:
    if "enum" in value:
        return ", ".join(value["enum"])
    if "maximum" in value and "description" not in value:
        least = f"{value['minimum']:g} to" if "minimum" in value else "above 0, up to"
        return f"{least} {value['maximum']:g}"
    return str(value.get("description", ""))


def _table(headings: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = ["<table><tr>", *(f"<th>{heading}</th>" for heading in headings), "</tr>"]
    for first, second, third in rows:
        cells = f"<td><code>{html.escape(first)}</code></td><td><code>{html.escape(second)}</code></td>"
        lines.append(f"<tr>{cells}<td>{html.escape(third)}</td></tr>")
    return "".join([*lines, "</table>"])
