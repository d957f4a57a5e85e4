"""Coverage of the 95 % intervals of parameters, on simulated people.

``--figures FILE`` writes the table of docs/results/model.md.
"""

from collections import defaultdict
from collections.abc import Callable

import pytest
from scipy import stats
from simulated import BRISK, EVEN_SLOW, TRUE, inside, known

from graphtrack.learning import fit
from graphtrack.model import Model, Parameters

SIMULATIONS = 40

JAGGED = {"coupling.speed_threshold", "motion.initial_speed_std"}
"""Parameters of the couplings' density without an interval that holds: about the truth, the likelihood is no
parabola in them."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "n_tracks", "n_steps", "true", "exempt"),
    [
        ("position", 8, 60, TRUE, set()),
        ("separate", 8, 60, TRUE, set()),
        ("intentional", 8, 60, TRUE, set()),
        # The strength of the coupling of the body is distinguished from its speed threshold.
        ("joint", 40, 16, BRISK, {*JAGGED, "coupling.motion_body_kappa"}),
        ("joint", 40, 16, EVEN_SLOW, JAGGED),
    ],
    ids=["position", "separate", "intentional", "joint", "joint without a threshold"],
)
def test_intervals_hold_what_they_say_in_40_simulations(
    preset: str,
    n_tracks: int,
    n_steps: int,
    true: Parameters,
    exempt: set[str],
    figures: Callable[..., None],
    request: pytest.FixtureRequest,
) -> None:
    right: dict[str, list[bool]] = defaultdict(list)
    for seed in range(SIMULATIONS):
        people = known(preset, 100 + seed, n_tracks, n_steps, true)
        # Couplings take long to climb from the defaults, and end where they do from the true ones.
        start = Model("joint", true) if preset == "joint" else Model(preset)
        for name, holds in inside(fit(people, start, hold_out=0.0), true).items():
            right[name].append(holds)
    people_of = request.node.callspec.id
    for name, holds in right.items():
        row = {"people": people_of, "parameter": name, "contain the truth": sum(holds), "of": len(holds)}
        figures("Intervals that contain the parameter", row)
    every = [one for name, holds in right.items() for one in holds if name not in exempt]
    row = {"people": people_of, "parameter": "all", "contain the truth": sum(every), "of": len(every)}
    figures("Intervals that contain the parameter", row)
    # Parameters of one simulation are nearly independent of each other.
    low, high = stats.binom.ppf([0.001, 0.999], len(every), 0.95)
    assert low <= sum(every) <= high, f"{sum(every)} of {len(every)}"
