"""An MJCF's equalities and motors as couplings of a hand's joints: which joint follows which, and which share a motor."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
from scipy.sparse.csgraph import connected_components

from dexnudge.errors import HandError
from dexnudge.hands.config import HandConfig
from dexnudge.hands.loops.closing import FULL_TURN, LOOPS, Equalities, Loop, ends, limits_of, motor_dofs
from dexnudge.hands.loops.fit import SolvedLoop, most_error, size_text, solve_loop, straight_line
from dexnudge.hands.tree import Mimic, Tree, TreeJoint, locked

CURVE_SAMPLES = 101  # of the leader's range, for a joint that follows it along a curve
LEAST_OFFSET = 1e-4  # [rad or m] of a line, that is printed
NARROWED = 1e-6  # [rad or m] less of a range is said


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name, or the one that a nameless joint gets."""
    return model.joint(joint).name or f"joint{joint}"


def coupled(tree: Tree, model: mujoco.MjModel, config: HandConfig) -> tuple[Tree, HandConfig]:
    """Return the tree with the joints that the model's equalities tie together as followers, and the config with its pairs.

    Raises:
        HandError: a loop or an equality that joints following one another along straight lines cannot stand for.
    """
    by_name = {joint_name(model, joint): joint for joint in range(model.njnt)}
    kept = _from_the_palm(tree, config.palm, by_name)
    if not kept:
        return tree, config
    equalities = Equalities(model)
    concerned = [set(model.dof_jntid[row].tolist()) for row in equalities.dofs()]
    notes = [
        f"{_title(model, [equality])} ties the hand to what is outside of it: left out"
        for equality, joints in enumerate(concerned)
        if joints & set(kept) and not joints <= set(kept)
    ]
    inner = [equality for equality, joints in enumerate(concerned) if joints and joints <= set(kept)]
    driven = motor_dofs(model)
    motors = [[joint for joint in kept if joint in model.dof_jntid[row]] for row in driven]
    moved = {joint for joints in motors for joint in joints}
    change = _Change(model, {joint.name: joint for joint in tree.joints}, notes)
    for group in _groups(inner, concerned):
        loop = Loop(
            tuple(joint for joint in kept if any(joint in concerned[equality] for equality in group)),
            tuple(group),
            _title(model, group),
        )
        if not change.follow_curves(group):
            change.follow_loop(solve_loop(equalities, loop, [joint for joint in loop.joints if joint in moved]))
    pairs = _ordered_by_tendons(model, kept)
    couplings = (*config.couplings, *(pair for pair in pairs if pair not in config.couplings))
    couplings = tuple(pair for pair in couplings if pair in config.couplings or change.are_free(pair))
    change.tell_shared_motors(motors, couplings)
    joints = tuple(change.joints[joint.name] for joint in tree.joints)
    return replace(tree, joints=joints, notes=(*tree.notes, *notes)), replace(config, couplings=couplings)


def _from_the_palm(tree: Tree, palm: str, by_name: dict[str, int]) -> list[int]:
    """Return the model's numbers of the tree's movable joints, the nearest to the palm first."""
    beside: dict[str, list[TreeJoint]] = {link: [] for link in tree.links}
    for joint in tree.joints:
        beside[joint.parent].append(joint)
        beside[joint.child].append(joint)
    order, seen, links = [], {palm}, [palm]
    for link in links:
        for joint in beside[link]:
            for other in {joint.parent, joint.child} - seen:
                seen.add(other)
                links.append(other)
                if not joint.fixed and joint.name in by_name:
                    order.append(by_name[joint.name])
    return order


def _groups(equalities: list[int], concerned: list[set[int]]) -> list[list[int]]:
    """Return the equalities that concern the same joints, together."""
    if not equalities:
        return []
    share = [[bool(concerned[one] & concerned[other]) for other in equalities] for one in equalities]
    count, label = connected_components(np.asarray(share))
    return [[equality for equality, mine in zip(equalities, label, strict=True) if mine == k] for k in range(count)]


