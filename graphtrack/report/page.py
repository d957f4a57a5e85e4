"""Standard report of a tracking run: `graphtrack report`, and `write_report` in Python."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.errors import InputError
from graphtrack.evaluation.metrics import Angle, angular_error, position_rmse
from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.geometry.planar import heading_half_width, speed_interval
from graphtrack.inference.engines import Failure, Solution
from graphtrack.io.sensors import SensorScene
from graphtrack.model import Model
from graphtrack.report.content import Card, Chart, DataTable, Note, Picture, Records, Report, Section, records
from graphtrack.report.figures import figures_of_people, write_figures
from graphtrack.report.html import write_html
from graphtrack.report.interaction import behaviour_of
from graphtrack.report.lives import (
    Pair,
    identities_section,
    identity_cards,
    is_associated,
    life_of,
    pair_tracks,
)
from graphtrack.report.methods import (
    BEHAVIOUR,
    methods_lines,
    methods_section,
    methods_text,
    with_behaviour,
)
from graphtrack.report.plots import plot_errors, plot_reliability
from graphtrack.report.plots.scene import is_crowd, plot_pairs
from graphtrack.report.replay import KNOWN_HEADING, replay_data
from graphtrack.report.sensors import sensors_section, shown_sensors
from graphtrack.report.style import probability_ellipse
from graphtrack.tracks.sensors import Sensors
from graphtrack.tracks.track import ReadSummary, Track, TrackSet
from graphtrack.tracks.validation import finite_rows

if TYPE_CHECKING:
    from graphtrack.evaluation.identity_events import IdentityEvent
    from graphtrack.forecasting.recorded import Forecasts
    from graphtrack.inference.engines import PersonalConstants
    from graphtrack.interaction.attention import Attention
    from graphtrack.interaction.groups import Groups
    from graphtrack.interaction.people import Place
    from graphtrack.io.read_write import Given
    from graphtrack.io.sensors import SensorsLike
    from graphtrack.report.background import Backdrop
    from graphtrack.report.interaction import Behaviour


PersonErrors = dict[str, float | None]
"""Column of the table of people → error of one of them."""

_MEDIAN_FRAMES = 500
"""Frames of a person that medians of intervals are of."""

ANGLES: tuple[Angle, ...] = ("body", "head")

CLOCK_TIMES = 1e6
"""Seconds from which times are clock times, not times of a recording."""


def tracking_report(
    estimates: TrackSet,
    observations: TrackSet | None = None,
    *,
    title: str = "Tracks",
    subtitle: str = "",
    comparison: Records | None = None,
    calibration: Records | None = None,
    cards: tuple[Card, ...] = (),
    sections: tuple[Section, ...] = (),
    events: Sequence[IdentityEvent] | None = None,
    behaviour: Behaviour | None = None,
    sensors: Sensors | None = None,
    background: Backdrop | None = None,
) -> Report:
    """Compose the report of a tracking run.

    Parameters
    ----------
    estimates : the result
    observations : input of the estimates, matched by ``track_id``; its reading summary is shown
    title, subtitle : str
    comparison : methods against each other, as for `graphtrack.report.plots.plot_errors`
    calibration : interval coverage of the methods, as for `graphtrack.report.plots.plot_reliability`
    cards : further numbers, which come first at the top of the page
    sections : further sections, put at the end

    events : identity errors, from `graphtrack.evaluation.identity_events.judge_events`;
        with it, or with tracks that were associated, there is a timeline of identities
    behaviour : groups, gaze and forecasts, from `graphtrack.report.interaction.behaviour_of`
    sensors : descriptions of sensors, by name: fields of view, and errors with their 1-σ
    background : a photo or a floor plan to draw under the paths

    Returns
    -------
    Report
        For `graphtrack.report.html.write_html`.

    Raises
    ------
    InputError
        If a comparison table has no rows or lacks a column, or a background shows none of the paths.
    """
    estimates, observations, origin = _from_zero(estimates, observations)
    if origin:
        subtitle = f"{subtitle} Times count from {origin}.".strip()
    behaviour = None if behaviour is None else behaviour.in_times_of(estimates)
    pairs = pair_tracks(estimates, observations)
    errors = tuple(person_errors(pair) for pair in pairs)
    lives = [life_of(pair) for pair in pairs] if events is not None or is_associated(pairs) else None
    shown = shown_sensors(pairs, sensors)
    ground = None if background is None else background.on_ground([one.position for one in estimates])
    replay = replay_data(
        pairs, lives=lives, events=events or (), behaviour=behaviour, sensors=shown, background=ground
    )
    words = "Paths from above"
    words += "" if is_crowd(pairs) else ", with body and head at regular times"
    picture = Picture(
        words,
        plot_pairs(pairs, sensors=shown, background=ground),
        f"Bird's-eye view of the paths of {len(pairs)} people.",
        is_photo=ground is not None,
    )
    parts = [] if lives is None else [identities_section(pairs, lives, events or (), bool(replay["people"]))]
    extra: tuple[Card, ...] = ()
    if behaviour is not None:
        # Imported here: a page of tracks only does not need it.
        from graphtrack.report.interaction_sections import behaviour_cards, behaviour_sections

        parts += behaviour_sections(behaviour, estimates, pairs)
        extra = behaviour_cards(behaviour)
        if computed := [name for name in BEHAVIOUR if getattr(behaviour, name) is not None]:
            sections = with_behaviour(sections, computed)
    parts += [
        _angles_section(pairs),
        Section("People", (people_table(pairs, errors), *motion_table(pairs))),
        Section("From above", (picture,)),
        *sensors_section(shown, sensors),
    ]
    if comparison is not None or calibration is not None:
        parts.append(_methods_section(comparison, calibration))
    summary = (estimates if observations is None else observations).summary
    if summary.rows_read or summary.notes:
        parts.append(Section("What was read", reading_items(summary)))
    return Report(
        title=title,
        subtitle=subtitle,
        cards=(*cards, *_cards(pairs, errors), *identity_cards(lives or ()), *extra),
        replay=replay,
        sections=(*parts, *sections),
    )


def run_sections(
    observed: TrackSet,
    found: Sequence[Solution | Failure],
    model: Model,
    calibration: Records | None = None,
) -> tuple[Section, ...]:
    """Return the sections on a smoothing run: calibration on its observations, constants, and methods.

    Parameters
    ----------
    observed : the observations that were solved, of which some may have no solution
    found, model : of the run
    calibration : from `observed_calibration`, where it is known already
    """
    from graphtrack.evaluation.observed import observed_calibration  # the solver takes long to import

    good = [one for one in found if not isinstance(one, Failure)]
    if not good:
        return ()
    learned = {one.track.track_id: one.constants for one in good if one.constants is not None}
    words = methods_text(
        model, good[0].engine, constants=learned, summary=observed.summary, failed=len(found) - len(good)
    )
    checked = observed_calibration(observed, good, model) if calibration is None else calibration
    return (
        *observed_section(checked),
        *constants_section(learned, observed.names),
        methods_section(methods_lines(*words)),
    )


def constants_section(
    constants: Mapping[int, PersonalConstants], names: Mapping[int, str]
) -> tuple[Section, ...]:
    """Return the section on each person's learned constants; none without any.

    Parameters
    ----------
    constants : track id → constants
    names : track id → name
    """
    if not constants:
        return ()
    rows = []
    for track_id, one in constants.items():
        likely = max(one.coupling, key=lambda name: one.coupling[name])
        turns = [math.degrees(math.sqrt(d)) for d in (one.body_diffusion, one.head_diffusion)]
        rows.append((names[track_id], one.acceleration_density, *turns, likely, 100.0 * one.coupling[likely]))
    table = DataTable(
        "Constants of each person",
        ("person", "q (m²/s³)", "body turns (°/√s)", "head turns (°/√s)", "orientations", "probability (%)"),
        tuple(rows),
        "Learned from the recording: the density of white-noise acceleration, by how much body and head turn "
        "in a second, and the likeliest way in which they follow the path.",
        "person",
    )
    noise = (Note(f"{line[0].upper()}{line[1:]}.") for line in next(iter(constants.values())).noise_lines())
    return (Section("Learned constants", (table, *noise)),)


def observed_section(calibration: Records) -> tuple[Section, ...]:
    """Return the section on calibration without a truth; none without rows.

    Parameters
    ----------
    calibration : from `graphtrack.evaluation.observed.observed_calibration`
    """
    rows = records(calibration)
    if not rows:
        return ()
    words = "Reliability on the observations: share of them in the intervals that all others predict"
    note = Note(
        "Each observation is compared with its prediction from all others, with the noise that is declared "
        "or was learned. On the grey line, 95 % of the observations lie in the intervals of 95 %: the "
        "uncertainties are calibrated. No truth is needed. Errors that all observations share "
        "do not show, nor do errors that last for several frames, which look like motion."
    )
    table = _reliability(rows, without=("method",))
    shown = Picture(words, plot_reliability(rows, "observations"))
    return (Section("Calibration", (note, shown, DataTable.of("Reliability on the observations", table))),)


_RELIABILITY = {
    "method": "method",
    "group": "group",
    "model": "model",
    "quantity": "quantity",
    "nees": "NEES / dof",
    "nees_error": "± (95 %)",
    **{f"coverage_{level}": f"inside {level} %" for level in (50, 90, 95)},
    "tracks": "tracks",
}
"""Column of `graphtrack.evaluation.metrics.calibration_rows` → its heading."""


def _reliability(rows: Records, without: Collection[str] = ()) -> list[dict[str, Any]]:
    """Return rows of calibration with headings for people."""
    return [
        {heading: row[name] for name, heading in _RELIABILITY.items() if name in row and name not in without}
        for row in records(rows)
    ]


def people_table(pairs: Sequence[Pair], errors: Sequence[PersonErrors]) -> DataTable:
    """Return one line a person: extent in time, observed channels, uncertainty and, with truth, errors.

    Parameters
    ----------
    pairs : the people
    errors : errors of each person, from `person_errors`
    """
    table: list[dict[str, Any]] = []
    for pair, line in zip(pairs, errors, strict=True):
        estimate = pair.estimate
        step = np.diff(estimate.position[finite_rows(estimate.position)], axis=0)
        body_std, head_std = (_median(np.degrees(estimate.std(name))) for name in ("body", "head"))
        table.append(
            {
                "person": pair.name,
                "id": None if pair.name == str(estimate.track_id) else estimate.track_id,
                "label": pair.label,
                "from (s)": float(estimate.t[0]),
                "to (s)": float(estimate.t[-1]),
                "frames": len(estimate),
                "observed (%)": None
                if pair.was_observed is None
                else 100.0 * float(pair.was_observed.mean()),
                "path (m)": float(np.hypot(*step.T).sum()),
                "95 % radius (m)": _median_radius(pair),
                "body ±1σ (°)": body_std,
                "head ±1σ (°)": head_std,
                **line,
            }
        )
    known = [c for c in (table[0] if table else ()) if any(row[c] not in (None, "") for row in table)]
    note = (
        "Uncertainties are medians over the frames; the 95 % radius is the longer half-axis of the ellipse."
    )
    rows = [{c: row[c] for c in known} for row in table]
    return DataTable.of("Results of each person", rows, note, person_column="person", most=None)


def motion_table(pairs: Sequence[Pair]) -> list[DataTable]:
    """Return a table of each person's speed and heading, with intervals; none without velocities."""
    rows = []
    for pair in pairs:
        track, velocity = pair.estimate, pair.estimate.velocity
        if velocity is None or not (known := finite_rows(velocity)).any():
            continue
        # Ends of intervals take a while, and their medians change little with more frames.
        some = np.unique(np.linspace(0, len(track) - 1, _MEDIAN_FRAMES).astype(int))
        covariance = None if track.covariance is None else track.covariance[some, 2:4, 2:4]
        low, high, half = np.full(1, np.nan), np.full(1, np.nan), np.full(1, np.nan)
        if covariance is not None:
            low, high = speed_interval(velocity[some], covariance)
            half = heading_half_width(velocity[some], covariance)
        rows.append(
            {
                "person": pair.name,
                "median speed (m/s)": round(float(np.median(track.speed[known])), 3),
                "95 % from": _median(low, 3),
                "to": _median(high, 3),
                "fastest (m/s)": round(float(track.speed[known].max()), 3),
                "heading (°)": round(float(np.degrees(direction(velocity[known].sum(axis=0)))), 1),
                "frames with a heading (%)": round(100.0 * float(np.mean(half < KNOWN_HEADING)), 1),
                "heading ± 95 % (°)": _median(np.degrees(half[half < KNOWN_HEADING]), 1),
            }
        )
    note = (
        "Medians over the frames. The heading points from the first to the last frame; its interval "
        "is that of a frame, of those in which it is known within 90°: nobody who stands has one."
    )
    title = "Speed and heading of each person"
    return [DataTable.of(title, rows, note, person_column="person", most=None)] if rows else []


