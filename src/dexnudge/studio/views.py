"""What is shown of a scene, of draws and of a selected one: visual scenes and parts; contacts, forces and clearances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from jaxtyping import Float, Int

from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.mechanics.balance import contact_forces
from dexnudge.mechanics.friction_cone import friction_cone_edges
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.results.samples import Sample, Samples
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts
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

LONGEST_ARROW = 0.06  # [m] of the strongest force of a draw: it reaches out of the finger
LEAST_SHOWN = 0.02  # of the strongest force: a weaker one has no arrow
CONE_HEIGHT = 0.02  # [m]
TOUCHING, NEAR, FAR = 0.0, 0.01, 0.03  # [m] clearances that are red, yellow, and a link's own colour
RED, YELLOW = (0.85, 0.10, 0.16), (0.98, 0.80, 0.10)


@dataclass(frozen=True, eq=False)
class Layers:
    """Of one draw, world frame, where its motion begins.

    Attributes:
        contacts: of hand and object [m].
        supports: where the surroundings carry the object [m].
        hand_forces: arrows (tail, head) of the forces of the hand on the object [m]; they end where they act.
        support_forces: of the surroundings on the object [m]; they begin where they act.
        cones: the friction pyramids of the contacts, as the force balance takes them, opened towards the hand.
        balanced: whether there are forces that balance the object.
        pressed: sum of the normal forces of the hand [N]; 0 where nothing balances.
        clearance: least distance of each link's surface from the surroundings [m], negative inside; inf without surface.
    """

    contacts: Float[np.ndarray, "contact 3"]
    supports: Float[np.ndarray, "support 3"]
    hand_forces: Float[np.ndarray, "a 2 3"]
    support_forces: Float[np.ndarray, "b 2 3"]
    cones: trimesh.Trimesh
    balanced: bool
    pressed: float
    clearance: Float[np.ndarray, " link"]


def layers_of(sample: Sample) -> Layers:
    """Return the layers of a draw; forces are those that balance the object with the least press."""
    scene, contacts = sample.scene, sample.contacts
    supports, task = support_contacts(scene), sliding_task(scene)
    forces = contact_forces(contacts, supports, task) if len(contacts.points) else None
    by_hand, by_supports, pressed = np.zeros((0, 2, 3)), np.zeros((0, 2, 3)), 0.0
    if forces is not None:
        strongest = float(np.linalg.norm([*forces.hand, *forces.support], axis=1).max())
        by_hand = _arrows(contacts.points, forces.hand / strongest, ends=True)
        by_supports = _arrows(supports.points, forces.support / strongest, ends=False)
        pressed = float(-(forces.hand * contacts.normals).sum())
    edges = np.zeros((0, 8, 3))
    if len(contacts.points):
        motion = task.twist.direction(contacts.points)
        edges = friction_cone_edges(contacts.normals, motion, friction=task.friction_hand)
    return Layers(
        contacts=contacts.points,
        supports=supports.points,
        hand_forces=by_hand,
        support_forces=by_supports,
        cones=_pyramids(contacts.points, -CONE_HEIGHT * edges),
        balanced=forces is not None,
        pressed=pressed,
        clearance=link_clearance(scene, sample.hand, sample.q),
    )


def _arrows(
    points: Float[np.ndarray, "n 3"], forces: Float[np.ndarray, "n 3"], *, ends: bool
) -> Float[np.ndarray, "m 2 3"]:
    """Return arrows of forces, shares of the strongest, that end or begin at their points."""
    shown = np.linalg.norm(forces, axis=1) > LEAST_SHOWN
    here, along = points[shown], LONGEST_ARROW * forces[shown]
    return np.stack([here - along, here] if ends else [here, here + along], axis=1)


def _pyramids(points: Float[np.ndarray, "n 3"], edges: Float[np.ndarray, "n edge 3"]) -> trimesh.Trimesh:
    """Return one mesh of pyramids with their tips at `points` [m]; empty without any."""
    count, sides = edges.shape[:2]
    if not count:
        return trimesh.Trimesh()
    vertices = np.concatenate([points[:, None], points[:, None] + edges], axis=1)
    side = np.arange(sides)
    faces = np.column_stack([np.zeros(sides, dtype=int), 1 + side, 1 + np.roll(side, -1)])
    every = faces[None] + (sides + 1) * np.arange(count)[:, None, None]
    return trimesh.Trimesh(vertices.reshape(-1, 3), every.reshape(-1, 3), process=False)


def link_clearance(scene: Scene, hand: Hand, q: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, " link"]:
    """Return how far the surface of each link is from the surroundings [m], negative inside; inf without surface."""
    points = hand.dense_points
    T = hand.forward_kinematics(torch.as_tensor(q[None].astype(np.float64)))[0].numpy()[points.link]
    world = np.einsum("pij,pj->pi", T[:, :3, :3], points.points) + T[:, :3, 3]
    least = np.full(len(hand.link_names), np.inf)
    np.minimum.at(least, points.link, surroundings_distance(scene.environment_mesh)(world).distance)
    return least


def clearance_colour(clearance: float, own: Colour) -> Colour:
    """Return the colour of a link by its clearance [m]: red where it touches, yellow at 10 mm, its own from 30 mm on."""
    places, colours = (TOUCHING, NEAR, FAR), np.array([RED, YELLOW, own])
    red, green, blue = (float(np.interp(clearance, places, channel)) for channel in colours.T)
    return red, green, blue


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