def _title(model: mujoco.MjModel, group: Sequence[int]) -> str:
    """Return what equalities are called in messages: a loop by the bodies that it joins."""
    pairs = []
    for equality in group:
        if model.eq_type[equality] in [int(kind) for kind in LOOPS]:
            one, other = (model.body(body).name or f"body{body}" for body in ends(model, equality))
            pairs.append(f"'{one}'-'{other}'")
    names = [
        f"'{model.equality(equality).name}'" if model.equality(equality).name else str(equality) for equality in group
    ]
    return f"loop {', '.join(pairs)}" if pairs else f"equality {', '.join(names)}"


def _ordered_by_tendons(model: mujoco.MjModel, kept: list[int]) -> list[tuple[str, str]]:
    """Return the pairs (follower, leader) of joints whose difference a tendon holds below zero."""
    pairs = []
    for tendon in range(model.ntendon):
        first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        wraps = slice(first, first + count)
        if count != 2 or (model.wrap_type[wraps] != mujoco.mjtWrap.mjWRAP_JOINT).any():
            continue
        (one, other), (a, b) = model.wrap_objid[wraps].tolist(), model.wrap_prm[wraps].tolist()
        if model.tendon_limited[tendon] and a == -b and one in kept and other in kept:
            low, high = model.tendon_range[tendon] / a
            if max(low, high) == 0.0:
                pairs.append((joint_name(model, one), joint_name(model, other)))
            elif min(low, high) == 0.0:
                pairs.append((joint_name(model, other), joint_name(model, one)))
    return pairs


