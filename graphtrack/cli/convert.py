"""`graphtrack convert`."""

from __future__ import annotations

from graphtrack.cli import options
from graphtrack.cli.console import emit
from graphtrack.display import counted


def convert(inputs: options.Inputs, output: options.Output, reading: options.CameraReading) -> None:
    """Write tracks in another format, as they are: the ending of the output names it."""
    from graphtrack.io import write

    options.check_outputs({"--output": output}, reading.inputs(inputs), table=output)
    tracks = reading.tracks(inputs)
    write(tracks, output)
    people, rows = counted(len(tracks), "track"), counted(tracks.n_frames, "person-frame")
    emit(f"wrote {output}: {people}, {rows}")
