"""Reach as a condition of success: an arm brings the hand to the object, along the whole push, and away again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from dexnudge.arms.arm import Arm
from dexnudge.arms.arm_json import read_arm, write_arm
from dexnudge.arms.inverse_kinematics import LEVER, Chain, InverseKinematics
from dexnudge.arms.mounting import mount
from dexnudge.arms.robot import Robot
from dexnudge.errors import ArmError, check_kind, quote
from dexnudge.geometry.rigid import rigid_transform
from dexnudge.hands.batch import HandBatch
from dexnudge.hands.hand import Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.planning.object_path import check_slides, push_length
from dexnudge.scenes.placement import surroundings_distance
from dexnudge.scenes.scene import Scene
from dexnudge.verification.criteria import CriterionResult
from dexnudge.verification.measurements import measure

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


PER_LINK = 60  # points on a link: about 4 cm apart on a Panda's
SEED = 0  # of their places


@dataclass(frozen=True)
class ArmPoints:
    """Points on the links that move. joint: whose motion each follows. place: in the frame behind that joint [m]."""

    joint: Int[np.ndarray, " point"]
    place: Float[np.ndarray, "point 3"]

    def blocked(
        self,
        chain: Chain,
        scene: Scene,
        positions: Float[np.ndarray, "row n"],
        T_world_base: Float[np.ndarray, "#row 4 4"],
    ) -> Bool[np.ndarray, " row"]:
        """Return at which joint angles a point is inside the surroundings."""
        inside = np.zeros(len(positions), dtype=bool)
        if not len(self.place) or not len(positions):
            return inside
        frames, bounds = T_world_base[:, None] @ chain.frames(positions), scene.environment_mesh.bounds
        for joint in np.unique(self.joint):
            own = frames[:, joint]
            points = self.place[self.joint == joint] @ own[:, :3, :3].swapaxes(1, 2) + own[:, None, :3, 3]
            row, point = np.nonzero(((points > bounds[0]) & (points < bounds[1])).all(axis=2))
            if len(row):
                deep = surroundings_distance(scene.environment_mesh)(points[row, point]).distance < 0
                inside[row[deep]] = True
        return inside


@cached_per_instance
def arm_points(arm: Arm) -> ArmPoints:
    """Return points spread over the links between base and flange; the same every time."""
    moving = [joint.name for joint in arm.chain if not joint.fixed]
    joints, places = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for link, mesh in arm.tree.links.items():
        pose, above = np.eye(4), arm.tree.chain_to(link)
        while above and above[-1].fixed:
            pose = above.pop().origin @ pose
        if above and above[-1].name in moving and len(mesh.faces):
            drawn = np.asarray(trimesh.sample.sample_surface(mesh, PER_LINK, seed=SEED)[0])
            places.append(trimesh.transform_points(drawn, pose))
            joints.append(np.full(len(drawn), moving.index(above[-1].name)))
    return ArmPoints(np.concatenate(joints), np.concatenate(places))


LEAST_MARGIN = 0.02  # of half a joint's range, some 3 degrees: what calibration and soft joints use up
BACK_OFF = 0.03  # [m] that the hand comes from, and draws back to
STATION = 0.02  # [m] at most from one place of the hand to the next: branches of an arm do not part within it
STEEPEST = 0.1  # norm of the contact normals' mean, below which they cancel
FILE = "reach.json"


class Reach:
    """The arm brings the hand from 3 cm before contact to contact, along the push, and 3 cm back from the object.

    By inverse kinematics from eight starts, each followed from place to place. Its value is the margin in [0, 1]: the least
    along the way of the joints' distance to their limits, as a share of half their range, and of the Jacobian's smallest
    singular value, as a share of 0.1 m/rad; of the best way that an arm has, and 0 where it has none. Passed from 0.02 on.
    Ways on which points of the arm's links are inside the surroundings, at contact or at either end, do not count. Whether
    the whole way is free, and the arm clear of the object and of itself, is for a plan to find.

    Args:
        arm: the arm, where it stands.
        mount: (4, 4) T_flange_mount, pose of the hand's base, or of its palm where it has none, in the flange's frame; the
            default of arm and hand unless given.

    Raises:
        InputError: no arm. SceneError: `mount` is no rigid pose.
    """

    name = "reach"
    tolerance = 1.0e-3
    """What inverse kinematics leaves open: 0.1 mm and 0.1 mrad, near a singularity more of a joint."""

    def __init__(self, arm: Arm, *, mount: Any = None) -> None:
        check_kind("arm", arm, Arm, 'load_arm("panda")')
        self.arm = arm
        self.mount = None if mount is None else rigid_transform(mount, "mount", unscaled="check the numbers")
        self._kinematics, self._points = InverseKinematics(arm), arm_points(arm)
        self._robot: Robot | None = None  # of the hand that was asked for last

    def robot(self, hand: Hand) -> Robot:
        """Return the arm with the hand at its flange."""
        if self._robot is None or self._robot.hand is not hand:
            self._robot = mount(self.arm, hand, self.mount)
        return self._robot

    def __call__(self, hands: HandBatch, scene: Scene) -> CriterionResult:
        """Judge each hand."""
        found = arm_margins(
            self._kinematics,
            *flange_ways(self.robot(hands.hand), hands, scene),
            blocked=lambda positions, _: self.blocked(scene, positions, self.arm.T_world_base[None]),
        )
        if found.contact.any():
            what = "the arm does not reach along the whole motion, or only at its joints' limits or through the surroundings"
        else:
            what = "the arm reaches none of the hands even at contact"
        sentence = f"{what}; move the `arm_base` (find-base shows where), turn the `mount`, or draw more (`num`)"
        return CriterionResult(found.margin, found.margin >= LEAST_MARGIN, sentence)

    def blocked(
        self, scene: Scene, positions: Float[np.ndarray, "row n"], T_world_base: Float[np.ndarray, "#row 4 4"]
    ) -> Bool[np.ndarray, " row"]:
        """Return at which joint angles, from which base (one, or each its own), a link stands in the surroundings."""
        return self._points.blocked(self._kinematics.chain, scene, positions, T_world_base)

    def save(self, folder: Path, hand: Hand) -> None:
        """Write what the criterion needs, reach.json."""
        mount, points = self.robot(hand).T_flange_mount, self._points
        write_arm(self.arm, folder / FILE, T_flange_mount=mount, point_joint=points.joint, point_place=points.place)

    @classmethod
    def load(cls, folder: Path) -> Reach:
        """Return the criterion that `save` wrote.

        Raises:
            ArmError: the file is missing or damaged.
        """
        arm, content = read_arm(folder / FILE)
        mount = content.get("T_flange_mount")
        if mount is None:
            raise ArmError(f"{folder / FILE}: T_flange_mount is {quote(mount)}; expected 4 x 4 numbers; sample again")
        found = cls(arm, mount=mount)
        found._points = _points(content, sum(not joint.fixed for joint in arm.chain), folder / FILE)
        return found

    def __repr__(self) -> str:
        return f"Reach({self.arm!r})"


def flange_ways(
    robot: Robot, hands: HandBatch, scene: Scene
) -> tuple[Float[np.ndarray, "hand early 4 4"], Float[np.ndarray, "hand late 4 4"]]:
    """Return the flange's ways, T_world_flange: from contact to 3 cm before it, and on along the push and 3 cm back."""
    check_slides(scene, "an arm whose reach is judged")
    contact = robot.flange_poses(hands.q.detach().cpu().numpy())
    back = BACK_OFF * _back_off(hands, scene)
    push = push_length(scene) * scene.motion * np.ones((len(contact), 1))
    before = _moved(contact, back)
    along = _moved(contact, push)
    after = _moved(along[:, -1], back)
    return before, np.concatenate([along, after[:, 1:]], axis=1)


