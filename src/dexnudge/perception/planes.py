"""The large planes of what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from dexnudge.perception.depth_view import DepthView, depth_noise

VIEW_OFFSET = 0.002  # [m] by which neighbouring views of a camera on a robot's wrist disagree, as standard deviation
CELL = 0.005  # [m] of the lattice in which points of all views are averaged, and of a plane's patch
MOST_CELLS = 60_000  # of merged points; above that the lattice is coarser
STRAYS = 0.15  # of the median number of points in a cell: where fewer lie, these are strays between surfaces
NEIGHBOURS = 20  # of a point, from which its normal is taken
DENSE = 0.02  # [m] within which a point of a surface has them: 40 % of the lattice measured
NORMAL_AGREES = np.cos(np.radians(25.0))  # normals of noisy neighbourhoods scatter by as much
SAME_PLANE = np.cos(np.radians(8.0))  # two fits whose normals lie closer, within the noise, are one plane
HYPOTHESES = 250  # for each plane: with a tenth of the points on it, one is missed once in 10^11
LEAST_AREA = 2.5e-3  # [m^2] 5 x 5 cm: the support of a phone
MOST_PLANES = 12
UPRIGHT = np.array([0.0, 0.0, 1.0])
NEARLY_LEVEL = np.cos(np.radians(6.0))  # what people put things on is level, where measurements do not say otherwise
CORRELATED = 0.08  # [m] over which errors of depth are about equal: a patch as large tells of one height, not of a tilt
SCORED = 5000  # points that hypotheses are tried on


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane n . x = d fitted to measured points.

    Attributes:
        normal: n, unit vector toward the cameras.
        offset: d [m].
        noise: root mean square distance of its points [m].
        points: (n, 3) what was measured on it, merged over the views [m].
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    noise: float
    points: Float[np.ndarray, "n 3"]

    def heights(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return signed distances [m] of points, positive on the side of the cameras."""
        return points @ self.normal - self.offset

    @property
    def band(self) -> float:
        """Distance [m] within which a measured point belongs to the plane."""
        return max(3 * self.noise, 0.0015)

    @property
    def level(self) -> bool:
        """Whether something could stand on it: its normal within 25 degrees of up."""
        return bool(self.normal[2] > NORMAL_AGREES)


def merged_points(
    views: Sequence[DepthView], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """Return the measured points of all views inside a box [m], averaged in a lattice of at least 5 mm, strays left out."""
    points = np.concatenate([view.points() for view in views])
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    cell = CELL
    means, counts = cell_means(points, cell)
    while len(counts) > MOST_CELLS:
        cell *= 1.5
        means, counts = cell_means(points, cell)
    return means[counts >= STRAYS * np.median(counts)] if len(counts) else means


def cell_means(points: Float[np.ndarray, "n 3"], cell: float) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, " k"]]:
    """Return the mean of the points in each cell of a lattice [m], and their number."""
    if not len(points):
        return points, np.zeros(0, dtype=np.int64)
    cells = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, place, counts = np.unique(key, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(place, points[:, axis], len(counts)) for axis in range(3)], axis=1)
    return sums / counts[:, None], counts


