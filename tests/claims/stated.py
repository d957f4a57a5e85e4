"""What README and docs state of the experiments, and where in the experiments' tables it stands."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import product

from beyond import BEYOND
from claim import Claim, Measured, Record, Results
from following import FOLLOWING
from pixels import PIXELS

RATES = (100, 80, 60)
BESIDE = "Paper / ours"
METHODS = {
    "printed, the paper's parameters": "printed",
    "consistent, the paper's parameters": "consistent",
    "Kalman filter, fitted": "kf fitted",
    "intentional, fitted": "intentional",
    "particle filter, joint": "particle joint",
    "particle filter, joint-intentional": "particle joint-intentional",
    "graph, joint": "graph joint",
    "graph, joint-intentional": "graph joint-intentional",
    "graph, joint, isam2": "graph joint, isam2",
    "graph, joint-intentional, isam2": "graph joint-intentional, isam2",
}
"""Label of a line in docs/baselines.md → method in the experiments' tables."""


def _of(names: Iterable[str]) -> dict[str, str]:
    chosen = set(names)
    return {label: method for label, method in METHODS.items() if method in chosen}


def _interval(row: Record) -> list[float]:
    return [row["reduction %"], row["low"], row["high"]]


# Baxter et al.'s statistic.


def deviations(results: Results) -> Measured:
    """People, frames, mean, deviation and how many per cent are near 0."""
    labels = {
        "motion capture, walking": "mocap, walking",
        "turning": "mocap, turning",
        "sideways and backwards": "mocap, sideways and back",
        "CAVIAR mws1gt, labelled": "CAVIAR mws1gt",
        "SALSA, a party": "SALSA, party",
        "the corpus below": "simulated corpus",
    }
    columns = ("people", "frames", "mean (°)", "std (°)", "within 22.5° (%)")
    rows = {row["data"]: row for row in results.rows("Direction of travel minus head")}
    return {label: [rows[data][column] for column in columns] for label, data in labels.items()}


# Baxter et al. 2014 on the simulated corpus.

ON_CORPUS = _of(set(METHODS.values()) - {"particle joint", "particle joint-intentional"})


def _gains(results: Results, rate: int, method: str, measure: str) -> tuple[float, float]:
    """The least and the greatest of the medians of seven behaviours."""
    (row,) = [row for row in results.rows(BESIDE, ours=method) if row["detection %"] == rate]
    return row[f"{measure} gain, least"], row[f"{measure} gain, greatest"]


def simulated_by_rate(measure: str) -> Callable[[Results], Measured]:
    """A line for each rate of detection, of one measure."""

    def measured(results: Results) -> Measured:
        methods = [method for method in ON_CORPUS.values() if not method.endswith("isam2")]
        return {
            f"{rate} %": [end for method in methods for end in _gains(results, rate, method, measure)]
            for rate in RATES
        }

    return measured


def simulated_by_method(results: Results) -> Measured:
    """A line for each method, of both measures."""
    return {
        label: [
            end
            for rate, measure in product(RATES, ("MSE", "CLL"))
            for end in _gains(results, rate, method, measure)
        ]
        for label, method in ON_CORPUS.items()
    }


# Baxter et al. 2014 on CAVIAR.

GAIN = "Gain over the Kalman filter of Baxter et al. 2014"


def caviar_gains(results: Results) -> Measured:
    """Medians over the people, and their deviation."""
    labels = {
        "printed": ("printed", True),
        "consistent": ("consistent", True),
        "Kalman filter, fitted": ("kf fitted", False),
        "intentional, fitted": ("intentional", False),
        "graph, joint": ("graph joint", False),
        "graph, joint-intentional": ("graph joint-intentional", False),
        "graph, joint, isam2": ("graph joint, isam2", False),
        "graph, joint-intentional, isam2": ("graph joint-intentional, isam2", False),
    }
    title, found = GAIN, {}
    for label, (method, has_likelihood) in labels.items():
        rows = {row["detection %"]: row for row in results.rows(title, method=method)}
        columns = ["MSE gain", "± people", *(["CLL gain", "± people "] if has_likelihood else [])]
        found[label] = [rows[rate][column] for rate in RATES for column in columns]
    return found


NATS_SAID = (
    "in nats a detection they are {} (Kalman filter), {} (`intentional`), {} (graph, `joint`) and {} "
    "(`joint-intentional`) at 100 %, and {}, {}, {} and {} at 60 %"
)