class _Change:
    """The tree's joints while equalities make followers of them, and what there is to say about it."""

    def __init__(self, model: mujoco.MjModel, joints: dict[str, TreeJoint], notes: list[str]) -> None:
        self.model, self.joints, self.notes = model, joints, notes

    def are_free(self, names: Sequence[str]) -> bool:
        """Whether all of these joints are independent."""
        return all(not self.joints[name].fixed and self.joints[name].mimic is None for name in names)

    def follow_curves(self, group: list[int]) -> bool:
        """Make followers of the joints of `<joint>` equalities; False where these do more than name a leader for each."""
        model = self.model
        if (model.eq_type[group] != mujoco.mjtEq.mjEQ_JOINT).any():
            return False
        leader_of = {int(model.eq_obj1id[equality]): int(model.eq_obj2id[equality]) for equality in group}
        if len(leader_of) < len(group) or any(self._returns(joint, leader_of) for joint in leader_of):
            return False
        for equality in group:
            self._follow_curve(
                int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality]), model.eq_data[equality, :5]
            )
        return True

    @staticmethod
    def _returns(joint: int, leader_of: dict[int, int]) -> bool:
        seen = {joint}
        while (joint := leader_of.get(joint, -1)) >= 0:
            if joint in seen:
                return True
            seen.add(joint)
        return False

    def _follow_curve(self, follower: int, leader: int, coefficients: np.ndarray) -> None:
        """angle - zero = c0 + c1 x + c2 x^2 + ..., x = leader's angle - its zero."""
        model, name = self.model, joint_name(self.model, follower)
        zero = float(model.qpos0[model.jnt_qposadr[follower]])
        if leader < 0:
            value = zero + float(coefficients[0])
            self.joints[name] = locked(self.joints[name], value)
            self.notes.append(
                f"an equality holds joint '{name}' at {size_text(self.model, follower, value)}: it is fixed"
            )
            return
        leads = joint_name(model, leader)
        leader_zero = float(model.qpos0[model.jnt_qposadr[leader]])
        if not coefficients[2:].any():
            slope = float(coefficients[1])
            offset = float(zero + coefficients[0] - slope * leader_zero)
        else:
            lower, upper = limits_of(model, FULL_TURN)[:, leader]
            angles = np.linspace(lower, upper, CURVE_SAMPLES)
            curve = zero + np.polynomial.polynomial.polyval(angles - leader_zero, coefficients)
            line = straight_line(angles, curve, leader)
            if line.error > most_error(self.model, follower):
                most = size_text(model, follower, most_error(model, follower))
                raise HandError(
                    f"joint '{name}' follows '{leads}' along a curve: expected one within {most} of a straight line, got "
                    f"polycoef {coefficients.tolist()}, up to {size_text(model, follower, line.error)} off; narrow "
                    f"the range of '{leads}', or give the last three coefficients as 0"
                )
            slope, offset = line.multiplier, line.offset
            self.notes.append(
                f"joint '{name}' follows '{leads}' along a curve, read as {_line_text(slope, offset)}, off by at most "
                f"{size_text(self.model, follower, line.error)}"
            )
        self._follow(follower, Mimic(leads, slope, offset))

    def _follow(self, follower: int, mimic: Mimic) -> None:
        """Make a follower of a joint, which keeps the limits that the model states, if it states some."""
        joint = self.joints[joint_name(self.model, follower)]
        if not self.model.jnt_limited[follower]:
            joint = replace(joint, lower=-np.inf, upper=np.inf)
        self.joints[joint.name] = replace(joint, mimic=mimic)

    def follow_loop(self, solved: SolvedLoop) -> None:
        """Make followers of a loop's joints, and narrow its leaders to the range in which it closes."""
        lines = []
        for follower, line in solved.followers.items():
            name, leads = joint_name(self.model, follower), joint_name(self.model, line.leader)
            self._follow(follower, Mimic(leads, line.multiplier, line.offset))
            # Its limits were kept where the loop was solved; what the line is off beside them narrows nothing.
            joint, taken = self.joints[name], line.multiplier * np.array(solved.ranges[line.leader]) + line.offset
            lower, upper = min(joint.lower, float(taken.min())), max(joint.upper, float(taken.max()))
            self.joints[name] = replace(joint, lower=lower, upper=upper)
            lines.append(f"{name} follows {leads} as {_line_text(line.multiplier, line.offset)}")
        angles = [line.error for joint, line in solved.followers.items() if not self._slides(joint)]
        error = f" / {np.degrees(max(angles)):.2g} deg" if angles else ""
        self.notes.append(f"{solved.loop.name}: {', '.join(lines)}; off by at most {solved.offset * 1e3:.2g} mm{error}")
        for leader, (lower, upper) in solved.ranges.items():
            joint = self.joints[joint_name(self.model, leader)]
            low, high = max(lower, joint.lower), min(upper, joint.upper)
            if low - joint.lower > NARROWED or joint.upper - high > NARROWED:
                self.joints[joint.name] = replace(joint, lower=low, upper=high)
                ends = " to ".join(size_text(self.model, leader, end) for end in (low, high))
                self.notes.append(
                    f"{solved.loop.name} closes only for joint '{joint.name}' at {ends}: its limits are these"
                )

    def tell_shared_motors(self, motors: list[list[int]], couplings: tuple[tuple[str, str], ...]) -> None:
        """Note the joints that share a motor though nothing says how they share its way."""
        for number, joints in enumerate(motors):
            names = [name for joint in joints if self.are_free([name := joint_name(self.model, joint)])]
            told = {name for pair in couplings for name in pair if set(pair) <= set(names)}
            if len(names) > 1 and not set(names) <= told:
                motor = self.model.actuator(number).name or f"motor{number}"
                pairs = ", ".join(f"[{outer}, {inner}]" for inner, outer in pairwise(names))
                self.notes.append(
                    f"joints {', '.join(names)} share the motor '{motor}' and count as independent; 'couplings: [{pairs}]' "
                    "in the hand's YAML keeps each outer one at most at the angle of the inner one"
                )

    def _slides(self, joint: int) -> bool:
        return bool(self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE)


def _line_text(multiplier: float, offset: float) -> str:
    shift = f" {'+' if offset > 0 else '-'} {abs(offset):.3g}" if abs(offset) >= LEAST_OFFSET else ""
    return f"{multiplier:.3g} x{shift}"
