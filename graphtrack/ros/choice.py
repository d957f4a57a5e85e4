"""Choice of the topics of a recording to read."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.ros.definitions import IDS, OF_PEOPLE, POSE, POSE_WITH_COVARIANCE

OURS = "/graphtrack/"
"""Prefix of the topics that are written."""

OWN_INPUT = f"{OURS}detections"
"""Of the topics that are written here, that which is read back: it says most."""

_OF_ONE = (POSE, POSE_WITH_COVARIANCE)


def chosen_topics(topics: Mapping[str, str], asked: str | None, path: Path) -> list[str]:
    """The topics to read, all of one type: one, or those of one person each.

    Parameters
    ----------
    topics : of the recording, name → type
    asked : a name, or a pattern for several of one person each; None: the one that tells of people
    """
    known = {name: kind for name, kind in sorted(topics.items()) if kind in OF_PEOPLE}
    if asked is not None:
        found = [name for name in known if name == asked or fnmatch.fnmatchcase(name, asked)]
        if asked in topics and asked not in known:
            types = ", ".join(OF_PEOPLE)
            raise InputError(f"the topic {asked} of {topics[asked]}", f"one of {types}", path=path)
        if not found:
            raise InputError(f"no topic {asked}", f"one of {_listed(known or topics)}", path=path)
    else:
        # Whoever recorded what they observed and what was made of it means the former.
        found = [name for name in known if not name.startswith(OURS)]
        if not found:
            found = [name for name in (OWN_INPUT,) if name in known] or list(known)
        tracked = [name for name in found if topics[name] == IDS]
        if len(found) == len(tracked) > 1:
            # People who are tracked are among those who are known; their faces and bodies are parts of them.
            first = [name for name in tracked if name.endswith("persons/tracked")]
            found = first or found
    if not known:
        types = ", ".join(OF_PEOPLE)
        expected = f"a topic of one of {types}; there are {_listed(topics)}"
        raise InputError("no topic that tells of people", expected, path=path)
    if len(found) > 1 and not (asked is not None and _is_of_each(topics, found)):
        expected = f"--topic with one of {_listed({name: topics[name] for name in found})}"
        raise InputError(f"{len(found)} topics that tell of people", expected, path=path)
    return found


def _is_of_each(topics: Mapping[str, str], found: list[str]) -> bool:
    """Return whether topics are of one person each, and of one type."""
    kinds = {topics[name] for name in found}
    return len(kinds) == 1 and kinds <= {*_OF_ONE}


def is_of_one(kind: str) -> bool:
    """Return whether the messages of a type tell of one person."""
    return kind in _OF_ONE


def _listed(topics: Mapping[str, str]) -> str:
    shown = [f"{name} ({kind})" for name, kind in sorted(topics.items())[:20]]
    return ", ".join(shown) + (" …" if len(topics) > 20 else "") if shown else "no topics at all"
