"""Forces with which a hand slides an object, chosen so that its motors can make them, and the torques for them.

Many forces balance a sliding object. Chosen are ones that keep away from the edges of the friction cones, with which every
link that touches presses a little, and which fingers with a shared tendon can hold: such a tendon pulls alike on both of its
joints, and only a joint's end stop, or the order of the two joints, can carry a difference. The supports change on the way,
over an edge above all, and gravity turns in the hand as an object tips, so the forces are chosen anew at places along it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.linalg import block_diag
from scipy.optimize import nnls

from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.mechanics.balance import balance_problem, contact_forces
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.friction_cone import EDGE_COUNT, across, pressing
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.planning.object_path import Station
from dexnudge.scenes.support_contacts import SupportContacts
from dexnudge.simulation.model import OBJECT_SIDE, SimulationModel

NEAR = 0.02  # [m] from the object within which a link may be asked to touch it
ITERATIONS = 20
CLOSE_ENOUGH = 5.0e-5  # [m] of every gap
DAMPING = 5.0e-3  # [m] of lever: two segments of one finger may not both reach, and must not tear away a third
BASE_LEVER = 0.02  # [m] the base does what fingers would need more than that many metres per radian for


def closed_configuration(
    simulation: SimulationModel, q: Float[np.ndarray, " coordinates"], pressing: Iterable[int]
) -> Float[np.ndarray, " coordinates"]:
    """Move q until the `pressing` links touch the object, by damped Gauss-Newton steps of the motors and of the base.

    A motor that two joints share moves both alike. The base keeps its rotation, and moves for the links that the fingers
    would have to turn far for.
    """
    wanted = set(pressing)
    angle_of_motor = simulation.angle_of_motor * simulation.motor_scale
    closed = np.array(q, dtype=np.float64)
    for _ in range(ITERATIONS):
        simulation.place(closed)
        rows, gaps = [], []
        for link in range(len(simulation.hand.link_names)):
            gap, towards, point = _gap(simulation, link)
            if gap < 0 or (link in wanted and gap < NEAR):
                jacobian = simulation.point_jacobian(point, link)
                fingers = towards @ jacobian @ angle_of_motor  # [m/rad], also of motors that slide
                rows.append(np.concatenate([fingers, BASE_LEVER * towards]))
                gaps.append(gap)
        if not gaps or np.abs(gaps).max() < CLOSE_ENOUGH:
            break
        A, b = np.array(rows), np.array(gaps)
        step = np.linalg.solve(A.T @ A + DAMPING**2 * np.eye(A.shape[1]), A.T @ b)
        closed[ROOT_COORDINATES:] += angle_of_motor @ step[:-3]
        closed[:3] += BASE_LEVER * step[-3:]
        closed = simulation.hand.clamp(torch.as_tensor(closed)[None])[0].numpy()
    return closed


def _gap(simulation: SimulationModel, link: int) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Return a link's distance to the object [m, at most NEAR], the direction to it, and the nearest point of the link."""
    mine = np.flatnonzero(simulation.model.geom_bodyid == simulation.link_body[link])
    least, ends = NEAR, np.zeros(6)
    for one in mine:
        for other in np.flatnonzero(simulation.side == OBJECT_SIDE):
            found = np.zeros(6)
            distance = mujoco.mj_geomDistance(simulation.model, simulation.data, int(one), int(other), NEAR, found)
            if distance < least:
                least, ends = float(distance), found
    if least == 0.0 or least >= NEAR:
        return NEAR, np.zeros(3), np.zeros(3)
    return least, (ends[3:] - ends[:3]) / least, ends[:3]


