"""Coverage of the 95 % intervals of parameters, on simulated people.

One command prints the table of docs/results/model.md:
``pytest tests/learning/test_coverage.py -m slow -s``
"""

from __future__ import annotations

from collections import defaultdict

import pytest
from scipy import stats
from simulated import BRISK, EVEN_SLOW, TRUE, inside, unknown

from graphtrack.learning import fit
from graphtrack.learning.optimise import Criterion
from graphtrack.model import Model, Parameters

SIMULATIONS = 40

JAGGED = {"coupling.speed_threshold", "motion.initial_speed_std"}
"""Parameters of the couplings' density without an interval that holds: about the truth, the criterion is no
parabola in them (`test_the_criterion_is_jagged_in_those_parameters_alone`)."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "criterion", "n_tracks", "n_steps", "true", "exempt"),
    [
        ("position", "evidence", 8, 60, TRUE, set()),
        ("separate", "evidence", 8, 60, TRUE, set()),
        ("intentional", "evidence", 8, 60, TRUE, set()),
        # The strength of the coupling of the body is distinguished from its speed threshold.
        ("joint", "truth", 40, 16, BRISK, {*JAGGED, "coupling.motion_body_kappa"}),
        ("joint", "truth", 40, 16, EVEN_SLOW, JAGGED),
    ],
    ids=["position", "separate", "intentional", "joint", "joint without a threshold"],
)
def test_intervals_hold_what_they_say_in_40_simulations(
    preset: str,
    criterion: Criterion,
    n_tracks: int,
    n_steps: int,
    true: Parameters,
    exempt: set[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    right: dict[str, list[bool]] = defaultdict(list)
    for seed in range(SIMULATIONS):
        people = unknown(preset, 100 + seed, n_tracks, n_steps, criterion == "truth", true)
        # Couplings take long to climb from the defaults, and end where they do from the true ones.
        start = Model("joint", true) if preset == "joint" else Model(preset)
        for name, holds in inside(fit(people, start, hold_out=0.0, criterion=criterion), true).items():
            right[name].append(holds)
    with capsys.disabled():
        print(f"\n{preset}, by {criterion}: {n_tracks} people, {n_steps} frames")
        for name, holds in right.items():
            print(f"| {preset} | {criterion} | `{name}` | {sum(holds)} of {len(holds)} |", flush=True)
    every = [one for name, holds in right.items() for one in holds if name not in exempt]
    # Parameters of one simulation are nearly independent of each other.
    low, high = stats.binom.ppf([0.001, 0.999], len(every), 0.95)
    assert low <= sum(every) <= high, f"{sum(every)} of {len(every)}"
