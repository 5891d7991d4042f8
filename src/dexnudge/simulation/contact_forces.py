"""Contact forces of a simulation at its present step."""

import mujoco
import numpy as np
from jaxtyping import Float, Int

from dexnudge.simulation.model import HAND_SIDE, OBJECT_SIDE, SimulationModel


def pair_sides(simulation: SimulationModel) -> Int[np.ndarray, " contact"]:
    """Return the two sides of each current contact, as the sum of their bits."""
    geoms = np.asarray(simulation.data.contact.geom).reshape(-1, 2)
    return np.asarray(simulation.side[geoms].sum(axis=1))


def normal_forces(simulation: SimulationModel) -> Float[np.ndarray, " contact"]:
    """Return the normal force of each current contact [N], as `mj_contactForce` does.

    Elliptic cones have it in the first row of their constraint; pyramidal ones as the sum over their edges.
    """
    data = simulation.data
    first = np.asarray(data.contact.efc_address)
    if simulation.model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL:
        dimensions = np.asarray(data.contact.dim)
        until = np.concatenate([[0.0], np.cumsum(data.efc_force)])
        force = until[first + np.where(dimensions > 1, 2 * (dimensions - 1), 1)] - until[first]
    else:
        force = np.append(data.efc_force, 0.0)[first]
    return np.where(first >= 0, force, 0.0)


def link_forces(simulation: SimulationModel) -> Float[np.ndarray, " link"]:
    """Return the sum of each hand link's normal forces on the object [N]."""
    found = np.zeros(len(simulation.link_body))
    if simulation.data.ncon:
        on_object = pair_sides(simulation) == HAND_SIDE + OBJECT_SIDE
        geoms = np.asarray(simulation.data.contact.geom).reshape(-1, 2)[on_object]
        np.add.at(found, simulation.link_of_geom[geoms].max(axis=1), normal_forces(simulation)[on_object])
    return found


def contact_force_sums(simulation: SimulationModel, one: int, other: int) -> Float[np.ndarray, " 2"]:
    """Return the sums over the contacts between two sides of (normal force, size of the tangential force) [N]."""
    sums, force = np.zeros(2), np.zeros(6)
    if simulation.data.ncon:
        for index in np.flatnonzero(pair_sides(simulation) == one + other):
            mujoco.mj_contactForce(simulation.model, simulation.data, int(index), force)
            sums += force[0], np.hypot(force[1], force[2])
    return sums
