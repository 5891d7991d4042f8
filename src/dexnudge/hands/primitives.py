"""Basic shapes as closed triangle meshes, inscribed in the true shape and centred on their own frame."""

import numpy as np
import trimesh
from jaxtyping import Float

CIRCLE_SECTIONS = 48  # a circle of radius 10 mm is at most 0.02 mm off its polygon
SPHERE_SUBDIVISIONS = 3  # 1280 faces; a sphere of radius 10 mm is at most 0.07 mm off


def box(size: Float[np.ndarray, " 3"]) -> trimesh.Trimesh:
    """Box of edge lengths `size` [m]."""
    return trimesh.creation.box(extents=size)


def cylinder(radius: float, length: float) -> trimesh.Trimesh:
    """Cylinder about z, from -length/2 to length/2 [m]."""
    return trimesh.creation.cylinder(radius=radius, height=length, sections=CIRCLE_SECTIONS)


def capsule(radius: float, length: float) -> trimesh.Trimesh:
    """Capsule about z: a cylinder from -length/2 to length/2 [m] with half balls on both ends."""
    mesh = trimesh.creation.capsule(radius=radius, height=length, count=[CIRCLE_SECTIONS // 2, CIRCLE_SECTIONS])
    mesh.apply_translation((0.0, 0.0, -mesh.bounds.mean(axis=0)[2]))
    return mesh


def ellipsoid(semi_axes: Float[np.ndarray, " 3"]) -> trimesh.Trimesh:
    """Ellipsoid with the given semi-axes along x, y and z [m]; a sphere where they are equal."""
    mesh = trimesh.creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=1.0)
    mesh.apply_scale(semi_axes)
    return mesh


def sphere(radius: float) -> trimesh.Trimesh:
    """Sphere of the given radius [m]."""
    return ellipsoid(np.full(3, radius))
