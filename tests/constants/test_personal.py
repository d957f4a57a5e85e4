"""Constants of each person: evidence against exact densities, invariances, and people not learned from."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import ran, run
from innovation_filter import estimates
from noisy_walkers import walker
from scipy import stats

import graphtrack as gt
from graphtrack.constants.filters import turning_evidence
from graphtrack.constants.personal import averaged, mixture, solve_learned
from graphtrack.constants.population import COUPLINGS, DIFFUSIONS, Population, learned, posterior
from graphtrack.constants.prediction import HALVES, HeldOut
from graphtrack.errors import InputError
from graphtrack.experiments.harness import evenly, thinned
from graphtrack.geometry.angles import wrap
from graphtrack.model.given import observed_direction
from graphtrack.model.parameters import CouplingParameters, Parameters
from graphtrack.tracks.track import Track, TrackSet


def mixed(count: int = 12) -> TrackSet:
    """People who face where they go, and as many who walk sideways and turn a lot."""
    return TrackSet(
        tuple(
            walker(k, turn=1.0 * (k % 2), aside=1.4 * (k % 2), track_id=k, n=60 + 7 * (k % 3))
            for k in range(count)
        )
    )


def body_error(found: TrackSet, truth: TrackSet) -> float:
    pairs = zip(found, truth, strict=True)
    return float(np.degrees(np.mean([np.abs(wrap(one.body - true.true_body)).mean() for one, true in pairs])))


# -- evidence ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("diffusion", [0.003, 0.1, 1.0])
@pytest.mark.parametrize("kappa", [3.0, 30.0])
def test_evidence_of_turning_is_near_that_of_a_filter_on_a_grid(diffusion: float, kappa: float) -> None:
    track = replace(walker(2, n=40), head_kappa=np.full(40, kappa))
    assert track.head is not None
    circle = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    step = circle[1] - circle[0]
    blur = np.exp(-0.5 * wrap(circle[:, None] - circle) ** 2 / (0.1 * diffusion))
    blur /= blur.sum(axis=0)
    density, expected = np.full(len(circle), 0.5 / np.pi), 0.0
    for k, angle in enumerate(track.head):
        density = blur @ density if k else density
        joint = density * stats.vonmises(kappa, loc=angle).pdf(circle)
        expected += np.log(joint.sum() * step) if k else 0.0
        density = joint / (joint.sum() * step)
    found = turning_evidence([track], "head", Parameters(), np.array([diffusion]))
    assert found[0, 0] == pytest.approx(expected, abs=0.02 * len(track.head))


def test_classes_count_as_the_angle_of_their_mean() -> None:
    classes = np.zeros((3, 8))
    classes[0, 2] = 1.0
    classes[1, [1, 3]] = 0.5
    classes[2] = np.nan
    track = replace(walker(3, n=3), body=None, body_kappa=None, body_likelihood=classes)
    angle, kappa = observed_direction(track, "body", Parameters())
    np.testing.assert_allclose(angle[:2], np.pi / 2.0, atol=1e-12)
    assert kappa[0] > kappa[1] > 0.0 and np.isnan(angle[2]) and kappa[2] == 0.0


@pytest.mark.parametrize("half", HALVES)
def test_held_out_angles_are_judged_by_estimates_without_them(half: int) -> None:
    track, model = walker(4, n=30), gt.Model("joint")
    head = track.head.copy()
    head[[3, 4, 11]] = np.nan
    track = replace(track, head=head)
    held_out = HeldOut([track], model.parameters)
    estimate = gt.smooth(held_out.without(half)[0], model)
    found = held_out.density([estimate], half)
    grid = np.linspace(-np.pi, np.pi, 2000, endpoint=False)
    expected = 0.0
    for place, channel, kappa in ((4, "body", 4.0), (5, "head", 8.0)):
        values = getattr(track, channel)
        for k in np.flatnonzero(np.isfinite(values))[half::2].tolist():
            believed = stats.vonmises(1.0 / estimate.covariance[k, place, place]).pdf
            density = believed(grid - getattr(estimate, channel)[k]) * stats.vonmises(kappa).pdf(
                grid - values[k]
            )
            expected += np.log(density.mean() * 2.0 * np.pi)
    assert found[0] == pytest.approx(expected, rel=1e-6)


def test_halves_share_every_angle_and_class_and_nothing_else_changes() -> None:
    classes = np.full((20, 8), np.nan)
    classes[::3, 2] = classes[::3, 3] = 0.5
    classes[::3] = np.nan_to_num(classes[::3])
    track = replace(walker(5, n=20), body=None, body_kappa=None, body_likelihood=classes)
    parts = [HeldOut([track], Parameters()).without(half)[0] for half in HALVES]
    for column in ("head", "body_likelihood"):
        known = [np.isfinite(getattr(one, column).reshape(20, -1)[:, 0]) for one in (track, *parts)]
        np.testing.assert_array_equal(known[0], known[1] ^ known[2])
        assert abs(int(known[1].sum()) - int(known[2].sum())) <= 1
    np.testing.assert_array_equal(parts[0].position, track.position)
    persistent = replace(track, inputs={"body_persistence": np.ones(20)})
    for half in HALVES:
        kept = HeldOut([persistent], Parameters()).without(half)[0]
        np.testing.assert_array_equal(kept.body_likelihood, classes)


@pytest.mark.parametrize("online", [False, True])
def test_a_classifier_that_is_wrong_throughout_does_not_free_people_who_walk(online: bool) -> None:
    """Its errors predict each other, which would speak for somebody who side-steps."""
    people = []
    for k in range(4):
        track = walker(k, n=80, track_id=k, aside=np.pi / 2.0)
        nearest = np.round(np.nan_to_num(track.body) * 4.0 / np.pi).astype(int) % 8
        wrong = 0.9 * np.eye(8)[nearest] + 0.1 / 8.0
        classes = {"head": None, "body": None, "body_kappa": None, "body_likelihood": wrong}
        people.append(replace(track, **classes, inputs={"body_persistence": np.ones(len(track))}))
    scene = gt.TrackSet(tuple(people))
    answered = gt.track_online(scene).tracks if online else gt.smooth(scene).tracks
    for one in answered:
        ahead = np.abs(wrap(one.body - np.arctan2(one.velocity[:, 1], one.velocity[:, 0])))[20:]
        assert np.median(ahead) < np.radians(20.0)


def test_somebody_who_faces_where_he_goes_is_coupled_however_noisy_the_angles() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 18.0, 0.1)
    people = []
    for k in range(6):
        course = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.3, 0.3) * t
        steps = 0.12 * np.column_stack([np.cos(course), np.sin(course)])
        position = np.cumsum(steps, axis=0)
        people.append(gt.Track(k, np.arange(len(t)), t, position, body=wrap(course), head=wrap(course)))
    truth = gt.TrackSet(tuple(people))
    noisy = gt.add_noise(truth, position_std=0.1, body_kappa=1.2, head_kappa=2.3, rng=rng)
    for one in gt.solve(noisy, "joint", constants="learn", trust="declared"):
        free = sum(p for name, p in one.constants.coupling.items() if "body follows path" not in name)
        assert free < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["body", "head"])
@pytest.mark.parametrize("declared", [True, False])
def test_a_classifier_that_is_often_wrong_turns_nobody(channel: str, declared: bool) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 20.0, 0.1)
    people, truth = [], []
    for k in range(8):
        course = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.3, 0.3) * t
        position = np.cumsum(0.12 * np.column_stack([np.cos(course), np.sin(course)]), axis=0)
        observed = {name: course + rng.normal(0.0, 0.25, len(t)) for name in ("body", "head")}
        wrong = rng.random(len(t)) < 0.3
        observed[channel] = np.where(wrong, course + np.pi, observed[channel])
        kappas = {f"{name}_kappa": np.full(len(t), 16.0) for name in observed} if declared else {}
        angles = {name: wrap(angle) for name, angle in observed.items()}
        noise = rng.normal(0.0, 0.1, position.shape)
        people.append(gt.Track(k, np.arange(len(t)), t, position + noise, **angles, **kappas))
        truth.append(course)
    found = gt.solve(gt.TrackSet(tuple(people)), "joint", constants="learn", trust="declared")
    assert found[0].constants.noise[f"{channel}_outliers"] == 0.3
    other = {"body": "head", "head": "body"}[channel]
    assert f"{other}_outliers" not in found[0].constants.noise
    for one, course in zip(found, truth, strict=True):
        for name in ("body", "head"):
            assert np.abs(wrap(getattr(one.track, name) - course)).mean() < np.radians(8.0)


def test_a_mixture_of_opposite_directions_is_no_more_uncertain_than_any_direction() -> None:
    states = np.zeros((2, 1, 6))
    states[1, :, 4:] = np.pi
    covariance = np.tile(np.eye(6), (2, 1, 1, 1))
    _, total = mixture(states, covariance, np.full(2, 0.5))
    assert np.diagonal(total[0])[4:] == pytest.approx(np.pi**2 / 3.0)


# -- the population ------------------------------------------------------------------------------------------


def test_shares_tend_to_those_of_the_people_and_without_people_are_the_prior() -> None:
    sure, start = np.log(np.eye(4)[[0] * 300 + [3] * 100] + 1e-9), Population().coupling
    np.testing.assert_allclose(learned(sure, start, 2.0, None)[[0, 3]], [0.75, 0.25], atol=0.01)
    np.testing.assert_allclose(learned(np.zeros((0, 4)), start, 2.0, None), start)


def test_one_person_leans_on_the_prior_and_evidence_that_says_nothing_changes_nothing() -> None:
    start = np.array(Population().body_diffusion)
    np.testing.assert_allclose(posterior(np.full((1, len(DIFFUSIONS)), -7.0), start)[0], start)


def test_a_population_is_read_as_it_was_written_and_others_are_refused(tmp_path) -> None:
    path = tmp_path / "people.toml"
    written = Population(coupling=(0.25, 0.25, 0.25, 0.25), people=7.0)
    written.save(path)
    assert Population.load(path) == written
    for content, message in (
        ("people = -1.0\n", "people"),
        ("coupling = [0.5, 0.5]\n", "4 positive shares"),
        ("coupling = 3\n", "a list of shares"),
        ("sofa = 1\n", "unknown key 'sofa'"),
        ("coupling = [0.5, 0.5\n", "people.toml"),
    ):
        path.write_text(content)
        with pytest.raises(InputError, match=message):
            Population.load(path)


# -- smoothing -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_everybody_gets_constants_of_their_own() -> None:
    people = mixed()
    found = gt.solve(people, constants="learn")
    facing, sideways = ([one.constants for one in found[k::2]] for k in (0, 1))  # type: ignore[union-attr]
    follows = [
        [sum(one.coupling[COUPLINGS[k].name] for k in (2, 3)) for one in some]  # type: ignore[union-attr]
        for some in (facing, sideways)
    ]
    assert max(follows[1]) < 0.05 < min(follows[0])
    mean = [np.mean([one.body_diffusion for one in some]) for some in (facing, sideways)]  # type: ignore[union-attr]
    assert mean[1] > 4.0 * mean[0]
    default, own = (gt.smooth(people, constants=which) for which in ("default", "learn"))
    assert body_error(own, people) < 0.6 * body_error(default, people)


def test_gross_errors_are_found_and_move_nobody() -> None:
    people, rng = mixed(6), np.random.default_rng(3)

    def spoilt(track: Track) -> Track:
        position, wrong = track.position.copy(), rng.random(len(track)) < 0.05
        position[wrong] += rng.normal(0.0, 4.0, (wrong.sum(), 2))
        return replace(track, position=position)

    def off(found: TrackSet) -> float:
        pairs = zip(found, people, strict=True)
        return float(
            np.mean([np.linalg.norm(one.position - true.true_position, axis=1).mean() for one, true in pairs])
        )

    wrong = people.map(spoilt)
    assert gt.smoothing.learn_constants(people)[0].gross_errors < 1e-3
    assert 0.02 < gt.smoothing.learn_constants(wrong)[0].gross_errors < 0.08
    assert off(gt.smooth(wrong)) < 1.15 * off(gt.smooth(people))
    assert off(gt.track_online(wrong)) < 1.3 * off(gt.track_online(people))


@pytest.mark.slow
def test_neither_order_nor_threads_change_an_estimate() -> None:
    people = mixed(8)
    found = gt.smooth(people, constants="learn")
    for other in (
        gt.smooth(people, constants="learn", jobs=1),
        gt.smooth(people.with_tracks(people.tracks[::-1]), constants="learn"),
    ):
        by_id = {one.track_id: one for one in other}
        for one in found:
            assert (by_id[one.track_id].position == one.position).all()
            assert (by_id[one.track_id].covariance == one.covariance).all()


@pytest.mark.slow
def test_gtsam_has_the_same_constants_and_estimates() -> None:
    people = mixed(4)
    chain, graph = (gt.smooth(people, constants="learn", engine=name) for name in ("chain", "gtsam"))  # type: ignore[call-overload]
    for one, other in zip(chain, graph, strict=True):
        np.testing.assert_allclose(other.position, one.position, atol=0.02)
        assert np.abs(wrap(other.body - one.body)).max() < 0.1


def test_a_known_population_is_used_as_it_is() -> None:
    people = mixed(4)
    free = Population(coupling=(0.997, 0.001, 0.001, 0.001))
    _, shares = solve_learned(
        people,
        gt.Model("joint"),
        lambda some, model, own, done: gt.solve(some, "joint", constants="default"),
        population=free,
    )
    assert shares.coupling == free.coupling


FREE = Parameters(coupling=CouplingParameters(motion_body_kappa=30.0))


def test_alternatives_are_averaged_with_their_spread() -> None:
    track = walker(5)
    one, other = (gt.solve(track, gt.Model("joint", own))[0] for own in (Parameters(), FREE))
    apart = replace(other, track=replace(other.track, body=wrap(other.track.body + 1.0)))  # type: ignore[union-attr]
    found = averaged([one, apart], np.array([0.5, 0.5])).track  # type: ignore[list-item]
    assert found.covariance is not None and one.track.covariance is not None  # type: ignore[union-attr]
    assert (found.covariance[:, 4, 4] > one.track.covariance[:, 4, 4] + 0.1).all()  # type: ignore[union-attr]
    away = wrap(found.body - one.track.body)  # type: ignore[union-attr]
    assert (np.abs(away - 0.5) < 0.25).all()


@pytest.mark.slow
def test_the_command_prints_the_constants_and_refuses_others(cwd) -> None:
    gt.write(mixed(4), "walks.csv")
    done = ran("smooth", "walks.csv", "-o", "found.csv", "--report", "page.html", program="graphtrack")
    assert done.stderr.count("body turns") == 4 and "model joint" in done.stderr
    page = (cwd / "page.html").read_text(encoding="utf-8")
    assert "Constants of each person" in page and "body turns (°/√s)" in page
    done = ran("fit", "walks.csv", "--constants", "-o", "people.toml", program="graphtrack")
    population, people = gt.smoothing.learn_constants("walks.csv")
    assert Population.load("people.toml") == population and set(people) == set(range(4))
    ran("smooth", "walks.csv", "-o", "again.csv", "--constants", "people.toml", program="graphtrack")
    for wrong in (["--constants", "lern"], ["--constants", "learn", "--model", "intentional"]):
        done = run("smooth", "walks.csv", "-o", "no.csv", *wrong, program="graphtrack")
        assert done.returncode == 2 and "constants" in done.stderr


def test_info_shows_the_constants_of_each_person(tmp_path: Path) -> None:
    people = mixed(4).map(lambda track: replace(track, position_std=None))
    gt.write(people, tmp_path / "seen.csv")
    out = ("--constants", "--json", tmp_path / "out.json")
    done = ran("info", tmp_path / "seen.csv", *out, program="graphtrack")
    assert "noise, learned: positions 0." in done.stderr
    _, learned_by = gt.smoothing.learn_constants(gt.read(tmp_path / "seen.csv"))
    rows = json.loads((tmp_path / "out.json").read_text("utf-8"))
    assert [row["constants"] for row in rows] == [one.described() for one in learned_by.values()]


INPUTS = {"all": ("body", "head"), "heads alone": ("head",), "positions alone": ()}


def observed(tracks: TrackSet, hz: float, channels: tuple[str, ...], rng: np.random.Generator) -> list[Track]:
    """Noise of 0.1 m, 30° (body) and 20° (head), and 15 % of the frames empty."""
    found = []
    for track in tracks:
        track = thinned(track, max(1, round(1.0 / (hz * float(np.median(track.dt[1:]))))))
        if len(track) < 8:
            continue
        empty = rng.random(len(track)) < 0.15
        empty[0] = False
        truth = {f"true_{name}": getattr(track, name) for name in ("position", "body", "head")}
        position = track.position + rng.normal(0.0, 0.1, (len(track), 2))
        position[empty] = np.nan
        angles: dict[str, np.ndarray] = {}
        for name, degrees in (("body", 30.0), ("head", 20.0)):
            true, noise = getattr(track, name), rng.normal(0.0, np.radians(degrees), len(track))
            if true is not None and name in channels:
                angles[name] = np.where(empty, np.nan, wrap(true + noise))
                angles[f"{name}_kappa"] = np.full(len(track), np.radians(degrees) ** -2)
        std = np.full(len(track), 0.1)
        found.append(Track(len(found), track.frame, track.t, position, position_std=std, **truth, **angles))
    return found


def errors(track: Track, found: dict[str, np.ndarray]) -> dict[str, float]:
    away = found["position"] - track.true_position
    result = {"position": float(np.sqrt(np.mean(np.sum(away**2, axis=1))))}
    for name in ("body", "head"):
        truth = getattr(track, f"true_{name}")
        if truth is not None:
            result[name] = float(np.abs(wrap(found[name] - truth)).mean())
    return result


@pytest.mark.slow
@pytest.mark.parametrize("hz", [10.0, 2.5])
@pytest.mark.parametrize("channels", INPUTS.values(), ids=list(INPUTS))
def test_errors_are_those_of_a_filter_that_learns_its_constants_or_smaller(
    data_dir: Path, hz: float, channels: tuple[str, ...]
) -> None:
    rng, people, source = np.random.default_rng(7), list[Track](), list[str]()
    for name in ("lafan1", "citr", "vru"):
        tracks = gt.read(data_dir / name / "truth.csv.gz")
        if name == "lafan1":  # pieces of 20 seconds
            parts = [t[k : k + 600] for t in tracks for k in range(0, len(t) - 599, 600)]
            tracks = tracks.with_tracks(replace(one, track_id=k) for k, one in enumerate(parts))
        people += observed(evenly(tracks, 20, 3.0), hz, channels, rng)
        source += [name] * (len(people) - len(source))
    crowd = TrackSet(tuple(replace(track, track_id=k) for k, track in enumerate(people)))
    ratios = []
    smoothed = gt.smooth(crowd, constants="learn")
    pairs = [
        (errors(t, {n: getattr(s, n) for n in ("position", "body", "head")}), errors(t, estimates(t)))
        for t, s in zip(crowd, smoothed, strict=True)
    ]
    for name in ("lafan1", "citr", "vru"):
        own = [pair for pair, one in zip(pairs, source, strict=True) if one == name]
        for quantity in own[0][0]:
            ratios.append(
                np.mean([ours[quantity] for ours, _ in own]) / np.mean([its[quantity] for _, its in own])
            )
    assert max(ratios) < 1.1 and np.exp(np.mean(np.log(ratios))) < 1.0, ratios
