"""What the pages state of recordings beyond the papers, and where in the tables of commands it stands."""

from __future__ import annotations

from itertools import product

from claim import Claim, Measured, Results

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
    """How much of the time 004's trackers are on two heads, in per cent, and how far off the pan is."""
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


MODEL, PERCEPTION, TRACKERS = "docs/model.md", "docs/perception.md", "docs/trackers.md"

BEYOND: tuple[Claim, ...] = (
    Claim(MODEL, "honesty", honesty, "| model | | Hz | position |", cells=3),
    Claim(PERCEPTION, "perception evaluate people --seed 0", found_people, "| `score` |"),
    Claim(TRACKERS, "perception evaluate heads --heads 2 --seed 0", real_heads, "| two heads, 25 pictures"),
    Claim(PERCEPTION, "perception evaluate street --seed 0", street, "| method | share |", cells=2),
)
