"""Nominal masses and motor limits of exported hands: descriptions often lack them, and nothing that is judged uses them."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

DENSITY = 1000.0  # [kg/m^3] plastic housing with motors; gives the Shadow Hand's fingers their published 10-20 g
MIN_MASS = 0.002  # [kg] of links without geometry, as the Shadow model in gymnasium-robotics has it
MIN_INERTIA = 1.0e-6  # [kg m^2] keeps small links stable at time steps of some milliseconds
JOINT_EFFORT = 2.0  # [N m] Shadow Robot's published URDF
JOINT_VELOCITY = 2.0  # [rad/s] Shadow Robot's published URDF
JOINT_DAMPING = 0.1  # [N m s/rad] the Shadow model in gymnasium-robotics
JOINT_ARMATURE = 0.001  # [kg m^2] the Shadow model in gymnasium-robotics
POSITION_GAIN = 5.0  # [N m/rad] 5 N at a fingertip 0.1 m away for an error of 0.1 rad


@dataclass(frozen=True)
class BodyInertia:
    """Mass [kg], centre of mass [m, link frame], moments of inertia about it along the link's axes [kg m^2]."""

    mass: float
    centre: Float[np.ndarray, " 3"]
    diagonal: Float[np.ndarray, " 3"]


def body_inertia(mesh: trimesh.Trimesh) -> BodyInertia:
    """Return the inertia of a box as large as the mesh's bounding box, with the mass of its convex hull."""
    if len(mesh.faces) == 0:
        return BodyInertia(MIN_MASS, np.zeros(3), np.full(3, MIN_INERTIA))
    mass = max(MIN_MASS, DENSITY * mesh.convex_hull.volume)
    squares = np.asarray(mesh.extents) ** 2
    return BodyInertia(mass, mesh.bounds.mean(axis=0), np.maximum(MIN_INERTIA, mass / 12 * (squares.sum() - squares)))
