"""The probability that a verified configuration holds in physics, from what is known when it is sampled.

A logistic regression of executed pushes on figures of the contacts and of the balance along the way,

    p = 1 / (1 + exp(-(b + sum_k w_k (x_k - mean_k) / scale_k))),

x clipped to the range that it was fitted on. `benchmarks/execution_probability.py` fits it and measures how well it holds on
objects that did not help to fit it, and writes `execution_probability.json`, which says on what.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.contacts import ContactBatch, HandContacts
from dexnudge.mechanics.friction_cone import helping
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.planning.object_path import push_length, station
from dexnudge.results.path_margins import path_margins, pressing_contacts
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import carrying_normal, touching_contacts

MODEL = Path(__file__).with_name("execution_probability.json")
AGREEMENT = 1e-2  # by which rounding may change a probability: margins are found to 1e-3


def features(scene: Scene, contacts: Sequence[HandContacts]) -> dict[str, Float[np.ndarray, " configuration"]]:
    """Return what execution may depend on, by name, for the contacts of each configuration, of which there are some.

    Lengths over half the object's longest side. "ahead" is along the motion from the centre of mass, "aside" across it.
    """
    task, length, batch = sliding_task(scene), push_length(scene), ContactBatch.of(contacts)
    every, alone = batch.every, pressing_contacts(batch, scene)
    normal = carrying_normal(touching_contacts(scene))
    across = np.cross(normal, scene.motion)
    along, pressed = path_margins(scene, batch, length=length), path_margins(scene, alone, length=length)
    supports = station(scene, length).supports.points
    carried = (supports - task.centre) @ scene.motion / task.half_length if len(supports) else np.zeros(1)
    arm, help_of_each = (every.points - task.centre) / task.half_length, helping(every, task.twist)
    ahead, aside = arm @ scene.motion, arm @ across

    def spread(values: Float[np.ndarray, " contact"]) -> Float[np.ndarray, " configuration"]:
        return batch.reduced(np.maximum, values, empty=0.0) - batch.reduced(np.minimum, values, empty=0.0)

    found = {
        "links": batch.link_places()[1],
        "pressing_links": alone.link_places()[1],
        "help": batch.mean(help_of_each),
        "least_help": batch.reduced(np.minimum, help_of_each, empty=np.nan),
        "on_top": batch.mean(every.normals @ normal),
        "ahead": batch.mean(ahead),
        "aside": np.abs(batch.mean(aside)),
        "spread_ahead": spread(ahead),
        "spread_aside": spread(aside),
        "height": batch.mean(arm @ normal),
    }
    extents = np.sort(scene.object_mesh.extents)
    same = {
        "push_length": length / task.half_length,
        "thickness": extents[0] / task.half_length,
        "width": extents[1] / task.half_length,
        "half_length": task.half_length,
        "carried_ahead_at_end": carried.max(),
        "press_slack": task.friction_hand - task.friction_environment,
        "weight": task.weight / task.max_normal_force,
    }
    return {
        **{name: values.astype(np.float64) for name, values in found.items()},
        "margin": along[:, 0],
        "margin_at_end": along[:, -1],
        "least_margin": along.min(axis=1),
        "pressing_margin": pressed[:, 0],
        "pressing_margin_at_end": pressed[:, -1],
        "least_pressing_margin": pressed.min(axis=1),
        **{name: np.full(len(contacts), float(value)) for name, value in same.items()},
    }


@cache
def fitted_model(path: Path) -> dict[str, Any]:
    """Return bias, and mean, scale, weight, least and greatest value of each feature."""
    return json.loads(path.read_text(encoding="utf-8"))


def calibrated(foresight: Mapping[str, Any], scene: Scene, hand: Hand) -> dict[str, Any]:
    """Return the figures of `foresight` that mean what they say: a probability only for slides of the hand of the fit.

    For other hands, and motions that turn or tip, it is an order rather than a probability.
    """
    known = scene.turn is None and hand.name == fitted_model(MODEL)["calibrated"]["hand"]
    return {name: value for name, value in foresight.items() if name != "probability" or known}


def probabilities(scene: Scene, contacts: Sequence[HandContacts]) -> Float[np.ndarray, " configuration"]:
    """Return the probability that each verified configuration holds in physics, from its contacts."""
    if not len(contacts):
        return np.zeros(0)
    fitted = fitted_model(MODEL)
    found = features(scene, contacts)
    score = np.full(len(contacts), float(fitted["bias"]))
    for name, of in fitted["features"].items():
        value = np.clip(found[name], of["least"], of["greatest"])
        score += of["weight"] * (value - of["mean"]) / of["scale"]
    return np.asarray(1.0 / (1.0 + np.exp(-score)))
