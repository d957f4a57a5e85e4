"""What the pages state of the experiments on pixels, and where in the experiments' tables it stands."""

from __future__ import annotations

from itertools import product

from claim import Claim, Measured, Record, Results, numbers

COLOUR, MEMORY = "colour, then pose", "colour with memory, then pose"
MIXED, PRINTED = "mixed-state", "mixed-state, as in the paper"


def values_of(cell: object) -> list[float]:
    """Of a cell that is a number, or text with numbers; nothing of an empty one."""
    return [] if cell is None else [shown.value for shown in numbers(str(cell))]


# 003.


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


# 004.


def mixed_state(results: Results) -> Measured:
    """Errors of boxes, pans and tilts, mean ± deviation over the seeds."""
    columns = ("e(t)", "pan error (°)", "pan error, mode (°)", "tilt error (°)")
    return {
        f"{row['pans']}: {row['method']}": [
            row["sequences"],
            *(value for column in columns for value in values_of(row[column])),
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
    "filter {}° and {}°"
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
    """What the page says in words of 004."""
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
        LEVEL: [nodding["level (°)"], values_of(nodding["tilt error (°)"])[0], facing["level (°)"]],
        FIG_4: [place[who, box] for who in (COLOUR, PRINTED) for box in ("well placed", "badly placed")],
        ON_TOP: [
            *(top[who, what]["ratio"] for who in (MIXED, COLOUR) for what in ("centre (widths)", "pan (°)")),
            *(top[who, "centre (widths)"]["sequences where it is less (%)"] for who in (MIXED, COLOUR)),
        ],
    }


def still_heads(results: Results) -> Measured:
    """What the page says in words of 004's Tables 1 to 3."""
    named = {
        (row["people learned from"], row["exemplars a pose"], row["density"]): values_of(row["ours (%)"])[0]
        for row in results.rows("Identification of nine pans")
    }
    shown = [(34, k, density) for k in (1, 2) for density in ("gaussian", "saturated")]
    shown += [(70, 3, "gaussian"), (70, 4, "saturated")]
    diagonal = [row[f"{row['true pan (°)']:g}"] for row in results.rows("Confusions of pans", of="ours")]
    return {STILL: [named[key] for key in shown], TABLE_2: [min(diagonal), max(diagonal)]}


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
    """002's classifiers as printed, beside ours."""
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
    """002's localiser as printed, beside ours."""
    ours, printed = (results.row("head_localiser:", form=form) for form in ("ours", "as printed"))
    columns = ("overlap_of_first", "best_overlap_of_all", "candidates")
    return {PUBLISHED_HEADS: [row[column] for column in columns for row in (ours, printed)]}


# 000's network.


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


TRACKERS, PERCEPTION, BASELINES = "docs/trackers.md", "docs/perception.md", "docs/baselines.md"
EVALUATE = "perception evaluate"
FORMS = f"{EVALUATE} published --train 1000 --count 400"
SAID = (WORSE, RATIOS, MODES, LEVEL, FIG_4, ON_TOP)

PIXELS: tuple[Claim, ...] = (
    Claim(TRACKERS, "yan-sigma-pi", sigma_pi, "| kind | paper | ours |"),
    Claim(TRACKERS, "yan-sigma-pi", sigma_pi_real, "| real frames"),
    Claim(TRACKERS, "ba-mixed-state", mixed_state, "| heads: method |"),
    Claim(TRACKERS, "ba-mixed-state", mixed_state_hidden, "| things of the head's colours: tracker |"),
    Claim(TRACKERS, "ba-mixed-state", mixed_state_said, labels=SAID),
    Claim(TRACKERS, "ba-mixed-state", still_heads, labels=(STILL, TABLE_2)),
    Claim(PERCEPTION, f"{EVALUATE} localisation --train 250 --count 400", localisation, "| 002 Table 1"),
    Claim(PERCEPTION, f"{EVALUATE} recognition", recognition, "| 004 Tables 1 and 3"),
    Claim(PERCEPTION, f"{EVALUATE} pose --count 400", pose, "| pose |"),
    Claim(PERCEPTION, f"{EVALUATE} keypoints", keypoints, "| keypoints of |"),
    Claim(PERCEPTION, FORMS, published, "| 002 as printed |"),
    Claim(PERCEPTION, FORMS, published_heads, labels=(PUBLISHED_HEADS,)),
    Claim(BASELINES, "baxter-network", network_gains, "| Fig. 5(b), detected"),
    Claim(BASELINES, "baxter-network", network_splits, "| heads: split |"),
)
