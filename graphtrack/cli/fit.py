"""`graphtrack fit`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.cli import options
from graphtrack.cli.behaviour import read_quietly
from graphtrack.cli.console import console, emit, print_table, quiet_input_warnings, write_json
from graphtrack.errors import InputError
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    from graphtrack.io.options import Associate
    from graphtrack.learning import Fit, SceneFit
    from graphtrack.learning.interaction import AttentionFit, GroupFit
    from graphtrack.tracks.sensors import Sensor
    from graphtrack.tracks.table import Rows
    from graphtrack.tracks.track import TrackSet

Tables = dict[str, list[dict[str, object]]]
Learned = tuple[dict[str, Any], Sequence[str], Tables]
"""Results of learning as JSON-able data, notes, and tables by their titles."""

_HOLD_OUT = 0.25
_SHOWN = 30  # rows of a table that are printed


def fit(
    inputs: options.Inputs,
    reading: options.SceneReading,
    output: options.OutputPath,
    scene: bool = False,
    constants: bool = False,
    forecast: bool = False,
    groups: Path | None = None,
    attention: Path | None = None,
    model: str | None = None,
    hold_out: Annotated[float | None, typer.Option(min=0.0, max=0.9)] = None,
    max_frames: Annotated[int | None, typer.Option(min=2)] = None,
    report: Path | None = None,
    json_path: options.Json = None,
    seed: Annotated[int | None, typer.Option(min=0)] = None,
) -> None:
    """Fit a model to the truth of tracks; without truth, learn what their people have in common.

    Tracks with true_x and true_y give a model file (for --model), others constants (for smooth --constants).
    With --sensors the errors of sensors are learned that the file leaves unknown; 'unknown' in place of a
    file: all of them.

    Parameters
    ----------
    output : File to write (.toml).
    scene : Learn the scene from tracks: births, deaths, missed and false detections. With detections without
        identities this is the default.
    constants : Learn the constants that people have in common, also from tracks with a truth.
    forecast : Learn motion for graphtrack forecast --parameters; each file is a scene.
    groups : Learn group detection from this file of labelled groups: SALSA's, ETH's or a table.
    attention : Learn gaze from this file of labelled gaze targets (.csv): frame, track_id and target (an id
        or -1); for graphtrack attention --parameters.
    model : Starting point, or the model whose constants are learned: a preset or a model file (.toml); by
        default joint.
    hold_out : Share of the tracks with a truth, or of the end of a scene's or labelled recording, held out
        for validation; by default 0.25.
    max_frames : Most person-frames to fit to the truth of; by default 20,000.
    report : Write what was learned as HTML.
    seed : Seed of the choice of tracks with a truth; by default 0.
    """
    if output.suffix != ".toml":
        raise InputError(f"output {output.name!r}", "a name that ends in .toml", path=output)
    options.check_outputs(
        {"--output": output, "--report": report, "--json": json_path},
        {**reading.inputs(inputs, model), "--groups": groups, "--attention": attention},
    )
    if sum((constants, forecast, groups is not None, attention is not None)) > 1:
        raise InputError("several of --constants, --forecast, --groups and --attention", "one of them")
    held = _HOLD_OUT if hold_out is None else hold_out
    choice: dict[str, object] = {"--max-frames": max_frames, "--seed": seed}
    unused = {"--scene": scene, "--model": model, **choice}
    if forecast:
        expected = "recordings of people whose identities are known"
        options.refuse({**unused, "--hold-out": hold_out}, "with --forecast", expected)
        _write(_forecasts(inputs, reading, output), output, json_path, report)
        return
    for truth, what in ((groups, "groups"), (attention, "attention")):
        if truth is not None:
            expected = f"tracks and the labels of --{what} alone"
            options.refuse({**unused, "--report": report}, f"with --{what}", expected)
            _labelled(reading.tracks(inputs), truth, what, held, output, json_path)
            return
    if reading.sensors is not None:
        expected = "rows of several sensors alone"
        given = {
            "--scene": scene,
            "--constants": constants,
            "--hold-out": hold_out,
            "--select": reading.select,
        }
        options.refuse({**choice, **given}, "with --sensors", expected)
        _write(sensors_learned(inputs, reading, reading.sensors, model, output), output, json_path, report)
        return
    rows, are_detections = reading.rows(inputs[0]) if len(inputs) == 1 else (None, False)
    if constants:
        options.refuse({"--scene": scene}, "with --constants", "one of them")
    elif scene or are_detections:
        choice |= {"--select": reading.select, "--associate repair": reading.associate == "repair"}
        options.refuse(choice, "with a scene", "all rows of a recording, with identities or without")
        _write(_scene(rows, reading.associate, model, held, output), output, json_path, report)
        return
    elif reading.associate == "auto":
        reading = replace(reading, associate="never")
    from graphtrack.model import Model

    tracks = reading.tracks(inputs, rows, Model.named(model).scene)
    if constants or not any(track.has_truth for track in tracks):
        expected = "no such option: all observations are used"
        options.refuse({"--hold-out": hold_out, **choice}, "where constants are learned", expected)
        _write(_constants(tracks, model, output), output, json_path, report)
    else:
        chosen = {"hold_out": held, "max_frames": max_frames, "seed": seed}
        given = {name: value for name, value in chosen.items() if value is not None}
        _write(_truth(tracks, model, output, given), output, json_path, report)


UNKNOWN = Path("unknown")
"""Given for --sensors: no description."""


def sensors_learned(
    inputs: list[Path], reading: options.SceneReading, known: Path, model: str | None, output: Path
) -> Learned:
    """Learn the errors of sensors, and write their descriptions."""
    from graphtrack.learning.sensors import Identities, learn_sensors
    from graphtrack.model import Model

    if len(inputs) > 1:
        raise InputError("several files", "one recording at a time, to learn its sensors")
    if reading.poses is not None:
        raise InputError("--poses where errors of sensors are learned", "sensors at rest")
    rows, _ = replace(reading, sensors=None, associate="always").rows(inputs[0])
    emit(f"{rows.path}: {rows.format}, {counted(len(rows), 'row')}")
    by_option: dict[str, Identities] = {"repair": "own", "always": "none"}
    with console.status("learning") as status:
        found = learn_sensors(
            rows,
            None if known == UNKNOWN else known,
            model,
            identities=by_option.get(reading.associate),
            scene=Model.named(model).scene,
            progress=lambda done, total: status.update(f"learning: {done} of at most {total} rounds"),
        )
    found.save(output)
    use = f"to use it: graphtrack smooth FILE -o OUTPUT --sensors {output}"
    table = {"Errors of the sensors, ± 1-σ": sensor_rows(found)}
    return {"sensors": {name: one.to_table() for name, one in found.items()}}, [use], table


def sensor_rows(sensors: Mapping[str, Sensor]) -> list[dict[str, object]]:
    """Return a row for each sensor, of what is learned of it with its 1-σ."""
    from graphtrack.tracks.sensor_errors import shown_values

    def shown(value: float | None, std: float | None) -> str:
        return "" if value is None else f"{value:.3g}" if std is None else f"{value:.3f} ± {std:.3f}"

    return [
        {"sensor": name, **{key: shown(*values) for key, values in shown_values(one).items()}}
        for name, one in sensors.items()
    ]


def _truth(tracks: TrackSet, model: str | None, output: Path, given: Mapping[str, Any]) -> Learned:
    """Fit a model to the truth, with options of `graphtrack.learning.fit`."""
    from graphtrack.learning import fit as learn

    with console.status("learning") as status:
        found = learn(tracks, model, progress=lambda n: status.update(f"learning: {n} evaluations"), **given)
    found.model.save(output)
    tables = {"Changed parameters": parameter_rows(found), "Gain: log density a frame": score_rows(found)}
    return found.to_dict(), [*advice(found), caption(found, output)], tables


def _constants(tracks: TrackSet, model: str | None, output: Path) -> Learned:
    """Learn what people have in common, and each person's constants."""
    from graphtrack.smoothing import learn_constants

    with console.status("learning"):
        population, people = learn_constants(tracks, model)
    if not people:
        raise InputError("no track that could be smoothed", "observed positions to learn constants from")
    population.save(output)
    rows: list[dict[str, object]] = [
        {"track": track_id, "constants": one.described()} for track_id, one in people.items()
    ]
    content = {"population": asdict(population), "people": {str(k): asdict(one) for k, one in people.items()}}
    use = f"graphtrack smooth FILE -o OUTPUT --constants {output}" + (f" --model {model}" if model else "")
    how = f"Learned from the observations of {counted(len(people), 'track')}, not from a truth"
    return content, [f"{how}; to use it: {use}"], {"Constants": rows}


