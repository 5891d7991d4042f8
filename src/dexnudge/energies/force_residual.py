"""How far contact forces are from moving the object along its motion, and where the contacts should go instead.

For each hand the residual of the quasi-static balance is the distance between what contacts and supports can exert and
what the motion needs,

    E = min over 0 <= lambda of  1/2 | A lambda + g |^2 ,   normal force of each link <= its limit,

A the wrenches of the friction cones' edges and of the supports, g gravity's wrench, all in units of the object's
weight, torques over half of the object's length. By the envelope theorem dE/dc = f x r_torque / half_length for a contact
at c with force f: no differentiation of the solver. Solved by cyclic coordinate descent, each coordinate exactly, warm
from the last call. It guides, with one contact per link; verification has a balance of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.geometry.warp_runtime import wp

CONE_EDGES = wp.constant(8)
SMALLEST_COLUMN = wp.constant(1.0e-9)  # squared length under which a column is no contact
SMALLEST_FORCE = 0.01  # [weights of the object] less does not count as a contact's force
SMALLEST_RESIDUAL = wp.constant(1.0e-10)  # squared; further sweeps would change nothing that matters


@dataclass(frozen=True)
class SlidingBalance:
    """What the contacts must do; working frame.

    Attributes:
        centre_of_mass: [m]. half_length: half of the object's longest side [m].
        support_wrenches: (s, 6) wrenches per unit normal force, at the friction that is asked for: one of each support that
            slides, 8 of each that stands.
        gravity: (3,) unit vector. friction_hand: coefficient. max_normal: largest normal force of a link over the weight.
    """

    centre_of_mass: Float[Tensor, " 3"]
    half_length: float
    support_wrenches: Float[Tensor, "s 6"]
    gravity: Float[Tensor, " 3"]
    friction_hand: float
    max_normal: float


Vector6 = wp.types.vector(length=6, dtype=wp.float32)


@wp.func
def contact_wrench(normal: wp.vec3, arm: wp.vec3, friction: float, edge: int) -> Vector6:
    """Return the wrench of one edge of the friction cone about the inward normal, per unit normal force."""
    helper = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal[0]) > 0.7:
        helper = wp.vec3(0.0, 1.0, 0.0)
    one = wp.normalize(wp.cross(normal, helper))
    two = wp.cross(normal, one)
    angle = float(edge) * (2.0 * wp.PI / float(CONE_EDGES))
    force = -normal + friction * (wp.cos(angle) * one + wp.sin(angle) * two)
    torque = wp.cross(arm, force)
    return Vector6(force[0], force[1], force[2], torque[0], torque[1], torque[2])


@wp.func
def sweep(
    i: int,
    r: Vector6,
    columns: wp.array2d(dtype=Vector6),
    multipliers: wp.array2d(dtype=float),
    support: wp.array(dtype=Vector6),
    max_normal: float,
) -> Vector6:
    """Return the residual after each multiplier of hand i has been set to its best, in turn; a link's share one limit."""
    contacts = columns.shape[1] / CONE_EDGES
    for c in range(contacts):
        normal_force = float(0.0)  # noqa: UP018 - declares a variable of Warp
        for edge in range(CONE_EDGES):
            normal_force += multipliers[i, c * CONE_EDGES + edge]
        for edge in range(CONE_EDGES):
            k = c * CONE_EDGES + edge
            column = columns[i, k]
            square = wp.dot(column, column)
            if square > SMALLEST_COLUMN:
                old = multipliers[i, k]
                new = wp.clamp(old - wp.dot(column, r) / square, 0.0, max_normal - normal_force + old)
                r += (new - old) * column
                normal_force += new - old
                multipliers[i, k] = new
    for s in range(support.shape[0]):
        k = columns.shape[1] + s
        old = multipliers[i, k]
        new = wp.max(0.0, old - wp.dot(support[s], r) / wp.dot(support[s], support[s]))
        r += (new - old) * support[s]
        multipliers[i, k] = new
    return r


