"""What the pages state of recordings beyond the papers, and where in the tables of commands it stands."""

from __future__ import annotations

from itertools import product

from claim import Claim, Measured, Record, Results

# Modes of the couplings.

PRESETS = ("separate", "joint", "joint-intentional", "full")
SIDEWAYS = "sideways and back"
WALKERS = ("ordinary", SIDEWAYS)
MODES_SAID = (
    "online in the body, by {}° ({} … {}, 95 % over clips), equal in the head (a difference of {}°, "
    "{} … {}), and worse in the position, by {} mm ({} … {})"
)
README_SAID = "the position of those who side-step, by {} mm online and {} mm offline"


def gaits_offline(results: Results) -> Measured:
    """Means and medians of body and head, and the mean of positions."""
    found: dict[str, list[float | None]] = {preset: [] for preset in PRESETS}
    for preset, who in product(PRESETS, WALKERS):
        row = results.rows("Errors by model", people=who, model=preset)[0]
        found[preset] += [row[f"{of} (°){what}"] for of in ("body", "head") for what in ("", ", median")]
        found[preset].append(row["position (m)"])
    return found


def gaits_online(results: Results) -> Measured:
    """Means by both engines, and of the particle filter."""
    rows = {(row["people"], row[""], row["model"]): row for row in results.rows("Errors by model")}
    return {
        f"{preset}{suffix}": [
            rows[who, f"online, {engine}", preset][measure]
            for who, measure in product(WALKERS, ("body (°)", "head (°)", "position (m)"))
        ]
        for (engine, suffix), preset in product(
            (("chain", ""), ("isam2", ", isam2"), ("particles", ", particles")), PRESETS
        )
    }


def _full_less_separate(results: Results, way: str) -> Record:
    rows = results.rows("The error of full", people=SIDEWAYS, full_less="separate")
    return next(row for row in rows if row[""] == way)


def gaits_said(results: Results) -> Measured:
    """`full` less `separate`, online, on those who do not face where they go."""
    row = _full_less_separate(results, "online, chain")
    body = [-row[f"body (°){end}"] for end in ("", ", high", ", low")]
    head = [row[f"head (°){end}"] for end in ("", ", low", ", high")]
    position = [1000.0 * row[f"position (m){end}"] for end in ("", ", low", ", high")]
    return {MODES_SAID: [*body, *head, *position]}


def gaits_rivals(results: Results) -> Measured:
    """The graph less the particle filter, model by model; positions in millimetres."""
    found: dict[str, list[float | None]] = {}
    for preset, who in product(PRESETS, WALKERS):
        row = results.row("The error of the graph", people=who, model=preset)
        for measure, unit in (("body (°)", 1.0), ("head (°)", 1.0), ("position (m)", 1000.0)):
            found.setdefault(preset, []).extend(
                unit * row[f"{measure}{end}"] for end in ("", ", low", ", high")
            )
    return found


def readme_said(results: Results) -> Measured:
    """How much worse its position is there."""
    ways = ("online, chain", "offline")
    return {README_SAID: [1000.0 * _full_less_separate(results, way)["position (m)"] for way in ways]}


# Stated uncertainties.


def honesty(results: Results) -> Measured:
    """NEES by noise, and in brackets the shares inside 50 % and 95 %, for each quantity."""
    rows = {
        (row["model"], row[""], row["Hz"], row["σ (m)"]): row
        for row in results.rows("NEES a degree of freedom")
    }
    found: dict[str, list[float | None]] = {}
    for model, way, rate in product(("separate", "joint", "full"), ("offline", "online"), (30.0, 10.0, 2.5)):
        own = [rows[model, way, rate, std] for std in (0.05, 0.1, 0.3)]
        line: list[float | None] = []
        for of in ("position", "velocity", "body", "head"):
            line += [row[f"{of}: NEES"] for row in own]
            line += [row[f"{of}: in {level} % (%)"] for row in own for level in (50, 95)]
        found[f"{model} | {way} | {rate:g}"] = line
    return found


# Town Centre.


def found_people(results: Results) -> Measured:
    """How many detections there are by what is said of them, and how many of them are right, in per cent."""
    rows = results.rows("Town Centre's first minute: detections within")
    columns = {
        "detections": "detections",
        "says (%)": "mean (%)",
        "right (%)": "found (%)",
        "… of those wholly inside": "found inside (%)",
    }
    return {label: [row[column] for row in rows] for label, column in columns.items()}


def street(results: Results) -> Measured:
    """Errors, shares within what is said and identities, by method and share of likelihoods for nothing."""
    columns = ("position (m)", "body (°)", "body within 95 %", "head (°)", "head within 95 %", "IDF1", "MOTA")
    found: dict[str, list[float | None]] = {}
    for row in results.rows("Town Centre's first minute by every method"):
        share = "0.05" if row["outliers"] == "as packaged" else "learned"
        found[f"{row['method']} | {share}"] = [row[column] for column in columns]
    return found


def real_heads(results: Results) -> Measured:
    """How much of the time Ba & Odobez's trackers are on two heads, in per cent, and how far off the pan
    is."""
    labels = {
        "mixed-state": "mixed-state",
        "mixed-state, motion of 0.4 s (noise and persistence of ten frames)": "mixed-state, motion of 0.4 s",
        "mixed-state, told the place to half a head": "mixed-state, told the place",
        "colour": "colour",
        "colour, motion of 0.4 s": "colour, motion of 0.4 s",
        "colour, told the place": "colour, told the place",
    }
    found: dict[str, list[float | None]] = {}
    for label, method in labels.items():
        *people, mean = results.rows("Real heads", method=method)
        touching = mean["touching (%)"]
        found[label] = [mean["on the head (%)"], touching]
        if method.endswith("told the place"):
            of_people = [row["on the head (%)"] for row in people]
            found[label] = [mean["on the head (%)"], *of_people, touching, mean["pan, while on it (°)"]]
    return found


MODEL, PERCEPTION, TRACKERS = "docs/results/model.md", "docs/perception.md", "docs/trackers.md"

BEYOND: tuple[Claim, ...] = (
    Claim(MODEL, "gaits", gaits_offline, "| offline | ordinary: body |"),
    Claim(MODEL, "gaits", gaits_online, "| online | ordinary: body |"),
    Claim(MODEL, "gaits", gaits_said, labels=(MODES_SAID,)),
    Claim("docs/baselines.md", "gaits", gaits_rivals, "| graph less particles, modes |"),
    Claim(MODEL, "gaits", readme_said, labels=(README_SAID,)),
    Claim(MODEL, "honesty", honesty, "| model | | Hz | position |", cells=3),
    Claim(PERCEPTION, "perception evaluate people --seed 0", found_people, "| `score` |"),
    Claim(TRACKERS, "perception evaluate heads --heads 2 --seed 0", real_heads, "| two heads, 25 pictures"),
    Claim(PERCEPTION, "perception evaluate street --seed 0", street, "| method | share |", cells=2),
)
