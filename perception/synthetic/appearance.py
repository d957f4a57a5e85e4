"""What people look like: skin, hair, hats, glasses and clothes, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from perception.synthetic.solids import CHECKED, PLAIN, SPECKLED, STRIPED

Reflectance = tuple[float, float, float]
Hair = Literal["short", "long", "bun", "bald", "receding", "afro", "ponytail"]
Hat = Literal["none", "cap", "beanie", "brim", "hood"]

_SKIN = np.array(
    [
        [0.62, 0.72, 0.88],
        [0.50, 0.62, 0.80],
        [0.40, 0.54, 0.72],
        [0.27, 0.39, 0.56],
        [0.16, 0.24, 0.37],
        [0.10, 0.15, 0.24],
    ]
)
_HAIR = np.array(
    [
        [0.04, 0.045, 0.05],
        [0.06, 0.09, 0.13],
        [0.10, 0.17, 0.27],
        [0.25, 0.42, 0.58],
        [0.50, 0.52, 0.55],
        [0.08, 0.18, 0.42],
    ]
)
_HAIR_SHARE = (0.34, 0.26, 0.16, 0.10, 0.10, 0.04)
_STYLES: tuple[Hair, ...] = get_args(Hair)
_STYLE_SHARE = (0.40, 0.20, 0.08, 0.08, 0.08, 0.06, 0.10)
_HATS: tuple[Hat, ...] = get_args(Hat)
_HAT_SHARE = (0.88, 0.04, 0.04, 0.02, 0.02)
_TEXTURES = (PLAIN, SPECKLED, STRIPED, CHECKED)
_TEXTURE_SHARE = (0.55, 0.15, 0.18, 0.12)


@dataclass(frozen=True)
class Appearance:
    """How one person looks.

    Attributes
    ----------
    skin, hair_colour, hat_colour, top, shirt, trousers, shoes : albedo, blue green red in 0…1
    hair, hat : style
    glasses, beard : whether there are any
    open_jacket : whether a strip of shirt shows on the chest
    backpack : whether there is one, of ``hat_colour``
    bare_arms : whether the forearms are skin
    top_texture : texture of the upper clothes, as in `Solids.texture`
    stretch : factors of the head's length, width and height
    height : metres
    build : factor of the body's width
    """

    skin: Reflectance
    hair_colour: Reflectance
    hair: Hair
    hat: Hat
    hat_colour: Reflectance
    glasses: bool
    beard: bool
    top: Reflectance
    shirt: Reflectance
    trousers: Reflectance
    shoes: Reflectance
    open_jacket: bool
    backpack: bool
    bare_arms: bool
    top_texture: tuple[int, float, float]
    stretch: tuple[float, float, float]
    height: float
    build: float


def random_appearance(rng: np.random.Generator) -> Appearance:
    """Draw one person."""

    def cloth(low: float = 0.03, high: float = 0.9) -> Reflectance:
        grey = rng.uniform(low, high)
        return _colour(np.clip(grey + rng.normal(0.0, 0.12, 3), 0.02, 0.95))

    share = rng.random()
    tone = _SKIN[int(share * 5)] * (1 - share * 5 % 1) + _SKIN[int(share * 5) + 1] * (share * 5 % 1)
    hair = _STYLES[rng.choice(len(_STYLES), p=_STYLE_SHARE)]
    return Appearance(
        skin=_colour(tone * rng.uniform(0.92, 1.08, 3)),
        hair_colour=_colour(_HAIR[rng.choice(len(_HAIR), p=_HAIR_SHARE)] * rng.uniform(0.8, 1.2)),
        hair=hair,
        hat=_HATS[rng.choice(len(_HATS), p=_HAT_SHARE)],
        hat_colour=cloth(0.03, 0.7),
        glasses=bool(rng.random() < 0.25),
        beard=bool(rng.random() < 0.15 and hair in ("short", "bald", "receding")),
        top=cloth(),
        shirt=cloth(0.3, 0.95),
        trousers=cloth(0.03, 0.45),
        shoes=cloth(0.02, 0.4),
        open_jacket=bool(rng.random() < 0.4),
        backpack=bool(rng.random() < 0.2),
        bare_arms=bool(rng.random() < 0.35),
        top_texture=(
            int(_TEXTURES[rng.choice(4, p=_TEXTURE_SHARE)]),
            float(rng.uniform(0.1, 0.5)),
            float(rng.uniform(3.0, 9.0)),
        ),
        stretch=tuple(rng.normal(1.0, 0.04, 3)),
        height=float(np.clip(rng.normal(1.72, 0.09), 1.45, 2.0)),
        build=float(rng.uniform(0.85, 1.25)),
    )


def _colour(values: np.ndarray) -> Reflectance:
    b, g, r = (float(value) for value in values)
    return b, g, r
