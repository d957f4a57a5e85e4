"""Chen et al.'s perception as printed beside ours, learned from the same rendered images and judged on the
same."""

from __future__ import annotations

import numpy as np

from perception.pose.classifier import FeatureClassifier
from perception.pose.heads import HeadLocaliser
from perception.pose.scores import evaluate
from perception.synthetic import make_heads, make_pedestrians
from perception.training.models import (
    FOUND_AS_WALKING,
    PUBLISHED,
    localisation_figures,
    train_on_rendered,
)

FORMS = {"ours": False, "as printed": True}


def published_beside_ours(
    train: int, count: int, rng: np.random.Generator, *, seed: int = 0
) -> dict[str, list[dict[str, str | float]]]:
    """Rows of figures by model: head localiser, body pose and templates in both forms.

    Parameters
    ----------
    train : rendered images that each learns from
    count : other images that they are judged on
    rng : source of those
    seed : of the training
    """
    people = make_pedestrians(count, rng)
    exact, found = make_heads(count, rng), make_heads(count, rng, FOUND_AS_WALKING)
    rows: dict[str, list[dict[str, str | float]]] = {name: [] for name in PUBLISHED}
    for name in PUBLISHED:
        for form, as_published in FORMS.items():
            model = train_on_rendered(
                name, images=train, test_images=50, seed=seed, as_published=as_published
            )
            if isinstance(model, HeadLocaliser):
                rows[name].append({"form": form, **localisation_figures(model, people)})
                continue
            assert isinstance(model, FeatureClassifier)
            if name == "body_pose":
                sets = {"people of 70-140 pixels": (people.images, people.body)}
            else:
                sets = {
                    "heads of 16-32 pixels": (exact.images, exact.pan),
                    "heads as they are found": (found.images, found.pan),
                }
            for what, (images, angle) in sets.items():
                figures = evaluate(model, images, angle).figures()
                rows[name].append({"form": form, "images": what, **figures})
    return rows
