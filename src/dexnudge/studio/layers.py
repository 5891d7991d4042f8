"""What is to be seen of a draw beside its bodies: contacts, forces, friction cones, supports, clearance."""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.mechanics.balance import contact_forces
from dexnudge.mechanics.friction_cone import friction_cone_edges
from dexnudge.mechanics.sliding_task import sliding_task
from dexnudge.results.samples import Sample
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import support_contacts
from dexnudge.viewer.visual_scene import Colour

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
