"""How deep a hand is in the object, in the surroundings and in itself: exact distance, dense points, both ways."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.verification.point_tree import PointHits, build_tree, near_points, raise_depths
from dexnudge.verification.solids import SolidDistance, Solids, TriangleSurface

WIDEST_HOLE = 0.03
"""A wider opening in the surroundings is the border of a scan, not a hole in a body; see `SolidDistance` [m]."""


@dataclass(frozen=True)
class Penetrations:
    """Greatest depth per configuration [m], 0 where nothing penetrates, and the hand's points near the object.

    Attributes:
        object: of hand and object in each other.
        environment: of hand and surroundings in each other, either grown by the clearance of the scene.
        self_collision: of the hand's links in each other.
        near_object: points within the reach that was asked for, in the OBJECT's frame.
    """

    object: Float[np.ndarray, " n"]
    environment: Float[np.ndarray, " n"]
    self_collision: Float[np.ndarray, " n"]
    near_object: PointHits


class HandSolids:
    """A hand's dense points as a tree, and its links as solids; made once per hand."""

    def __init__(self, hand: Hand, *, device: str = "cpu") -> None:
        count = len(hand.link_meshes)
        self.tree = build_tree(hand.dense_points, num_links=count, device=device)
        self.links = np.array([link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)])
        solids = [SolidDistance(hand.link_meshes[link], device=device) for link in self.links]
        self.solids = Solids(solids, half_spaces=True, device=device)
        partners = np.zeros((count, count), dtype=bool)
        for one, other in hand.self_collision_pairs:
            partners[one, other] = partners[other, one] = True
        self.partners = partners[self.links]


@cached_per_instance
def hand_solids(hand: Hand, *, device: str = "cpu") -> HandSolids:
    """The hand's solids."""
    return HandSolids(hand, device=device)


@cached_per_instance
def solid_distance(mesh: trimesh.Trimesh, *, widest_hole: float = np.inf, device: str = "cpu") -> SolidDistance:
    """Return a mesh of a scene as a solid; made once for all scenes that have it, such as those of a displaced object."""
    return SolidDistance(mesh, surroundings_distance(mesh, device=device), widest_hole=widest_hole)


class SceneSolids:
    """Object and surroundings as solids, and their triangles in the world; made once per scene."""

    def __init__(self, scene: Scene, *, device: str = "cpu") -> None:
        self.object = solid_distance(scene.object_mesh, device=device)
        self.environment = Solids(
            [solid_distance(scene.environment_mesh, widest_hole=WIDEST_HOLE, device=device)], device=device
        )
        self.object_surface = TriangleSurface(scene.object_in_world(), device=device)
        self.environment_surface = TriangleSurface(scene.environment_mesh, device=device)


@cached_per_instance
def scene_solids(scene: Scene, *, device: str = "cpu") -> SceneSolids:
    """The scene's solids."""
    return SceneSolids(scene, device=device)


class PenetrationCheck:
    """Measures the penetrations of one hand in one scene, for any number of configurations.

    Both ways: the hand's dense points (2 mm) in object and environment, and points of their surfaces (2 mm, with all
    edges and corners) in the links; in itself, the dense points of either link of a pair in the other. The depth in the
    surroundings is max(0, clearance - signed distance), with `scene.clearance`: for 0 the plain depth.
    """

    def __init__(self, hand: Hand, scene: Scene, *, device: str = "cpu") -> None:
        self._hand = hand_solids(hand, device=device)
        self._T_object_world = np.linalg.inv(scene.T_world_object)
        self._scene, self._clearance = scene_solids(scene, device=device), scene.clearance
        self._environment = scene.environment_mesh

    def __call__(
        self, T_world_link: Float[np.ndarray, "n link 4 4"], *, reach: float, known: dict[Any, Any] | None = None
    ) -> Penetrations:
        """Return the penetrations for the poses of the links; `reach` [m] is how far `near_object` looks.

        known: what was found for the same poses in other scenes; depths without the object's part come from there.
        """
        if len(T_world_link) == 0:
            nothing = np.zeros(0)
            empty = np.zeros(0, dtype=np.int64)
            return Penetrations(nothing, nothing, nothing, PointHits(empty, empty, nothing, *np.zeros((2, 0, 3))))
        known = {} if known is None else known
        mesh = self._environment
        if (PenetrationCheck, id(mesh), self._clearance) not in known:  # beside the mesh, so that no other has its id
            known[PenetrationCheck, id(mesh), self._clearance] = mesh, self.in_environment(T_world_link)
        if PenetrationCheck not in known:
            known[PenetrationCheck] = self.in_itself(T_world_link)
        object_depth, near_object = self.in_object(T_world_link, reach)
        environment_depth = known[PenetrationCheck, id(mesh), self._clearance][1]
        return Penetrations(object_depth, environment_depth, known[PenetrationCheck], near_object)

    def in_object(
        self, T_world_link: Float[np.ndarray, "n link 4 4"], reach: float = 0.0
    ) -> tuple[Float[np.ndarray, " n"], PointHits]:
        """Return the depth of hand and object in each other, and the points within `reach` of it; see `Penetrations`."""
        hits = near_points(self._hand.tree, self._T_object_world @ T_world_link, self._scene.object, reach=reach)
        deepest = np.zeros(len(T_world_link))
        np.maximum.at(deepest, hits.configuration, -hits.distance)
        T_world_solid = T_world_link[:, self._hand.links]
        self._scene.object_surface.raise_depths(self._hand.solids, T_world_solid, deepest)
        return deepest, hits

    def in_environment(self, T_world_link: Float[np.ndarray, "n link 4 4"]) -> Float[np.ndarray, " n"]:
        """Return the depth of hand and surroundings in each other; see `Penetrations`."""
        deepest, here = np.zeros(len(T_world_link)), np.eye(4)[None, None]
        hand, scene, clearance = self._hand, self._scene, self._clearance
        every = np.ones((1, T_world_link.shape[1]), dtype=bool)
        raise_depths(hand.tree, T_world_link, here, scene.environment, asked=every, reach=clearance, deepest=deepest)
        scene.environment_surface.raise_depths(hand.solids, T_world_link[:, hand.links], deepest, clearance=clearance)
        return deepest

    def in_itself(self, T_world_link: Float[np.ndarray, "n link 4 4"]) -> Float[np.ndarray, " n"]:
        """Return the depth of the hand's links in each other; see `Penetrations`."""
        return _self_penetration(self._hand, T_world_link)


def self_penetration(hand: Hand, joint_angles: Float[np.ndarray, "n joint"]) -> Float[np.ndarray, " n"]:
    """Return the greatest depth of any link in one that it must not touch [m], 0 where none is inside."""
    return _self_penetration(hand_solids(hand), hand.forward_kinematics(hand.at_origin(joint_angles)).numpy())


def _self_penetration(hand: HandSolids, T_world_link: np.ndarray) -> np.ndarray:
    deepest, T_link_world = np.zeros(len(T_world_link)), np.linalg.inv(T_world_link[:, hand.links])
    raise_depths(hand.tree, T_world_link, T_link_world, hand.solids, asked=hand.partners, reach=0.0, deepest=deepest)
    return deepest
