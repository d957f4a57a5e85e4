"""Boxes of people, and what is made of them: where they stand, and how sure a detector was."""

from __future__ import annotations

import numpy as np

from graphtrack.errors import InputError
from graphtrack.io.cameras import camera_or_scale, known_camera, on_ground
from graphtrack.io.options import ReadOptions
from graphtrack.table.rows import Rows


def placed_boxes(rows: Rows, options: ReadOptions) -> Rows:
    """Rows with positions: their own metres, or the middle of the lower edge of each box on the ground.

    Parameters
    ----------
    rows : with the channel ``box`` (n, 4), left, top, width and height in pixels, NaN where a row has none
    """
    left, top, width, height = rows.channels["box"].T
    pixel = np.column_stack([left + width / 2.0, top + height])
    rows = rows.with_channels(pixel=pixel)
    if "position" in rows.channels:
        camera, notes = known_camera(options, pixel)
        return rows.with_camera(camera).with_notes(*notes, "positions are columns 8 and 9, in metres")
    seen = np.asarray(np.isfinite(pixel).all(axis=1))
    if len(seen) and not seen.any():
        raise InputError("neither boxes nor metres", "one of them", path=rows.path)
    if not len(rows):
        return rows.with_channels(position=pixel)
    camera, notes = camera_or_scale(options, pixel, rows.channels["box"][seen, 3])
    return on_ground(rows, camera, notes)


def with_scores(rows: Rows) -> Rows:
    """Detections with the channel ``score`` (n,), from their confidences; rows with identities as they are.

    A detector's confidences are of any kind. Those from 0 on are taken as they are. Where some are negative,
    such as log odds and distances from a separating plane (the DPM of MOT16), the score of all is
    1 / (1 + exp(-confidence)), which keeps their order; a note says so. -1 throughout says nothing.
    """
    confidence = rows.channels["confidence"]
    if rows.has_identity or (confidence == -1.0).all():
        return rows
    if not (confidence < 0.0).any():
        return rows.with_channels(score=confidence)
    note = "some confidences are negative: scores are 1 / (1 + exp(-confidence))"
    logistic = 0.5 * (1.0 + np.tanh(0.5 * confidence))  # exp would overflow
    return rows.with_channels(score=logistic).with_notes(note)
