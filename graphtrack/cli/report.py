"""Commands `graphtrack report` and `graphtrack view`: tracks as an HTML page, and in Rerun."""

from __future__ import annotations

import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from graphtrack.cli import options
from graphtrack.cli.console import emit, option_name
from graphtrack.cli.track import horizon_of
from graphtrack.errors import InputError

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.io.atomic import Paths
    from graphtrack.report.background import Backdrop
    from graphtrack.tracks.track import TrackSet
    from graphtrack.viewer.pictures import PersonBoxes


@dataclass(frozen=True)
class OnPage:
    """Options of what a page shows with the tracks.

    Shown with the tracks
    ---------------------
    places : CSV of gaze targets that are no people: name and x, y, radius, or name and polygon (x y x y …).
    crowd : File of zones and lines given to 'graphtrack crowd', to measure density, speed and flow.
    background : Photo or floor plan to draw under the paths, with --homography, --point-pairs or
        --calibration, or --metres-per-pixel of a view from above.
    background_corner : Position in metres of the lower left corner of a view from above; by default its upper
        left corner is the origin.
    figures : Folder for the figures of the page, and of up to 12 people, as SVG and PDF.
    """

    places: options.InputFile | None = None
    crowd: options.InputFile | None = None
    background: Annotated[Path | None, typer.Option(metavar="IMAGE", exists=True, dir_okay=False)] = None
    background_corner: Annotated[str | None, typer.Option(metavar="X,Y")] = None
    figures: Annotated[Path | None, typer.Option(metavar="FOLDER", file_okay=False)] = None

    def given(self) -> dict[str, Any]:
        """Return what was given, by the name of its option."""
        return {option_name(f.name): value for f in fields(self) if (value := getattr(self, f.name))}

    def inputs(self) -> dict[str, Paths]:
        """Return the files that are read, by option name, for `check_outputs`."""
        return {name: path for name, path in self.given().items() if name in _PAGE_FILES}

    def content(self, reading: options.CameraReading, camera: GroundCamera | None) -> dict[str, Any]:
        """Return keywords of `graphtrack.write_report`; the image has the camera or scale of ``reading``.

        Parameters
        ----------
        camera : of the tracks, if any; used where ``reading`` has none
        """
        named = {"places": self.places, "crowd": self.crowd, "figures": self.figures}
        return {**named, "background": self._backdrop(reading, camera)}

    def _backdrop(self, reading: options.CameraReading, camera: GroundCamera | None) -> Backdrop | None:
        import numpy as np

        from graphtrack.io.cameras import known_camera
        from graphtrack.report.background import Backdrop

        path, corner = self.background, self.background_corner
        if path is None:
            if corner is not None:
                raise InputError("--background-corner", "--background with it")
            return None
        known, notes = known_camera(reading.options(), np.empty((0, 2)))
        for note in notes:
            emit(f"  note: {note}")
        scale = reading.metres_per_pixel
        if known is None and scale is not None:
            return Backdrop.of_plan(path, scale, None if corner is None else _corner(corner))
        if corner is not None:
            raise InputError("--background-corner", "--metres-per-pixel with it, and no camera")
        camera = camera if known is None else known
        if camera is None:
            expected = "--homography, --point-pairs or --calibration, or --metres-per-pixel"
            raise InputError("a background without a camera or scale", expected, path=path)
        return Backdrop.read(path, camera)


_PAGE_FILES = ("--places", "--crowd", "--background")


def _corner(text: str) -> tuple[float, float]:
    numbers = [_number(part) for part in text.split(",")]
    if len(numbers) != 2 or numbers[0] is None or numbers[1] is None:
        raise InputError(f"--background-corner {text!r}", "x and y in metres, such as -2.5,0")
    return numbers[0], numbers[1]


def _number(text: str | None) -> float | None:
    """Return the number that a text is; None for any other text."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def report(
    inputs: options.Inputs,
    output: options.OutputPath,
    reading: options.SceneReading,
    page: OnPage,
    observations: list[Path] | None = None,
    groups: Path | None = None,
    attention: Path | None = None,
    forecast: Path | None = None,
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
    forecast : Output of 'graphtrack forecast'.
    """
    from graphtrack.report.page import write_report

    tables = {"--groups": groups, "--attention": attention, "--forecast": forecast, **page.inputs()}
    options.check_outputs(
        {"--output": output}, {**reading.inputs(inputs), "--observations": observations, **tables}
    )
    tracks = _in_the_world(inputs, reading, page.background is not None)
    content = page.content(reading, tracks.camera)
    camera_used = page.background is not None
    observed = reading.tracks(observations, camera_used=camera_used) if observations else None
    write_report(
        output,
        tracks,
        observed,
        groups=groups,
        attention=attention,
        forecast=forecast,
        sensors=reading.sensors,
        title=title,
        **content,
    )
    if page.figures is not None:
        emit(f"wrote figures: {page.figures}")
    emit(f"wrote {output}: {output.stat().st_size / 1e6:.1f} MB")


def _in_the_world(inputs: list[Path], reading: options.SceneReading, camera_used: bool = False) -> TrackSet:
    """Return tracks; estimates are not corrected for the errors of sensors, since they are in the world."""
    if reading.sensors is None:
        return reading.tracks(inputs, camera_used=camera_used)
    as_they_are = replace(reading, sensors=None).tracks(inputs, camera_used=camera_used)
    is_estimated = any(track.covariance is not None for track in as_they_are)
    return as_they_are if is_estimated else reading.tracks(inputs, camera_used=camera_used)


def view(
    inputs: options.Inputs,
    reading: options.SceneReading,
    showing: options.Showing,
    video: Annotated[Path | None, typer.Option(metavar="VIDEO|FOLDER", exists=True)] = None,
    boxes: options.InputFile | None = None,
    groups: Annotated[str | None, typer.Option(metavar="FILE|find")] = None,
    forecast: Annotated[str | None, typer.Option(metavar="FILE|SECONDS")] = None,
    person: Annotated[str | None, typer.Option(metavar="ID")] = None,
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
    person : Id or name of the person whose time series are drawn; by default the one with most rows.
    """
    from graphtrack.forecasting.recorded import forecast as predict
    from graphtrack.interaction.groups import groups as find_groups
    from graphtrack.viewer.shown import view as show

    chosen = int(person) if person is not None and person.isdecimal() else person
    if [str(path) for path in inputs] == ["-"]:
        given = {"video": video, "boxes": boxes, "groups": groups, "forecast": forecast, **reading.given()}
        _show_stream(showing, chosen, {option_name(name): value for name, value in given.items()})
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
        person=chosen,
        sensors=reading.sensors,
    )
    if showing.save is not None:
        size = showing.save.stat().st_size / 1e6
        emit(f"wrote {showing.save}: {size:.1f} MB; to see it: rerun {showing.save}")


def _show_stream(showing: options.Showing, person: int | str | None, given: Mapping[str, object]) -> None:
    """Show answers on standard input."""
    from graphtrack.viewer.live import show_stream

    options.refuse(given, "with -", "unmodified answers of graphtrack track -")
    target = showing.target()
    options.check_outputs({"--save": showing.save})
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the stream handles the signal and ends; then this ends
    show_stream(sys.stdin.fileno(), target, person)


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
