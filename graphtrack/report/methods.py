"""Methods paragraph for a paper: version, model, constants, engine, what was refused, and the references."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.model import Model
from graphtrack.report.content import Note, Section
from graphtrack.tracks.display import counted

if TYPE_CHECKING:
    from graphtrack.inference.engines import PersonalConstants
    from graphtrack.tracks.track import ReadSummary


@dataclass(frozen=True)
class Reference:
    """A cited work.

    Attributes
    ----------
    cited : author and year, as the text cites it
    work : authors, title and place
    """

    cited: str
    work: str


REFERENCES: Mapping[str, Reference] = {
    "baxter": Reference(
        "Baxter et al. 2014",
        "R. H. Baxter, M. J. V. Leach, S. S. Mukherjee, N. M. Robertson: An adaptive motion model for person "
        "tracking with instantaneous head-pose features, 2014",
    ),
    "chen": Reference(
        "Chen et al. 2011",
        "C. Chen, A. Heili, J.-M. Odobez: A joint estimation of head and body orientation cues in "
        "surveillance video, ICCV Workshops, 2011",
    ),
    "bar-shalom": Reference(
        "Bar-Shalom et al. 2001",
        "Y. Bar-Shalom, X. R. Li, T. Kirubarajan: Estimation with applications to tracking and "
        "navigation, 2001",
    ),
    "mardia": Reference("Mardia & Jupp 2000", "K. V. Mardia, P. E. Jupp: Directional statistics, 2000"),
    "dellaert": Reference(
        "Dellaert & Kaess 2017", "F. Dellaert, M. Kaess: Factor graphs for robot perception, 2017"
    ),
    "pedpy": Reference(
        "Schrödter et al.", "T. Schrödter and the PedPy developers: PedPy, pedestrian trajectory analyzer"
    ),
    "steffen": Reference(
        "Steffen & Seyfried 2010",
        "B. Steffen, A. Seyfried: Methods for measuring pedestrian density, flow, speed and direction with "
        "minimal scatter, 2010",
    ),
}
"""Key → work."""

_MOTION = "positions under white-noise acceleration ({bar-shalom})"
_STEERED = "positions whose motion the head steers ({baxter})"

_MODELS = {
    "position": _MOTION,
    "separate": f"{_MOTION}, and body and head orientations with von Mises likelihoods ({{mardia}})",
    "joint-body": f"{_MOTION}, body orientations coupled to the direction of motion, and head orientations, "
    "with von Mises likelihoods ({chen}, {mardia})",
    "joint": f"{_MOTION}, body orientations coupled to the direction of motion, and head orientations "
    "coupled to the body, with von Mises likelihoods ({chen}, {mardia})",
    "intentional": f"{_STEERED}, and head orientations",
    "joint-intentional": f"{_STEERED}, and body and head orientations coupled to motion and body ({{chen}}, "
    "{mardia})",
    "social": f"{_MOTION}, body and head orientations coupled to motion and body ({{chen}}, {{mardia}}), and "
    "members of a conversation who face each other",
}
"""Preset → its terms."""

_ENGINES = {
    "chain": "by a Gauss–Newton method on the chain of each person's frames",
    "online": "online by a Gauss–Newton method on the chain of each person's latest frames",
    "gtsam": "with GTSAM ({dellaert})",
    "isam2": "online by iSAM2 in GTSAM ({dellaert})",
    "fixed-lag": "online by a fixed-lag smoother in GTSAM ({dellaert})",
}


def methods_text(
    model: Model,
    engine: str,
    *,
    constants: Mapping[int, PersonalConstants] | str = "learned",
    summary: ReadSummary | None = None,
    failed: int = 0,
) -> tuple[str, tuple[Reference, ...]]:
    """Return the methods paragraph of a run, and the works that it cites.

    Parameters
    ----------
    model, engine : of the run; the engine that "auto" resolves to, "online" for chain as it is online
    constants : learned constants of each person, or a word for those that were used
    summary : of the rows that were read; None: no data
    failed : number of tracks without an estimate
    """
    from graphtrack import __version__

    run = f"Tracks were estimated with graphtrack {__version__}"
    sentences = [f"{run} as a factor graph of {{model}}, solved {{engine}}."]
    changed = model.changed()
    own = f" with {', '.join(changed)}" if changed else " with its default parameters"
    sentences += [f"The preset is {model.preset}{own}.", _of_constants(constants)]
    sentences.append(
        "Uncertainties are those of the inverse Gauss–Newton curvature of the graph; intervals are of 95 % "
        "where nothing else is stated."
    )
    if summary is not None and summary.rows_read:
        sentences.append(_of_rows(summary))
    if failed:
        were = "was" if failed == 1 else "were"
        sentences.append(f"{counted(failed, 'track')} had no estimate and {were} left out.")
    text = " ".join(sentences).replace("{model}", _MODELS[model.preset]).replace("{engine}", _ENGINES[engine])
    return with_references(text)


def with_references(text: str) -> tuple[str, tuple[Reference, ...]]:
    """Return a text with authors and years for the keys of `REFERENCES` in braces, and the works cited."""
    cited = tuple(one for key, one in REFERENCES.items() if f"{{{key}}}" in text)
    for key, one in REFERENCES.items():
        text = text.replace(f"{{{key}}}", one.cited)
    return text, cited


def _of_constants(constants: Mapping[int, PersonalConstants] | str) -> str:
    if isinstance(constants, str) or not constants:
        words = constants or "the defaults"
        if words == "learned":
            return "The constants of each person are learned from the recording by how well they predict it."
        return f"The constants are {words}."
    known = list(constants.values())

    def median(values: Iterable[float]) -> float:
        return float(np.median(list(values)))

    turns = [
        math.degrees(math.sqrt(median(getattr(one, f"{name}_diffusion") for one in known)))
        for name in ("body", "head")
    ]
    learned, assumed = known[0].described_noise(), known[0].described_noise(assumed=True)
    noise = f"; the noise of the observations is {learned}." if learned else "."
    noise += f" The noise of the model was used for want of observations: {assumed}." if assumed else ""
    people = "1 person" if len(known) == 1 else f"each of {len(known)} people"
    density = median(one.acceleration_density for one in known)
    return (
        f"The constants of {people} were learned from the recording by how well they predict it: the median "
        f"density of acceleration is {density:.3g} m²/s³, and body and head turn by {turns[0]:.3g} and "
        f"{turns[1]:.3g}° in a second{noise}"
    )


def _of_rows(summary: ReadSummary) -> str:
    found = f"Of {summary.rows_read} rows of the input ({summary.format}) {summary.rows_used} were used"
    refused = [f"{count} {reason}" for reason, count in summary.refused.items() if count]
    return f"{found}; refused were {', '.join(refused)}." if refused else f"{found}, and none was refused."


def methods_lines(text: str, references: Iterable[Reference]) -> tuple[str, ...]:
    """Return a methods paragraph and a line for each work, of what `methods_text` returns."""
    return (text, *(f"{one.cited}: {one.work}." for one in references))


def methods_section(lines: Iterable[str]) -> Section:
    """Return the section with a methods paragraph, given `methods_lines`."""
    return Section("Methods, for a paper", tuple(Note(line) for line in lines))


def software_bibtex() -> str:
    """Return the BibTeX entry of this version of the program."""
    from graphtrack import __version__

    title = "{graphtrack: pedestrians' positions, bodies and heads on a factor graph}"
    fields = {"title": title, "author": "{The graphtrack developers}", "version": __version__}
    lines = [f"  {name} = {{{value}}}," for name, value in fields.items()]
    return "\n".join(["@software{graphtrack,", *lines, "}"])
