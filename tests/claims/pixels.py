"""What the pages state of the experiments on pixels, but of trackers, and where it was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product

from claim import Claim, Measured, Record, Results, values_in

CLASSES = "Body and head from class likelihoods"
SOURCES = ("mocap, walking", "mocap, turning", "mocap, sideways and back")


# Chen et al. 2011 from pixels, and in the image.


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
    """What the page says of Chen et al.'s heads, and of `full`."""

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
        data: [-values_in(row["head (°)"])[0] for row in rows if row["data"] == data and not _offline(row)]
        for data in ("deep_belief", "templates")
    }
    offline = [-values_in(row["head (°)"])[0] for row in rows if _offline(row)]
    gains = [end for values in (*online.values(), offline) for end in (min(values), max(values))]
    whole = "heads of the whole track − causal heads"
    jointly = results.row(title, data="deep_belief", method="smoother", difference=f"{whole}, joint")
    costs = [*results.rows(title, method="per frame", difference=whole), jointly]
    return {HEADS_GAIN: gains, CAUSAL: [value for row in costs for value in values_in(row["head (°)"])]}


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
                    line += [values_in(row[f"{angle} (°)"])[0], None]
        return found

    return measured


KNOWN_POSES = (
    "for {} to {} % of the bodies, by class, for {} to {} % of the pans, and for {}, {} and {} % of heads"
)


def known_poses(results: Results) -> Measured:
    """Errors of motion capture as Chen et al.'s classifiers answer for it, by method and model."""
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


# Models on rendered images.


def localisation(results: Results) -> Measured:
    """Of heads in rendered people."""
    columns = ("overlap_of_first", "best_overlap_of_all", "candidates")
    labels = {
        "differential, in the package (1,000 people)": "the package's (differential)",
        "differential, 250 people": "differential, trained on 250",
        "Fisher discriminants, the same 250 people": "fisher, trained on 250",
    }
    rows = {row["head localiser"]: row for row in results.rows("Head localisation")}
    return {label: [rows[name][column] for column in columns] for label, name in labels.items()}


def recognition(results: Results) -> Measured:
    """Of nine pans in per cent; of many exemplars the best number, with each density."""
    first = {(row["exemplars"], row["density"]): row for row in results.rows("Recognition of 9 pans: 34")}
    of_first = {key: row["rate_percent"] for key, row in first.items()}
    line: list[float | None] = []
    for density in ("gaussian", "saturated"):
        rows = results.rows("Recognition of 9 pans: 70", density=density)
        best = max(rows, key=lambda row: float(row["rate_percent"]))
        line += [best["rate_percent"], best["exemplars"]]
    unseen: list[float | None] = [None, None]
    return {
        "34 people train, 34 test, 1 exemplar": [of_first[1, "gaussian"], of_first[1, "saturated"], *unseen],
        "the same, 2 exemplars": [of_first[2, "gaussian"], of_first[2, "saturated"], *unseen],
        "70 train, 70 test, 5 splits, best number of exemplars": [*line, *unseen, *unseen],
    }


def _pose(row: Record) -> list[float]:
    return [
        row["mean_error_deg"],
        100.0 * row["accuracy_within_one_class"],
        row["expected_calibration_error"],
    ]


def pose(results: Results) -> Measured:
    """Errors and calibration of the classifiers, in exact boxes and in boxes as heads are found."""
    rows = {(row["classifier"], row["images"]): row for row in results.rows("Errors and calibration")}
    heads = {"deep_belief, 8 classes": "deep_belief", "templates, 12 classes": "templates"}
    heads["exemplars, 16 classes"] = "exemplars"
    found: dict[str, list[float | None]] = {}
    for label, name in heads.items():
        exact, rough = (rows[name, f"heads {what}"] for what in ("of 16-32 pixels", "as they are found"))
        rest = [rough["mean_error_deg"], rough["expected_calibration_error"]]
        found[label] = [*_pose(exact), *rest]
    near, far = (rows["body_pose", f"people of {size} pixels"] for size in ("70-140", "24-80"))
    found["body_pose, 8 classes, people of 70–140 pixels"] = [*_pose(near)]
    found["body_pose, people of 24–80 pixels before busy backgrounds"] = [*_pose(far)]
    return found


def keypoints(results: Results) -> Measured:
    """Errors, errors beyond 90° and calibration of body and head by keypoints of rendered people."""
    labels = {
        "people of 30–50 pixels": "rendered, 30-50 pixels",
        "of 50–100": "rendered, 50-100 pixels",
        "of 100–200": "rendered, 100-200 pixels",
        "all of them": "rendered, all sizes: as in training",
        "points half as far off": "rendered, all sizes: points half as far off",
        "points 1.5 times as far off": "rendered, all sizes: points 1.5 times as far off",
        "left and right exchanged for a tenth": "rendered, all sizes: left and right exchanged in a tenth",
        "without confidences": "rendered, all sizes: without confidences",
        "unsure points left out": "rendered, all sizes: unsure points left out",
        "skeletons as in training": "skeletons as in training",
    }
    columns = ("mean_deg", "beyond_90_percent", "calibration_error")
    rows = {row["people"]: row for row in results.rows("Body and head by keypoints")}
    return {
        label: [rows[name][f"{part}_{column}"] for part in ("body", "head") for column in columns]
        for label, name in labels.items()
    }


