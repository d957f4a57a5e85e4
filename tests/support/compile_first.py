"""Compile what the tests run, before their workers start: ``python tests/support/compile_first.py PART``.

Each worker would compile for itself, mostly twice the same.
"""

import os
import sys
import tempfile

import graphtrack as gt


def solver() -> None:
    """Smooth and track, with GTSAM's engines and the particle filter too; the extras are not there yet."""
    from graphtrack.baselines.particle_filter import particle_smoother
    from graphtrack.inference.engines import TRACK

    gt.warm_up("joint")
    particle_smoother(TRACK)
    gt.track_online(TRACK, "joint", engine="isam2")
    gt.smooth(TRACK, "joint", engine="gtsam")


def others() -> None:
    """Association, groups, gaze, forecasts, walls and perception."""
    import shapely
    from documents import run_line

    from graphtrack.inference.engines import TRACK

    gt.associate(gt.simulate("position", n_tracks=2, n_steps=40))
    gt.track_online(TRACK, "position", engine="fixed-lag", walkable=shapely.box(-9, -9, 9, 9))
    gt.warm_up("joint", functions="OnlineTracker", walkable=True)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        run_line("graphtrack simulate -o walks.csv --tracks 2")
        for command in ("groups", "attention", "forecast"):
            run_line(f"graphtrack {command} walks.csv -o {command}.csv")
        run_line("perception simulate -o clip --people 1 --frames 2")
        seen = "clip/video.mp4 --boxes clip/boxes.txt --homography clip/homography.txt"
        run_line(f"perception observe {seen} -o seen.csv")


if __name__ == "__main__":
    {"solver": solver, "others": others}[sys.argv[1]]()
