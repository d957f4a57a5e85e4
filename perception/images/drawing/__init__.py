"""What is seen and followed, drawn into the frames, as a video or a folder of images."""

from __future__ import annotations

from perception.images.drawing.estimates import draw
from perception.images.drawing.output import check_render, pictures
from perception.images.drawing.people import draw_people, people_by_frame

__all__ = ["check_render", "draw", "draw_people", "people_by_frame", "pictures"]
