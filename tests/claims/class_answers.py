"""What the pages state of 002 from pixels and in the image, and where in the tables it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product

from claim import Claim, Measured, Record, Results
from pixels import BASELINES, PERCEPTION, values_of

CLASSES = "Body and head from class likelihoods"
SOURCES = ("mocap, walking", "mocap, turning", "mocap, sideways and back")


def _cells(results: Results, where: Mapping[str, object], presets: Sequence[str]) -> list[float | None]:
    """Body, then head, with each preset: error and its interval."""
    found: list[float | None] = []
    for angle, preset in product(("body", "head"), presets):
        row = results.row(CLASSES, angle=angle, model=preset, **where)
        found += [row["error (°)"], row["low"], row["high"]]
    return found


def chen_pixels(results: Results) -> Measured:
    """Errors by method and model, heads by the package's network."""
    methods = {
        "particle filter": "particle",
        "particle filter, eq. 12–14 as printed": "particle, eq. 12–14",
        "graph, chain": "graph, chain",
        "graph, isam2": "graph, isam2",
        "offline: smoother": "smoother",
    }
    found: dict[str, list[float | None]] = {}
    for label, method in methods.items():
        where = {"data": "deep_belief", "method": method}
        found[label] = _cells(results, where, ("separate", "joint-body", "joint"))
    seen = [
        results.row(CLASSES, data="deep_belief", angle=angle, method="smoother", model="joint")
        for angle in ("body", "head")
    ]
    return {"per frame": [row["most likely class (°)"] for row in seen], **found}


TEMPLATES = "joint, body and head are {} and {} (particle filter), {} and {} (`chain`), {} and {} (offline)"
WITH_FULL = (
    "whose modes are of no use to people who face where they go, has {} and {} online (`isam2` {} and {}), "
    "and {} and {} offline"
)
HEADS_GAIN = "takes {}–{}° off the head's error online (`templates`: {}–{}°), and {}–{}° offline"
CAUSAL = (
    "change the error by {}° ({} … {}; `templates` {}°, {} … {}), smoothed jointly the "
    "difference is {}° ({} … {})"
)


def chen_pixels_said(results: Results) -> Measured:
    """What the page says of 002's heads, and of `full`."""

    def errors(data: str, method: str, model: str) -> list[float]:
        where = {"data": data, "method": method, "model": model}
        return [results.row(CLASSES, angle=angle, **where)["error (°)"] for angle in ("body", "head")]

    found = [
        error
        for method in ("particle", "graph, chain", "smoother")
        for error in errors("templates", method, "joint")
    ]
    methods = ("graph, chain", "graph, isam2", "smoother")
    full = [error for method in methods for error in errors("deep_belief", method, "full")]
    return {TEMPLATES: found, WITH_FULL: full}


def chen_pixels_differences(results: Results) -> Measured:
    """What the joint estimate takes off the head's error, and what causal heads cost it."""
    title, what = "Paired differences", "joint − joint-body"
    rows = results.rows(title, difference=what)
    online = {
        data: [-values_of(row["head (°)"])[0] for row in rows if row["data"] == data and not _offline(row)]
        for data in ("deep_belief", "templates")
    }
    offline = [-values_of(row["head (°)"])[0] for row in rows if _offline(row)]
    gains = [end for values in (*online.values(), offline) for end in (min(values), max(values))]
    whole = "heads of the whole track − causal heads"
    jointly = results.row(title, data="deep_belief", method="smoother", difference=f"{whole}, joint")
    costs = [*results.rows(title, method="per frame", difference=whole), jointly]
    return {HEADS_GAIN: gains, CAUSAL: [value for row in costs for value in values_of(row["head (°)"])]}


def _offline(row: Record) -> bool:
    return str(row["method"]).startswith("smoother")


def full_beside_joint(seed: int) -> Callable[[Results], Measured]:
    """Errors with both, and their difference, of one draw of clips; deviations are not compared."""

    def measured(results: Results) -> Measured:
        found: dict[str, list[float | None]] = {}
        for data in ("deep_belief", "templates"):
            line = found.setdefault(f"{data}, {seed}", [])
            for method in ("graph, chain", "smoother"):
                where = {"data": data, "method": method}
                for preset, angle in product(("joint", "full"), ("body", "head")):
                    line.append(results.row(CLASSES, angle=angle, model=preset, **where)["error (°)"])
                row = results.row("Paired differences", difference="full − joint", **where)
                for angle in ("body", "head"):
                    line += [values_of(row[f"{angle} (°)"])[0], None]
        return found

    return measured


KNOWN_POSES = (
    "for {} to {} % of the bodies, by class, for {} to {} % of the pans, and for {}, {} and {} % of heads"
)


def known_poses(results: Results) -> Measured:
    """Errors of motion capture as 002's classifiers answer for it, by method and model."""
    methods = {
        "particle filter": "particle",
        "particle filter, closest class": "particle, closest class",
        "chain": "graph, chain",
        "isam2": "graph, isam2",
        "offline": "smoother",
    }
    rows = {
        (row["method"], row["model"], row["data"], row["angle"]): row for row in results.rows("Known poses")
    }
    found: dict[str, list[float | None]] = {}
    for (label, method), preset in product(methods.items(), ("joint-body", "joint", "full")):
        own = [rows.get((method, preset, *where)) for where in product(SOURCES, ("body", "head"))]
        if None not in own:
            found[f"{label}, {preset}"] = [
                row[column] for row in own if row for column in ("error (°)", "low", "high")
            ]
    return found


def confusions(results: Results) -> Measured:
    """How often the true class is the likeliest, in per cent."""
    right = {
        of: [row[row["true"]] for row in results.rows(f"Confusion in per cent of the true class: {of}")]
        for of in ("body", "the head's pan", "the head's tilt")
    }
    ends = [end(right[of]) for of in ("body", "the head's pan") for end in (min, max)]
    return {KNOWN_POSES: [*ends, *right["the head's tilt"]]}


def chen_image(results: Results) -> Measured:
    """Errors of the joint particle filter with answers in the image of a camera."""
    methods = {
        "mixture, turned once": "particle, turned once",
        "closest class, turned once": "particle, closest class, turned once",
        "closest class, in the image (eq. 13–14)": "particle, closest class, in the image",
    }
    found: dict[str, list[float | None]] = {}
    for label, method in methods.items():
        found[label] = []
        for angle, data in product(("body", "head"), SOURCES):
            where = {"data": data, "angle": angle, "method": method, "model": "joint"}
            row = results.row("Answers in the image", **where)
            found[label] += [row["error (°)"], row["low"], row["high"]]
    return found


CLASS_ANSWERS: tuple[Claim, ...] = (
    *(
        Claim(
            PERCEPTION,
            f"chen-pixels --seed {seed}" if seed else "chen-pixels",
            full_beside_joint(seed),
            "| heads, `--seed` |",
        )
        for seed in range(3)
    ),
    Claim(PERCEPTION, "chen-pixels", chen_pixels, "| online, heads by `deep_belief`"),
    Claim(PERCEPTION, "chen-pixels", chen_pixels_said, labels=(TEMPLATES, WITH_FULL)),
    Claim(PERCEPTION, "chen-pixels", chen_pixels_differences, labels=(HEADS_GAIN, CAUSAL)),
    Claim(PERCEPTION, "chen-pixels", known_poses, "| known poses |"),
    Claim(PERCEPTION, "chen-pixels", confusions, labels=(KNOWN_POSES,)),
    Claim(BASELINES, "chen-classes", chen_image, "| `joint` | body: walking"),
)
