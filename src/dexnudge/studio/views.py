"""What is shown of a scene, of draws and of a selected one, as visual scenes and parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from dexnudge.jobs.cached import cached_per_instance
from dexnudge.results.samples import Samples
from dexnudge.scenes.scene import Scene
from dexnudge.studio.layers import Layers, clearance_colour
from dexnudge.studio.stage import Stage
from dexnudge.viewer.visual_scene import (
    PALETTE,
    Colour,
    Part,
    VisualScene,
    surrounding_parts,
    turning_parts,
    visual_scenes,
)

CONTACT_RADIUS, SUPPORT_RADIUS = 0.0025, 0.0015  # [m] of dots
CONE_OPACITY = 0.35
PRESSING = (0.85, 0.10, 0.16)  # colour of the hand's forces, and of a link that presses with all that it may


@cached_per_instance
def scene_alone(scene: Scene) -> VisualScene:
    """Return a scene without a hand; made once, so that its bodies are sent once."""
    body = Part("object", "object", scene.object_mesh, np.asarray(scene.T_world_object))
    around = surrounding_parts(scene.environment_mesh, scene.object_in_world().bounds)
    turning = turning_parts(scene, scene.object_motion.length)
    return VisualScene((body, *around, *turning), np.zeros((0, 3)), np.asarray(scene.motion), scene.motion_length)


@cached_per_instance
def sliding_parts(scene: Scene) -> tuple[Part, ...]:
    """Return the arrow of a slide and the object at its end; none where it turns, since visual scenes have those."""
    if scene.turn is not None:
        return ()
    goal = scene.object_motion.displacement(scene.motion_length) @ scene.T_world_object
    return scene_alone(scene).arrow(), Part("goal", "ghost", scene.object_mesh, goal)


def draws_together(samples: Samples, places: Int[np.ndarray, " m"]) -> list[VisualScene]:
    """Return the draws at these places, of the same bodies; of several without their forearms, which would hide all else."""
    views = visual_scenes(samples.scene, samples.hand, samples.q[places].astype(np.float64))
    if len(views) == 1:
        return views
    return [replace(view, parts=tuple(part for part in view.parts if part.role != "base")) for view in views]


def clearance_colours(view: VisualScene, layers: Layers, links: Sequence[str]) -> list[Colour]:
    """Return the colour of each part, of links by their clearance."""
    least = dict(zip(links, layers.clearance.tolist(), strict=True))
    hand = ("link", "fingertip", "base")
    return [
        clearance_colour(least[part.name], part.colour) if part.role in hand else part.colour for part in view.parts
    ]


def force_colours(view: VisualScene, forces: dict[str, float], limit: float) -> list[Colour]:
    """Return the colour of each part: the redder, the nearer a link's force [N] is to the limit."""
    found = []
    for part in view.parts:
        share = min(forces.get(part.name, 0.0) / limit, 1.0)
        red, green, blue = ((1 - share) * np.array(part.colour) + share * np.array(PRESSING)).tolist()
        found.append((red, green, blue))
    return found


def mark(stage: Stage, layers: Layers | None) -> None:
    """Show the layers of a draw in place of those of another; None takes them away."""
    if layers is None:
        stage.unmark()
        return
    stage.dots("contacts", "touching", layers.contacts, CONTACT_RADIUS, PALETTE["contact"])
    stage.dots("supports", "carrying", layers.supports, SUPPORT_RADIUS, PALETTE["support"])
    stage.arrows("forces", "of the hand", layers.hand_forces, PRESSING)
    stage.arrows("forces", "of the supports", layers.support_forces, PALETTE["support"])
    stage.glass("friction cones", "cones", layers.cones, PALETTE["contact"], CONE_OPACITY)