def _write(found: Learned, output: Path, json_path: Path | None, report: Path | None) -> None:
    """Print the learned parameters and the output path; write numbers and a page if requested."""
    from graphtrack.report.content import DataTable, Note, Report, Section
    from graphtrack.report.html import write_html

    content, notes, tables = found
    for title, rows in tables.items():
        print_table(title if len(rows) <= _SHOWN else f"{title}: {_SHOWN} of {len(rows)}", rows[:_SHOWN])
    for line in reversed(notes):
        emit(line)
    emit(f"wrote {output}")
    write_json(json_path, content)
    if report is not None:
        items: tuple[Note | DataTable, ...] = (
            *[Note(line) for line in notes],
            *[DataTable.of(title, rows) for title, rows in tables.items()],
        )
        write_html(report, Report("Learned parameters", sections=(Section("Learning", items),)))
        emit(f"wrote {report}")


def _labelled(
    tracks: TrackSet,
    truth: Path,
    what: str,
    held: float,
    output: Path,
    json_path: Path | None,
) -> None:
    """Learn from labelled groups or gaze, report the accuracy, and write the parameters."""
    from graphtrack.interaction.tables import read_gaze
    from graphtrack.learning.interaction import fit_attention, fit_groups

    with console.status("learning"), quiet_input_warnings():
        found: GroupFit | AttentionFit
        if what == "groups":
            found = fit_groups(tracks, read_quietly(truth, tracks.ids), hold_out=held)
        else:
            found = fit_attention(tracks, read_gaze(truth, tracks.ids), hold_out=held)
    found.parameters.save(output)
    title, counted_by = ("Groups", "frame") if what == "groups" else ("Gaze", "label")
    parts = {"training data": found.learned_from, "held-out data": found.held_out}
    scores = {name: score for name, score in parts.items() if score is not None}
    for name, score in scores.items():
        print_table(f"{title} in {name}, {counted(score.frames, counted_by)}", score.shown())
    emit(f"wrote {output}")
    learned = {name: score.to_dict() for name, score in scores.items()}
    write_json(json_path, {"parameters": asdict(found.parameters), **learned})


