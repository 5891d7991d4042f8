"""Forces with which a hand squeezes an object without moving it, and the motor torques that make them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.friction_cone import EDGE_COUNT, UP, friction_cone_edges, wrenches
from dexnudge.simulation.model import GRASP_FRICTION, SimulationModel

SQUEEZE = 14.0  # [N] wanted sum of all normal forces, before the limit per link
STRONGEST_LINK = 5.0  # [N] normal force of one link; what a tendon-driven finger holds continuously
BALANCE = 100.0  # weight of the net wrench against the sum of the forces: balance comes first
EVENNESS = 0.1  # weight of each edge's own size: forces spread over contacts and keep to the middle of their cones


@dataclass(frozen=True)
class Squeeze:
    """Contact forces on the object [N] whose net wrench is nearly zero, and the motor torques that make them.

    force: per contact, in the frame of the contacts. motor_torque: [N m] per motor of the model.
    """

    force: Float[np.ndarray, "contact 3"]
    motor_torque: Float[np.ndarray, " motor"]


def squeeze(
    simulation: SimulationModel, contacts: HandContacts, *, half_length: float, friction: float = GRASP_FRICTION
) -> Squeeze:
    """Return the squeeze of the grasp at which `simulation` was placed, with forces inside cones of this `friction`.

    Non-negative least squares over the edges of the contacts' friction pyramids: no net wrench first (torques over
    `half_length` [m]), then a sum of normal forces near SQUEEZE, then evenly spread; scaled down until no link presses
    harder than STRONGEST_LINK. A force f of the hand at a contact takes the joint torques J^T f; a motor that two
    joints share takes the mean of theirs, since its tendon pulls on both alike.
    """
    edges = friction_cone_edges(contacts.normals, UP, friction=friction)
    centre = np.array(simulation.data.xipos[simulation.object_body])
    wrench = wrenches(contacts.points[:, None], edges, centre=centre, half_length=half_length).reshape(-1, 6)
    count = len(wrench)
    rows = np.concatenate([BALANCE * wrench.T, np.ones((1, count)), EVENNESS * np.eye(count)])
    wanted = np.zeros(len(rows))
    wanted[6] = SQUEEZE
    size, _ = nnls(rows, wanted)
    strongest = np.bincount(np.repeat(contacts.link, EDGE_COUNT), weights=size).max()
    size *= min(1.0, STRONGEST_LINK / max(strongest, STRONGEST_LINK))
    force = np.einsum("ck,ckx->cx", size.reshape(-1, EDGE_COUNT), edges)
    torque = np.einsum("cxa,cx->a", simulation.contact_jacobians(contacts), force)
    return Squeeze(force=force, motor_torque=torque @ simulation.angle_of_motor)