@wp.kernel(enable_backward=False)
def solve_balance(
    active: wp.array(dtype=int),
    points: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    counts: wp.array2d(dtype=float),
    support: wp.array(dtype=Vector6),
    gravity: wp.vec3,
    centre: wp.vec3,
    half_length: float,
    friction: float,
    max_normal: float,
    sweeps: int,
    columns: wp.array2d(dtype=Vector6),
    multipliers: wp.array2d(dtype=float),
    residual: wp.array(dtype=Vector6),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """One hand: cyclic coordinate descent over cone edges and supports."""
    i = wp.tid()
    if active[i] == 0:
        return
    contacts = points.shape[1]
    supports = support.shape[0]
    r = Vector6(gravity[0], gravity[1], gravity[2], 0.0, 0.0, 0.0)
    for c in range(contacts):
        arm = (points[i, c] - centre) / half_length
        for edge in range(CONE_EDGES):
            k = c * CONE_EDGES + edge
            columns[i, k] = counts[i, c] * contact_wrench(normals[i, c], arm, friction, edge)
            r += multipliers[i, k] * columns[i, k]
    for s in range(supports):
        r += multipliers[i, contacts * CONE_EDGES + s] * support[s]
    for _ in range(sweeps):
        if wp.dot(r, r) < SMALLEST_RESIDUAL:
            break
        r = sweep(i, r, columns, multipliers, support, max_normal)
    residual[i] = r
    torque = wp.vec3(r[3], r[4], r[5])
    for c in range(contacts):
        force = wp.vec3()
        for edge in range(CONE_EDGES):
            k = c * CONE_EDGES + edge
            force += multipliers[i, k] * wp.vec3(columns[i, k][0], columns[i, k][1], columns[i, k][2])
        gradient[i, c] = wp.cross(force, torque) / half_length


def support_wrenches(
    points: Float[Tensor, "s 3"], forces: Float[Tensor, "s 3"], centre_of_mass: Float[Tensor, " 3"], half_length: float
) -> Float[Tensor, "s 6"]:
    """Return the wrenches of the supports' forces at `points` [m]."""
    torque = torch.linalg.cross((points - centre_of_mass) / half_length, forces)
    return torch.cat([forces, torque], dim=1)


class ForceResidual:
    """Solves the balances of a batch of hands; keeps the multipliers between calls.

    Where there are several balances, as of a motion that turns and then slides, each has forces of its own at the same
    contacts, and E is the sum.

    Attributes:
        residual: (batch,) distance to balance [weights of the object]; of several the root of the sum of squares.
        gradient: (batch, contact, 3) of E in the contacts' positions [1/m].
        active: (batch,) as given: a hand with 0 is skipped and keeps the results of its last call.
    """

    def __init__(
        self, balances: Sequence[SlidingBalance], active: Int[Tensor, " batch"], contacts: int, *, device: str = "cpu"
    ) -> None:
        self.active = active
        self._stages = [_Stage(balance, len(active), contacts, device=device) for balance in balances]
        self.gradient = torch.zeros(len(active), contacts, 3, device=device)

    @property
    def residual(self) -> Float[Tensor, " batch"]:
        """Length of the residual wrench [weights of the object]."""
        return self.wrench.flatten(1).norm(dim=1)

    @property
    def wrench(self) -> Float[Tensor, "batch balance 6"]:
        """Residual wrench of each balance [weights of the object]."""
        return torch.stack([stage.residual for stage in self._stages], dim=1)

    @property
    def loaded(self) -> Bool[Tensor, "batch contact"]:
        """Whether a contact carries a force in any of the balances."""
        count = self.gradient.shape[1] * CONE_EDGES
        forces = torch.stack([stage.multipliers[:, :count].unflatten(1, (-1, CONE_EDGES)) for stage in self._stages])
        return forces.sum(dim=3).amax(dim=0) > SMALLEST_FORCE

    def __call__(
        self,
        points: Float[Tensor, "batch contact 3"],
        normals: Float[Tensor, "batch contact 3"],
        counts: Float[Tensor, "batch contact"],
        *,
        sweeps: int,
    ) -> None:
        """Update `residual` and `gradient`; `normals` point out of the object, `counts` is 1 where a contact counts."""
        contacts = (
            wp.from_torch(self.active),
            wp.from_torch(points.contiguous(), dtype=wp.vec3),
            wp.from_torch(normals.contiguous(), dtype=wp.vec3),
            wp.from_torch(counts.contiguous()),
        )
        for stage in self._stages:
            stage.solve(contacts, sweeps=sweeps)
        self.gradient = torch.stack([stage.gradient for stage in self._stages]).sum(dim=0)


class _Stage:
    """One balance of a batch of hands, its multipliers, residual wrenches and gradient."""

    def __init__(self, balance: SlidingBalance, batch: int, contacts: int, *, device: str) -> None:
        columns = contacts * CONE_EDGES
        self.balance, self.device = balance, device
        self.multipliers = torch.zeros(batch, columns + len(balance.support_wrenches), device=device)
        self.residual = torch.zeros(batch, 6, device=device)
        self.gradient = torch.zeros(batch, contacts, 3, device=device)
        self._columns = wp.zeros((batch, columns), dtype=Vector6, device=device)
        self._support = wp.from_torch(balance.support_wrenches.contiguous().to(device), dtype=Vector6)

    def solve(self, contacts: tuple[wp.array, ...], *, sweeps: int) -> None:
        balance = self.balance
        wp.launch(
            solve_balance,
            dim=len(self.residual),
            inputs=[
                *contacts,
                self._support,
                wp.vec3(*balance.gravity.tolist()),
                wp.vec3(*balance.centre_of_mass.tolist()),
                balance.half_length,
                balance.friction_hand,
                balance.max_normal,
                sweeps,
                self._columns,
                wp.from_torch(self.multipliers),
                wp.from_torch(self.residual, dtype=Vector6),
                wp.from_torch(self.gradient, dtype=wp.vec3),
            ],
            device=self.device,
        )