CONE_SHARES = (0.5, 0.7, 0.85, 1.0)  # of the hand's friction that the forces use; the first that balances is taken
SURPLUS = 1.4  # times the forces that balance: an object then follows even where its support is rougher than planned
HARDER = 1.5  # times the surroundings' friction: where the reserve takes more links than the one that suffices
UPRIGHT = 0.999  # cosine of the tilt below which an object counts as tipped
PRELOAD = 1.0  # [N] with which every link that touches should press: a finger that rests keeps the object from turning
PINCH = 3.0  # [N] the same of each digit that pulls a tipped object: only friction on its sides holds it
BALANCE = 100.0  # weight of the net wrench against the size of the forces: balance comes first
TENDON = 3.0  # weight of torques that a shared tendon cannot make
PRESSING = 0.5  # weight of the preload
CARRIED = 1.0  # weight of each support force on what is pinched: an object that leans on what stands beside it wedges
LIKENESS = 1.0  # weight of each contact's difference from forces to be near to
EVENNESS = 0.1  # weight of each edge's own size: forces spread over contacts
ROOM = 0.7  # of the limit of a link that is planned for where that balances: the rest is left to control
LEVER = 0.05  # [m] that makes a torque a force in these weights: a finger's segment
UNBALANCED = 0.02  # net wrench over weight up to which forces count as balanced
LEAST_FORCE = 0.2  # [N] below which a link need not touch: a segment beside one that presses would curl its finger
AT_STOP = 0.02  # [rad of `Hand.joint_scales`] from an end stop at which it carries load


@dataclass(frozen=True)
class PushForces:
    """Forces of the hand at places along the push, its beginning and end included.

    Vectors are in axes that turn with the object, and are the world's where the push begins.

    done: share of the push's length that is behind each place. force: on the object per contact [N]. motor_torque: [N m]
    per motor, [N] of one that slides. base_wrench: force [N] and torque about the palm's origin [N m] that the base is to
    press with. cone_share: of the hand's friction that the forces use; 0 where no forces balance at the beginning and the
    hand only holds its place. surplus: by which those that balance were multiplied.
    closing: of each motor until the pressing links touch [rad], sliding ones [m], and base_closing of the base [m].
    link_force: normal force per link [N]. link_torque, link_wrench: torques and wrench that add one newton to it, at the
    beginning; zero for links without contacts. limit: of each link [N]. pinches: whether a tipped object is pulled by them.
    reserve: forces for harder pushes; None where there are none.
    """

    done: Float[np.ndarray, " place"]
    force: Float[np.ndarray, "place contact 3"]
    motor_torque: Float[np.ndarray, "place motor"]
    base_wrench: Float[np.ndarray, "place 6"]
    cone_share: Float[np.ndarray, " place"]
    surplus: Float[np.ndarray, " place"]
    closing: Float[np.ndarray, " motor"]
    base_closing: Float[np.ndarray, " 3"]
    link_force: Float[np.ndarray, "place link"]
    link_torque: Float[np.ndarray, "link motor"]
    link_wrench: Float[np.ndarray, "link 6"]
    limit: float
    pinches: bool = False
    reserve: PushForces | None = None


@dataclass(frozen=True)
class _Pushed:
    """What hand and object bring to every place.

    jacobians: of the contacts' points [m/rad], [m/m] of sliding joints. pinching: contacts `across` the way.
    """

    simulation: SimulationModel
    q: Float[np.ndarray, " coordinates"]
    contacts: HandContacts
    task: SlidingTask
    jacobians: Float[np.ndarray, "contact 3 angle"]
    pinches: bool
    pinching: Bool[np.ndarray, " contact"]


_Found = tuple[Float[np.ndarray, "contact 3"], float]


def forces_with_reserve(
    simulation: SimulationModel,
    q: Float[np.ndarray, " coordinates"],
    contacts: HandContacts,
    stations: Sequence[Station],
    task: SlidingTask,
) -> PushForces:
    """Return `push_forces`, and as their reserve those at `HARDER` times the surroundings' friction.

    There is none where these do not balance all along, nor where the object turns: other links press there than where it
    slides, and those that come to press at once, and hard, hit it.
    """
    planned = push_forces(simulation, q, contacts, stations, task)
    if any(station.twist.angular.any() for station in stations):
        return planned
    harder = replace(task, friction_environment=HARDER * task.friction_environment)
    reserve = push_forces(simulation, q, contacts, stations, harder)
    return replace(planned, reserve=reserve if reserve.cone_share.all() else None)


