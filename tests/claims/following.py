"""What the page of trackers states of Yan et al. 2011 and Ba & Odobez 2003, and where in the experiments'
tables it stands."""

from __future__ import annotations

from claim import Claim, Measured, Record, Results, values_in

COLOUR = "colour, then pose"
MIXED, PRINTED = "mixed-state", "mixed-state, as in the paper"
OUR_EXEMPLARS = "mixed-state, as in the paper with our exemplars"
PAGE = "docs/trackers.md"


# Yan et al. 2011.


def _success(row: Record) -> list[float]:
    return [row["success (%)"], row["std"], row["least"], row["greatest"]]


def sigma_pi(results: Results) -> Measured:
    """Success on rendered sequences in per cent, with its spread, and what the rest of the frames are."""
    found: dict[str, list[float | None]] = {}
    for row in results.rows("Paper / ours: Table 1"):
        kind = row["kind"]
        if kind == "mean of the persons":
            means = [row["paper: success"], row["ours: success"], row["ours: motion"], row["paper: motion"]]
            found["mean"] = means
        elif row["paper: success"] is not None:
            ours = _success(results.row("Rendered sequences", sequence=kind, method="sigma-pi"))
            rest = [row[f"ours: {column}"] for column in ("missing", "mismatch", "motion")]
            found[kind] = [row["paper: success"], *ours, *rest]
    return found


WALKERS = {
    "wk1gt 236–511, person 1": "walks through",
    "wk2gt 360–634, person 4": "walks away",
    "wk2gt 800–1043, person 5": "walks in",
}
"""The others stand."""


def sigma_pi_real(results: Results) -> Measured:
    """Success on CAVIAR's people in per cent, with and without views, least and greatest of the seeds."""
    found: dict[str, list[float | None]] = {}
    methods = ("sigma-pi", "local features", "motion alone")
    means: dict[str, list[float]] = {method: [] for method in methods}
    for row in results.rows("Real frames", method="sigma-pi"):
        who = row["sequence"]
        ours, local, alone = (results.row("Real frames", sequence=who, method=method) for method in methods)
        values = [one[column] for one in (ours, local) for column in ("success (%)", "least", "greatest")]
        found[f"{who} ({WALKERS.get(who, 'stands')})"] = [*values, alone["success (%)"]]
        for method, one in zip(methods, (ours, local, alone), strict=True):
            means[method].append(one["success (%)"])
    found["mean"] = [sum(values) / len(values) for values in means.values()]
    return found


# Ba & Odobez 2003.


def mixed_state(results: Results) -> Measured:
    """Errors of boxes, pans and tilts, mean ± deviation over the seeds."""
    columns = ("e(t)", "pan error (°)", "pan error, mode (°)", "tilt error (°)")
    return {
        f"{row['pans']}: {row['method']}": [
            row["sequences"],
            *(value for column in columns for value in values_in(row[column])),
            row["never lost (%)"],
        ]
        for row in results.rows("Tracking before things")
    }


def mixed_state_hidden(results: Results) -> Measured:
    """How often heads come back from behind a wall, in per cent."""
    amounts = {0.3: "some", 1.0: "many"}
    return {
        f"{amounts[row['clutter']]}: {row['tracker']}": [
            row["sequences"],
            row["alone (%)"],
            row["guided by the graph (%)"],
        ]
        for row in results.rows("Back on the head")
    }


WORSE = "eq. 5 alone has a worse pan than the baseline** ({}° against {}°)"
RATIOS = "the ratio of mixed-state to the baseline is {} for e(t) and {} for the pan"
MODES = "the mean of the distribution is better by {}° for the baseline"
LEVEL = "tell nodding (tilts of {}° on average) with an error of {}°. Of heads that hardly nod ({}°)"
FIG_4 = (
    "of the baseline's frames with e(t) < 0.5 the pan is {}° off, above (but touching) {}°; of the paper's "
    "filter with our exemplars {}° and {}°"
)
STILL = (
    "{} % (90) Gaussian and {} % (94) saturated with one exemplar, {} % (87.5) and {} % (94.8) with two; of "
    "70 people {} % (67.2) Gaussian with three and {} % (70.5) saturated with four"
)
TABLE_2 = "{} to {} % on the diagonal (85 to 100)"
ON_TOP = (
    "the box's middle to {} and the pan's to {} of the tracker's own (colour: {} and {}), though in {} % of "
    "the sequences (colour: {} %) the box gets better"
)


def mixed_state_said(results: Results) -> Measured:
    """What the page says in words of Ba & Odobez 2003."""
    beside = {row["measure"]: row for row in results.rows("Paper / ours: joint against sequential")}
    box, pan, mode = (
        beside[f"mean {name}"] for name in ("e(t)", "pan error (°)", "pan error of the mode (°)")
    )
    tracking = {(row["pans"], row["method"]): row for row in results.rows("Tracking before things")}
    facing, nodding = tracking["−90° to 90°", MIXED], tracking["−90° to 90°, nodding", MIXED]
    place = {(row["method"], row["box"]): row["pan error (°)"] for row in results.rows("Pan by how well")}
    top = {(row["tracker"], row["error"]): row for row in results.rows("Graph on top")}
    return {
        WORSE: [pan[PRINTED], pan[COLOUR]],
        RATIOS: [box["ratio"], pan["ratio"]],
        MODES: [mode[COLOUR] - pan[COLOUR]],
        LEVEL: [nodding["level (°)"], values_in(nodding["tilt error (°)"])[0], facing["level (°)"]],
        FIG_4: [
            place[who, box] for who in (COLOUR, OUR_EXEMPLARS) for box in ("well placed", "badly placed")
        ],
        ON_TOP: [
            *(top[who, what]["ratio"] for who in (MIXED, COLOUR) for what in ("centre (widths)", "pan (°)")),
            *(top[who, "centre (widths)"]["sequences where it is less (%)"] for who in (MIXED, COLOUR)),
        ],
    }


def still_heads(results: Results) -> Measured:
    """What the page says in words of Ba & Odobez's Tables 1 to 3."""
    named = {
        (row["people learned from"], row["exemplars a pose"], row["density"]): values_in(row["ours (%)"])[0]
        for row in results.rows("Identification of nine pans")
    }
    shown = [(34, k, density) for k in (1, 2) for density in ("gaussian", "saturated")]
    shown += [(70, 3, "gaussian"), (70, 4, "saturated")]
    diagonal = [row[f"{row['true pan (°)']:g}"] for row in results.rows("Confusions of pans", of="ours")]
    return {STILL: [named[key] for key in shown], TABLE_2: [min(diagonal), max(diagonal)]}


SAID = (WORSE, RATIOS, MODES, LEVEL, FIG_4, ON_TOP)

FOLLOWING: tuple[Claim, ...] = (
    Claim(PAGE, "yan-sigma-pi", sigma_pi, "| kind | paper | ours |"),
    Claim(PAGE, "yan-sigma-pi", sigma_pi_real, "| real frames"),
    Claim(PAGE, "ba-mixed-state", mixed_state, "| heads: method |"),
    Claim(PAGE, "ba-mixed-state", mixed_state_hidden, "| things of the head's colours: tracker |"),
    Claim(PAGE, "ba-mixed-state", mixed_state_said, labels=SAID),
    Claim(PAGE, "ba-mixed-state", still_heads, labels=(STILL, TABLE_2)),
)
