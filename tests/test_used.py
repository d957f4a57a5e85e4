"""What is given is used, refused or named in a note: every public field at every entry point."""

import json
import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from selection import others_slow

import graphtrack as gt
from graphtrack.geometry.camera import GroundCamera
from graphtrack.interaction.attention import attention
from graphtrack.model import Model, Observation
from graphtrack.streaming.session import Answers
from graphtrack.tracks.schema import COLUMNS, INTEGERS
from graphtrack.tracks.track import Track, TrackSet, to_columns

N = 5
RNG = np.random.default_rng(0)
CAMERA = GroundCamera.from_homography([[0.02, 0.0, -6.0], [0.0, -0.03, 14.0], [0.0, 0.01, 1.0]])


def _person(track_id: int, y: float) -> Track:
    t = np.arange(N) / 10
    position = np.column_stack([0.13 * np.arange(N), np.full(N, y)]) + 0.02 * RNG.standard_normal((N, 2))
    return Track(
        track_id,
        np.arange(N),
        t,
        position,
        position_std=np.full(N, 0.1),
        pixel=np.column_stack([300.0 + np.arange(N), np.full(N, 200.0)]),
        body=np.full(N, 1.6 * track_id - 1.5),
        body_kappa=np.full(N, 5.0),
        head=np.full(N, 1.5 * track_id - 1.2),
        head_kappa=np.full(N, 6.0),
        observed_velocity=np.tile([1.0, 0.1 * track_id], (N, 1)),
        observed_velocity_covariance=np.tile([[0.2, 0.05], [0.05, 0.1]], (N, 1, 1)),
        body_axis=np.full(N, 1.4 * track_id - 1.3),
        body_axis_kappa=np.full(N, 3.0),
        score=np.full(N, 0.9),
        sensor=np.array(["laser", "camera"])[np.arange(N) % 2],
        velocity=np.full((N, 2), 0.4),
        covariance=np.tile(np.diag([0.01, 0.02, 0.1, 0.1, 0.2, 0.3]), (N, 1, 1)),
        identity_p=np.full(N, 0.8),
        observed=np.ones(N),
        true_position=position + 0.01,
        true_body=np.full(N, 0.15),
        true_head=np.full(N, 0.25),
        label=f"person {track_id}",
    )


FULL = TrackSet((_person(1, 0.0), _person(2, 0.2)))
"""Two people, so near each other that angles are evidence on who is who."""
CLASSES = {
    f"{name}_likelihood": np.tile(RNG.uniform(0.1, 1.0, k), (N, 1)) for name, k in (("body", 8), ("head", 12))
}
NO_CLASSES = ("body", "body_kappa", "head", "head_kappa")
ELLIPSES = {
    "position_std": None,
    "position_covariance": np.tile([[0.02, 0.005], [0.005, 0.01]], (N, 1, 1)),
}


def scene_of(name: str) -> TrackSet:
    """The scene, with class likelihoods or ellipses in place of angles or circles where these are changed."""
    if name == "position_covariance":
        return FULL.map(lambda one: replace(one, **ELLIPSES))
    if "likelihood" not in name and "_p" not in name.replace("pos_std", "").replace("identity_p", ""):
        return FULL.map(lambda one: replace(one, **dict.fromkeys(CLASSES)))
    return FULL.map(lambda one: replace(one, **CLASSES, **dict.fromkeys(NO_CLASSES)))


def standing(scene: TrackSet) -> TrackSet:
    """Observations of people who stand and face each other."""
    still = {"covariance": None, "velocity": None}
    return scene.map(
        lambda one: replace(
            one, position=np.tile([1.3 * one.track_id, 0.0], (N, 1)) + 0.0 * one.position, **still
        )
    )


