"""How far contact forces are from moving the object along its motion, and where the contacts should go instead.

For each hand the residual of the quasi-static balance is the distance between what contacts and supports can exert and
what the motion needs,

    E = min over 0 <= lambda of  1/2 | A lambda + g |^2 ,   normal force of each link <= its limit,

A the wrenches of the friction cones' edges and of the supports, g gravity's wrench, all in units of the object's
weight, torques over half of the object's length. By the envelope theorem dE/dc = f x r_torque / half_length for a contact
at c with force f: no differentiation of the solver. Solved by cyclic coordinate descent with over-relaxation (projected
SOR), warm from the last call. It guides, with one contact per link; verification has a balance of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.geometry.warp_runtime import WarpStruct, wp

CONE_EDGES = wp.constant(8)
RELAXATION = wp.constant(1.5)  # of a coordinate's step; at 1 each is set to its best, above 1 fewer sweeps do
SMALLEST_COLUMN = wp.constant(1.0e-9)  # squared length under which a column is no contact
SMALLEST_FORCE = 0.01  # [weights of the object] less does not count as a contact's force
SMALLEST_RESIDUAL = wp.constant(1.0e-8)  # squared; further sweeps would change nothing that matters


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
    inverse: wp.array2d(dtype=float),
    multipliers: wp.array2d(dtype=float),
    support: wp.array(dtype=Vector6),
    max_normal: float,
) -> Vector6:
    """Return the residual after a step of each multiplier of hand i in turn; a link's share one limit."""
    contacts = columns.shape[1] / CONE_EDGES
    for c in range(contacts):
        normal_force = float(0.0)  # noqa: UP018 - declares a variable of Warp
        for edge in range(CONE_EDGES):
            normal_force += multipliers[i, c * CONE_EDGES + edge]
        for edge in range(CONE_EDGES):
            k = c * CONE_EDGES + edge
            if inverse[i, k] > 0.0:
                column = columns[i, k]
                old = multipliers[i, k]
                new = wp.clamp(
                    old - RELAXATION * wp.dot(column, r) * inverse[i, k], 0.0, max_normal - normal_force + old
                )
                r += (new - old) * column
                normal_force += new - old
                multipliers[i, k] = new
    for s in range(support.shape[0]):
        k = columns.shape[1] + s
        old = multipliers[i, k]
        new = wp.max(0.0, old - RELAXATION * wp.dot(support[s], r) * inverse[i, k])
        r += (new - old) * support[s]
        multipliers[i, k] = new
    return r


@wp.struct
class Contacts:
    """Contacts of a batch of hands, and what the balance does to them."""

    links: wp.array(dtype=int)  # (C,) columns of the arrays below that may touch
    points: wp.array2d(dtype=wp.vec3)  # (B, L) [m]
    normals: wp.array2d(dtype=wp.vec3)  # (B, L) out of the object
    wanted: wp.array2d(dtype=float)  # (B, L) above 0 where a contact counts
    pull: wp.array2d(dtype=wp.vec3)  # (B, L) gradient times `pull_weight`
    pull_weight: float


@wp.struct
class Balance:
    """One balance, the multipliers of a batch of hands, and what came of it."""

    support: wp.array(dtype=Vector6)
    gravity: wp.vec3
    centre: wp.vec3
    half_length: float
    friction: float
    max_normal: float
    is_first: int  # 1 where `square` and `gradient` begin with this balance, 0 where it adds to them
    columns: wp.array2d(dtype=Vector6)  # (B, 8 C)
    inverse: wp.array2d(dtype=float)  # (B, 8 C + supports) of the squared lengths; 0 where there is no contact
    multipliers: wp.array2d(dtype=float)  # (B, 8 C + supports)
    residual: wp.array(dtype=Vector6)  # (B,)
    square: wp.array(dtype=float)  # (B,) of the residuals of all balances
    gradient: wp.array2d(dtype=wp.vec3)  # (B, C) of all balances


