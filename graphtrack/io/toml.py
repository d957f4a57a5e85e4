"""TOML files: models and parameters."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from graphtrack.errors import InputError


def read_toml(path: str | Path, expected: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Parameters
    ----------
    path : of the file
    expected : what the file should be, for the message
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(error.strerror or str(error), f"a readable file: {expected}", path=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"no TOML ({error})", expected, path=path) from error
    except RecursionError as error:
        raise InputError("brackets within brackets without end", expected, path=path) from error