def find_planes(views: Sequence[DepthView], low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"]) -> list[Plane]:
    """Return the planes that fill at least 25 cm^2 of what was measured inside a box, largest first.

    One after the other by RANSAC (Fischler and Bolles 1981), each hypothesis a point with its normal (Schnabel, Wahl and
    Klein 2007), refined by least squares; the points of a plane are taken out before the next.

    Args:
        views: pixels of `mask` count as others do; take them out where they should not.
        low: corner of the box in the world [m].
        high: the opposite corner [m].
    """
    merged = merged_points(views, low, high)
    if len(merged) <= NEIGHBOURS:
        return []
    cameras = np.mean([view.T_world_camera[:3, 3] for view in views], axis=0)
    distance = float(np.median(np.linalg.norm(merged - cameras, axis=1)))
    widest = 3 * np.hypot(depth_noise(distance), VIEW_OFFSET)
    distances, near = cKDTree(merged).query(merged, k=NEIGHBOURS)
    dense = distances[:, -1] < DENSE  # sparser points are strays at the edges of surfaces
    points, near = merged[dense], near[dense]
    around = merged[near] - merged[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))[1][:, :, 0]
    generator = np.random.default_rng(0)
    free = np.ones(len(points), dtype=bool)
    found: list[Plane] = []
    for _ in range(4 * MOST_PLANES):
        left = np.flatnonzero(free)
        if len(left) * CELL**2 < LEAST_AREA or len(found) == MOST_PLANES:
            break
        on = _largest(points[left], normals[left], widest, generator)
        plane, on = _refined(points[left], normals[left], on, widest)
        if plane is None or len(on) * CELL**2 < LEAST_AREA:
            break
        free[left[on]] = False
        if any(abs(each.normal @ plane.normal) > SAME_PLANE and _within(each, plane, widest) for each in found):
            continue
        found.append(_toward(plane, cameras))
    return found


def _largest(points: np.ndarray, normals: np.ndarray, band: float, generator: np.random.Generator) -> np.ndarray:
    """Return which points lie on the best of many hypotheses, each a point with its normal."""
    few = generator.choice(len(points), min(SCORED, len(points)), replace=False)
    best, most = few[0], 0
    normals = np.where(np.abs(normals[:, 2:]) > NEARLY_LEVEL, UPRIGHT, normals)
    for index in few[:HYPOTHESES]:
        if (count := int(_on(points[few], normals[few], points[index], normals[index], band).sum())) > most:
            best, most = index, count
    return np.flatnonzero(_on(points, normals, points[best], normals[best], band))


def _on(points: np.ndarray, normals: np.ndarray, centre: np.ndarray, normal: np.ndarray, band: float) -> np.ndarray:
    return (np.abs((points - centre) @ normal) < band) & (np.abs(normals @ normal) > NORMAL_AGREES)


def _refined(points: np.ndarray, normals: np.ndarray, on: np.ndarray, widest: float) -> tuple[Plane | None, np.ndarray]:
    """Return the least-squares plane of the points on it, whose band follows their scatter, and which they are."""
    plane = None
    for _ in range(6):
        if len(on) < NEIGHBOURS:
            return None, on
        centre = points[on].mean(axis=0)
        normal = np.linalg.svd(points[on] - centre, full_matrices=False)[2][2]
        normal = _level_unless_tilted(points[on] - centre, normal)
        distances = (points - centre) @ normal
        scatter = 1.4826 * float(np.median(np.abs(distances[on])))  # of a normal distribution, robust
        plane = Plane(normal, float(normal @ centre), float(np.sqrt(np.mean(distances[on] ** 2))), points[on])
        band = float(np.clip(3 * scatter, 0.0015, widest))
        on = np.flatnonzero(_on(points, normals, centre, normal, band))
    return plane, on


def _level_unless_tilted(around: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the vertical for a plane that is as likely level, else its normal: small patches do not tell a tilt.

    The tilt stays where the squared residual falls by more than an F-test with two degrees of freedom asks for (factor 4,
    95 %), each 8 x 8 cm of the patch counted as one measurement.
    """
    if abs(normal[2]) < NEARLY_LEVEL:
        return normal
    measurements = max(len(around) * CELL**2 / CORRELATED**2, 1.0)
    level, tilted = float(np.mean(around[:, 2] ** 2)), float(np.mean((around @ normal) ** 2))
    return UPRIGHT if level < (1 + 8 / measurements) * tilted else normal


def _within(one: Plane, other: Plane, band: float) -> bool:
    return bool(np.abs(one.heights(other.points)).mean() < band)


def _toward(plane: Plane, place: np.ndarray) -> Plane:
    if place @ plane.normal >= plane.offset:
        return plane
    return replace(plane, normal=-plane.normal, offset=-plane.offset)