def published(results: Results) -> Measured:
    """Chen et al.'s classifiers as printed, beside ours."""
    labels = {
        "body, people of 70–140 pixels": ("body_pose", "people of 70-140 pixels"),
        "templates, heads of 16–32 pixels": ("templates", "heads of 16-32 pixels"),
        "templates, heads as they are found": ("templates", "heads as they are found"),
    }
    found: dict[str, list[float | None]] = {}
    for label, (model, images) in labels.items():
        forms = [results.row(f"{model}:", form=form, images=images) for form in ("ours", "as printed")]
        found[label] = [value for row in forms for value in _pose(row)]
    return found


PUBLISHED_HEADS = (
    "first candidate overlaps the head by {}, as printed by {}; the best of all by {} and {}, of {} and {} "
    "candidates"
)


def published_heads(results: Results) -> Measured:
    """Chen et al.'s localiser as printed, beside ours."""
    ours, printed = (results.row("head_localiser:", form=form) for form in ("ours", "as printed"))
    columns = ("overlap_of_first", "best_overlap_of_all", "candidates")
    return {PUBLISHED_HEADS: [row[column] for column in columns for row in (ours, printed)]}


# Baxter et al.'s network.


def network_gains(results: Results) -> Measured:
    """CLL and MSE gains with labelled heads and with the network's."""
    found: dict[str, list[float | None]] = {}
    for rate, method in product((100, 80, 60), ("printed", "consistent")):
        rows = [
            row
            for heads in ("labelled", "network")
            for row in results.rows("Paper / ours: CAVIAR", heads=heads, method=method)
            if row["detection %"] == rate
        ]
        found[f"{method}, {rate} %"] = [
            row[column]
            for measure in ("CLL", "MSE")
            for row in rows
            for column in (f"ours: {measure} gain", f"± people ({measure})")
        ]
    return found


def network_splits(results: Results) -> Measured:
    """The last layer learned on a part of the heads."""
    labels = {
        ("rendered, 10-32 pixels", "80:20"): "rendered, 80:20",
        ("rendered, 10-32 pixels", "50:50"): "rendered, 50:50",
        ("CAVIAR, 4-10 pixels", "50:50"): "CAVIAR, 50:50",
        ("CAVIAR, 4-10 pixels", "50:50 of the people"): "CAVIAR, 50:50 of the people",
    }
    columns = ("number", "right (%)", "± splits", "mean error (°)", "TPR", "FPR")
    return {
        labels[row["heads"], row["split"]]: [row[column] for column in columns]
        for row in results.rows("The network's last layer")
    }


PERCEPTION, BASELINES = "docs/perception.md", "docs/baselines.md"
EVALUATE = "perception evaluate"
FORMS = f"{EVALUATE} published --train 1000 --count 400 --seed 0"

PIXELS: tuple[Claim, ...] = (
    *(
        Claim(
            PERCEPTION,
            f"chen-pixels --seed {seed}" if seed else "chen-pixels",
            full_beside_joint(seed),
            "| heads, `--seed` |",
        )
        for seed in range(3)
    ),
    Claim(PERCEPTION, "chen-pixels", known_poses, "| known poses |"),
    Claim(PERCEPTION, "chen-pixels", confusions, labels=(KNOWN_POSES,)),
    Claim(PERCEPTION, "chen-pixels", chen_pixels, "| online, heads by `deep_belief`"),
    Claim(PERCEPTION, "chen-pixels", chen_pixels_said, labels=(TEMPLATES, WITH_FULL)),
    Claim(PERCEPTION, "chen-pixels", chen_pixels_differences, labels=(HEADS_GAIN, CAUSAL)),
    Claim(
        PERCEPTION,
        f"{EVALUATE} localisation --train 250 --count 400",
        localisation,
        "| Chen et al. 2011, Table 1",
    ),
    Claim(PERCEPTION, f"{EVALUATE} recognition", recognition, "| Ba & Odobez 2003, Tables 1 and 3"),
    Claim(PERCEPTION, f"{EVALUATE} pose --count 400", pose, "| pose |"),
    Claim(PERCEPTION, f"{EVALUATE} keypoints", keypoints, "| keypoints of |"),
    Claim(PERCEPTION, FORMS, published, "| Chen et al. 2011 as printed |"),
    Claim(PERCEPTION, FORMS, published_heads, labels=(PUBLISHED_HEADS,)),
    Claim(BASELINES, "chen-classes", chen_image, "| `joint` | body: walking"),
    Claim(BASELINES, "baxter-network", network_gains, "| Fig. 5(b), detected"),
    Claim(BASELINES, "baxter-network", network_splits, "| heads: split |"),
)
