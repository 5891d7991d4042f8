"""How well an arm can carry a hand along a way: far from its joints' limits and from where it cannot move freely."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from dexnudge.arms.inverse_kinematics import LEVER, InverseKinematics

STARTS = 8  # of inverse kinematics at contact: they solve 99.8 % of the poses that a Panda reaches
STEPS = 10  # of inverse kinematics from one station to the next
LARGEST_TURN = 30.0  # [rad/m] of a joint by the flange's way: more is a jump to another branch
FREELY = 0.1  # [m/rad] smallest singular value from which on the flange moves freely: 0.1 m/s ask 1 rad/s of a joint
ROWS = 20_000  # of a batch: some 30 MB
Blocked = Callable[[Float[np.ndarray, "row n"], Int[np.ndarray, " row"]], Bool[np.ndarray, " row"]] | None


@dataclass(frozen=True)
class ArmMargins:
    """What the best branch of each way keeps.

    margin: in [0, 1], the least along the way of the joints' distance to their limits, as a share of half a range, and of
    the flange Jacobian's smallest singular value, as a share of `FREELY`; 0 where no branch leads along the whole way.
    contact: whether the arm reaches contact at all.
    """

    margin: Float[np.ndarray, " way"]
    contact: Bool[np.ndarray, " way"]


def arm_margins(
    kinematics: InverseKinematics,
    before: Float[np.ndarray, "way early 4 4"],
    after: Float[np.ndarray, "way late 4 4"],
    *,
    starts: int = STARTS,
    blocked: Blocked = None,
) -> ArmMargins:
    """Return the margins of ways of the flange, T_world_flange; each solution at contact is followed from there.

    before: from contact to where the hand comes from. after: from contact to where it ends. blocked: tells at which joint
    angles, of which ways, the arm cannot be; asked at contact and at both ends.
    """
    contact, own = after[:, 0], kinematics.starts(starts)
    margin, reached = np.zeros(len(contact)), np.zeros(len(contact), dtype=bool)
    for rows in np.array_split(np.arange(len(contact)), max(1, len(contact) * starts // ROWS)):
        found = kinematics.solve_all(np.repeat(contact[rows], starts, axis=0), np.tile(own, (len(rows), 1)))
        way, branches = np.repeat(rows, starts)[found.solved], found.positions[found.solved]
        reached[way] = True
        if blocked:
            free = ~blocked(branches, way)
            way, branches = way[free], branches[free]
        kept = _margins(kinematics, branches)
        for stations in (before, after):
            kept = np.minimum(kept, _followed(kinematics, stations, way, branches, blocked))
        np.maximum.at(margin, way, kept)
    return ArmMargins(margin, reached)


def _followed(
    kinematics: InverseKinematics,
    ways: Float[np.ndarray, "way station 4 4"],
    way: Int[np.ndarray, " row"],
    start: Float[np.ndarray, "row n"],
    blocked: Blocked,
) -> Float[np.ndarray, " row"]:
    """Return the least margin of each branch behind the first station; 0 where it ends, or is blocked at the last."""
    positions, rows, kept, stations = start, np.arange(len(start)), np.ones(len(start)), ways[way]
    for before, after in zip(stations.swapaxes(0, 1), stations.swapaxes(0, 1)[1:], strict=False):
        found = kinematics.solve_all(after[rows], positions, most_steps=STEPS)
        far = np.linalg.norm(after[rows, :3, 3] - before[rows, :3, 3], axis=1)
        smooth = np.abs(found.positions - positions).max(axis=1) <= LARGEST_TURN * far
        on = found.solved & smooth
        kept[rows[~on]] = 0.0
        rows, positions = rows[on], found.positions[on]
        kept[rows] = np.minimum(kept[rows], _margins(kinematics, positions))
    if blocked:
        kept[rows[blocked(positions, way[rows])]] = 0.0
    return kept


def _margins(kinematics: InverseKinematics, positions: Float[np.ndarray, "row n"]) -> Float[np.ndarray, " row"]:
    """Return the margin at joint angles."""
    jacobian = kinematics.chain.flange(positions).jacobian
    jacobian[:, 3:] *= LEVER
    smallest = np.linalg.svd(jacobian, compute_uv=False).min(axis=1, initial=np.inf)
    return np.clip(np.minimum(kinematics.arm.limits.room(positions), smallest / FREELY), 0.0, 1.0)