def caviar_likelihoods(results: Results) -> Measured:
    """Of fitted methods, in nats a detection."""
    title, methods = GAIN, ("kf fitted", "intentional", "graph joint", "graph joint-intentional")
    rows = {(row["detection %"], row["method"]): row["nats a detection"] for row in results.rows(title)}
    return {NATS_SAID: [rows[rate, method] for rate, method in product((100, 60), methods)]}


def caviar_reasons(results: Results) -> Measured:
    """What the gains are made of; a log-likelihood above 0 has no gain, and no number."""
    named_otherwise = {
        "head along the travel": "head along the travel, no deviation",
        "deviations shuffled": "the same deviations, new at every frame",
        "low base weight (τ = 3.5)": "low base weight, τ = 3.5",
        "R = (0.07 m)²": "R = (0.07 m)², that of the labels",
        "positions ± 0.1 m": "noise of 0.1 m on the positions",
        "positions ± 0.25 m": "noise of 0.25 m",
        "positions ± 0.5 m": "noise of 0.5 m",
    }
    columns = ("printed: MSE gain", "printed: CLL gain", "consistent: MSE gain", "consistent: CLL gain")
    found: dict[str, list[float | None]] = {}
    for row in results.rows("Where the gains come from"):
        name = row["what is changed"]
        found[named_otherwise.get(name, name)] = [row[c] for c in columns if row[c] is not None]
    return found


# Baxter et al. 2014 in withheld windows.

WINDOWS = list(product(("corpus, 3 s", "mocap turns, 1 s"), ("visible", "hidden")))
ERROR = "Error in the withheld window"


def occlusion_online(results: Results) -> Measured:
    """By how much the squared error is below the Kalman filter's, in %, with its interval."""
    found: dict[str, list[float | None]] = {}
    for label, method in METHODS.items():
        found[label] = []
        for data, head in WINDOWS:
            row = results.row(ERROR, data=data, head=head, method=method)
            if row["reduction %"] < -1000.0:
                found[label].append(row["reduction %"])
            elif method == "kf fitted" and data != WINDOWS[0][0]:
                found[label].append(0.0)  # it is what the others are measured against
            else:
                found[label] += _interval(row)
    return found


def occlusion_offline(results: Results) -> Measured:
    """Root mean squared errors in metres."""
    labels = {
        "rts, fitted": "rts",
        "particle smoother, joint, 4,000 particles": "ffbs joint",
        "particle smoother, joint-intentional, 4,000 particles": "ffbs joint-intentional",
        "graph, joint": "smoother joint",
        "graph, joint-intentional": "smoother joint-intentional",
    }
    return {
        label: [results.row(ERROR, data=data, head=head, method=method)["RMSE (m)"] for data, head in WINDOWS]
        for label, method in labels.items()
    }


def occlusion_said(results: Results) -> Measured:
    """What docs/results/papers.md says of it."""
    data, head = WINDOWS[2]
    best = [
        results.row(ERROR, data=data, head=head, method=method)["reduction %"]
        for method in ("graph joint-intentional", "intentional")
    ]
    return {OCCLUSION_SAID: best}


OCCLUSION_SAID = "the graph's squared error is {} % below the Kalman filter's, the tracker's {} %"


# Chen et al. 2011.


def chen_joint(results: Results) -> Measured:
    """Mean errors of the body, with the intervals of the differences."""
    people = {"walking": "mocap, walking", "sideways and backwards": "mocap, sideways and back"}
    methods = {
        "particle filter, online": "particle",
        "graph, online": "graph",
        "graph, online, isam2": "graph, isam2",
        "particle smoother": "ffbs",
        "graph, offline": "smoother",
    }
    found: dict[str, list[float | None]] = {}
    for (who, data), (how, method) in product(people.items(), methods.items()):
        where = {"data": data, "angle": "body", "method": method}
        row = results.row("Body and head: observation", **where)
        errors = ("observation", "separate", "joint-body", "joint")
        line = [*(row[f"{name} (°)"] for name in errors), row["low"], row["high"]]
        line += [row["full (°)"] for row in results.rows("Beyond Chen et al. 2011", **where)]
        found[f"{who}: {how}"] = line
    return found


FITTED_METHODS = {
    "particle filter, online": "particle",
    "graph, online": "graph",
    "graph, online, isam2": "graph, isam2",
    "particle smoother": "ffbs",
    "graph, offline": "smoother",
}
WHO_WALKS = ("mocap, walking", "mocap, sideways and back")


