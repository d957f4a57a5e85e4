"""The tracks of several files as one set."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import replace
from itertools import count
from pathlib import Path

from graphtrack.bounds import LARGEST_ID
from graphtrack.errors import InputError
from graphtrack.table.as_read import merged
from graphtrack.tracks import Track, TrackSet


def merged_tracks(sets: Sequence[TrackSet], paths: Sequence[Path]) -> TrackSet:
    """The tracks of several files, each with an id of its own, and a label if it has none."""
    tracks: list[Track] = []
    taken: set[int] = set()
    numbered: list[dict[int, int]] = []
    renumbered = 0
    _check_kinds(sets, paths)
    for tracks_of_file, path in zip(sets, paths, strict=True):
        # The file's own ids stay with it, so that a new one never takes the place of one to come.
        numbered.append({})
        free = _free_ids(taken | {track.track_id for track in tracks_of_file}, len(tracks_of_file))
        for track in tracks_of_file:
            identity = track.track_id
            if identity in taken:
                identity = next(free)
                renumbered += 1
            taken.add(identity)
            numbered[-1][track.track_id] = identity
            tracks.append(replace(track, track_id=identity, label=track.label or _stem(path)))
    summary = sets[0].summary
    for other in sets[1:]:
        summary = summary.merged(other.summary)
    notes = list(summary.notes)
    if renumbered:
        notes.append(f"{renumbered} tracks renumbered because files use the same ids")
    as_read = merged([(one.as_read, ids) for one, ids in zip(sets, numbered, strict=True)])
    camera = sets[0].camera
    if any(other.camera != camera for other in sets[1:]):
        camera = None
        notes.append("the files have different cameras, so none is kept")
    return TrackSet(tuple(tracks), camera, replace(summary, notes=tuple(notes)), as_read)


def _check_kinds(sets: Sequence[TrackSet], paths: Sequence[Path]) -> None:
    """Refuse files of one table each of which some have numbers for identities and others text."""
    kinds = [bool(one.as_read.names) for one in sets if one.as_read is not None]
    if len(kinds) == len(sets) and len({*kinds}) > 1:
        number, text = paths[kinds.index(False)], paths[kinds.index(True)]
        found = f"identities that are numbers in {number} and text in {text}"
        raise InputError(found, "one kind in all files", path=text)


def _free_ids(used: Set[int], most: int) -> Iterator[int]:
    """Ids that are not used: those after the highest, or where they would end too soon, from 0 on."""
    first = max(used) + 1
    return (k for k in count(first if first + most <= LARGEST_ID else 0) if k not in used)


def _stem(path: Path) -> str:
    # A name need not be UTF-8, but what is written of it must.
    name = path.name.encode(errors="surrogateescape").decode(errors="replace")
    return name.split(".")[0] or name