def push_forces(
    simulation: SimulationModel,
    q: Float[np.ndarray, " coordinates"],
    contacts: HandContacts,
    stations: Sequence[Station],
    task: SlidingTask,
) -> PushForces:
    """Return the forces of the configuration q at places along the push; contacts and task are those where it begins.

    Places the model at q.

    Non-negative least squares over the edges of narrowed friction cones and the supports' normal forces: no net wrench
    while the object moves, little load that tendons cannot hold, a preload on every link, small and even forces; no link
    above the task's largest normal force. Where none balance, the linear program's forces in the whole cone; where there
    are none either, those of the place before. The hand makes more than these, all in proportion, where no link exceeds its
    limit: what it pulls too much its base holds back.
    """
    simulation.place(q)
    pinches = stations[-1].T[2, 2] < UPRIGHT and not stations[-1].twist.angular.any()
    pinching = across(contacts, stations[-1].twist.linear)
    pushed = _Pushed(simulation, q, contacts, task, simulation.contact_jacobians(contacts), bool(pinches), pinching)
    found = _along(pushed, stations)
    share = np.array([share for _, share in found])
    surplus = np.array(
        [  # more than the force that lifts a tipped object throws it
            1.0 if pinches and (station.T[:3, :3] @ each.sum(axis=0))[2] > 0 else _surplus(each, contacts, task)
            for station, (each, _) in zip(stations, found, strict=True)
        ]
    )
    force = surplus[:, None, None] * np.stack([each for each, _ in found])
    load = np.linalg.norm(force, axis=2).max(axis=0)
    pressing = np.flatnonzero(np.bincount(contacts.link, weights=load, minlength=1) > LEAST_FORCE)
    closed = closed_configuration(simulation, q, pressing.tolist())
    link_force, unit = _of_links(pushed, force)
    return PushForces(
        done=np.array([station.done for station in stations]),
        force=force,
        motor_torque=np.stack([_motor_torque(pushed, each) for each in force]),
        base_wrench=_base_wrench(pushed, force),
        cone_share=share,
        surplus=surplus,
        closing=simulation.motor_of_angle @ (closed - q)[ROOT_COORDINATES:],
        base_closing=(closed - q)[:3],
        link_force=link_force,
        link_torque=np.stack([_motor_torque(pushed, each) for each in unit]),
        link_wrench=_base_wrench(pushed, unit),
        limit=task.max_normal_force,
        pinches=pushed.pinches,
    )


def _along(pushed: _Pushed, stations: Sequence[Station]) -> list[_Found]:
    """Return forces at every station, and the share of the cone; those before where nothing balances, zero at the beginning.

    A tip before a slide is made with forces as near as may be to those with which the slide begins: what pulls a tipped
    object pinches it, and fingers that first press and then pinch let go in between.
    """
    nothing = (np.zeros_like(pushed.contacts.points), 0.0)

    def along(stretch: Sequence[Station], like: _Found = nothing) -> list[_Found]:
        found = [like]
        for station in stretch:
            found.append(_chosen(_carried(pushed, station), station, like[0]) or found[-1])
        return found[1:]

    if not pushed.pinches:
        return along(stations)
    turns = next(k for k, station in enumerate(stations) if not station.twist.angular.any())
    slide = along(stations[turns:])
    return along(stations[:turns], slide[0]) + slide


def _carried(pushed: _Pushed, station: Station) -> _Pushed:
    """Return the same with everything where it is at a station."""
    contacts, rotation = pushed.contacts.moved(station.T), station.T[:3, :3]
    jacobians = np.einsum("xy,cya->cxa", rotation, pushed.jacobians)
    return replace(pushed, contacts=contacts, task=station.task(pushed.task), jacobians=jacobians)