def _points(content: dict[str, Any], joints: int, path: Path) -> ArmPoints:
    """Return the points on the links that a file holds; ArmError where they are none."""
    try:
        joint = np.asarray(content["point_joint"], dtype=np.int64)
        place = np.asarray(content["point_place"], dtype=float).reshape(-1, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise ArmError(f"{path}: its points are none ({error}); expected joints and places; sample again") from error
    if joint.shape != (len(place),) or not np.isfinite(place).all() or not ((joint >= 0) & (joint < joints)).all():
        raise ArmError(f"{path}: its points do not belong to {joints} joints; expected a joint for each; sample again")
    return ArmPoints(joint, place)


def _moved(
    poses: Float[np.ndarray, "hand 4 4"], way: Float[np.ndarray, "hand 3"]
) -> Float[np.ndarray, "hand station 4 4"]:
    """Return poses carried along a straight way, both ends among them."""
    length = float(np.linalg.norm(way, axis=1).max(initial=0.0))
    shares = np.linspace(0.0, 1.0, int(np.ceil(length / STATION - 1e-9)) + 1)
    stations = np.repeat(poses[:, None], len(shares), axis=1)
    stations[:, :, :3, 3] += shares[:, None] * way[:, None]
    return stations


def _back_off(hands: HandBatch, scene: Scene) -> Float[np.ndarray, "hand 3"]:
    """Return where each hand draws back to: along the mean of its contacts' normals; up where they cancel."""
    ways = np.tile((0.0, 0.0, 1.0), (len(hands), 1))
    for way, contacts in zip(ways, measure(hands, scene).contacts, strict=True):
        mean = contacts.normals.mean(axis=0) if len(contacts.normals) else np.zeros(3)
        if np.linalg.norm(mean) > STEEPEST:
            way[:] = mean / np.linalg.norm(mean)
    return ways
