"""Python interface: the commands `observe`, `follow` and `report` as functions, with the same defaults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from graphtrack.io.options import PoseAxes
from graphtrack.tracks.track import TrackSet
from perception.cli.follow import follow_target
from perception.cli.observe import ModelOptions, ObserveJob
from perception.cli.options import CameraOptions, MotionOptions, Reports
from perception.cli.report import report_folder
from perception.cli.searching import NetworkOptions
from perception.observation.tables import Observations


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)


def _network(given: NetworkOptions | None) -> NetworkOptions:
    """Return the options, whose files may be given as text."""
    one = given or NetworkOptions()
    return replace(one, detector=_path(one.detector), keypoints=_path(one.keypoints))


def _model(given: ModelOptions | None) -> ModelOptions:
    """Return the options, whose files may be given as text."""
    one = given or ModelOptions()
    return replace(
        one,
        head_pose_model=_path(one.head_pose_model),
        body_pose_model=_path(one.body_pose_model),
        head_localiser_model=_path(one.head_localiser_model),
        camera_models=_path(one.camera_models),
    )


def _camera(
    homography: str | Path | None,
    point_pairs: str | Path | None,
    calibration: str | Path | None,
    fps: float | None,
) -> CameraOptions:
    return CameraOptions(
        _path(homography), point_pairs=_path(point_pairs), calibration=_path(calibration), fps=fps
    )


def observe(
    video: str | Path,
    output: str | Path | None = None,
    *,
    boxes: str | Path | None = None,
    boxes_first_frame: int | None = None,
    homography: str | Path | None = None,
    point_pairs: str | Path | None = None,
    calibration: str | Path | None = None,
    fps: float | None = None,
    homographies: str | Path | None = None,
    poses: str | Path | None = None,
    pose_axes: PoseAxes | None = None,
    video_start: float | None = None,
    follow_camera: bool = False,
    reference_frame: int | None = None,
    network: NetworkOptions | None = None,
    model: ModelOptions | None = None,
    write_boxes: str | Path | None = None,
    render: str | Path | None = None,
    causal: bool = False,
    appearance: bool | None = None,
) -> Observations:
    """Detect people in a recording and observe their positions, bodies and heads, as `perception observe`.

    Parameters
    ----------
    video : a video, or a folder of images
    output : table to write; an interrupted run with the same output continues
    boxes : people's boxes (MOT text, COCO JSON, CAVIAR XML); None: people are detected
    boxes_first_frame : number of the recording's first frame in ``boxes``
    homography, point_pairs, calibration : file of the camera, one of them; None: pixels times a scale
    fps : frames a second; None: the video's, or 25
    homographies : file with one homography a frame, image to ground, of a camera that moves
    poses : file with the poses of the vehicle that carries the camera, whose view in the vehicle's frame is
        ``homography`` or ``calibration``
    pose_axes : of poses in space: "robot", x forward and z up; "camera", z forward and y down
    video_start : time of the poses at t = 0 of the video, seconds; None: 0
    follow_camera : whether the camera's motion is followed by features of the background
    reference_frame : number of the frame whose view ``homography`` or ``calibration`` is; None: the first
    network, model : networks, keypoints, and models of body and head of your own
    write_boxes : file for the detected boxes (MOT text)
    render : video or folder to draw the observations in
    causal : use past frames only
    appearance : include appearance descriptors; None: for boxes without identities

    Returns
    -------
    Observations
        Columns of the table, in metres, seconds and likelihoods of directions in the world.

    Raises
    ------
    InputError
        If an input cannot be used, options exclude each other, or nobody is observed.
    """
    job = ObserveJob(
        Path(video),
        _path(output),
        _camera(homography, point_pairs, calibration, fps),
        MotionOptions(
            _path(homographies), _path(poses), pose_axes, video_start, follow_camera, reference_frame
        ),
        _network(network),
        _model(model),
        boxes=_path(boxes),
        boxes_first_frame=boxes_first_frame,
        write_boxes_to=_path(write_boxes),
        render=_path(render),
        causal=causal,
        appearance=appearance,
        reports=Reports(),
    )
    return job.run()


def follow(
    video: str | Path,
    output: str | Path | None = None,
    *,
    homography: str | Path | None = None,
    point_pairs: str | Path | None = None,
    calibration: str | Path | None = None,
    fps: float | None = None,
    tracker: str = "mixed-state",
    init: tuple[float, float, float, float] | None = None,
    start: float = 0.0,
    check: bool = True,
    guided: bool = False,
    render: str | Path | None = None,
    particles: int | None = None,
    seed: int = 0,
    foot_at: float | None = None,
    middle_at: float | None = None,
    pan_limit: float | None = None,
    as_in_the_paper: bool = False,
    background: Sequence[str | Path] = (),
) -> Observations:
    """Track one person or head through a recording, as `perception follow`.

    Parameters
    ----------
    video, output, homography, point_pairs, calibration, fps, render : as of `observe`
    tracker : "mixed-state", "head-graph", "sigma-pi", "cue-graph" or "color"
    init : the target's left, top, width and height in the first frame, pixels; None: trackers of heads
        detect one in the first two seconds, sigma-pi and cue-graph wait for motion
    start : time in the video at which to start, seconds
    check : refuse a start on no person, and search for a lost person; False to follow anything
    guided : the graph predicts the next box for the tracker
    particles : their number; None: the tracker's own
    seed : of the random numbers
    foot_at : foot point in box heights below the box's top
    middle_at : height of the box's middle above the ground, metres, in place of a foot point
    pan_limit : degrees, largest pan away from the camera
    as_in_the_paper : the published form of the tracker
    background : images, or folders of images, without the person, for sigma-pi and cue-graph

    Returns
    -------
    Observations
        Columns of the table, with the boxes in pixels.

    Raises
    ------
    InputError
        If an input cannot be used, or there is no target.
    """
    return follow_target(
        Path(video),
        _path(output),
        _camera(homography, point_pairs, calibration, fps),
        tracker=tracker,
        init=init,
        start=start,
        check=check,
        guided=guided,
        render=_path(render),
        particles=particles,
        seed=seed,
        foot_at=foot_at,
        middle_at=middle_at,
        pan_limit=pan_limit,
        as_in_the_paper=as_in_the_paper,
        background=[Path(one) for one in background],
        reports=Reports(),
    )


def report(
    video: str | Path,
    output: str | Path,
    *,
    boxes: str | Path | None = None,
    boxes_first_frame: int | None = None,
    homography: str | Path | None = None,
    point_pairs: str | Path | None = None,
    calibration: str | Path | None = None,
    fps: float | None = None,
    network: NetworkOptions | None = None,
    adapt: bool = True,
    method: Literal["smoother", "ffbs", "particle", "chain", "isam2", "fixed-lag"] = "smoother",
    person_height: float = 1.7,
    seed: int = 0,
    figures: bool = False,
) -> TrackSet:
    """Detect, track and smooth people, and write a folder with tables, video and page: `perception report`.

    Parameters
    ----------
    video, boxes, boxes_first_frame, homography, point_pairs, calibration, fps, network : as of `observe`;
        without a camera its view is estimated from the boxes
    output : folder to write or to continue
    adapt : fit the camera's own models of body and head first
    method : "smoother": the graph, offline; "ffbs", "particle": the joint particle filter, offline and
        online; "chain", "isam2", "fixed-lag": the graph, online
    person_height : mean height of people's boxes, metres
    seed : of the random numbers
    figures : write the figures of the page, and of up to 12 people, as SVG and PDF into its folder figures

    Returns
    -------
    TrackSet
        The estimates, as in ``tracks.csv`` of the folder.

    Raises
    ------
    InputError
        If an input cannot be used, or nobody is found.
    """
    run = report_folder(
        Path(video),
        Path(output),
        _camera(homography, point_pairs, calibration, fps),
        _network(network),
        boxes=_path(boxes),
        boxes_first_frame=boxes_first_frame,
        adapt=adapt,
        method=method,
        person_height=person_height,
        seed=seed,
        figures=figures,
        reports=Reports(),
    )
    return run.read("tracks")