@wp.kernel(enable_backward=False)
def solve_balance(
    contacts: Contacts, balance: Balance, active: wp.array(dtype=int), sweeps: int, rows: wp.array(dtype=int)
):
    """One hand: cyclic coordinate descent over cone edges and supports."""
    i = rows[wp.tid()]
    if active[i] == 0:
        return
    count = contacts.links.shape[0]
    supports = balance.support.shape[0]
    gravity = balance.gravity
    r = Vector6(gravity[0], gravity[1], gravity[2], 0.0, 0.0, 0.0)
    for c in range(count):
        link = contacts.links[c]
        counts = wp.where(contacts.wanted[i, link] > 0.0, 1.0, 0.0)
        arm = (contacts.points[i, link] - balance.centre) / balance.half_length
        for edge in range(CONE_EDGES):
            k = c * CONE_EDGES + edge
            column = counts * contact_wrench(contacts.normals[i, link], arm, balance.friction, edge)
            square = wp.dot(column, column)
            balance.columns[i, k] = column
            balance.inverse[i, k] = wp.where(square > SMALLEST_COLUMN, 1.0 / square, 0.0)
            r += balance.multipliers[i, k] * column
    for s in range(supports):
        r += balance.multipliers[i, count * CONE_EDGES + s] * balance.support[s]
    for _ in range(sweeps):
        if wp.dot(r, r) < SMALLEST_RESIDUAL:
            break
        r = sweep(i, r, balance.columns, balance.inverse, balance.multipliers, balance.support, balance.max_normal)
    balance.residual[i] = r
    kept = wp.where(balance.is_first > 0, 0.0, 1.0)
    balance.square[i] = kept * balance.square[i] + wp.dot(r, r)
    torque = wp.vec3(r[3], r[4], r[5])
    for c in range(count):
        force = wp.vec3()
        for edge in range(CONE_EDGES):
            column = balance.columns[i, c * CONE_EDGES + edge]
            force += balance.multipliers[i, c * CONE_EDGES + edge] * wp.vec3(column[0], column[1], column[2])
        gradient = kept * balance.gradient[i, c] + wp.cross(force, torque) / balance.half_length
        balance.gradient[i, c] = gradient
        contacts.pull[i, contacts.links[c]] = contacts.pull_weight * gradient


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
        square: (batch,) squared distance to balance [weights of the object, squared]; of several the sum.
        wrench: (batch, balance, 6) residual of each [weights of the object].
        gradient: (batch, contact, 3) of E in the contacts' positions [1/m].
        active: (batch,) as given: a hand with 0 is skipped and keeps the results of its last call.
    """

    def __init__(
        self, balances: Sequence[SlidingBalance], active: Int[Tensor, " batch"], contacts: int, *, device: str = "cpu"
    ) -> None:
        batch, columns = len(active), contacts * CONE_EDGES
        wp.load_module(solve_balance.module, device=device)  # loading is not safe from several threads
        self.active, self.device = active, device
        self.square = torch.zeros(batch, device=device)
        self.gradient = torch.zeros(batch, contacts, 3, device=device)
        self.wrench = torch.zeros(batch, len(balances), 6, device=device)
        self._multipliers = [
            torch.zeros(batch, columns + len(each.support_wrenches), device=device) for each in balances
        ]
        self._active = wp.from_torch(active)
        self._balances = []
        for place, (balance, multipliers) in enumerate(zip(balances, self._multipliers, strict=True)):
            packed = Balance()
            support = balance.support_wrenches.contiguous().to(device)
            packed.support = wp.from_torch(support, dtype=Vector6)
            packed.inverse = wp.from_torch(
                torch.cat([multipliers[:, :columns], support.square().sum(dim=1).reciprocal().expand(batch, -1)], dim=1)
            )
            packed.gravity = wp.vec3(*balance.gravity.tolist())
            packed.centre = wp.vec3(*balance.centre_of_mass.tolist())
            packed.half_length, packed.friction = balance.half_length, balance.friction_hand
            packed.max_normal, packed.is_first = balance.max_normal, int(place == 0)
            packed.columns = wp.zeros((batch, columns), dtype=Vector6, device=device)
            packed.multipliers = wp.from_torch(multipliers)
            packed.residual = wp.from_torch(self.wrench[:, place], dtype=Vector6)
            packed.square, packed.gradient = wp.from_torch(self.square), wp.from_torch(self.gradient, dtype=wp.vec3)
            self._balances.append(packed)

    @property
    def residual(self) -> Float[Tensor, " batch"]:
        """Length of the residual wrench [weights of the object]."""
        return self.square.sqrt()

    @property
    def loaded(self) -> Bool[Tensor, "batch contact"]:
        """Whether a contact carries a force in any of the balances."""
        count = self.gradient.shape[1] * CONE_EDGES
        forces = torch.stack([each[:, :count].unflatten(1, (-1, CONE_EDGES)) for each in self._multipliers])
        return forces.sum(dim=3).amax(dim=0) > SMALLEST_FORCE

    def launches(self, contacts: WarpStruct, rows: wp.array, *, sweeps: int) -> list[wp.Launch]:
        """Return launches, in their order, that solve the balances at the `Contacts` of the hands `rows`.

        They update the attributes from where the multipliers are.
        """
        return [
            wp.launch(
                solve_balance,
                dim=len(rows),
                inputs=[contacts, balance, self._active, sweeps, rows],
                device=self.device,
                record_cmd=True,
            )
            for balance in self._balances
        ]
