"""Experiments on a few people: their tables, and that methods are compared alike."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import innovation_filter
import numpy as np
import pytest

from graphtrack.evaluation.chosen_filter import chosen_filter
from graphtrack.experiments import Settings, baxter_weight, chen_joint, gaits, unseen_people
from graphtrack.experiments.baxter_simulated import RIVAL, Gain, paired
from graphtrack.experiments.chen_classes import (
    OPTIONS,
    camera_before,
    classified,
    image_scores,
    in_image,
    turned_to_world,
)
from graphtrack.experiments.chen_joint import (
    ANGLES,
    FITTED,
    PAIRS,
    Cohort,
    FittedErrors,
    Scores,
    _pairs,
    _parameters,
    confusion_of,
    errors_of,
    fitted_models,
    most_likely_error,
)
from graphtrack.experiments.harness import ISAM2, at_limit, fit, halves, unit_of
from graphtrack.geometry.angles import class_centres, difference, wrap
from graphtrack.inference import smooth_track
from graphtrack.model import Model
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour
from graphtrack.simulation.crowd import strollers
from graphtrack.simulation.degrade import add_class_likelihoods, add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.track import BODY_CLASSES, Track, TrackSet

SETTINGS = Settings(quick=True)


@pytest.mark.slow
def test_baxter_weight_fits_each_dependence_of_the_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    corpus = simulate_behaviour(4, CorpusParameters(tracks=3, steps=120), rng=SETTINGS.rng(0))
    first, *others = corpus.tracks()
    source = baxter_weight.WeightData("corpus", 2.5, [first], others)
    monkeypatch.setattr(baxter_weight, "sources", lambda settings: [source])
    monkeypatch.setattr(baxter_weight, "METHODS", ("intentional",))
    done: list[int] = []
    detail, beside = baxter_weight.EXPERIMENT.run(SETTINGS, done.append).tables
    weights = {row["weight"]: row for row in detail.records()}
    assert set(weights) == {"constant", "grows", "falls"} and len(done) > 6
    low, high = "λ at 0° (1/s)", "λ at 90° (1/s)"
    assert weights["constant"][low] == pytest.approx(weights["constant"][high])
    assert weights["grows"][low] < weights["grows"][high]
    assert weights["falls"][low] > weights["falls"][high]
    (row,) = beside.records()
    for weight in ("grows", "falls"):
        gain = weights[weight]["nats"] - weights["constant"]["nats"]
        assert row[f"{weight} − constant (nats)"] == pytest.approx(gain)


@pytest.mark.slow
def test_people_of_every_source_are_judged_by_every_model(monkeypatch: pytest.MonkeyPatch) -> None:
    def people(seed: int):  # type: ignore[no-untyped-def]
        return lambda settings: strollers(np.random.default_rng(seed), people=2, seconds=6.0)

    sources = {name: people(k) for k, name in enumerate(("one", "other"))}
    monkeypatch.setattr(unseen_people, "SOURCES", {**sources, "absent": lambda settings: None})
    done: list[int] = []
    summary, errors = unseen_people.EXPERIMENT.run(SETTINGS, done.append).tables
    rows = errors.records()
    settings = {(row["source"], row["rate (Hz)"], row["inputs"], row["way"]) for row in rows}
    assert len(settings) == 2 * 2 * 3 * 2 and len(rows) == 3 * len(settings)
    for row in rows:
        own = [row[f"{model} (m or °)"] for model in unseen_people.MODELS]
        assert all(0.0 < one < 180.0 for one in own if one is not None and np.isfinite(one))
        assert row["over the filter"] == pytest.approx(own[0] / own[1])
        assert row["over the best preset"] == pytest.approx(own[0] / np.nanmin(own[2:]))
    for row in summary.records():
        ratios = [one["over the filter"] for one in rows if one["way"] == row["way"]]
        assert row["over the filter, geometric mean"] == pytest.approx(np.exp(np.mean(np.log(ratios))))
    assert sum(done) == len(settings) / 2


def test_the_filter_that_chooses_is_the_reference() -> None:
    people = unseen_people.observed(
        strollers(np.random.default_rng(3), people=3, seconds=12.0), 10.0, "all", np.random.default_rng(4)
    )
    for track in people:
        found, expected = chosen_filter(track, online=False), innovation_filter.estimates(track)
        assert np.sqrt(np.mean((found.position - expected["position"]) ** 2)) < 0.01
        for name in ("body", "head"):
            assert np.degrees(np.abs(wrap(getattr(found, name) - expected[name])).mean()) < 1.5


def test_wrong_turns_are_those_that_last() -> None:
    n = 40
    truth = Track(0, np.arange(n), 0.1 * np.arange(n), np.zeros((n, 2)), true_body=np.zeros(n))
    body = np.zeros(n)
    body[5:8], body[20:30] = 3.0, -2.0
    count, hours = unseen_people.wrong_turns(TrackSet((truth,)), [replace(truth, body=body)])
    assert count == 1 and hours == pytest.approx(3.9 / 3600.0)
    spun = replace(truth, true_body=np.where(np.arange(n) == 24, 1.7, 0.0))
    assert unseen_people.wrong_turns(TrackSet((spun,)), [replace(spun, body=body)])[0] == 0


@pytest.mark.slow
def test_every_way_is_scored_on_the_same_people(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = simulate("joint", n_tracks=4, n_steps=15, rng=np.random.default_rng(0))
    some = {gaits.ORDINARY: drawn, gaits.SIDEWAYS: drawn.with_tracks(drawn.tracks[:2])}
    monkeypatch.setattr(gaits, "people", lambda settings: some)
    monkeypatch.setattr(gaits, "DRAWS", 2)
    steps: list[int] = []
    expected: list[int] = []
    found = gaits.EXPERIMENT.run(Settings(), steps.append, expected.append)
    assert [sum(steps)] == expected
    errors, differences = (table.records() for table in found.tables)
    assert len(errors) == 2 * (len(gaits.ESTIMATORS) * len(gaits.PRESETS) + len(gaits.LEARNING))
    rows = {(row["people"], row[""], row["model"]): row for row in errors}
    for (who, way, preset), row in rows.items():
        count = 2 if who == gaits.SIDEWAYS or way != "offline" else 4
        assert (row["clips"], row["draws"]) == (count, 1 if way.endswith("isam2") else 2)
        assert 0.0 < row["body (°)"] < 90.0 and 0.0 < row["position (m)"] < 0.5, preset
    for row in differences:
        learned, other = (rows[row["people"], row[""], m] for m in (gaits.LEARNED, row["learned less"]))
        assert row["head (°)"] == pytest.approx(learned["head (°)"] - other["head (°)"])
    for way in gaits.LEARNING:
        learned, constant = (rows[gaits.ORDINARY, way, model] for model in (gaits.LEARNED, "joint"))
        assert learned["body (°)"] != constant["body (°)"]


def test_a_clip_has_the_same_noise_whoever_else_is_there() -> None:
    drawn = simulate("joint", n_tracks=3, n_steps=5, rng=np.random.default_rng(0))
    alone, all_of_them = (
        gaits._noisy(tracks, Settings(), 1) for tracks in (drawn.with_tracks(drawn.tracks[2:]), drawn)
    )
    np.testing.assert_array_equal(alone.tracks[0].position, all_of_them.tracks[2].position)
    assert not np.array_equal(
        gaits._noisy(drawn, Settings(), 0).tracks[0].position, all_of_them.tracks[0].position
    )


def test_without_the_recording_a_line_says_so(tmp_path: Path) -> None:
    found = gaits.EXPERIMENT.run(Settings(data=tmp_path))
    assert not found.tables and "--data" in found.notes[0]
    assert gaits.people(Settings()) == {}


@pytest.fixture(scope="module")
def tracks() -> TrackSet:
    drawn = simulate("joint", n_tracks=2, n_steps=30, rng=np.random.default_rng(0))
    return add_noise(drawn, position_std=0.05, rng=np.random.default_rng(1))


def test_the_camera_sees_all_of_them(tracks: TrackSet) -> None:
    camera = camera_before(tracks)
    for track in tracks:
        seen = camera.ground_to_image(track.position)
        assert np.isfinite(seen).all() and not camera.is_mirrored
        np.testing.assert_allclose(camera.image_to_ground(seen), track.position, atol=1e-6)


def test_sure_answers_in_the_image_are_turned_to_the_true_class_of_the_world(tracks: TrackSet) -> None:
    camera = camera_before(tracks)
    seen = tracks.map(lambda track: in_image(track, camera))
    sure = add_class_likelihoods(seen, body=np.eye(8), head=np.eye(12), rng=np.random.default_rng(2))
    for track, truth in zip(sure, tracks, strict=True):
        turned = turned_to_world(track, camera)
        for angle, count in (("body", 8), ("head", 12)):
            likelihood = getattr(turned, f"{angle}_likelihood")
            np.testing.assert_allclose(likelihood.sum(axis=1), 1.0)
            said = class_centres(count)[likelihood.argmax(axis=1)]
            # Half a class of the image, half a one of the world, and the noise of the position.
            assert np.abs(difference(said, getattr(truth, f"true_{angle}"))).max() < 2.2 * np.pi / count


def test_every_filter_is_scored_with_every_model_of_the_paper(tracks: TrackSet) -> None:
    short = tracks.map(lambda track: track[:8])
    found = image_scores("drawn", short, partial(classified, rng=np.random.default_rng(3)))
    methods = {method for preset, method, _ in found.errors if preset != "observation"}
    assert methods == set(OPTIONS)
    assert {preset for preset, *_ in found.errors} == {"observation", "separate", "joint-body", "joint"}
    assert all(len(errors) == 2 and np.isfinite(errors).all() for errors in found.errors.values())


def test_each_method_gets_its_own_parameters_and_isam2_those_of_its_graph() -> None:
    tracks = simulate("joint", n_tracks=2, n_steps=25, rng=np.random.default_rng(5))

    def smoothed(track: Track, model: Model) -> Track:
        return smooth_track(track, model).track

    def observed(track: Track, model: Model) -> Track:
        return track

    methods = {
        "graph": ("online", smoothed),
        f"graph{ISAM2}": ("online", smoothed),
        "none": ("online", observed),
    }
    seen: list[int] = []
    found = fitted_models(tracks, methods, 14, seen.append)
    assert set(found) == {(preset, method) for preset in FITTED for method in methods}
    for preset in FITTED:
        assert found[preset, f"graph{ISAM2}"] is found[preset, "graph"]
        before = np.mean([errors_of(smoothed(track, Model(preset)), track) for track in tracks])
        after = np.mean([errors_of(smoothed(track, found[preset, "graph"]), track) for track in tracks])
        assert after < before
    # The paper's separate filtering has no κ₂ to fit.
    of_head = "coupling.head_body_kappa"
    assert found["joint-body", "graph"].parameters.value(of_head) == Model("joint-body").parameters.value(
        of_head
    )
    case = Cohort("people", tracks, tracks)
    scores = Scores("people", 2, {})
    rows = list(_parameters([FittedErrors(case, scores, found, {})]))
    assert rows[0]["method"] == "default" and len(rows) == 1 + 2 * len(FITTED)
    assert [row["κ₂"] for row in rows if row["preset"] == "joint-body"] == [None, None]


@pytest.mark.slow
def test_every_method_is_judged_with_default_and_with_fitted_parameters(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    people = simulate("joint", n_tracks=2, n_steps=12, rng=np.random.default_rng(0))
    monkeypatch.setattr(chen_joint, "cases", lambda settings: [Cohort("people", people, people)])
    steps: list[int] = []
    expected: list[int] = []
    detail = chen_joint.EXPERIMENT.run(SETTINGS, steps.append, expected.append).tables[0]
    assert sum(steps) <= expected[0]  # a search may end before its time
    rows = detail.records()
    assert len(rows) == len(ANGLES) * len(chen_joint.METHODS)
    for row in rows:
        default = [row[f"{preset} (°)"] for preset in chen_joint.PRESETS]
        assert all(np.isnan(value) == str(row["method"]).endswith(ISAM2) for value in default)
        assert all(0.0 < row[f"{preset}, fitted (°)"] < 180.0 for preset in FITTED)


def test_a_search_that_ends_where_it_may_go_no_further_says_so() -> None:
    (found,) = fit(lambda value: value, [0.17], evaluations=60)
    assert at_limit(0.17, found) and not at_limit(0.17, 0.01) and at_limit(24.36, 2436.0)


@pytest.mark.slow
def test_differences_between_methods_are_of_the_same_people() -> None:
    rng = np.random.default_rng(0)
    hard = rng.uniform(0.0, 100.0, 30)  # differs from person to person by far more than from method to method
    names = {name for pair in PAIRS for name in pair}
    worth = {name: float(i) for i, name in enumerate(sorted(names))}
    fitted = {
        (preset, name, angle): hard - worth[name] + rng.normal(0.0, 0.1, 30)
        for preset in FITTED
        for name in names
        for angle in ANGLES
    }
    people = simulate("joint", n_tracks=30, n_steps=2, rng=rng)
    case = Cohort("people", people, people)
    rows = list(_pairs([FittedErrors(case, Scores("people", 30, {}), {}, fitted)], rng))
    assert len(rows) == len(FITTED) * len(ANGLES) * len(PAIRS)
    for row in rows:
        first, second = str(row["difference"]).split(" − ")
        assert row["fitted (°)"] == pytest.approx(worth[second] - worth[first], abs=0.15)
        assert row["low"] < row["fitted (°)"] < row["high"] and row["high"] - row["low"] < 0.3


def test_people_who_are_judged_come_from_other_units_than_those_fitted_on() -> None:
    drawn = simulate("joint", n_tracks=12, n_steps=3, rng=np.random.default_rng(1)).tracks
    gaits_of = ("walk", "walk-turn-left")
    labels = [f"dataset-{1 + k % 2}_{gaits_of[k % 2]}_style-{k % 5}_00{k}" for k in range(12)]
    clips = TrackSet(tuple(replace(track, label=label) for track, label in zip(drawn, labels, strict=True)))
    assert unit_of(clips.tracks[0]) == "dataset-1 style-0"
    fitted, judged = ({unit_of(track) for track in half} for half in halves(clips))
    assert not fitted & judged and fitted | judged == {unit_of(track) for track in clips}
    assert unit_of(drawn[3]) == str(drawn[3].track_id)


@pytest.mark.parametrize(("degrees", "classes"), [(41.7, 8), (30.3, 12)])
def test_confusions_have_the_mean_error_that_was_asked_for(degrees: float, classes: int) -> None:
    matrix = confusion_of(np.radians(degrees), classes)
    rng = np.random.default_rng(0)
    truth = rng.uniform(-np.pi, np.pi, 20_000)
    n = len(truth)
    track = Track(0, np.arange(n), 0.1 * np.arange(n), np.zeros((n, 2)), body=truth, head=truth)
    name = "body" if classes == BODY_CLASSES else "head"
    seen = add_class_likelihoods(TrackSet((track,)), **{name: matrix}, rng=rng).tracks[0]
    assert most_likely_error(seen, seen, name) == pytest.approx(degrees, rel=0.02)


def test_graphs_meet_the_tracker_on_the_same_tracks_of_each_cell() -> None:
    hard = np.exp(
        np.random.default_rng(1).normal(0.0, 1.0, 40)
    )  # squared errors of the tracker over the filter's
    found = []
    for behaviour, share in enumerate((0.5, 2.0)):  # the graph's squared error over the tracker's
        found.append(Gain(behaviour, 1.0, RIVAL, 1.0 / hard, 1.0 / hard, -hard))
        few = hard[:10]
        found.append(
            Gain(behaviour, 1.0, "graph joint", 1.0 / (share * few), 1.0 / few, -few - np.log(share))
        )
    cells, counts = paired(found, ("straight", "turn"), np.random.default_rng(2))
    first, second = cells.records()
    assert first["squared error / rival's"] == pytest.approx(0.5)
    assert first["ratio: high"] == pytest.approx(0.5)
    assert second["squared error / rival's"] == pytest.approx(2.0)
    assert first["nats a detection − rival's"] == pytest.approx(np.log(2.0))
    assert second["nats: high"] == pytest.approx(-np.log(2.0))
    (count,) = counts.records()
    assert count["cells"] == 2
    assert count["squared error: better"] == count["squared error: clearly worse"] == 1
    assert count["likelihood: clearly better"] == count["likelihood: clearly worse"] == 1