def _base_wrench(pushed: _Pushed, force: Float[np.ndarray, "n contact 3"]) -> Float[np.ndarray, "n 6"]:
    return np.concatenate([force, np.cross(pushed.contacts.points - pushed.q[:3], force)], axis=2).sum(axis=1)


def _of_links(
    pushed: _Pushed, force: Float[np.ndarray, "place contact 3"]
) -> tuple[Float[np.ndarray, "place link"], Float[np.ndarray, "link contact 3"]]:
    """Return the normal force of every link [N], and what one newton of it, spread over its contacts, is."""
    contacts = pushed.contacts
    mine = contacts.link == np.arange(len(pushed.simulation.hand.link_names))[:, None]
    normal = -np.einsum("pcx,cx->pc", force, contacts.normals)
    return normal @ mine.T, mine[..., None] * -contacts.normals / np.maximum(mine.sum(axis=1), 1)[:, None, None]


def _surplus(force: Float[np.ndarray, "contact 3"], contacts: HandContacts, task: SlidingTask) -> float:
    """Return `SURPLUS`, or less where a link would press harder than it may."""
    normal = -np.einsum("cx,cx->c", force, contacts.normals)
    hardest = float(np.bincount(contacts.link, weights=normal, minlength=1).max())
    return max(1.0, min(SURPLUS, ROOM * task.max_normal_force / hardest)) if hardest > 0 else 1.0


def _chosen(pushed: _Pushed, station: Station, like: Float[np.ndarray, "contact 3"]) -> _Found | None:
    """Return forces at a station in the axes of the start, and the share of the cone; None if nothing balances.

    Of the contacts that press or push alone, if they can do it well inside their cones: a squeeze that is a little off
    turns the object. like: forces to be near to, of whatever contacts, in the axes of the start; zero where there are none.
    """
    contacts, task, rotation = pushed.contacts, pushed.task, station.T[:3, :3]
    kept = pushed.pinching if pushed.pinches else pressing(contacts, task.twist)
    tries = [(kept, share) for share in CONE_SHARES[:-1]] + [(np.ones_like(kept), share) for share in CONE_SHARES]
    for used, share in tries:
        narrowed = replace(
            task, friction_hand=share * task.friction_hand, max_normal_force=ROOM * task.max_normal_force
        )
        some = replace(
            pushed,
            contacts=contacts.some(used),
            task=narrowed,
            jacobians=pushed.jacobians[used],
            pinching=pushed.pinching[used],
        )
        found = _balanced(some, station.supports, like[used] @ rotation.T)
        if found is not None:
            force = np.zeros_like(contacts.points)
            force[used] = found @ rotation
            return force, share
    solved = contact_forces(contacts, station.supports, task)
    return None if solved is None else (solved.hand @ rotation, 1.0)


