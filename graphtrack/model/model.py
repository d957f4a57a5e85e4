"""`Model`: a list of terms with their parameters, and the presets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import tomli_w

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.atomic import atomic_path
from graphtrack.io.source import read_toml
from graphtrack.model.function_term import FunctionTerm
from graphtrack.model.observation import OwnParameters, States, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.parameters import LikelihoodParameters, Parameters
from graphtrack.model.term import FramePacker, Term, types_of
from graphtrack.model.terms.conversation import FacesGroup, OrientationPersistence
from graphtrack.model.terms.couplings import BodyFollowsMotion, HeadFollowsBody
from graphtrack.model.terms.motion import IntentionalMotion, Motion
from graphtrack.model.terms.orientation import (
    Anchor,
    BodyDynamics,
    BodyLikelihood,
    HeadDynamics,
    HeadLikelihood,
)
from graphtrack.model.terms.position import PositionLikelihood
from graphtrack.packages import gtsam
from graphtrack.tracks.display import html_table, listed, shortened
from graphtrack.tracks.scene import GivenScene, known_values
from graphtrack.tracks.track import Track

_POSITION: tuple[type[Term], ...] = (Motion, PositionLikelihood)
_SEPARATE: tuple[type[Term], ...] = (*_POSITION, BodyDynamics, HeadDynamics, BodyLikelihood, HeadLikelihood)

presets: dict[str, tuple[type[Term], ...]] = {
    "position": _POSITION,
    "separate": _SEPARATE,
    "joint-body": (*_SEPARATE, BodyFollowsMotion),
    "joint": (*_SEPARATE, BodyFollowsMotion, HeadFollowsBody),
    "intentional": (IntentionalMotion, PositionLikelihood, HeadDynamics, HeadLikelihood),
    "joint-intentional": (IntentionalMotion, *_SEPARATE[1:], BodyFollowsMotion, HeadFollowsBody),
    "social": (*_SEPARATE, BodyFollowsMotion, HeadFollowsBody, FacesGroup, OrientationPersistence),
}
"""Name → terms. ``joint-body`` is "separate" of Chen et al. (2011) (κ₂ = 0), ``joint`` their model, and
``intentional`` that of Baxter et al. (2014). In ``social`` the members of a conversation face each other."""


def every_term() -> tuple[type[Term], ...]:
    """All terms of the presets, and the anchor of a track's first orientations."""
    return (*dict.fromkeys(kind for terms in presets.values() for kind in terms), Anchor)


preset_parameters: dict[str, Parameters] = {
    "social": Parameters(likelihood=LikelihoodParameters(body_outliers=0.05, head_outliers=0.05))
}
"""Default parameters of the presets whose best values differ from those of `Parameters`."""


def default_parameters(preset: str) -> Parameters:
    """The default parameters of a preset."""
    return preset_parameters.get(preset, Parameters())


BEST_PRESET = "joint"  # The default preset


OwnTerm = type[Term] | FunctionTerm


def name_of(kind: OwnTerm) -> str:
    """The name of a term of a user's own, with its numbers."""
    return repr(kind) if isinstance(kind, FunctionTerm) else kind.__name__


def has_kernels(kind: OwnTerm) -> bool:
    """Return True if a term has compiled kernels: the class itself defines them."""
    return isinstance(kind, FunctionTerm) or "kernels" in vars(kind)


def _made(kinds: Iterable[OwnTerm], parameters: Parameters) -> list[Term]:
    """Terms of one's own with the parameters of a model; InputError for what is none."""
    found: list[Term] = []
    count: dict[str, int] = {}
    for kind in kinds:
        if isinstance(kind, FunctionTerm):
            count[kind.label] = count.get(kind.label, 0) + 1
            found.append(kind.of_model(parameters, count[kind.label]))
        elif isinstance(kind, type) and issubclass(kind, Term):
            found.append(kind(parameters))
        else:
            raise InputError(f"a term {shortened(repr(kind))}", "one from term(…), or a subclass of Term")
    return found


