"""Commands `graphtrack simulate` and `graphtrack add-noise`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, write_tracks
from graphtrack.errors import InputError
from graphtrack.simulation import WALKING_PACE
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    import numpy as np

    from graphtrack.io.atomic import Paths
    from graphtrack.io.sensors import SensorScene
    from graphtrack.tracks.track import TrackSet


@dataclass(frozen=True)
class NoiseOptions:
    """Options of noise that is added to exact values.

    Noise
    -----
    position_noise : 1-σ of the noise on each axis, metres.
    body_kappa : von Mises concentration of the body's noise.
    head_kappa : von Mises concentration of the head's noise.
    """

    position_noise: float | None = None
    body_kappa: float | None = None
    head_kappa: float | None = None

    @property
    def given(self) -> dict[str, float | None]:
        """Return the noise for `graphtrack.simulation.degrade.add_noise` and `detector.detect`."""
        return {
            "position_std": self.position_noise,
            "body_kappa": self.body_kappa,
            "head_kappa": self.head_kappa,
        }

    @property
    def is_none(self) -> bool:
        """Return True if nothing is added."""
        return all(one is None for one in self.given.values())


@dataclass(frozen=True)
class SensorOptions:
    """Options of simulated sensors.

    Several sensors
    ---------------
    sensors : Description of sensors (.toml); write what they observe of the people, as .csv, .parquet or
        .ndjson.
    identities : Identities in the rows: true; own, of each sensor's own tracker; or none. The column true_id
        has the people's.
    poses_out : Write the observed poses of moving sensors (.csv).
    truth_output : Write the people's true positions, for 'graphtrack score'.
    """

    sensors: options.InputFile | None = None
    identities: Literal["true", "own", "none"] = "true"
    poses_out: Path | None = None
    truth_output: Path | None = None

    def described(self, missing: float) -> SensorScene | None:
        """Return the sensors; refuse options that do not apply, such as a share of ``missing`` frames."""
        if self.sensors is None:
            given: dict[str, object] = {**self.outputs, "--identities": self.identities != "true"}
            options.refuse(given, "without --sensors", "a description of sensors")
            return None
        from graphtrack.io.sensors import SensorScene

        scene = SensorScene.load(self.sensors)
        if missing:
            raise InputError("--missing with --sensors", "detection_probability of each sensor")
        if self.poses_out is not None and not any(sensor.moves for sensor in scene.values()):
            raise InputError("--poses-out with sensors at rest", "moves = true of at least one")
        return scene

    @property
    def outputs(self) -> dict[str, Path | None]:
        """The files to write in addition to the rows, by option name."""
        return {"--poses-out": self.poses_out, "--truth-output": self.truth_output}

    def inputs(self, scene: SensorScene | None) -> dict[str, Paths]:
        """Return the files to read, by option name."""
        if self.sensors is None or scene is None:
            return {}
        simulated = (sensor.simulation for sensor in scene.values())
        paths = [self.sensors.parent / one.path for one in simulated if one is not None and one.path]
        return {"--sensors": self.sensors, "the path of a sensor": paths}

    def write(self, people: TrackSet, scene: SensorScene, output: Path, rng: np.random.Generator) -> None:
        """Write what the sensors observe of exact people, and report it."""
        from graphtrack.io.read_write import check_table_name, write_table
        from graphtrack.simulation.sensors import observe

        assert self.sensors is not None
        check_table_name(output)
        if self.poses_out is not None:
            check_table_name(self.poses_out)
        if self.truth_output is not None:
            options.check_outputs({}, table=self.truth_output)
        folder = self.sensors.parent
        try:
            found = observe(people, scene, identities=self.identities, folder=folder, rng=rng)
        except InputError as error:
            raise error if error.path is not None else error.at(self.sensors) from error
        write_table(found.columns, output)
        emit(f"wrote {output}: {found.described()}")
        if self.truth_output is not None:
            write_tracks(found.truth, self.truth_output)
            emit(f"wrote {self.truth_output}: the truth")
        if found.poses is not None and self.poses_out is None:
            emit("  note: poses of moving sensors are not written without --poses-out")
        elif found.poses is not None and self.poses_out is not None:
            write_table(found.poses, self.poses_out)
            emit(f"wrote {self.poses_out}: {counted(len(found.poses['t']), 'pose')}")


def simulate(
    output: options.Output,
    observing: SensorOptions,
    model: str = "joint",
    tracks: Annotated[int, typer.Option(min=1)] = 10,
    steps: Annotated[int, typer.Option(min=1)] = 200,
    fps: float = 10.0,
    missing: Annotated[float, typer.Option(min=0.0, max=1.0)] = 0.0,
    pace: float = WALKING_PACE,
    glances: float = 0.0,
    scenario: bool = False,
    scene: Literal["party", "crossing"] | None = None,
    groups: Path | None = None,
    gaze: Path | None = None,
    seed: options.Seed = 0,
) -> None:
    """Simulate people from the model, with their truth, and write the table.

    Parameters
    ----------
    model : A preset or a model file (.toml).
    tracks : Number of people.
    steps : Frames of each person.
    fps : Frames a second.
    missing : Share of unobserved frames.
    pace : Median walking speed, m/s; 0: the model's random walk, whose speed grows without bound.
    glances : Glances to the side a minute.
    scenario : The demo's six scripted people instead, without a model.
    scene : People without noise instead: party, in conversations and alone, with gaze between them; crossing,
        who cross a square of 20 m about the origin, --tracks of them on average.
    groups : Write the conversation groups of the party (.csv).
    gaze : Write the gaze targets of the party (.csv); -1: nobody.
    """
    import numpy as np

    from graphtrack.model import Model
    from graphtrack.simulation.sampling import simulate as sample
    from graphtrack.simulation.scenario import scenario as scripted

    outputs = {"--output": output, "--groups": groups, "--gaze": gaze}
    sensors = observing.described(missing)
    inputs = {"--model": options.model_file(model), **observing.inputs(sensors)}
    options.check_outputs(outputs | observing.outputs, inputs, table=output)
    if scene != "party" and (groups is not None or gaze is not None):
        raise InputError("--groups or --gaze without --scene party", "that scene, which has them")
    if scene is not None and scenario:
        raise InputError("--scene and --scenario", "one of them")
    rng = np.random.default_rng(seed)
    if scene == "crossing":
        from graphtrack.simulation.crowd import crossing

        what, found = "a crossing", crossing(rng, people=tracks, seconds=steps / fps, fps=fps)
    elif scene is not None:
        from graphtrack.io.read_write import write_table
        from graphtrack.simulation.scenario import party

        made = party(rng, people=tracks, steps=steps, fps=fps)
        what, found = "a party", made.tracks
        for path, columns in ((groups, made.group_columns()), (gaze, made.look_columns())):
            if path is not None:
                write_table(columns, path)
    elif scenario:
        what, found = "the demo's people", scripted(rng, fps=fps, seconds=steps / fps)
    else:
        chosen = Model.named(model)
        what = f"model {model}"
        found = sample(
            chosen,
            n_tracks=tracks,
            n_steps=steps,
            fps=fps,
            missing=missing,
            rng=rng,
            pace=pace or None,
            glances=glances,
        )
    if sensors is not None:
        observing.write(found, sensors, output, rng)
        return
    write_tracks(found, output)
    emit(f"wrote {output}: {counted(len(found), 'track')}, {found.n_frames} person-frames; {what}")


def add_noise(
    inputs: options.Inputs,
    output: options.Output,
    reading: options.MetricReading,
    noise: NoiseOptions,
    every: float | None = None,
    missed: float = 0.0,
    occlude_share: float = 0.0,
    occlude_seconds: float = 2.0,
    clutter: float = 0.0,
    clutter_count: Literal["poisson", "fixed"] = "poisson",
    anonymous: bool = False,
    truth_output: Path | None = None,
    seed: options.Seed = 0,
) -> None:
    """Take exact tracks as the truth, and write noisy observations of them together with the truth.

    Each false detection is a separate track of one row with the label "false".

    Errors of a detector
    --------------------
    every : Seconds between frames: the recording is resampled, linearly between its rows.
    missed : Probability that a person is missed in a frame.
    occlude_share : Share of the people who are hidden once, at a random time.
    occlude_seconds : Duration of the occlusion.
    clutter : False detections a frame, uniform in the bounding box of all people.
    clutter_count : Poisson: that mean number a frame; fixed: that number in each frame.
    anonymous : Leave out identities and truth, and shuffle each frame; --truth-output keeps the truth.
        Written as .csv, .parquet or .ndjson.
    truth_output : Write the true positions in the same frames to this file, for 'graphtrack score'.
    """
    import numpy as np

    from graphtrack.io.read_write import check_table_name, write_table
    from graphtrack.simulation.detector import Detector, detect, summary_of

    detector = Detector(missed, occlude_share, occlude_seconds, clutter, clutter_count)
    if detector.is_perfect and not anonymous and noise.is_none and every is None:
        raise InputError(
            "no noise",
            "at least one of --position-noise, --body-kappa, --head-kappa, --every, --missed, "
            "--occlude-share, --clutter, --anonymous",
        )
    options.check_outputs(
        {"--output": output, "--truth-output": truth_output}, reading.inputs(inputs), table=output
    )
    if anonymous:
        check_table_name(output)
    if truth_output is not None:
        options.check_outputs({}, table=truth_output)
    tracks = reading.tracks(inputs)
    rng = np.random.default_rng(seed)
    found = detect(tracks, detector, every=every, **noise.given, rng=rng)
    if anonymous:
        write_table(found.anonymous(rng), output)
    else:
        write_tracks(found.observed, output)
    if every is not None:
        emit(f"  note: {found.truth.summary.notes[-1]}")
    emit(f"wrote {output}: {summary_of(found)}")
    if truth_output is not None:
        write_tracks(found.truth, truth_output)
        emit(f"wrote {truth_output}: the truth")