def _balanced(
    pushed: _Pushed, supports: SupportContacts, like: Float[np.ndarray, "contact 3"]
) -> Float[np.ndarray, "contact 3"] | None:
    contacts, task = pushed.contacts, pushed.task
    problem = balance_problem(contacts, supports, task)
    if problem.blocked or len(contacts.points) == 0:
        return None
    edges, hand = np.ascontiguousarray(problem.hand[..., :3]), problem.hand.reshape(-1, 6)
    support = problem.support_normal + problem.support_friction
    mismatch, slack = _tendon_rows(pushed, np.einsum("cxa,ckx->cka", pushed.jacobians, edges).reshape(len(hand), -1))
    count, others = len(hand), len(support) + slack.shape[1]
    links = np.repeat(problem.link, EDGE_COUNT)
    of_link = (links == np.arange(problem.link.max() + 1)[:, None]).astype(float)
    if like.any():
        near, size = LIKENESS * block_diag(*edges.transpose(0, 2, 1)), LIKENESS / task.weight * like.ravel()
    else:
        preload = PINCH / _beside(pushed) if pushed.pinches else np.full(len(of_link), PRELOAD)
        near, size = PRESSING * of_link, PRESSING / task.weight * preload
    carried = CARRIED * np.eye(len(support) if pushed.pinches else 0, count + others, count)
    rows = np.concatenate(
        [
            BALANCE * np.concatenate([hand.T, support.T, np.zeros((6, slack.shape[1]))], axis=1),
            TENDON / LEVER * np.concatenate([mismatch, np.zeros((len(mismatch), len(support))), slack], axis=1),
            EVENNESS * np.eye(count, count + others),
            carried,
            np.pad(near, ((0, 0), (0, others))),
        ]
    )
    wanted = np.concatenate([-BALANCE * problem.load, np.zeros(len(rows) - 6 - len(size)), size])
    capped: set[int] = set()
    while True:
        size, _ = nnls(rows, wanted)
        if np.linalg.norm(rows[:6] @ size - wanted[:6]) > BALANCE * UNBALANCED:
            return None
        load = np.bincount(links, weights=size[:count])
        over = {int(link) for link in np.flatnonzero(load > problem.cap * (1 + UNBALANCED))} - capped
        if not over:
            force = np.einsum("ck,ckx->cx", size[:count].reshape(-1, EDGE_COUNT), edges)
            return np.asarray(force * task.weight)
        capped |= over
        for link in sorted(over):  # a link above its limit is held at it
            row = np.concatenate([BALANCE * (links == link), np.zeros(others)])
            rows, wanted = np.concatenate([rows, row[None]]), np.append(wanted, BALANCE * problem.cap)


def _beside(pushed: _Pushed) -> Int[np.ndarray, " link"]:
    """Return of each link that touches how many of its digit do, of which one alone may come to press; 1 of a palm."""
    hand = pushed.simulation.hand
    names = [hand.link_names[link] for link in np.unique(pushed.contacts.link)]
    digits = np.array([hand.digit_of_link[name] or name for name in names])
    return (digits == digits[:, None]).sum(axis=1)


def _tendon_rows(
    pushed: _Pushed, torque: Float[np.ndarray, "edge angle"]
) -> tuple[Float[np.ndarray, "pair edge"], Float[np.ndarray, "pair slack"]]:
    """Return the follower's minus the leader's torque per edge [N m per unit force], and what joint stops take."""
    pairs = pushed.simulation.hand.coupled_indices
    torque = torque * pushed.simulation.hand.joint_scales
    mismatch = (torque[:, pairs[:, 0]] - torque[:, pairs[:, 1]]).T
    straight, together = _stops(pushed.simulation.hand, pushed.q)
    slack = np.concatenate([-np.diag(straight.astype(float)), np.diag(together.astype(float))], axis=1)
    return mismatch, slack[:, np.abs(slack).sum(axis=0) > 0] * LEVER


def _stops(hand: Hand, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return per coupled pair whether the follower is at its lower stop, and whether it is as far as its leader."""
    angles, pairs = q[ROOT_COORDINATES:], hand.coupled_indices
    follower, leader = angles[pairs[:, 0]], angles[pairs[:, 1]]
    near = AT_STOP * hand.joint_scales[pairs[:, 0]]
    return follower < hand.lower[pairs[:, 0]] + near, follower > leader - near


def _motor_torque(pushed: _Pushed, force: np.ndarray) -> np.ndarray:
    """Return J^T f per motor; of a shared tendon the joints' mean, or the leader's where a stop carries its follower."""
    simulation, torque = pushed.simulation, np.einsum("cxa,cx->a", pushed.jacobians, force)
    motors = simulation.motor_of_angle
    found = torque @ simulation.angle_of_motor
    for (follower, leader), straight in zip(
        simulation.hand.coupled_indices, _stops(simulation.hand, pushed.q)[0], strict=True
    ):
        if straight and torque[follower] > torque[leader]:
            found[motors[:, leader] > 0] = torque[leader]
    return np.asarray(found)