class Model:
    """A list of terms. Every engine interprets the same list.

    Parameters
    ----------
    preset : name of a list in `presets`
    parameters : their parameters; by default those of the preset
    terms : further terms of your own: from `term`, or subclasses of `Term`
    scene : known parameters of birth, death and detection: `SceneParameters`, or a mapping of some of them by
        name

    Attributes
    ----------
    scene : name → value of the scene's known parameters; the others are learned from detections
    terms : all terms, in order
    own_terms : those of your own
    has_body, has_head : True if a term acts on them; they are then estimated
    has_groups : True if people face their group; groups are detected where tracks do not have them
    """

    def __init__(
        self,
        preset: str = "joint",
        parameters: Parameters | None = None,
        terms: Iterable[OwnTerm] = (),
        scene: GivenScene = None,
    ) -> None:
        if preset not in presets:
            raise InputError(f"model {preset!r}", f"one of {', '.join(presets)}, or a model file (.toml)")
        self.preset = preset
        self.parameters = default_parameters(preset) if parameters is None else parameters
        self.own_terms = tuple(terms)
        self.scene = {} if scene is None else known_values(scene)
        standard = [kind(self.parameters) for kind in presets[preset]]
        self.terms = (*standard, *_made(self.own_terms, self.parameters))
        used = frozenset().union(*(term.uses for term in self.terms))
        self.has_body, self.has_head = "body" in used, "head" in used
        self.has_groups = any(isinstance(term, FacesGroup) for term in self.terms)

    def __repr__(self) -> str:
        parts = [repr(self.preset), *map(name_of, self.own_terms), *self.changed()]
        return f"Model({listed(parts, 5)})"

    def _repr_html_(self) -> str:
        terms = [(term.label, (term.documented.__doc__ or "").partition("\n")[0]) for term in self.terms]
        return html_table(repr(self), ("term", ""), terms)

    def changed(self) -> list[str]:
        """Return the parameters that differ from the preset's, as text."""
        own = asdict(default_parameters(self.preset))
        changed = [
            f"{table}.{name}={value!r}"
            for table, values in asdict(self.parameters).items()
            for name, value in values.items()
            if value != own[table][name]
        ]
        return changed + [f"scene.{name}={value!r}" for name, value in self.scene.items()]

    def __reduce__(self) -> tuple[Any, ...]:
        return Model, (self.preset, self.parameters, self.own_terms, dict(self.scene))

    def with_parameters(self, parameters: Parameters) -> Model:
        """The same terms and scene with other parameters."""
        return Model(self.preset, parameters, self.own_terms, self.scene)

    def with_terms(self, *kinds: OwnTerm) -> Model:
        """The same model with further terms."""
        return Model(self.preset, self.parameters, (*self.own_terms, *kinds), self.scene)

    def with_scene(self, scene: GivenScene) -> Model:
        """The same terms and parameters, with the known parameters of another scene."""
        return Model(self.preset, self.parameters, self.own_terms, scene)

    def with_own(self, own: OwnParameters) -> Model:
        """The same model with a person's own parameters."""
        return self.with_parameters(self.parameters.with_values(own.named()))

    def has_term(self, kind: type[Term]) -> bool:
        """Return True if a term of the model is of that kind."""
        return any(isinstance(term, kind) for term in self.terms)

    @property
    def compiled_terms(self) -> tuple[Term, ...]:
        """The terms that the chain engine packs, with the anchor of first orientations."""
        known = tuple(term for term in self.terms if term.is_compiled)
        return (*known, Anchor(self.parameters, self.has_body, self.has_head))

    @property
    def compiled(self) -> Model:
        """The model without those terms of its own that have no compiled kernel."""
        known = [kind for kind in self.own_terms if has_kernels(kind)]
        if len(known) == len(self.own_terms):
            return self
        return Model(self.preset, self.parameters, known, self.scene)

    def is_linear(self, packed: PackedTracks) -> bool:
        """Return True if the linear solution of packed tracks is the solution."""
        return all(term.states("is_linear") and term.is_linear(packed) for term in self.terms)

    def factors(self, step: Step) -> list[gtsam.NonlinearFactor]:
        """All factors of a step."""
        if step.own is not None:
            return self.with_own(step.own).factors(replace(step, own=None))
        for term in self.terms:
            if term.is_compiled:
                vars(term).setdefault("packer", self.packer)
        return [factor for term in self.terms for factor in term.factors(step)]

    @cached_property
    def packer(self) -> FramePacker:
        """The packer of frames for all compiled terms at once; an engine may set one with more fields."""
        known = [term for term in self.terms if term.is_compiled]
        return FramePacker(known, types_of(known))

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of states (up to constants), from the terms' densities and not the factors."""
        return sum(term.cost(states, track, camera) for term in self.terms)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of a model file. Raise InputError if the model has terms of your own."""
        if self.own_terms:
            names = ", ".join(map(name_of, self.own_terms))
            raise InputError(
                f"a model with user-defined terms ({names}), which a file cannot hold",
                "a preset and its parameters: save Model(preset, parameters), add the terms once loaded",
            )
        scene = {"scene": dict(self.scene)} if self.scene else {}
        return {"preset": self.preset, **asdict(self.parameters), **scene}

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> Model:
        """The inverse of `to_dict`, by default of `BEST_PRESET`; InputError for unknown or wrong values."""
        tables = dict(content)
        preset, scene = tables.pop("preset", BEST_PRESET), tables.pop("scene", None)
        if not isinstance(preset, str):
            raise InputError(f"preset = {preset!r}", f"one of {', '.join(presets)}")
        return cls(preset, Parameters.from_dict(tables, default_parameters(preset)), scene=scene)

    def save(self, path: str | Path) -> None:
        """Write a model file (TOML), whole or not at all; InputError if it cannot hold the model."""
        content = tomli_w.dumps(self.to_dict())
        with atomic_path(path) as temporary:
            Path(temporary).write_text(content, encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Model:
        """Read a model file (TOML), by default of `BEST_PRESET`; InputError names the file and the key."""
        content = read_toml(path, "a model file")
        try:
            return cls.from_dict(content)
        except InputError as error:
            raise InputError(error.found, error.expected, path=path) from error

    @classmethod
    def named(cls, model: Model | str | Path | None) -> Model:
        """A model from a preset's name, a model file's path, or None for `BEST_PRESET`; a model as it is."""
        if model is None:
            return cls(BEST_PRESET)
        if isinstance(model, Model):
            return model
        if isinstance(model, str) and model in presets:
            return cls(model)
        if isinstance(model, str | Path) and Path(model).suffix == ".toml":
            return cls.load(model)
        raise InputError(
            f"model {shortened(str(model))}", f"one of {', '.join(presets)}, or a model file (.toml)"
        )
