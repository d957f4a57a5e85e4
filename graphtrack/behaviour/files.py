"""Files of parameters of behaviour."""

from __future__ import annotations

import tomllib
from pathlib import Path

import tomli_w

from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path


def save_parameters(parameters: GroupParameters, path: str | Path) -> None:
    """Write parameters of groups (TOML), whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(tomli_w.dumps({"groups": parameters.to_dict()}), encoding="utf-8")


def load_parameters(path: str | Path) -> GroupParameters:
    """Read parameters of groups (TOML); what is not named is as it was learned.

    Raises
    ------
    InputError
        With the file and the key.
    """
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(error.strerror or str(error), "a readable file of parameters", path=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"no TOML ({error})", "a file of parameters", path=path) from error
    if not isinstance(content.get("groups"), dict):
        raise InputError("no table [groups]", "what 'graphtrack fit --groups' writes", path=path)
    try:
        return GroupParameters.from_dict(content["groups"], DEFAULT)
    except InputError as error:
        raise InputError(error.found, error.expected, path=path) from error
