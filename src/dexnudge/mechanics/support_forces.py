"""The forces with which what carries an object can act on it while it moves."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from dexnudge.mechanics.friction_cone import EDGE_COUNT, friction_cone_edges
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.scenes.support_contacts import MOTION_TOLERANCE, PIVOT_SPEED, SupportContacts


def support_forces(
    supports: SupportContacts, task: SlidingTask
) -> tuple[Float[np.ndarray, "column 3"], Float[np.ndarray, "column 3"], Int[np.ndarray, "column"], bool]:
    """Return unit normal forces, the friction at them, whose they are, and whether a support blocks the motion."""
    velocity = task.twist.velocity(supports.points)
    approach = (supports.normals * velocity).sum(axis=1)
    stands = np.linalg.norm(velocity, axis=1) <= PIVOT_SPEED
    axis = task.twist.angular / max(float(np.linalg.norm(task.twist.angular)), np.finfo(float).tiny)
    carries = np.flatnonzero(stands | (np.abs(approach) <= MOTION_TOLERANCE))
    normals, friction, support = [], [], []
    for index in carries:
        normal = supports.normals[index]
        if stands[index]:
            cone = friction_cone_edges(-normal[None], axis, friction=task.friction_environment)[0]
            friction.extend(cone - normal)
        else:
            slip = velocity[index] - approach[index] * normal
            friction.append(-task.friction_environment * slip / np.linalg.norm(slip))
        repeated = EDGE_COUNT if stands[index] else 1
        normals += [normal] * repeated
        support += [index] * repeated
    blocked = bool(np.any((approach < -MOTION_TOLERANCE) & ~stands))
    return np.reshape(normals, (-1, 3)), np.reshape(friction, (-1, 3)), np.array(support, dtype=np.int64), blocked
