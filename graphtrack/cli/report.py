"""Commands `graphtrack report` and `graphtrack view`: tracks as an HTML page, and in Rerun."""

from __future__ import annotations

import signal
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit
from graphtrack.cli.track import horizon_of
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.tracks.track import TrackSet
    from graphtrack.viewer.pictures import PersonBoxes


def report(
    inputs: options.Inputs,
    output: options.OutputPath,
    reading: options.SceneReading,
    observations: list[Path] | None = None,
    groups: Path | None = None,
    attention: Path | None = None,
    places: Path | None = None,
    forecast: Path | None = None,
    crowd: Path | None = None,
    title: str = "Tracks",
) -> None:
    """Write an HTML report of existing tracks, with groups, gaze and forecasts.

    Parameters
    ----------
    output : Page to write (.html).
    title : At the top of the page.

    Shown with the tracks
    ---------------------
    observations : Observations from which the tracks were estimated; repeat for more files.
    groups : Output of 'graphtrack groups'.
    attention : Output of 'graphtrack attention'.
    places : File of gaze targets given to 'graphtrack attention'.
    forecast : Output of 'graphtrack forecast'.
    crowd : File of zones and lines given to 'graphtrack crowd', to measure density, speed and flow.
    """
    from graphtrack.report.page import write_report

    tables = {"--groups": groups, "--attention": attention, "--places": places, "--forecast": forecast}
    tables |= {"--crowd": crowd}
    options.check_outputs(
        {"--output": output}, {**reading.inputs(inputs), "--observations": observations, **tables}
    )
    tracks = _in_the_world(inputs, reading)
    observed = None if not observations else reading.tracks(observations)
    write_report(
        output,
        tracks,
        observed,
        groups=groups,
        attention=attention,
        forecast=forecast,
        places=places,
        sensors=reading.sensors,
        crowd=crowd,
        title=title,
    )
    emit(f"wrote {output}: {output.stat().st_size / 1e6:.1f} MB")


def _in_the_world(inputs: list[Path], reading: options.SceneReading) -> TrackSet:
    """Return tracks; estimates are not corrected for the errors of sensors, since they are in the world."""
    if reading.sensors is None:
        return reading.tracks(inputs)
    as_they_are = replace(reading, sensors=None).tracks(inputs)
    is_estimated = any(track.covariance is not None for track in as_they_are)
    return as_they_are if is_estimated else reading.tracks(inputs)


def view(
    inputs: options.Inputs,
    reading: options.SceneReading,
    showing: options.Showing,
    video: Annotated[Path | None, typer.Option(metavar="VIDEO|FOLDER", exists=True)] = None,
    boxes: options.InputFile | None = None,
    groups: Annotated[str | None, typer.Option(metavar="FILE|find")] = None,
    forecast: Annotated[str | None, typer.Option(metavar="FILE|SECONDS")] = None,
    person: Annotated[int | None, typer.Option(metavar="ID")] = None,
) -> None:
    """Show tracks in Rerun: ground, video and time series of one person on one time line.

    With - as the file, answers of `graphtrack track -` on standard input are shown as they arrive.

    Shown with the tracks
    ---------------------
    video : Video, or folder of images, with the frame numbers of the tracks.
    boxes : People's boxes, MOT text or CAVIAR XML, with the ids of the tracks; by default the boxes of the
        input, if any.
    groups : Output of 'graphtrack groups', or find: detect them now.
    forecast : Output of 'graphtrack forecast', or a horizon in seconds: predict now.
    person : Person whose time series are drawn; by default the person with most rows.
    """
    from graphtrack.forecasting.recorded import forecast as predict
    from graphtrack.interaction.groups import groups as find_groups
    from graphtrack.viewer.shown import view as show

    if [str(path) for path in inputs] == ["-"]:
        given = {"video": video, "boxes": boxes, "groups": groups, "forecast": forecast, **reading.given()}
        _show_stream(showing, person, {options.option_name(name): value for name, value in given.items()})
        return
    showing.target()
    ahead = _number(forecast)
    files = {
        "--groups": None if groups is None or groups == "find" else Path(groups),
        "--forecast": None if forecast is None or ahead is not None else Path(forecast),
    }
    options.check_outputs({"--save": showing.save}, {**reading.inputs(inputs), "--boxes": boxes, **files})
    tracks = _in_the_world(inputs, reading)
    horizon = horizon_of(ahead)
    show(
        tracks,
        save=showing.save,
        connect=showing.connect,
        groups=find_groups(tracks) if groups == "find" else files["--groups"],
        forecast=files["--forecast"]
        if horizon is None
        else predict(tracks, horizon=horizon[0], step=horizon[1]),
        video=video,
        boxes=_boxes(inputs, boxes, reading, video),
        person=person,
        sensors=reading.sensors,
    )
    if showing.save is not None:
        size = showing.save.stat().st_size / 1e6
        emit(f"wrote {showing.save}: {size:.1f} MB; to see it: rerun {showing.save}")


def _show_stream(showing: options.Showing, person: int | None, given: Mapping[str, object]) -> None:
    """Show answers on standard input."""
    from graphtrack.viewer.live import show_stream

    options.refuse(given, "with -", "unmodified answers of graphtrack track -")
    target = showing.target()
    options.check_outputs({"--save": showing.save})
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the stream handles the signal and ends; then this ends
    show_stream(sys.stdin.fileno(), target, person)


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _boxes(
    inputs: list[Path], given: Path | None, reading: options.SceneReading, video: Path | None
) -> PersonBoxes | None:
    """Return boxes with the ids of the tracks, from the given file or the input."""
    from graphtrack.viewer.pictures import boxes_of

    if given is None and (video is None or len(inputs) != 1):
        return None
    found = boxes_of(
        inputs[0] if given is None else given, None if given else reading.format, reading.options()
    )
    if given is not None and found is None:
        raise InputError(
            "no boxes with identities", "MOT text or CAVIAR XML of people who have ids", path=given
        )
    return found
