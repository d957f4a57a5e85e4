"""Baselines that the graph is compared with."""

from graphtrack.baselines.kalman import kalman_filter, rauch_tung_striebel

__all__ = ["kalman_filter", "rauch_tung_striebel"]
