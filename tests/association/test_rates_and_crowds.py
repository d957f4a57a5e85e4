"""What is learned of a scene, and the identities, at any rate, any number of people and from any start."""

import numpy as np
import pytest
from crossing_people import idf1, packed_square, run_online, street
from selection import others_slow

from graphtrack.association.motion import noise_of, velocities_of
from graphtrack.association.offline import associate_detections
from graphtrack.association.online import OnlineAssociation
from graphtrack.association.scene import first_guess
from graphtrack.tracks.detections import Detections


def corridor(
    hz: float, seconds: float = 60.0, seed: int = 0, noise: float = 0.1
) -> tuple[Detections, np.ndarray]:
    """People who walk both ways through a dense corridor; 15 % are missed, 10 % of detections are false."""
    rng = np.random.default_rng(seed)
    rows, owners = [], []
    for person in range(round(1.5 * seconds)):
        t0, way = rng.uniform(-10.0, seconds), rng.choice([-1.0, 1.0])
        speed, x = rng.normal(1.3, 0.15), rng.uniform(0.0, 4.0)
        for k in range(max(0, int(np.ceil(t0 * hz))), int(min(seconds, t0 + 12.0 / speed) * hz)):
            if rng.random() > 0.15:
                y = (0.0 if way > 0.0 else 12.0) + way * speed * (k / hz - t0)
                rows.append((k, *rng.normal((x, y), noise)))
                owners.append(person)
    false = len(rows) // 10
    rows += [(k, *rng.uniform((0.0, 0.0), (4.0, 12.0))) for k in rng.integers(0, int(seconds * hz), false)]
    owners += [-1] * false
    table = np.array(rows)
    detections = Detections(table[:, 0].astype(np.int64), table[:, 0] / hz, table[:, 1:])
    return detections, np.array(owners)[detections.row]


@pytest.mark.parametrize("hz", [1.0, 2.0, 5.0, 25.0])
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_pairs_show_where_people_go(hz: float, turn: float) -> None:
    detections, _ = corridor(hz, 40.0)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    position = detections.position @ axes
    found = velocities_of(detections.step, position, axes, 1.0 / hz, 0.1, 1.0)
    weight, along = found[:, 0], found[:, 1:3] @ axes.T
    assert weight.sum() == pytest.approx(1.0)
    # Both ways, 1.3 m/s: much of the weight, and little across.
    both = np.abs(np.abs(along[:, 1]) - 1.3) < 0.4
    assert weight[both & (np.abs(along[:, 0]) < 0.6)].sum() > 0.55
    assert weight[both & (along[:, 1] > 0.0)].sum() == pytest.approx(0.4, abs=0.2)


@pytest.mark.parametrize("hz", [1.0, 2.0, 5.0, 25.0])
@pytest.mark.parametrize("noise", [0.05, 0.1, 0.3])
def test_triples_show_the_noise(hz: float, noise: float) -> None:
    detections, _ = corridor(hz, 40.0, noise=noise)
    found = noise_of(detections.step, detections.position, 48.0, 1.0 / hz)
    assert 0.5 * noise < found < 1.8 * noise + 0.06


QUICK = [(1.0, 10, 40.0), (25.0, 100, 4.0)]
SIZES = [*QUICK, (2.5, 100, 40.0), (5.0, 10, 40.0), (25.0, 10, 20.0)]
CROWDS = [(hz, 1600, 20.0 / hz) for hz in (1.0, 5.0, 25.0)]


@pytest.mark.parametrize(("hz", "people", "seconds"), others_slow([*SIZES, *CROWDS], QUICK))
def test_what_is_learned_online_is_the_simulator(hz: float, people: int, seconds: float) -> None:
    frames = round(seconds * hz)
    detections, _ = packed_square(
        np.random.default_rng(1), people=people, frames=frames, step=1.0 / hz, square_metres=25.0
    )
    association = OnlineAssociation()
    run_online(detections, association)
    scene, square = association.scene, 25.0 * people
    assert association.learned >= (1 if people == 1600 else 2)
    # 10 % are missed; a false detection a frame for 50 people; nobody comes or leaves.
    assert 0.8 < scene.detection_probability < 0.97
    false = people / 50.0 / square
    watched = min(len(detections), 2000) / people * square  # m² · frames
    assert abs(scene.clutter_density - false) < 4.0 * np.sqrt(false / watched) + 3.0 / watched + 0.3 * false
    assert scene.position_std == pytest.approx(0.1, rel=0.35)
    assert scene.death_rate < 0.06


def test_a_false_start_is_forgotten() -> None:
    """Half a minute of nothing but false detections, then people."""
    rng = np.random.default_rng(2)
    detections, whose = street(rng, people=30, frames=200, miss=0.1, false=0.3)
    frame = np.repeat(np.arange(75), 6)
    position = np.concatenate([rng.uniform(-8.0, 8.0, (len(frame), 2)), detections.position])
    both = np.concatenate([frame, detections.frame + 75])
    owners = np.concatenate([np.full(len(frame), -1), whose])
    together = Detections(both, 0.4 * both, position)
    _, last, _ = run_online(together)
    alone = run_online(detections)[1]
    late = both[together.row] >= 75 + 100
    found = idf1(last[late], owners[together.row][late])
    assert found > idf1(alone[detections.frame >= 100], whose[detections.frame >= 100]) - 0.05


@pytest.mark.parametrize(
    ("hz", "least"), others_slow([(1.3333, 0.55), (2.0, 0.7), (4.0, 0.85)], [(1.3333, 0.55), (2.0, 0.7)])
)
def test_a_dense_corridor_has_identities_at_low_rates(hz: float, least: float) -> None:
    detections, whose = corridor(hz)
    assert idf1(associate_detections(detections).identity, whose) > least
    assert idf1(run_online(detections)[1], whose) > least - 0.15


def test_few_detections_are_people_and_no_clutter() -> None:
    guess = first_guess(Detections(np.zeros(2, np.int64), np.zeros(2), np.array([[0.0, 0.0], [3.0, 0.0]])))
    assert guess.clutter_density < 0.01
