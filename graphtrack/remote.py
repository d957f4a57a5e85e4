"""Files that are named by a URL, on object stores and elsewhere, by the package fsspec (extra ``cloud``)."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from graphtrack.errors import InputError
from graphtrack.later import package

_MARK = "://"


class RemoteFile(type(Path())):  # type: ignore[misc]
    """The path of a file elsewhere: it is there once it is opened, and nothing lies beside it."""

    def __new__(cls, url: str) -> RemoteFile:  # noqa: D102
        made = super().__new__(cls, url)
        made.url = url
        return made

    def __init__(self, url: str) -> None:
        if Path.__init__ is not object.__init__:  # from Python 3.12 on
            super().__init__(url)

    def __str__(self) -> str:
        return vars(self).get("url") or super().__str__()

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (str(self),)

    def open(self, *arguments: Any, **options: Any) -> Any:
        """The content, read whole, as a stream."""
        url = str(self)
        fsspec = package("fsspec", "cloud")
        try:
            with fsspec.open(url, "rb") as stream:
                return io.BytesIO(stream.read())
        except FileNotFoundError as error:
            raise InputError("no such file", "an existing file", path=url) from error
        except ImportError as error:
            said = " ".join(str(error).split())
            expected = "fsspec's packages for such URLs (for http: pip install requests aiohttp)"
            raise InputError(said, expected, path=url) from error
        except Exception as error:  # each store has errors of its own
            said = " ".join(str(error).split()) or type(error).__name__
            raise InputError(said, "the URL of a file that can be read", path=url) from error


def place_of(given: str | Path) -> Path:
    """A path, or what a URL such as ``s3://bucket/tracks.parquet`` names."""
    if isinstance(given, RemoteFile):
        return given
    return RemoteFile(given) if isinstance(given, str) and _MARK in given else Path(given)
