"""Views of the ground by a camera that moves: one camera a frame, with the uncertainty of its motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera, apply_homography
from graphtrack.geometry.poses import PosePath
from graphtrack.io.options import PoseAxes, ReadOptions
from graphtrack.io.poses import read_poses
from graphtrack.tracks.display import listed
from graphtrack.tracks.moving import EVERY, NO_POSE, UNDECLARED, definite, nearby
from perception.ground.camera_motion import ImageMotion, Lost, spread, transported
from perception.images.frames import Clock

NO_HOMOGRAPHY = "in a frame without a homography"
NOT_FOLLOWED = "in a frame in which the camera's motion is not known"
DECLARED = f"positions declare {UNDECLARED[0]:g} m and the uncertainty of the camera's motion"
"""Note on the noise of positions by views that are not exact."""


@dataclass(frozen=True, eq=False)
class View:
    """View of the ground in one frame.

    Attributes
    ----------
    camera : over the ground, in world coordinates
    covariance : (9, 9) of E, row by row, in (1 + E)·(the camera's homography); None: exact
    """

    camera: GroundCamera
    covariance: FloatArray | None = None

    def position_covariance(self, position: FloatArray) -> FloatArray | None:
        """Return covariances (n, 2, 2) of observed positions (n, 2), m²; None for an exact view.

        They are the sum of the view's and of the default noise of positions that declare none.
        """
        if self.covariance is None:
            return None
        return definite(spread(self.covariance, position) + UNDECLARED[0] ** 2 * np.eye(2))

    @classmethod
    def moved(cls, camera: GroundCamera, motion: ImageMotion) -> View:
        """Return the view of a frame from the camera of the reference frame.

        The optical centre is that of the reference frame.
        """
        to_ground = camera.homography
        homography = to_ground @ motion.to_reference
        centre = camera.optical_centre_on_ground
        moved = replace(camera, homography=homography, centre_on_ground=centre)
        return cls(moved, transported(motion.covariance, to_ground))


@dataclass(frozen=True, eq=False)
class MovingCamera:
    """Camera that moves.

    Attributes
    ----------
    views : frame number → view
    missing : why people in other frames have no position
    """

    views: Mapping[int, View]
    missing: str


Ground = GroundCamera | MovingCamera
"""A camera that is still, or one that moves."""


def view_in(ground: Ground, frame: int) -> View | None:
    """Return the view of the ground in a frame; None where it is not known."""
    return View(ground) if isinstance(ground, GroundCamera) else ground.views.get(frame)


def followed_views(camera: GroundCamera, motions: Mapping[int, ImageMotion | Lost]) -> MovingCamera:
    """Return the views of a camera by its motion in the image since the reference frame.

    Parameters
    ----------
    camera : of the reference frame, over the ground
    motions : frame number → motion
    """
    known = {frame: motion for frame, motion in motions.items() if isinstance(motion, ImageMotion)}
    return MovingCamera({frame: View.moved(camera, motion) for frame, motion in known.items()}, NOT_FOLLOWED)


def carried_views(
    camera: GroundCamera, path: PosePath, frames: Iterable[int], clock: Clock, start: float = 0.0
) -> MovingCamera:
    """Return the views of a camera on a vehicle, in frames with people.

    Parameters
    ----------
    camera : over the ground in the vehicle's frame, x forward and y left
    path : poses of the vehicle in the world
    frames : numbers
    clock : times of the frames
    start : time of the poses at t = 0 of the video, seconds

    Raises
    ------
    InputError
        If no frame has a pose.
    """
    numbers = np.unique(np.fromiter(frames, np.int64))
    t = clock.seconds(numbers) + start
    known = path.covers(t)
    if len(t) and not known.any():
        of_frames = f"frames from {t[0]:.15g} to {t[-1]:.15g} s"
        found = f"poses from {path.t[0]:.15g} to {path.t[-1]:.15g} s, and {of_frames}"
        raise InputError(found, "times of one clock; --video-start is that of the poses at the video's t = 0")
    numbers, t = numbers[known], t[known]
    poses, covariances = path.at(t, nearby(t, t, path.correlation_time))
    centre = camera.optical_centre_on_ground
    views = {}
    for number, (x, y, yaw), covariance in zip(numbers.tolist(), poses.tolist(), covariances, strict=True):
        cos, sin = np.cos(yaw), np.sin(yaw)
        to_world = np.array([[cos, -sin, x], [sin, cos, y], [0.0, 0.0, 1.0]])
        moved = replace(
            camera,
            homography=to_world @ camera.homography,
            centre_on_ground=None if centre is None else apply_homography(to_world, centre),
        )
        # A turn about the vehicle is a turn about the origin and a shift.
        by_pose = np.zeros((9, 3))
        by_pose[[2, 5], [0, 1]] = 1.0
        by_pose[[1, 2, 3, 5], 2] = -1.0, y, 1.0, -x
        views[number] = View(moved, None if path.is_exact else by_pose @ covariance @ by_pose.T)
    return MovingCamera(views, NO_POSE)


def path_of_camera(path: str | Path, axes: PoseAxes | None, fps: float) -> tuple[PosePath, tuple[str, ...]]:
    """Read the poses of one camera; return them, with times since 1970 if they have such, and notes.

    Raises
    ------
    InputError
        For a file that cannot be read, or with poses of several sensors.
    """
    found = read_poses(path, ReadOptions(poses=path, pose_axes=axes, fps=fps))
    if EVERY not in found.paths and len(found.paths) > 1:
        raise InputError(f"poses of {listed(found.paths)}", "those of one camera", path=path)
    own = found.paths.get(EVERY) or next(iter(found.paths.values()))
    return own.shifted(found.origin / 1e9), found.notes
