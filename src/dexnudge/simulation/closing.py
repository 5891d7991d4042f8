"""How far the hand closes until the links that are to press touch the object, and no other link is in it.

A configuration's contacts are up to 2 mm from the object; so far, fingers that are only told a force would drift.
"""

from collections.abc import Iterable

import mujoco
import numpy as np
import torch
from jaxtyping import Float

from dexnudge.hands.hand import ROOT_COORDINATES
from dexnudge.simulation.push_model import OBJECT_SIDE, PushModel

LOOK = 0.02  # [m] from the object within which a link is looked at
ITERATIONS = 20
CLOSE_ENOUGH = 5.0e-5  # [m] of every gap
DAMPING = 5.0e-3  # [m] of lever: two segments of one finger may not both reach, and must not tear away a third
BASE_LEVER = 0.02  # [m] the base does what fingers would need more than that many metres per radian for


def closed_configuration(
    push: PushModel, q: Float[np.ndarray, " coordinates"], pressing: Iterable[int]
) -> Float[np.ndarray, " coordinates"]:
    """q moved until the `pressing` links touch the object; damped Gauss-Newton steps of the motors and of the base.

    A motor that two joints share moves both alike. The base keeps its rotation, and moves for the links that the fingers
    would have to turn far for.
    """
    wanted = set(pressing)
    angle_of_motor = push.indices.angle_of_motor
    closed = np.array(q, dtype=np.float64)
    for _ in range(ITERATIONS):
        push.place(closed)
        rows, gaps = [], []
        for link in range(len(push.hand.link_names)):
            gap, towards, point = _gap(push, link)
            if gap < 0 or (link in wanted and gap < LOOK):
                jacobian = push.indices.point_jacobian(push.model, push.data, point, link)
                fingers = towards @ jacobian @ angle_of_motor
                rows.append(np.concatenate([fingers, BASE_LEVER * towards]))
                gaps.append(gap)
        if not gaps or np.abs(gaps).max() < CLOSE_ENOUGH:
            break
        A, b = np.array(rows), np.array(gaps)
        step = np.linalg.solve(A.T @ A + DAMPING**2 * np.eye(A.shape[1]), A.T @ b)
        closed[ROOT_COORDINATES:] += angle_of_motor @ step[:-3]
        closed[:3] += BASE_LEVER * step[-3:]
        closed = push.hand.clamp(torch.as_tensor(closed)[None])[0].numpy()
    return closed


def _gap(push: PushModel, link: int) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Distance from a link to the object [m, negative inside, at most LOOK], direction to it, nearest point of the link."""
    mine = np.flatnonzero(push.model.geom_bodyid == push.indices.link_body[link])
    least, ends = LOOK, np.zeros(6)
    for one in mine:
        for other in np.flatnonzero(push.side == OBJECT_SIDE):
            found = np.zeros(6)
            distance = mujoco.mj_geomDistance(push.model, push.data, int(one), int(other), LOOK, found)
            if distance < least:
                least, ends = float(distance), found
    if least == 0.0 or least >= LOOK:
        return LOOK, np.zeros(3), np.zeros(3)
    return least, (ends[3:] - ends[:3]) / least, ends[:3]
