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


YEAR = 2026
"""Of this version."""


@dataclass(frozen=True)
class Reference:
    """A cited work.

    Attributes
    ----------
    cited : author and year, as the text cites it
    authors, title, place : as printed; the place may be empty
    year : 0 for a work that is updated
    """

    cited: str
    authors: tuple[str, ...]
    title: str
    year: int
    place: str = ""

    @property
    def work(self) -> str:
        """Authors, title, place and year."""
        parts = [self.title, *filter(None, [self.place, str(self.year or "")])]
        return f"{', '.join(self.authors)}: {', '.join(parts)}"

    def bibtex(self, key: str) -> str:
        """Return the BibTeX entry."""
        fields = {"author": " and ".join(self.authors), "title": f"{{{self.title}}}", "year": self.year}
        return _bibtex("misc", key, fields | {"howpublished": self.place})


def _bibtex(kind: str, key: str, fields: Mapping[str, object]) -> str:
    lines = [f"  {name} = {{{value}}}," for name, value in fields.items() if value]
    return "\n".join([f"@{kind}{{{key},", *lines, "}"])


REFERENCES: Mapping[str, Reference] = {
    "baxter": Reference(
        "Baxter et al. 2014",
        ("R. H. Baxter", "M. J. V. Leach", "S. S. Mukherjee", "N. M. Robertson"),
        "An adaptive motion model for person tracking with instantaneous head-pose features",
        2014,
    ),
    "chen": Reference(
        "Chen et al. 2011",
        ("C. Chen", "A. Heili", "J.-M. Odobez"),
        "A joint estimation of head and body orientation cues in surveillance video",
        2011,
        "ICCV Workshops",
    ),
    "bar-shalom": Reference(
        "Bar-Shalom et al. 2001",
        ("Y. Bar-Shalom", "X. R. Li", "T. Kirubarajan"),
        "Estimation with applications to tracking and navigation",
        2001,
    ),
    "mardia": Reference("Mardia & Jupp 2000", ("K. V. Mardia", "P. E. Jupp"), "Directional statistics", 2000),
    "dellaert": Reference(
        "Dellaert & Kaess 2017", ("F. Dellaert", "M. Kaess"), "Factor graphs for robot perception", 2017
    ),
    "kendon": Reference(
        "Kendon 1990",
        ("A. Kendon",),
        "Conducting interaction: patterns of behavior in focused encounters",
        1990,
        "Cambridge University Press",
    ),
    "setti": Reference(
        "Setti et al. 2015",
        ("F. Setti", "C. Russell", "C. Bassetti", "M. Cristani"),
        "F-formation detection: individuating free-standing conversational groups in images",
        2015,
        "PLoS ONE 10",
    ),
    "pedpy": Reference(
        "Schrödter et al.",
        ("T. Schrödter and the PedPy developers",),
        "PedPy, pedestrian trajectory analyzer",
        0,
    ),
    "steffen": Reference(
        "Steffen & Seyfried 2010",
        ("B. Steffen", "A. Seyfried"),
        "Methods for measuring pedestrian density, flow, speed and direction with minimal scatter",
        2010,
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

BEHAVIOUR: Mapping[str, str] = {
    "groups": "Conversation groups were found from the empty place that their members face ({kendon}, "
    "{setti}), and people who walk together from their common velocity and distance.",
    "attention": "Gaze targets were estimated from the directions of heads by a switching state-space model, "
    "with probabilities for people, named places and nothing.",
}
"""What was computed from the tracks → a sentence on how."""


def methods_text(
    model: Model,
    engine: str,
    *,
    constants: Mapping[int, PersonalConstants] | str = "learned",
    summary: ReadSummary | None = None,
    failed: int = 0,
    behaviour: Iterable[str] = (),
) -> tuple[str, tuple[Reference, ...]]:
    """Return the methods paragraph of a run, and the works that it cites.

    Parameters
    ----------
    model, engine : of the run; the engine that "auto" resolves to, "online" for chain as it is online
    constants : learned constants of each person, or a word for those that were used
    summary : of the rows that were read; None: no data
    failed : number of tracks without an estimate
    behaviour : keys of `BEHAVIOUR` that were computed too
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
    sentences += [BEHAVIOUR[name] for name in behaviour]
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


_TITLE = "Methods, for a paper"


def methods_section(lines: Iterable[str]) -> Section:
    """Return the section with a methods paragraph, given `methods_lines`."""
    return Section(_TITLE, tuple(Note(line) for line in lines))


def with_behaviour(sections: Iterable[Section], computed: Iterable[str]) -> tuple[Section, ...]:
    """Return sections of which that on methods, if need be a new one, says what else was computed.

    ``computed``: keys of `BEHAVIOUR`
    """
    lines = methods_lines(*with_references(" ".join(BEHAVIOUR[name] for name in computed)))
    rest = [one for one in sections if one.title != _TITLE]
    notes = [note for one in sections if one.title == _TITLE for note in one.items]
    return (*rest, Section(_TITLE, (*notes, *map(Note, lines))))


def bibtex_entries(works: Iterable[Reference]) -> str:
    """Return the BibTeX entries of this version of the program, and of works."""
    from graphtrack import __version__

    title = "{graphtrack: pedestrians' positions, bodies and heads on a factor graph}"
    fields = {"title": title, "author": "{The graphtrack developers}", "year": YEAR, "version": __version__}
    keys = {one.cited: key for key, one in REFERENCES.items()}
    return "\n".join(
        [_bibtex("software", "graphtrack", fields), *(one.bibtex(keys[one.cited]) for one in works)]
    )