def changed(track: Track, name: str) -> Track:
    """The track with other values of a field."""
    if name == "label":
        return replace(track, label=track.label + "!")
    if name == "track_id":
        return replace(track, track_id=track.track_id + 10)
    value = np.array(getattr(track, name))
    if name == "sensor":
        return replace(track, sensor=np.char.add(value, "'"))
    if name == "frame":
        return replace(track, frame=value + 3)
    if "likelihood" in name:
        return replace(track, **{name: np.roll(value, 2, axis=1)})
    return replace(track, **{name: value * np.linspace(0.7, 0.9, N).reshape(-1, *[1] * (value.ndim - 1))})


def outcome(call: Callable[[], Any]) -> tuple[str, str]:
    """The result as text, and what was said; a refusal is a result."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = call()
        except gt.GraphtrackError as error:
            return f"refused: {error}", ""
    notes = [str(one.message) for one in caught if issubclass(one.category, gt.InputWarning)]
    if isinstance(found, TrackSet):
        notes += found.summary.notes
        found = {name: values.tolist() for name, values in to_columns(found).items()}
    return repr(found), "\n".join(notes)


def remembered(call: Callable[[Any], Any]) -> Callable[[Any], tuple[str, str]]:
    """The outcome of a call, computed once for what is given, which has the text of its values."""
    known: dict[str, tuple[str, str]] = {}

    def run(given: Any) -> tuple[str, str]:
        values = (
            {k: v.tolist() for k, v in to_columns(given).items()} if isinstance(given, TrackSet) else given
        )
        text = repr(values)
        if text not in known:
            known[text] = outcome(lambda: call(given))
        return known[text]

    return run


ENTRIES: dict[str, Callable[[TrackSet], Any]] = {
    "smooth position": lambda tracks: gt.smooth(tracks, "position"),
    "smooth joint": lambda tracks: gt.smooth(tracks, "joint"),
    "smooth gtsam": lambda tracks: gt.smooth(tracks, "position", engine="gtsam"),
    "smooth in the image": lambda tracks: gt.smooth(replace(tracks, camera=CAMERA), "position"),
    "track_online": lambda tracks: gt.track_online(tracks, "joint"),
    "associate": gt.associate,
}
OF_OBSERVATIONS: dict[str, Callable[[TrackSet], Any]] = {
    "groups": lambda tracks: gt.groups(tracks).columns(),
    "attention": lambda tracks: [one.probability.tolist() for one in attention(tracks)],
    "forecast": lambda tracks: gt.forecast(tracks, horizon=0.4).columns,
}
TRACK_FIELDS = [f.name for f in fields(Track) if f.name not in ("inputs", "track_id", "frame")]
OBSERVED = [f.name for f in fields(Observation) if f.name not in ("frame", "inputs", "sensor")]
"""Without the sensor, which only tells rows of one time apart."""
OF_A_POSITION = ("pixel", "u", "v")
"""Without a camera the pixel of a position that is given, as `perception observe` writes both: not named."""


def columns_of(name: str) -> set[str]:
    return {name} | {column.name for column in COLUMNS if column.field == name}


def is_named(name: str, notes: str) -> bool:
    return any(one in notes.replace(",", " ").split() for one in columns_of(name))


@pytest.mark.parametrize("entry", [*ENTRIES, *OF_OBSERVATIONS])
def test_every_field_of_a_track_is_used_refused_or_named(entry: str) -> None:
    found_by = remembered({**ENTRIES, **OF_OBSERVATIONS}[entry])
    names = TRACK_FIELDS if entry in ENTRIES else [one for one in OBSERVED if one in TRACK_FIELDS]
    if entry == "attention":
        names = [one for one in names if one not in ("body", "body_kappa")]  # by the groups alone
    names = [one for one in names if entry == "smooth in the image" or one not in OF_A_POSITION]
    silent = []
    for name in names:
        scene = scene_of(name)
        if name == "score":
            scene = scene.map(lambda one: replace(one, identity_p=None))  # else it was evidence before
        if entry in OF_OBSERVATIONS:
            observed = scene.map(lambda one: replace(one, covariance=None))
            scene = observed if entry == "forecast" else standing(scene)
        before, notes = found_by(scene)
        after, _ = found_by(scene.map(lambda one, name=name: changed(one, name)))
        if before == after and not is_named(name, notes):
            silent.append(name)
    assert silent == []


@pytest.mark.parametrize("entry", ["position", "joint"])
def test_every_column_of_a_table_is_used_refused_or_named(entry: str) -> None:
    found_by, silent = remembered(lambda rows: gt.smooth(pd.DataFrame(rows), entry)), []
    for column in COLUMNS:
        table = scene_of(column.field).to_table()
        if column.name not in table or column.name in OF_A_POSITION:
            continue
        if column.name in ("x_std", "y_std"):
            table = table.drop(columns="pos_std")
        if column.name == "score":
            table = table.drop(columns="identity_p")  # else it was evidence before
        other = table.copy()
        other[column.name] = other[column.name] * np.tile(np.linspace(0.7, 0.9, N), 2)
        before, notes = found_by(table.to_dict("list"))
        after, _ = found_by(other.to_dict("list"))
        if before == after and column.name not in notes.replace(",", " ").split():
            silent.append(column.name)
    assert silent == []


def observation(k: int, person: int = 0, name: str = "") -> Observation:
    """An observation with every channel that goes with that of a name."""
    track = scene_of(name)[person]
    given = {
        f.name: value[k].tolist()
        for f in fields(Observation)
        if f.name not in ("t", "frame", "inputs") and (value := getattr(track, f.name)) is not None
    }
    return Observation(t=k / 10, frame=k, **given)


def other(one: Observation, name: str) -> Observation:
    if name == "t":
        return replace(one, t=one.t + 0.02)
    value = getattr(one, name)
    if name == "sensor":
        return replace(one, sensor=f"{value}'")
    if name.endswith("covariance"):
        return replace(one, **{name: (0.8 * np.array(value)).tolist()})
    return replace(one, **{name: tuple(np.roll(value, 1) * 0.8) if isinstance(value, list) else 0.7 * value})


def smoothed(options: dict[str, Any]) -> Callable[[list[list[Observation]]], Any]:
    def call(frames: list[list[Observation]]) -> Any:
        smoother = gt.OnlineSmoother(**options)
        found = [smoother.update(one) for one, _ in frames]
        return [(one.position.tolist(), one.covariance.tolist(), one.body, one.head, one.t) for one in found]

    return call


def tracked(options: dict[str, Any]) -> Callable[[list[list[Observation]]], Any]:
    def call(frames: list[list[Observation]]) -> Any:
        tracker = gt.OnlineTracker(**options)
        found = [tracker.update(k / 10, some) for k, some in enumerate(frames)]
        return [
            (p.track_id, p.position.tolist(), p.covariance.tolist(), p.identity_p)
            for one in found
            for p in one
        ]

    return call


EVIDENCE_ALONE = ["score", "body", "head", "body_likelihood", "head_likelihood"]

ONLINE = {
    f"{name} {model} {'camera' if camera else ''}": (make({"model": model, "camera": camera}))
    for name, make in (("OnlineSmoother", smoothed), ("OnlineTracker", tracked))
    for model in ("position", "joint")
    for camera in (None, CAMERA)
}


@pytest.mark.parametrize(
    "entry",
    others_slow(
        ONLINE,
        ["OnlineSmoother position ", "OnlineSmoother joint camera", "OnlineTracker joint camera"],
    ),
)
def test_every_field_of_an_observation_is_used_refused_or_named(entry: str) -> None:
    found_by, silent = remembered(ONLINE[entry]), []
    # Evidence of the tracker counts once enough detections were decided: see tests/association.
    evidence = [*EVIDENCE_ALONE] if "Tracker position" in entry else ["score"] * ("Tracker" in entry)
    evidence += [] if entry.endswith("camera") else OF_A_POSITION
    names = [one for one in OBSERVED if one not in evidence]
    for name in names:
        frames = [[observation(k, person, name) for person in (0, 1)] for k in range(N)]
        if "position" in name and entry.endswith("camera"):
            frames = [[replace(one, pixel=None) for one in some] for some in frames]
        before, notes = found_by(frames)
        after, _ = found_by([[other(one, name) for one in some] for some in frames])
        if before == after and not is_named(name, notes):
            silent.append(name)
    assert silent == []


@pytest.mark.parametrize(
    ("model", "identified"),
    others_slow(
        [(model, identified) for model in ("position", "joint") for identified in (True, False)],
        [("joint", True)],
    ),
)
def test_every_key_of_a_stream_is_used_refused_or_named(model: str, identified: bool) -> None:
    known: dict[str, tuple[str, list[str]]] = {}

    def answers(rows: list[dict[str, Any]]) -> tuple[str, list[str]]:
        if repr(rows) in known:
            return known[repr(rows)]
        notes: list[str] = []
        settings = Answers(Model(model), associate="never" if identified else "auto")
        people = settings.people(notes.append) if identified else settings.scenes(notes.append)
        found = [people.answers(k, json.dumps(row).encode()) for k, row in enumerate(rows)]
        known[repr(rows)] = repr([*found, people.finish()]), notes
        return known[repr(rows)]

    silent = []
    for column in COLUMNS:
        table = scene_of(column.field).to_table().sort_values(["t", "track_id"]).drop(columns="label")
        if column.name not in table or column.name in OF_A_POSITION:
            continue
        if column.name in ("x_std", "y_std"):
            table = table.drop(columns="pos_std")
        if not identified and column.field in (EVIDENCE_ALONE if model == "position" else ["score"]):
            continue  # evidence, once enough detections were decided
        table = table if identified else table.drop(columns="track_id")
        altered = table.copy()
        altered[column.name] = altered[column.name] * np.repeat(np.linspace(0.7, 0.9, N), 2)
        before, notes = answers(table.to_dict("records"))
        after, _ = answers(altered.to_dict("records"))
        if before == after and not any(f"'{column.name}'" in one for one in notes):
            silent.append(column.name)
    assert silent == []
    assert INTEGERS  # an identity and a frame are needed, and answered


def test_rows_of_three_numbers_and_detections_of_another_time_are_refused() -> None:
    tracker = gt.OnlineTracker("position")
    for wrong in ([(1.0, 2.0, 3.0)], np.ones((2, 3)), [(1.0,)], [3.0], ["ab"], [None]):
        with pytest.raises(gt.InputError, match=r"found a detection .*, expected x and y in metres"):
            tracker.update(0.0, wrong)
    with pytest.raises(gt.InputError, match=r"a detection of t = 0.3 in the update of t = 0"):
        tracker.update(0.0, [Observation(t=0.3, position=(1.0, 2.0))])
    assert tracker.updates == 0


def test_x_std_and_y_std_are_the_noise_of_positions_without_pos_std() -> None:
    track = FULL[0]
    x, y = np.sqrt(track.covariance[:, 0, 0]), np.sqrt(track.covariance[:, 1, 1])
    declared = replace(track, covariance=None, position_std=np.sqrt((x**2 + y**2) / 2.0))
    by_axes = replace(track, position_std=None)
    for call in (gt.smooth, gt.track_online):
        with pytest.warns(gt.InputWarning, match="x_std and y_std are used as the noise"):
            found = call(by_axes, "position")
        with pytest.warns(gt.InputWarning, match="not used"):
            expected = call(declared, "position")
        np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
        np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-9)
    # Where both are given, pos_std counts.
    both = gt.smooth(track, "position")
    np.testing.assert_array_equal(
        both.position, gt.smooth(replace(track, covariance=None), "position").position
    )