def chen_fitted(results: Results) -> Measured:
    """Five parameters fitted for each method, and errors with them and with the defaults."""
    parameters = ("q (m²/s³)", "D_body (rad²/s)", "D_head (rad²/s)", "κ₁ ((m/s)⁻²)", "κ₂")
    found: dict[str, list[float | None]] = {}
    for label, method in FITTED_METHODS.items():
        # iSAM2 has those of its graph.
        own = {"preset": "joint", "method": method.removesuffix(", isam2")}
        row = results.row("Parameters fitted for each method", **own)
        found[label] = [row[name] for name in parameters]
        for data, angle in product(WHO_WALKS, ("body", "head")):
            errors = results.row("Errors with the parameters", data=data, angle=angle, method=method)
            found[label] += [errors["joint, default (°)"], errors["joint, fitted (°)"]]
    return found


def chen_pairs(results: Results) -> Measured:
    """Graph less particles on the same people, with intervals."""
    pairs = {
        "online": "graph − particle",
        "online, isam2": "graph, isam2 − particle",
        "offline": "smoother − ffbs",
    }
    found: dict[str, list[float | None]] = {}
    for (label, difference), which in product(pairs.items(), ("default", "fitted")):
        line = found.setdefault(f"{label}, {which}", [])
        for data, angle in product(WHO_WALKS, ("body", "head")):
            where = {"data": data, "angle": angle, "difference": difference}
            row = results.row("Methods compared on the same people", **where)
            line += [row[f"{which} (°)"], row[f"{which}: low"], row[f"{which}: high"]]
    return found


def cells_won(results: Results) -> Measured:
    """Cells of the corpus in which graphs are better than the fitted tracker, and worse."""
    columns = [f"{measure}: {how}" for measure in ("squared error", "likelihood") for how in WON]
    columns[3:3] = ["ratio, least", "ratio, greatest"]
    columns += ["nats, least", "nats, greatest"]
    found: dict[str, list[float | None]] = {}
    for label, method in METHODS.items():
        if method.startswith("graph"):
            row = results.row("Graphs against the fitted tracker: cells", method=method)
            found[label] = [row[column] for column in columns]
    return found


WON = ("better", "clearly better", "clearly worse")


HEADS_SAID = (
    "the head's error from {}° to {}° with the particle filter and from {}° to {}° with the graph online"
)


def chen_heads(results: Results) -> Measured:
    """What docs/results/papers.md says of heads."""
    columns, found = ("joint-body (°)", "joint (°)"), []
    for method in ("particle", "graph"):
        where = {"data": "mocap, walking", "angle": "head", "method": method}
        row = results.row("Body and head: observation", **where)
        found += [row[column] for column in columns]
    return {HEADS_SAID: found}


def chen_classes(results: Results) -> Measured:
    """Mean errors of body and head by model and method, with their intervals."""
    methods = {
        "particle filter": "particle",
        "particle filter, closest class": "particle, closest class",
        "chain": "graph, chain",
        "isam2": "graph, isam2",
        "offline": "smoother",
    }
    found: dict[str, list[float | None]] = {}
    for (label, method), preset in product(methods.items(), ("joint-body", "joint", "full")):
        line = []
        people = ("mocap, walking", "mocap, turning", "mocap, sideways and back")
        for data, angle in product(people, ("body", "head")):
            where = {"data": data, "angle": angle, "method": method, "model": preset}
            for row in results.rows("Body and head from class likelihoods", **where):
                line += [row["error (°)"], row["low"], row["high"]]
        if line:
            found[f"{label}, {preset}"] = line
    return found


def engines(results: Results) -> Measured:
    """Errors of `joint` on people who walk, by engine; times are not compared."""
    labels = {
        "chain (default)": (("chain", "chain, offline"), 0, 2),
        "isam2": (("isam2",), 1, 1),  # before them the 2 of iSAM2
        "isam2 --lag none": (("isam2, full history",), 0, 4),
        "fixed-lag": (("fixed-lag",), 0, 1),
        "gtsam": (("gtsam, offline",), 0, 1),
    }
    found: dict[str, list[float | None]] = {}
    for label, (methods, before, after) in labels.items():
        rows = [
            results.row("Every engine", angle=angle, method=method)
            for method, angle in product(methods, ("body", "head"))
        ]
        found[label] = [*[None] * before, *(row["error (°)"] for row in rows), *[None] * after]
    return found


# The README's table of filters beside the graph.

STEERED = ("intentional", "graph joint-intentional", "graph joint-intentional, isam2")
READMES = "| online, same observations |"


def readme_corpus(results: Results) -> Measured:
    """Both gains of Baxter et al.'s tracker and of the graph with a head that steers, at 80 % of the
    detections."""
    return {
        label: [end for method in STEERED for end in _gains(results, 80, method, measure)]
        for label, measure in (
            ("Baxter's corpus, squared error: times below their Kalman filter's", "MSE"),
            ("the same, log-likelihood (CLL)", "CLL"),
        )
    }


