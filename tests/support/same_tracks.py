"""Comparison of sets of tracks to the last bit."""

from dataclasses import fields

import numpy as np

from graphtrack.tracks.track import Track, TrackSet

ANGLES = ("body", "head", "true_body", "true_head")


def assert_same(
    one: TrackSet, other: TrackSet, *, but: tuple[str, ...] = (), in_degrees: bool = False
) -> None:
    """Every attribute of every track, those named in ``but`` apart.

    Parameters
    ----------
    in_degrees : angles went through degrees, which costs them their last bits
    """
    assert [track.track_id for track in one] == [track.track_id for track in other]
    for first, second in zip(one, other, strict=True):
        for name in (field.name for field in fields(Track) if field.name not in but):
            mine, others = getattr(first, name), getattr(second, name)
            if name == "inputs":
                assert set(mine) == set(others)
                for key in mine:
                    np.testing.assert_array_equal(mine[key], others[key], err_msg=key)
            elif mine is None or others is None or not isinstance(mine, np.ndarray):
                assert mine is others or mine == others, name
            elif in_degrees and name in ANGLES:
                np.testing.assert_allclose(mine, others, rtol=1e-14, err_msg=name)
            else:
                np.testing.assert_array_equal(mine, others, err_msg=name)
