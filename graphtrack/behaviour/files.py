"""Files of parameters of behaviour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from graphtrack.behaviour.attention import AttentionParameters
from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.bounds import with_table
from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from graphtrack.io.toml import read_toml

Made = TypeVar("Made", GroupParameters, AttentionParameters)


def save_parameters(parameters: GroupParameters | AttentionParameters, path: str | Path) -> None:
    """Write parameters of groups or of attention (TOML), whole or not at all."""
    if isinstance(parameters, AttentionParameters):
        content = {"attention": asdict(parameters)}
    else:
        content = {"groups": parameters.to_dict()}
    with atomic_path(path) as temporary:
        temporary.write_text(tomli_w.dumps(content), encoding="utf-8")


def load_parameters(path: str | Path) -> GroupParameters:
    """Read parameters of groups (TOML); what is not named is as it was learned.

    Raise InputError with the file and the key.
    """
    return _loaded(path, "groups", lambda table: GroupParameters.from_dict(table, DEFAULT))


def load_attention(path: str | Path) -> AttentionParameters:
    """Read parameters of attention (TOML); what is not named is as by default.

    Raise InputError with the file and the key.
    """
    return _loaded(path, "attention", lambda table: with_table(AttentionParameters(), "attention", table))


def _loaded(path: str | Path, name: str, made: Callable[[dict[str, Any]], Made]) -> Made:
    """Return parameters made of a file's table; errors name the file."""
    table = read_toml(path, "a file of parameters").get(name)
    try:
        if not isinstance(table, dict):
            raise InputError(f"no table [{name}]", f"what 'graphtrack fit --{name}' writes")
        return made(table)
    except InputError as error:
        raise InputError(error.found, error.expected, path=path) from error