def readme_windows(results: Results) -> Measured:
    """The same in withheld windows of motion capture."""
    data, head = WINDOWS[2]
    rows = [results.row(ERROR, data=data, head=head, method=method) for method in STEERED]
    label = "a second unseen at the turn: squared error below a Kalman filter's"
    return {label: [row["reduction %"] for row in rows]}


def readme_joint(results: Results) -> Measured:
    """Chen et al.'s separate and joint, of the particle filter and of the graph by both engines."""
    found: dict[str, list[float | None]] = {}
    for angle in ("body", "head"):
        line = found.setdefault(f"{angle} of who walks: Chen et al.'s separate → joint", [])
        for method in ("particle", "graph", "graph, isam2"):
            where = {"data": "mocap, walking", "angle": angle, "method": method}
            row = results.row("Body and head: observation", **where)
            line += [row["joint-body (°)"], row["joint (°)"]]
    return found


# Who is who where people meet.


def meetings(results: Results) -> Measured:
    """Switches offline and online, with little and more noise, by what is given."""
    cells = [(way, std) for way in ("offline", "online") for std in (0.05, 0.1)]
    rows = {(row[""], row["σ (m)"], row["of"]): row["switches"] for row in results.rows("Identity switches")}
    evidence = ("positions", "and body", "and head", "and both")
    return {one: [rows[way, std, one] for way, std in cells] for one in evidence}


# Groups among people who are independent of each other.


def strangers(results: Results) -> Measured:
    """Per cent in a conversation without and with the odds against people who just met, of who stop."""
    rows = {
        (row["side (m)"], row["evidence"], row["way"]): row
        for row in results.rows("Independent walkers in groups")
        if row["who stop (%)"]
    }
    return {
        f"{side} m, {evidence}": [
            rows[side, evidence, way][f"conversing, {odds} (%)"]
            for way in ("offline", "online")
            for odds in ("without", "with")
        ]
        for side in (8, 12, 18)
        for evidence in ("positions", "positions and heads")
    }


CLAIMS: Sequence[Claim] = (
    Claim("docs/baselines.md", "baxter-statistics", deviations, "| deviation |"),
    Claim(
        "docs/results/papers.md", "baxter-simulated", simulated_by_rate("MSE"), "| detected: squared error |"
    ),
    Claim(
        "docs/results/papers.md", "baxter-simulated", simulated_by_rate("CLL"), "| detected: log-likelihood |"
    ),
    Claim("docs/baselines.md", "baxter-simulated", simulated_by_method, "| corpus | 100 %: MSE"),
    Claim("docs/baselines.md", "baxter-caviar", caviar_gains, "| CAVIAR | 100 %: MSE"),
    Claim("docs/baselines.md", "baxter-caviar", caviar_likelihoods, labels=(NATS_SAID,)),
    Claim("docs/baselines.md", "baxter-caviar", caviar_reasons, "| all detected | `printed`: MSE"),
    Claim("docs/baselines.md", "baxter-occlusion", occlusion_online, "| online | corpus, 3 s"),
    Claim("docs/baselines.md", "baxter-occlusion", occlusion_offline, "| offline | corpus,"),
    Claim("docs/results/papers.md", "baxter-occlusion", occlusion_said, labels=(OCCLUSION_SAID,)),
    Claim("docs/results/papers.md", "chen-joint", chen_joint, "| body | observed |"),
    Claim("docs/results/papers.md", "chen-joint", chen_fitted, "| five parameters fitted |"),
    Claim("docs/results/papers.md", "chen-joint", chen_pairs, "| graph less particles |"),
    Claim("docs/results/papers.md", "baxter-simulated", cells_won, "| cells of 21 |"),
    Claim("docs/results/papers.md", "chen-joint", chen_heads, labels=(HEADS_SAID,)),
    Claim("docs/results/engines.md", "chen-classes", chen_classes, "| class likelihoods | walking: body"),
    Claim("docs/engine.md", "chen-classes", engines, "| engine | | models |"),
    Claim("README.md", "baxter-simulated", readme_corpus, READMES),
    Claim("README.md", "baxter-occlusion", readme_windows, READMES),
    Claim("README.md", "chen-joint", readme_joint, READMES),
    Claim("docs/tracking.md", "meetings", meetings, "| switches, 120 meetings |"),
    Claim("docs/behaviour.md", "strangers", strangers, "| in a conversation, % |"),
    *FOLLOWING,
    *PIXELS,
    *BEYOND,
)
