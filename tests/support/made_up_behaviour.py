"""Small groups, attention and forecasts for the tests of the report."""

import numpy as np

from graphtrack.forecasting.recorded import Forecasts
from graphtrack.interaction.attention import Attention
from graphtrack.interaction.groups import Groups
from graphtrack.interaction.people import Place
from graphtrack.tracks.track import Track, TrackSet

BAR = Place("bar", np.array([[4.0, 3.0]]), 0.5)
SCREEN = Place("screen", np.array([[0.0, 6.0], [2.0, 6.0], [2.0, 6.2], [0.0, 6.2]]))

AHEAD = np.array([0.4, 0.8, 1.2, 1.6])


def standing(people: int = 4, n: int = 20, start: float = 0.0, hz: float = 2.5) -> TrackSet:
    """People, numbered from 1, who stand in a row, a metre apart."""
    t = start + np.arange(n) / hz
    return TrackSet(
        tuple(
            Track(one, np.arange(n), t, np.tile([float(one), 0.0], (n, 1)), head=np.zeros(n))
            for one in range(1, people + 1)
        )
    )


def grouped(tracks: TrackSet, probability: float = 0.9) -> Groups:
    """Persons 1 and 2 in conversation as group 0, all other people alone."""
    person = np.concatenate([np.full(len(track), track.track_id) for track in tracks])
    frame = np.concatenate([track.frame for track in tracks])
    t = np.concatenate([track.t for track in tracks])
    inside = person <= 2
    centre = np.where(inside[:, None], [1.5, 0.0], np.nan)
    number = np.where(inside, 0, -1)
    found = (frame, t, person, number, inside.astype(int), np.full(len(person), probability), centre)
    order = np.lexsort((person, frame))
    return Groups(*(column[order] for column in found))


def looking(tracks: TrackSet, places: tuple[Place, ...] = ()) -> list[Attention]:
    """Each person looks at the next (0.6), at the first place (0.2) if there is one, and at nothing."""
    found = []
    ids = [track.track_id for track in tracks]
    for k, track in enumerate(tracks):
        others = tuple(one for one in ids if one != track.track_id)
        share = np.zeros((len(track), len(others) + len(places) + 1))
        share[:, others.index(ids[(k + 1) % len(ids)])] = 0.6
        if places:
            share[:, len(others)] = 0.2
        share[:, -1] = 1.0 - share.sum(axis=1)
        names = tuple(place.name for place in places)
        found.append(Attention(track.track_id, track.frame, track.t, others, names, share))
    return found


def forecast(tracks: TrackSet, every: int = 2) -> Forecasts:
    """In every second frame: each person goes along x with 1 m/s."""
    made = [(track, k) for track in tracks for k in range(0, len(track), every)]
    count = len(AHEAD)
    ahead = np.tile(AHEAD, len(made))
    start = np.repeat([track.position[k] for track, k in made], count, axis=0)
    columns = {
        "track_id": np.repeat([track.track_id for track, _ in made], count),
        "frame": np.repeat([track.frame[k] for track, k in made], count),
        "t": np.repeat([track.t[k] for track, k in made], count),
        "ahead": ahead,
        "x": start[:, 0] + ahead,
        "y": start[:, 1],
        "x_std": 0.2 * ahead,
        "y_std": 0.2 * ahead,
        "xy_cov": 0.0 * ahead,
        "radius_50": 0.25 * ahead,
        "radius_90": 0.5 * ahead,
    }
    return Forecasts(columns, len(tracks))
