"""How deep a hand is in the object, in the surroundings and in itself: exact distance, dense points, both ways."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_lattice import Boxes, lattice_in_boxes
from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.verification.point_tree import PointHits, SolidDistance, build_tree, query_tree

SURFACE_SPACING = 2e-3
"""Spacing of the object's and the environment's points that are looked for in the hand's links [m]."""
WIDEST_HOLE = 0.03
"""A wider opening in the surroundings is the border of a scan, not a hole in a body; see `SolidDistance` [m]."""
DIRECTIONS = np.asarray(trimesh.creation.icosphere(subdivisions=1).vertices)
"""Normals of the half-spaces that rule out most of those points before any distance is asked for."""
THREADS = 2
"""Object, environment and self are measured side by side; distance queries run outside Python's lock."""


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
        self.tree = build_tree(hand.dense_points)
        meshes = {i: mesh for i, mesh in enumerate(hand.link_meshes) if len(mesh.faces)}
        self.solids = {i: SolidDistance(mesh, ExactDistance(mesh, device=device)) for i, mesh in meshes.items()}
        # Half-spaces that hold a link: no point is deeper in the link than in the least of them.
        self.extent = {i: (hand.link_meshes[i].vertices @ DIRECTIONS.T).max(axis=0) for i in self.solids}
        count = len(hand.link_meshes)
        self.partners = np.zeros((count, count), dtype=bool)
        for one, other in hand.self_collision_pairs:
            self.partners[one, other] = self.partners[other, one] = True


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
        self.environment = solid_distance(scene.environment_mesh, widest_hole=WIDEST_HOLE, device=device)
        self.object_triangles = np.asarray(scene.object_in_world().triangles, dtype=np.float64)
        self.environment_triangles = np.asarray(scene.environment_mesh.triangles, dtype=np.float64)


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
        self._all_links = np.ones(len(hand.link_meshes), dtype=bool)
        self._T_object_world = np.linalg.inv(scene.T_world_object)
        self._scene, self._clearance = scene_solids(scene, device=device), scene.clearance

    def __call__(self, T_world_link: Float[np.ndarray, "n link 4 4"], *, reach: float) -> Penetrations:
        """Return the penetrations for the poses of the links; `reach` [m] is how far `near_object` looks."""
        if len(T_world_link) == 0:
            nothing = np.zeros(0)
            empty = np.zeros(0, dtype=np.int64)
            return Penetrations(nothing, nothing, nothing, PointHits(empty, empty, nothing, *np.zeros((2, 0, 3))))
        with ThreadPoolExecutor(THREADS) as pool:
            self_collision = pool.submit(self.in_itself, T_world_link)
            environment = pool.submit(self.in_environment, T_world_link)
            in_object = pool.submit(self.in_object, T_world_link, reach)
            object_depth, near_object = in_object.result()
            return Penetrations(object_depth, environment.result(), self_collision.result(), near_object)

    def in_object(
        self, T_world_link: Float[np.ndarray, "n link 4 4"], reach: float = 0.0
    ) -> tuple[Float[np.ndarray, " n"], PointHits]:
        """Return the depth of hand and object in each other, and the points within `reach` of it; see `Penetrations`."""
        hits = query_tree(
            self._hand.tree, self._T_object_world @ T_world_link, self._scene.object, links=self._all_links, reach=reach
        )
        deepest = np.zeros(len(T_world_link))
        np.maximum.at(deepest, hits.configuration, -hits.distance)
        self._into_links(self._scene.object_triangles, T_world_link, deepest)
        return deepest, hits

    def in_environment(self, T_world_link: Float[np.ndarray, "n link 4 4"]) -> Float[np.ndarray, " n"]:
        """Return the depth of hand and surroundings in each other; see `Penetrations`."""
        deepest = np.zeros(len(T_world_link))
        clearance = self._clearance
        query_tree(
            self._hand.tree,
            T_world_link,
            self._scene.environment,
            links=self._all_links,
            reach=clearance,
            deepest=deepest,
        )
        self._into_links(self._scene.environment_triangles, T_world_link, deepest, clearance)
        return deepest

    def in_itself(self, T_world_link: Float[np.ndarray, "n link 4 4"]) -> Float[np.ndarray, " n"]:
        """Return the depth of the hand's links in each other; see `Penetrations`."""
        return _self_penetration(self._hand, T_world_link)

    def _into_links(
        self, triangles: np.ndarray, T_world_link: np.ndarray, deepest: np.ndarray, clearance: float = 0.0
    ) -> None:
        """Raise `deepest` to the greatest depth of the surface's points in any link grown by the clearance."""
        links = np.array(list(self._hand.solids))
        low = np.stack([self._hand.solids[link].low for link in links]) - clearance
        high = np.stack([self._hand.solids[link].high for link in links]) + clearance
        T = T_world_link[:, links].reshape(-1, 4, 4)
        owner = np.tile(np.arange(len(links)), len(T_world_link))
        middle = 0.5 * (low + high)[owner]
        boxes = Boxes(
            centre=np.einsum("bij,bj->bi", T[:, :3, :3], middle) + T[:, :3, 3],
            axes=np.swapaxes(T[:, :3, :3], 1, 2),
            half=0.5 * (high - low)[owner],
        )
        points, box, _ = lattice_in_boxes(triangles, boxes, spacing=SURFACE_SPACING)
        local = middle[box] + np.einsum("nix,nx->ni", boxes.axes[box], points - boxes.centre[box])
        configuration = box // len(links)
        for index, (link, solid) in enumerate(self._hand.solids.items()):
            mine = np.flatnonzero(owner[box] == index)
            room = (self._hand.extent[link] - local[mine] @ DIRECTIONS.T).min(axis=1)
            mine = mine[room + clearance > deepest[configuration[mine]]]
            np.maximum.at(deepest, configuration[mine], clearance - solid.query(local[mine]).distance)


def self_penetration(hand: Hand, joint_angles: Float[np.ndarray, "n joint"]) -> Float[np.ndarray, " n"]:
    """Return the greatest depth of any link in one that it must not touch [m], 0 where none is inside."""
    return _self_penetration(hand_solids(hand), hand.forward_kinematics(hand.at_origin(joint_angles)).numpy())


def _self_penetration(hand: HandSolids, T_world_link: np.ndarray) -> np.ndarray:
    deepest = np.zeros(len(T_world_link))
    for link, solid in hand.solids.items():
        T_solid_link = np.linalg.inv(T_world_link[:, link])[:, None] @ T_world_link
        query_tree(hand.tree, T_solid_link, solid, links=hand.partners[link], reach=0.0, deepest=deepest)
    return deepest