def reading_items(summary: ReadSummary) -> tuple[DataTable | Note, ...]:
    """Return the reading summary: rows read, used and refused, reasons, and assumptions."""
    counts = {"read": summary.rows_read, "used": summary.rows_used}
    counts |= {f"refused: {reason}": count for reason, count in summary.refused.items()}
    rows = [{"rows": name, "number": count} for name, count in counts.items()]
    return (
        DataTable.of(f"Rows of the input ({summary.format})", rows),
        *(Note(note) for note in summary.notes),
    )


def _from_zero(estimates: TrackSet, observations: TrackSet | None) -> tuple[TrackSet, TrackSet | None, str]:
    """Shift clock times to count from the first whole second, and return that: a date, or seconds.

    Times of dates, of bags and since 1970 are read as seconds of their first day.
    """
    origin = float(np.floor(min((track.t[0] for track in estimates), default=0.0)))
    read = estimates.as_read or (None if observations is None else observations.as_read)
    scale = None if read is None else read.time
    if scale is not None and scale.origin:
        zone = " UTC" if scale.kind == "number" or scale.zone else ""
        since = str(np.datetime64(scale.origin // 10**9 + int(origin), "s")).replace("T", " ") + zone
    elif origin >= CLOCK_TIMES:
        since = f"{origin:.0f} s"
    else:
        return estimates, observations, ""

    def shift(track: Track) -> Track:
        return replace(track, t=track.t - origin)

    return estimates.map(shift), None if observations is None else observations.map(shift), since


_CURVES = "Speed and orientation"


def _angles_section(pairs: tuple[Pair, ...]) -> Section:
    # The chart uses the data of the replay, which omits people without a position.
    placed = [pair.estimate for pair in pairs if _is_known(pair.estimate.position)]
    if not any(_is_known(values) for one in placed for values in (one.velocity, one.body, one.head)):
        return Section(_CURVES, (Note("No velocity, body or head was estimated."),))
    note = (
        "Shows the person selected here, in the replay or in the table of people. A click moves the replay "
        "to that time; drag to move, ctrl + wheel to zoom, double-click to fit. Body and head are drawn "
        "where their 1-σ is below 60°."
    )
    return Section(_CURVES, (Chart("angles", "One person over time", note),))


def _methods_section(comparison: Records | None, calibration: Records | None) -> Section:
    items: list[DataTable | Picture] = []
    if comparison is not None:
        words = "Error of each method: the median, and its spread over the tracks"
        table = DataTable.of("Comparison of methods", comparison)
        items += [Picture(words, plot_errors(comparison)), table]
    if calibration is not None:
        words = "Reliability: observed coverage of intervals against their nominal probability"
        items += [
            Picture(words, plot_reliability(calibration)),
            DataTable.of("Reliability", _reliability(calibration)),
        ]
    return Section("Methods", tuple(items))


def _cards(pairs: Sequence[Pair], errors: Sequence[PersonErrors]) -> tuple[Card, ...]:
    frames = sum(len(pair.estimate) for pair in pairs)
    times = [pair.estimate.t for pair in pairs]
    seconds = max(t[-1] for t in times) - min(t[0] for t in times) if times else 0.0
    cards = [Card("People", str(len(pairs))), Card("Person-frames", f"{frames:,}".replace(",", "\u202f"))]
    cards.append(Card("Duration", f"{seconds:.1f} s"))
    was_observed = [pair.was_observed for pair in pairs if pair.was_observed is not None]
    if was_observed:
        cards.append(
            Card("Observed", f"{100.0 * np.concatenate(was_observed).mean():.1f} %", "of the person-frames")
        )
    for column, label, unit in (
        ("position RMSE (m)", "Position error", "m"),
        ("body error (°)", "Body error", "°"),
        ("head error (°)", "Head error", "°"),
    ):
        known = [value for e in errors if (value := e[column]) is not None]
        if known:
            cards.append(Card(label, f"{np.median(known):.3g} {unit}", "median over people"))
    return tuple(cards)


def person_errors(pair: Pair) -> PersonErrors:
    """Return one person's errors in position (root mean square, metres) and angles (mean, degrees).

    None if the truth is unknown.
    """
    truth = replace(
        pair.estimate,
        true_position=pair.true_position,
        true_body=pair.true_body,
        true_head=pair.true_head,
    )
    errors = {"position RMSE (m)": position_rmse(pair.estimate, truth)}
    errors |= {f"{name} error (°)": angular_error(pair.estimate, truth, name) for name in ANGLES}
    return {name: error if np.isfinite(error) else None for name, error in errors.items()}


def _median_radius(pair: Pair) -> float | None:
    if pair.estimate.covariance is None:
        return None
    return _median(probability_ellipse(pair.estimate.covariance[:, :2, :2]).semi_major)


def _median(values: FloatArray, digits: int | None = None) -> float | None:
    known = values[np.isfinite(values)]
    if not known.size:
        return None
    median = float(np.median(known))
    return median if digits is None else round(median, digits)


def _is_known(values: FloatArray | None) -> bool:
    return values is not None and bool(np.isfinite(values).any())


def write_report(
    path: str | Path,
    tracks: Given,
    observations: Given | None = None,
    *,
    solutions: Sequence[Solution | Failure] = (),
    model: Model | str | Path | None = None,
    groups: Groups | str | Path | None = None,
    attention: Sequence[Attention] | str | Path | None = None,
    forecast: Forecasts | str | Path | None = None,
    places: Sequence[Place] | str | Path | None = None,
    sensors: SensorsLike | None = None,
    crowd: Sequence[Place] | str | Path | None = None,
    background: Backdrop | None = None,
    figures: str | Path | None = None,
    title: str = "Tracks",
    subtitle: str = "",
) -> None:
    """Write the HTML report of tracks, with groups, gaze and forecasts.

    Parameters
    ----------
    path : output file; an existing file is replaced
    tracks : estimates, or unmodified observations
    observations : input of the estimates, matched by ``track_id``
    solutions, model : what `graphtrack.solve` returned for these observations, and its model (by default
        "joint"): with them the page has calibration, learned constants and a methods paragraph
    groups : result of `graphtrack.groups`, or the file that ``graphtrack groups`` wrote
    attention : result of `graphtrack.attention`, or the file that
        ``graphtrack attention`` wrote
    forecast : result of `graphtrack.forecast`, or the file that ``graphtrack forecast`` wrote
    places : other gaze targets, or a file with their positions
    sensors : descriptions of the sensors, or their file: fields of view and errors are shown. The tracks are
        in the world already. Fields of view that are not described are learned
    crowd : zones and lines, or their file, in which PedPy measures density, speed and flow
    background : a photo or a floor plan to draw under the paths
    figures : folder for the figures of the page as SVG and PDF, made if it is missing
    title, subtitle : text at the top

    Raises
    ------
    InputError
        For groups, gaze and forecasts of people or frames that are not in the tracks, solutions without
        observations, files that cannot be read, and a path that cannot be written.
    """
    tracks = tracks_of(tracks)
    observations = None if observations is None else tracks_of(observations)
    behaviour = behaviour_of(tracks, groups=groups, attention=attention, forecast=forecast, places=places)
    if solutions and observations is None:
        raise InputError("solutions without observations", "the observations that were solved")
    sections = () if observations is None else run_sections(observations, solutions, Model.named(model))
    if crowd is not None:
        from graphtrack.report.crowd import crowd_sections  # PedPy takes seconds to import

        sections = (*crowd_sections(tracks, crowd), *sections)
    report = tracking_report(
        tracks,
        observations,
        title=title,
        subtitle=subtitle,
        behaviour=behaviour,
        sensors=None if sensors is None else SensorScene.of(sensors),
        sections=sections,
        background=background,
    )
    if figures is not None:
        write_figures(figures, report, figures_of_people(tracks, observations))
    write_html(path, report)