def _forecasts(inputs: list[Path], reading: options.SceneReading, output: Path) -> Learned:
    """Learn motion for forecasts."""
    from graphtrack.learning.forecasts import fit_forecast

    scenes = {str(path): reading.tracks([path]) for path in inputs}
    if len(scenes) < len(inputs):
        raise InputError("a file twice", "each recording once")
    with console.status("learning") as status:
        found = fit_forecast(scenes, progress=lambda what: status.update(f"learning: {what}"))
    found.parameters.save(output)
    start = asdict(found.start)
    fields = type(found.parameters).__dataclass_fields__
    changed: list[dict[str, object]] = [
        {"parameter": name, "before": start[name], "after": value, "unit": fields[name].metadata["unit"]}
        for name, value in asdict(found.parameters).items()
    ]
    bought: list[dict[str, object]] = [
        {
            "recording": name,
            "ADE ratio": round(found.errors[name][0], 3),
            "FDE ratio": round(found.errors[name][1], 3),
            "log density before": found.density[name][0],
            "after": found.density[name][1],
        }
        for name in found.errors
    ]
    tables = {"Parameters": changed, "Errors over those of constant velocity, and density": bought}
    return found.to_dict(), ["Judged on what was learned from."], tables


def _scene(rows: Rows | None, associate: Associate, model: str | None, held: float, output: Path) -> Learned:
    """Learn a scene: from detections, or from tracks.

    Parameters
    ----------
    rows : of the input; None: there are several
    associate : "always": the identities of the input are forgotten
    held : share held out
    """
    from graphtrack.learning import fit_scene

    if rows is None:
        raise InputError("several files", "one recording at a time, to learn a scene")
    labelled = rows.has_identity and associate != "always"
    emit(f"{rows.path}: {rows.format}, {counted(len(rows), 'row')}")
    with console.status("learning") as status:
        found = fit_scene(
            rows,
            model,
            labelled=labelled,
            hold_out=held,
            progress=lambda done, total: status.update(f"learning: {done} of {total} sweeps"),
        )
    found.model.save(output)
    tables = {
        "The scene": scene_rows(found),
        "Gain: log density a detection": scene_part_rows(found),
    }
    return found.to_dict(), [*scene_advice(found), scene_caption(found)], tables


