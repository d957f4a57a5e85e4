"""`Method`: a method that is compared with others of its kind, on tracks, detections or groups."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from graphtrack.errors import InputError

MethodGroup = Literal["online", "offline"]
Settings = TypeVar("Settings")


@dataclass(frozen=True)
class Method:
    """A method that is compared with others of its kind.

    Attributes
    ----------
    name : short and unique
    online : True if each estimate uses only the past; online and offline methods are not compared with each
        other
    information : description of the observations used, such as "positions, body, head; past only"
    run : in `compare` a function of a track and its camera (or None) that returns the track with estimates,
        one for each frame; None in channels that are not estimated. In `compare_trackers` detections of a
        recording → tracks; an online tracker assigns a frame's identities at once and never revises them. In
        `compare_groups` tracks → labels (n,) of the rows of `people_of`; members of a group share one within
        a frame
    preset : of its model; "" without one
    """

    name: str
    online: bool
    information: str
    run: Callable[..., Any]
    preset: str = ""

    @property
    def group(self) -> MethodGroup:
        """Group within which the method is compared."""
        return "online" if self.online else "offline"


def made(
    method: str | Method, registry: Mapping[str, Callable[[Settings], Method]], settings: Settings, where: str
) -> Method:
    """Return a method by its name in a registry; a method is returned unchanged.

    Raises
    ------
    InputError
        For an unknown name; ``where`` precedes the known ones.
    """
    if isinstance(method, Method):
        return method
    if method not in registry:
        raise InputError(f"method {method!r}", f"{where}one of {', '.join(registry)}")
    return registry[method](settings)


def compared(
    methods: Sequence[str | Method], make: Callable[[str | Method], Method], known: Iterable[str]
) -> list[Method]:
    """Return methods of names or of a user; InputError without any, or with two of the same name."""
    found = [make(method) for method in ([methods] if isinstance(methods, str) else methods)]
    names = [method.name for method in found]
    if not names:
        raise InputError("no methods", f"one or more of {', '.join(known)}")
    if len(set(names)) != len(names):
        raise InputError(f"methods {', '.join(names)}", "each method once")
    return found
