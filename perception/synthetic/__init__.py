"""Rendered heads, people and scenes with exact labels. Angles are radians, images uint8 blue green red."""

from __future__ import annotations

from perception.synthetic.cameras import Camera
from perception.synthetic.folders import contact_sheet
from perception.synthetic.heads import HeadSet, HeadVariation, draw_poses, make_heads
from perception.synthetic.pedestrians import PedestrianSet, PedestrianVariation, make_pedestrians
from perception.synthetic.scene import Furniture, Label, Person, RenderedFrame, Scene, render_frame

__all__ = [
    "Camera",
    "Furniture",
    "HeadSet",
    "HeadVariation",
    "Label",
    "PedestrianSet",
    "PedestrianVariation",
    "Person",
    "RenderedFrame",
    "Scene",
    "contact_sheet",
    "draw_poses",
    "make_heads",
    "make_pedestrians",
    "render_frame",
]