def parameter_rows(found: Fit) -> list[dict[str, object]]:
    """Return parameters before and after, a row each."""
    headings = ("parameter", "before", "after", "95 % from", "to", "")
    return [dict(zip(headings, astuple(one), strict=True)) for one in found.learned]


def score_rows(found: Fit) -> list[dict[str, object]]:
    """Return log density before and after, a row for each part of the tracks."""
    return [
        {"tracks": name, "n": n, "before": before, "after": after, "gain": after - before}
        for (name, (before, after)), n in zip(found.scores.items(), found.tracks, strict=False)
    ]


def caption(found: Fit, output: Path) -> str:
    """Describe what the model was fitted to, and its use."""
    tracks = counted(found.tracks[0], "track")
    return (
        f"Fitted to the truth of {tracks} (model {found.start.preset}, {found.evaluations} evaluations); "
        f"to use it: graphtrack smooth FILE -o OUTPUT --model {output}"
    )


def advice(found: Fit) -> list[str]:
    """Return advice if learning did not improve held-out tracks, else none."""
    before, after = found.scores.get("held out", (0.0, 0.0))
    if after >= before:
        return []
    learned, held = found.tracks
    return [
        f"The score on {counted(held, 'track')} held out fell by {before - after:.3g} a frame: "
        f"keep the initial model ({found.start.preset}), or learn from more than "
        f"{counted(learned, 'track')}."
    ]


def scene_rows(found: SceneFit) -> list[dict[str, object]]:
    """Return parameters before and after, a row each."""
    return [
        {
            "parameter": f"scene.{one.name}",
            "before": one.start,
            "after": one.value,
            "unit": one.unit,
            "": f"{one.note}: not learned" if one.note else "",
        }
        for one in found.learned
    ]


def scene_part_rows(found: SceneFit) -> list[dict[str, object]]:
    """Return log density before and after, a row for each part of the recording."""
    return [
        {"": name, **asdict(part), "gain": part.after - part.before} for name, part in found.parts.items()
    ]


def scene_caption(found: SceneFit) -> str:
    """Describe the recording."""
    part = found.parts["learned from"]
    how = "given" if found.labelled else "found"
    return (
        f"Learned from {counted(part.detections, 'detection')} in {part.seconds:.0f} s: "
        f"{part.people} people {how}, {part.false} detections false."
    )


def scene_advice(found: SceneFit) -> list[str]:
    """Return advice if learning did not improve the held-out part, else none."""
    held = found.parts.get("held out")
    if held is None or held.after >= held.before:
        return []
    return [
        f"The score on {held.seconds:.0f} s held out fell by {held.before - held.after:.3g} a "
        "detection: learn from a longer recording."
    ]
