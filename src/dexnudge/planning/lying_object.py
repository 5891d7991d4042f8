"""An object on its support, as points from which rays measure its surroundings wherever it is shifted along the support."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull, QhullError
from trimesh.transformations import rotation_matrix

from dexnudge.geometry.exact_distance import Rays
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.geometry.surface_lattice import distinct_rows, surface_lattice
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.support_contacts import SUPPORT_DISTANCE, SupportContacts, carrying_normal, support_contacts
from dexnudge.scenes.support_hull import outer_points
from dexnudge.scenes.sweep import INSET, sweep_of

SIDE_SPACING = 0.005  # [m] between the points of the upper and lower side
FACING = 0.5  # cosine with the support's normal from which a surface counts as upper or lower side
MOST_TILT = 0.15  # [rad] by which an object may rock, about 9 degrees: a hand can follow, and nothing slides off
PIVOT = 0.002  # [m] beyond the edge about which an object turns: nearer points come down too little to count
AROUND = 0.03  # [m] from the centre of mass, within which few points mostly show that they carry it
ROUNDING = 1e-6  # [m]
DOWN = np.array([0.0, 0.0, -1.0])  # gravity's direction, world
SEEN = 1.0  # [m] clearances above and below are measured up to here

Rows = slice | Bool[np.ndarray, " side"]
EVERY = slice(None)


@dataclass(frozen=True)
class AtRest:
    """A pose in which an object rests.

    margin: from its centre of mass, seen along gravity, to the edge of what carries it [m]; negative: it tips; -inf where
    fewer than three points are carried. T_rocked: world to world, what turned it there.
    """

    margin: float
    T_rocked: Float[np.ndarray, "4 4"]


class LyingObject:
    """The object of a scene at rest, shifted by vectors along its support.

    Attributes:
        normal: of the support, unit, upward, world; (0, 0, 0) where nothing carries the object.
        points: of the whole surface [m, world]. lower, upper: of the surfaces that face the support and away from it.
        centre: of mass [m, world].
    """

    def __init__(self, scene: Scene) -> None:
        self.mesh = scene.object_in_world()
        self._environment = Rays(scene.environment_mesh)
        self._sweep = sweep_of(scene)
        supports = support_contacts(scene)
        self._touching, self.normal = supports.normals, _normal_of_support(scene, supports)
        self.points, self._lift = self._sweep.points, self._sweep.lift
        sides, normals = self._sides()
        self.lower, self.upper = sides[normals @ self.normal < -FACING], sides[normals @ self.normal > FACING]
        self.centre = scene.T_world_object[:3, :3] @ centre_of_mass(scene.object_mesh) + scene.T_world_object[:3, 3]

    def _sides(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Return points of the surface, drawn inward a little, and the outward normals there; each place once."""
        points, face = surface_lattice(np.asarray(self.mesh.triangles, dtype=np.float64), spacing=SIDE_SPACING)
        normals = np.asarray(self.mesh.face_normals)[face]
        keys = np.round(np.concatenate([points * 1e6, normals * 10], axis=1))
        first = np.sort(distinct_rows(keys)[0])
        return points[first] - INSET * normals[first], normals[first]

    def free_travel(self, direction: Float[np.ndarray, "3"], *, reach: float) -> float:
        """Return how far the object can translate along the unit `direction` before it meets the surroundings [m]."""
        found = self._sweep.first_obstacle(direction, carrying=self.normal, touching=self._touching, reach=reach)
        return reach if found is None else found.way

    def below(self, shift: Float[np.ndarray, "3"], rows: Rows = EVERY) -> Float[np.ndarray, " n"]:
        """Return the way [m] from points of the lower side straight down to the surroundings, up to `SEEN`."""
        return self._below(self.lower[rows] + shift)

    def _below(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        lifted = points + self._lift * self.normal
        return self._environment(lifted, -self.normal, reach=SEEN + self._lift + INSET) - self._lift - INSET

    def front_is_carried(
        self, shifts: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "3"], room: float
    ) -> Bool[np.ndarray, " n"]:
        """Return for each shift whether the foremost points of the lower side have less than `room` [m] below."""
        along = self.lower @ direction
        front = self.lower[along > along.max() - SIDE_SPACING] + shifts[:, None] + self._lift * self.normal
        ways = self._environment(front.reshape(-1, 3), -self.normal, reach=SEEN).reshape(front.shape[:2])
        return (ways < room + self._lift + INSET).any(axis=1)

    def above(self, shift: Float[np.ndarray, "3"], rows: Rows = EVERY) -> Float[np.ndarray, " n"]:
        """Return the way [m] from points of the upper side straight up to the surroundings, up to `SEEN`."""
        return self._environment(self.upper[rows] + shift, self.normal, reach=SEEN + INSET) - INSET

    def at_rest(self, shift: Float[np.ndarray, "3"], *, least: float) -> AtRest:
        """Return how the shifted object comes to rest: as it is, or rocked onto what lies below it.

        Where the centre of mass is less than `least` [m] within what carries it, the object turns about the edge that it is
        nearest to, until a further point of its lower side is carried, and so on, up to `MOST_TILT`. So an arched object
        that has one foot over an edge comes to lie on its arch.
        """
        best = AtRest(-np.inf, np.eye(4))
        if not self.normal.any():
            return best
        gap = self.below(shift)
        centre = self.centre + shift
        points = self.lower + shift
        resting, plane = points[np.argmin(gap)], self._plane
        foot = centre + DOWN * ((resting - centre) @ self.normal) / (DOWN @ self.normal)
        flat = (points - foot) @ plane.T
        T_rocked, tilt = np.eye(4), 0.0
        while (gap <= SUPPORT_DISTANCE).sum() >= 3:
            try:
                edges = _edges(flat[gap <= SUPPORT_DISTANCE])
            except QhullError:  # all on one line
                return best
            across, offset = edges[np.argmax(edges[:, 2]), :2], float(edges[:, 2].max())
            if -offset > best.margin:
                best = AtRest(-offset, T_rocked)
            beyond = flat @ across + offset
            ahead = (beyond > PIVOT) & (gap > SUPPORT_DISTANCE)
            if -offset >= least or not ahead.any():
                return best
            angle = float((gap[ahead] / beyond[ahead]).min())
            tilt += angle
            if tilt > MOST_TILT:
                return best
            gap = gap - angle * beyond
            axis = across[0] * plane[1] - across[1] * plane[0]
            T_rocked = rotation_matrix(angle, axis, foot - offset * across @ plane) @ T_rocked
        return best

    def keeps_balance(self, shift: Float[np.ndarray, "3"], *, least: float) -> bool:
        """Return whether `at_rest` finds a margin of at least `least` [m] for the shifted object."""
        return self._surely_rests(shift, least) or self.at_rest(shift, least=least).margin >= least

    def rocked(self, shift: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
        """Return the `T_rocked` of `at_rest` that lets the shifted object be carried at all."""
        return np.eye(4) if self._surely_rests(shift, 0.0) else self.at_rest(shift, least=0.0).T_rocked

    def _surely_rests(self, shift: Float[np.ndarray, "3"], least: float) -> bool:
        """Whether the points around the centre of mass alone carry it so; where they do not, all of them may."""
        if not self.normal.any():
            return False
        around, flat, doubt = self._around
        resting = self._below(around + shift) <= SUPPORT_DISTANCE
        try:
            return bool(-_edges(flat[resting])[:, 2].max() > least + doubt) if resting.sum() >= 3 else False
        except QhullError:  # all on one line
            return False

    @cached_property
    def _around(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"], float]:
        """Outermost points of the lower side near the centre of mass [m], seen along gravity, and by what that is off."""
        arm = self.lower - self.centre
        height, lean = arm @ self.normal, self._plane @ DOWN / (DOWN @ self.normal)
        flat = arm @ self._plane.T - height.mean() * lean
        near = np.flatnonzero(np.linalg.norm(flat, axis=1) < AROUND)
        near = near[outer_points(flat[near])] if len(near) else near
        return self.lower[near], flat[near], ROUNDING + float(np.ptp(height) * np.linalg.norm(lean))

    @cached_property
    def _plane(self) -> Float[np.ndarray, "2 3"]:
        """Axes of the support's plane, unit; the first is as near the world's x as can be."""
        first = np.array([1.0, 0.0, 0.0]) - self.normal[0] * self.normal
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])


def _edges(flat: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "edge 3"]:
    """Outward normal and offset of each edge of the convex hull; QhullError where all lie on one line."""
    return np.asarray(ConvexHull(flat[outer_points(flat)]).equations)


@cached_per_instance
def lying_object(scene: Scene) -> LyingObject:
    """Return the scene's object; made once per scene."""
    return LyingObject(scene)


def _normal_of_support(scene: Scene, contacts: SupportContacts) -> Float[np.ndarray, "3"]:
    """Return the upward unit normal of what carries the object; zeros where nothing does.

    Of a surface that scatters it is that of the fitted plane: single contacts on bumps and worn edges lean by many degrees.
    """
    fitted = [support.normal for support in scene.supports if support.side == "below"] if scene.surface_noise else []
    return fitted[0] if fitted and carrying_normal(contacts).any() else carrying_normal(contacts)
