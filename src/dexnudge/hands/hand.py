"""A robot hand: its kinematic tree, its limits and couplings, and the geometry that is judged."""

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from pathlib import Path

import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Int
from torch import Tensor

from dexnudge.errors import HandError
from dexnudge.geometry.exact_distance import ExactDistance
from dexnudge.geometry.surface_points import cached_surface_points
from dexnudge.geometry.transforms import rotation_6d_to_matrix

DENSE_SPACING = 0.002  # [m] between the points that judge
FINGERTIP_SPACING = 0.004  # [m] between the points that guide, where contact is made
DIGIT_SPACING = 0.006  # [m] on the other links of a digit
PALM_SPACING = 0.010  # [m] on the palm and the base, which are large and smooth
COARSE_SPACING = 0.008  # [m] on an arm's links, of all points
ALWAYS_OVERLAPPING = 0.001  # [m] links that overlap by this at zero joint angles are no collision pair
LEAST_SPREAD = 1e-4  # [m] of the fingertips that a sliding joint must change to open or close the hand
LEAST_TILT = 0.3  # sine of the fingers' angle to the palm normal; less says nothing of where they point along the palm
BOX_MARGIN = 1e-6  # [m] points farther outside a link's bounding box are outside the link, whatever was rounded
ROOT_COORDINATES = 9  # translation (3) and 6D rotation (6) stand before the joint angles in q
SLIDE_SCALE = 0.05  # [m] of a sliding joint that counts as a radian: what a tip moves at a finger segment's lever


@dataclass(frozen=True)
class LinkPoints:
    """Surface points of all links [m], each in the frame of its own link, grouped by link in ascending order."""

    points: Float[np.ndarray, "p 3"]
    normals: Float[np.ndarray, "p 3"]
    link: Int[np.ndarray, " p"]


@dataclass(frozen=True)
class Joint:
    """One joint between a parent and a child link.

    T_parent_child = origin @ rotation(axis, multiplier * angle + offset), `angle` being the entry `index` of the joint
    angles; `index` is None where the joint is fixed. Of a joint that `slides` it is origin @ translation(axis *
    (multiplier * value + offset)) [m].
    """

    name: str
    origin: Float[np.ndarray, "4 4"]
    axis: Float[np.ndarray, " 3"]
    index: int | None
    multiplier: float = 1.0
    offset: float = 0.0
    slides: bool = False

    @property
    def scale(self) -> float:
        """What counts as a radian of this joint: 1 rad, or 0.05 m where it slides."""
        return SLIDE_SCALE if self.slides else 1.0


@dataclass(frozen=True, repr=False)
class Hand:
    """A hand with d joint angles and L links, link 0 being the palm, parents before children.

    What is said of joint angles [rad] holds for sliding joints in metres.

    Attributes:
        name: what weights and datasets call it.
        joint_names: the d independent joints in the order in which q holds them.
        lower: least joint angles [rad], [m] of a sliding joint.
        upper: greatest joint angles, the same.
        link_names: the L links, the palm first.
        link_parent: index of each link's parent, -1 for the palm.
        joints: for each link the joint that carries it; None for the palm.
        link_meshes: collision geometry in the link frame [m]; an empty mesh for a link without geometry.
        fingertips: digit name -> its last link.
        couplings: (follower, leader) pairs with the hard constraint angle(follower) <= angle(leader).
        palm_normal: direction in which the palm faces, palm frame.
        base_link: the forearm or adapter behind the palm, if it is part of the geometry.
        notes: what was assumed when the description was read, a sentence each.
        source: the description file that it was read from; None for a hand that is no file's.
        coarse_links: those of an arm that carries the hand; their points are farther apart.
        shown_by: descriptions whose visual meshes pictures and pages show in place of `link_meshes`; none: these.
    """

    name: str
    joint_names: tuple[str, ...]
    lower: Float[np.ndarray, " d"]
    upper: Float[np.ndarray, " d"]
    link_names: tuple[str, ...]
    link_parent: Int[np.ndarray, " link"]
    joints: tuple[Joint | None, ...]
    link_meshes: tuple[trimesh.Trimesh, ...]
    fingertips: dict[str, str]
    couplings: tuple[tuple[str, str], ...]
    palm_normal: Float[np.ndarray, " 3"]
    base_link: str | None = None
    notes: tuple[str, ...] = ()
    source: Path | None = field(default=None, compare=False)
    coarse_links: frozenset[str] = frozenset()
    shown_by: tuple[Path, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        missing = [link for link in self.fingertips.values() if link not in self.link_names]
        if missing:
            raise HandError(
                f"hand '{self.name}' names fingertip links that it does not have: {missing}; "
                f"expected some of {list(self.link_names)}; mend 'fingertips' in the hand's YAML"
            )
        doubles = [link for link, count in Counter(self.fingertips.values()).items() if count > 1]
        if doubles:
            digits = [digit for digit, link in self.fingertips.items() if link == doubles[0]]
            raise HandError(
                f"hand '{self.name}' names '{doubles[0]}' as the fingertip of {' and '.join(digits)}; expected a link "
                "of its own for each digit; mend 'fingertips' in the hand's YAML"
            )
        unknown = [name for pair in self.couplings for name in pair if name not in self.joint_names]
        if unknown:
            raise HandError(
                f"hand '{self.name}' couples joints that it does not have: {unknown}; "
                f"expected some of {list(self.joint_names)}; mend 'couplings' in the hand's YAML"
            )

    def __repr__(self) -> str:
        return (
            f"Hand '{self.name}': {self.num_joints} joints, {len(self.link_names)} links, "
            f"digits {', '.join(self.fingertips)}, {len(self.couplings)} couplings"
        )

    @property
    def num_joints(self) -> int:
        """d, the number of joint angles."""
        return len(self.joint_names)

    @cached_property
    def sliding(self) -> Bool[np.ndarray, " d"]:
        """Which of the d joints slide: their entries in q are in metres."""
        own = {joint.name: joint.slides for joint in self.joints if joint is not None}
        return np.array([own.get(name, False) for name in self.joint_names], dtype=bool)

    @cached_property
    def joint_scales(self) -> Float[np.ndarray, " d"]:
        """What counts as a radian of each joint: 1 rad, or 0.05 m of a sliding one.

        Step sizes, tolerances, speeds and noise of joints are given in radians, and multiplied by these.
        """
        return np.where(self.sliding, SLIDE_SCALE, 1.0)

    @cached_property
    def moved_links(self) -> Bool[np.ndarray, " link"]:
        """Which links any joint moves in the root's frame."""
        moved = np.zeros(len(self.link_names), dtype=bool)
        for link, joint in enumerate(self.joints):
            moved[link] = joint is not None and (joint.index is not None or moved[self.link_parent[link]])
        return moved

    @property
    def fingertip_links(self) -> tuple[str, ...]:
        """The last link of each digit."""
        return tuple(self.fingertips.values())

    @cached_property
    def fingertip_indices(self) -> list[int]:
        """Index of each of these links in `link_names`."""
        return [self.link_names.index(link) for link in self.fingertip_links]

    @cached_property
    def digit_of_link(self) -> dict[str, str | None]:
        """The digit that each link belongs to; None for the palm, the base and what several digits hang from."""
        digits: dict[str, str | None] = dict.fromkeys(self.link_names)
        seen: set[str] = set()
        for digit, tip in self.fingertips.items():
            link = self.link_names.index(tip)
            while link > 0 and self.link_names[link] != self.base_link:
                name = self.link_names[link]
                digits[name] = None if name in seen else digit
                seen.add(name)
                link = int(self.link_parent[link])
        return digits

    @cached_property
    def coupled_indices(self) -> Int[np.ndarray, "pair 2"]:
        """Indices (follower, leader) of the coupled joints."""
        pairs = [[self.joint_names.index(name) for name in pair] for pair in self.couplings]
        return np.asarray(pairs, dtype=np.int64).reshape(-1, 2)

    def forward_kinematics(self, q: Float[Tensor, "batch coordinates"]) -> Float[Tensor, "batch link 4 4"]:
        """T_world_link of every link for q = [root translation (3) | 6D rotation (6) | joint angles (d)]; differentiable."""
        root = torch.eye(4, dtype=q.dtype, device=q.device).repeat(len(q), 1, 1)
        root = torch.cat([torch.cat([rotation_6d_to_matrix(q[:, 3:9]), q[:, :3, None]], dim=2), root[:, 3:]], dim=1)
        transforms = [root]
        for link in range(1, len(self.link_names)):
            joint = self.joints[link]
            assert joint is not None
            local = torch.as_tensor(joint.origin, dtype=q.dtype, device=q.device).expand(len(q), 4, 4)
            if joint.index is not None:
                angle = joint.multiplier * q[:, ROOT_COORDINATES + joint.index] + joint.offset
                motion = _axis_translation if joint.slides else _axis_rotation
                local = local @ motion(joint.axis, angle)
            transforms.append(transforms[self.link_parent[link]] @ local)
        return torch.stack(transforms, dim=1)

    def clamp(self, q: Float[Tensor, "batch coordinates"]) -> Float[Tensor, "batch coordinates"]:
        """Return q with joint angles within limits and every follower at most its leader, by the least move of each pair."""
        lower = torch.as_tensor(self.lower, dtype=q.dtype, device=q.device)
        upper = torch.as_tensor(self.upper, dtype=q.dtype, device=q.device)
        angles = q[:, ROOT_COORDINATES:]
        for follower, leader in self.coupled_indices:
            excess = (angles[:, follower] - angles[:, leader]).clamp_min(0.0) / 2
            step = torch.zeros_like(angles)
            step[:, follower], step[:, leader] = -excess, excess
            angles = angles + step
        angles = torch.minimum(torch.maximum(angles, lower), upper)
        for follower, leader in self.coupled_indices:  # rounding and limits may have split a pair again
            angles[:, follower] = torch.minimum(angles[:, follower], angles[:, leader])
        return torch.cat([q[:, :ROOT_COORDINATES], angles], dim=1)

    def equalise_tendon_joints(self, q: Float[Tensor, "batch coordinates"]) -> Float[Tensor, "batch coordinates"]:
        """`clamp`, then both joints of each tendon at their mean, within the limits of both.

        One tendon pulls on both with the same torque, but a force at the fingertip asks less of the outer joint, which gives
        way inwards until it meets its limit, the inner joint's angle: there a loaded finger comes to rest.
        """
        q = self.clamp(q)
        for pair in self.coupled_indices:
            mean = q[:, ROOT_COORDINATES + pair].mean(dim=1, keepdim=True)
            q[:, ROOT_COORDINATES + pair] = mean.clamp(float(self.lower[pair].max()), float(self.upper[pair].min()))
        return q

    def link_spacing(self, link: int, *, dense: bool) -> float:
        """Return the distance between neighbouring surface points of a link [m]."""
        if self.link_names[link] in self.coarse_links:
            return COARSE_SPACING
        if dense:
            return DENSE_SPACING
        if self.link_names[link] in self.fingertip_links:
            return FINGERTIP_SPACING
        return DIGIT_SPACING if self.digit_of_link[self.link_names[link]] else PALM_SPACING

    @property
    def _zero(self) -> Float[Tensor, "1 coordinates"]:
        """The configuration with the root at the origin and all joint angles 0."""
        return self.at_origin(np.zeros((1, self.num_joints)))

    def at_origin(self, joint_angles: Float[np.ndarray, "n joint"]) -> Float[Tensor, "n coordinates"]:
        """Return configurations with the palm at the origin and these joint angles."""
        q = torch.zeros(len(joint_angles), ROOT_COORDINATES + self.num_joints, dtype=torch.float64, device="cpu")
        q[:, 3] = q[:, 7] = 1.0
        q[:, ROOT_COORDINATES:] = torch.from_numpy(joint_angles)
        return q

    @cached_property
    def apart(self) -> Float[np.ndarray, " d"]:
        """Joint angles of an open hand, whatever its limits: zero; of slides the end at which the tips are farther apart."""
        opened = np.zeros(self.num_joints)
        for index in np.flatnonzero(self.sliding):
            q = self._zero.repeat(2, 1)
            ends = np.array([self.lower[index], self.upper[index]])
            q[:, ROOT_COORDINATES + index] = torch.from_numpy(ends)
            tips = self.keypoints(q)
            spread = (tips - tips.mean(dim=1, keepdim=True)).norm(dim=2).sum(dim=1).numpy()
            if abs(spread[1] - spread[0]) > LEAST_SPREAD:
                opened[index] = ends[spread.argmax()]
        return opened

    @cached_property
    def finger_axis(self) -> Float[np.ndarray, " 3"]:
        """Unit direction in which the fingers point at zero joint angles, perpendicular to the palm normal; palm frame.

        A finger points from its first joint to its tip; the thumb points elsewhere and does not count. Where they point
        where the palm faces, as a gripper's jaws may, it is perpendicular to the line between the thumb and the others.
        """
        normal = self.palm_normal / np.linalg.norm(self.palm_normal)
        axis = self._along_palm
        if self.fingers_face:
            tips = self.keypoints(self._zero)[0].numpy()
            others = np.delete(tips, self.thumb, axis=0).mean(axis=0) if len(tips) > 1 else np.zeros(3)
            axis = np.cross(tips[self.thumb] - others, normal)
            if np.linalg.norm(axis) < BOX_MARGIN:
                axis = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
        return axis / np.linalg.norm(axis)

    @cached_property
    def fingers_face(self) -> bool:
        """Whether the fingers point where the palm faces, as a gripper's jaws may."""
        return bool(np.linalg.norm(self._along_palm) < LEAST_TILT)

    @cached_property
    def _along_palm(self) -> Float[np.ndarray, " 3"]:
        """Mean of the fingers' unit directions at zero joint angles, perpendicular to the palm normal."""
        transforms = self.forward_kinematics(self._zero)[0].numpy()
        tips = self.keypoints(self._zero)[0].numpy()
        knuckles = transforms[[self._first_link(link) for link in self.fingertip_indices], :3, 3]
        ways = tips - knuckles
        fingers = ways if len(ways) < 3 else np.delete(ways, self.thumb, axis=0)
        mean = (fingers / np.linalg.norm(fingers, axis=1, keepdims=True)).mean(axis=0)
        normal = self.palm_normal / np.linalg.norm(self.palm_normal)
        return np.asarray(mean - (mean @ normal) * normal)

    def _first_link(self, link: int) -> int:
        """The link nearest to the palm that a digit's first joint moves; the link itself where nothing moves it."""
        first = link
        while link > 0:
            joint = self.joints[link]
            if joint is not None and joint.index is not None:
                first = link
            link = int(self.link_parent[link])
        return first

    @cached_property
    def thumb(self) -> int:
        """Index of the digit that opposes the others: at zero joint angles its tip is farthest from their mean."""
        tips = self.keypoints(self._zero)[0].numpy()
        others = (tips.sum(axis=0) - tips) / max(len(tips) - 1, 1)
        return int(np.linalg.norm(tips - others, axis=1).argmax())

    @cached_property
    def finger_length(self) -> float:
        """Mean distance of the fingertip keypoints from the palm's origin along the finger axis [m]."""
        return float(self.keypoints(self._zero)[0].mean(dim=0).numpy() @ self.finger_axis)

    @cached_property
    def finger_middle(self) -> Float[np.ndarray, " 3"]:
        """Half the way from the palm's origin to the tips, along the finger axis [m], palm frame.

        Where the fingers point where the palm faces, along the palm normal as well.
        """
        along = self.finger_axis * self.finger_length / 2
        if not self.fingers_face:
            return np.asarray(along)
        normal = self.palm_normal / np.linalg.norm(self.palm_normal)
        return np.asarray(along + normal * (self.keypoints(self._zero)[0].mean(dim=0).numpy() @ normal) / 2)

    def keypoints(self, q: Float[Tensor, "batch coordinates"]) -> Float[Tensor, "batch digit 3"]:
        """Return the place on each fingertip that reaches for a target: see `fingertip_keypoints` [m]."""
        transforms = self.forward_kinematics(q)
        links = self.fingertip_indices
        own = torch.as_tensor(self.fingertip_keypoints, dtype=q.dtype, device=q.device)
        return torch.einsum("bdij,dj->bdi", transforms[:, links, :3, :3], own) + transforms[:, links, :3, 3]

    @cached_property
    def fingertip_keypoints(self) -> Float[np.ndarray, "digit 3"]:
        """Keypoint of each fingertip in its link's frame [m]: two thirds of the way from its joint to its far end.

        Of a tip that is fixed to the link before it, as a ball on a finger's end is, the middle of its box; of a jaw that
        slides a third of the way from there to its far end, away from the palm.
        """
        transforms = self.forward_kinematics(self._zero)[0].numpy()
        points = []
        for tip in self.fingertip_indices:
            mesh, joint = self.link_meshes[tip], self.joints[tip]
            if joint is not None and joint.index is None:
                points.append(mesh.bounds.mean(axis=0))
            elif joint is not None and joint.slides:
                middle, pose = mesh.bounds.mean(axis=0), transforms[tip]
                away = pose[:3, :3].T @ (pose[:3, :3] @ middle + pose[:3, 3])
                away /= max(float(np.linalg.norm(away)), BOX_MARGIN)
                points.append(middle + away * ((mesh.vertices - middle) @ away).max() / 3.0)
            else:
                points.append(2.0 / 3.0 * mesh.vertices[np.linalg.norm(mesh.vertices, axis=1).argmax()])
        return np.asarray(points)

    @cached_property
    def dense_points(self) -> LinkPoints:
        """Surface points that verify: neighbours are at most 2 mm apart."""
        return self._points(dense=True)

    @cached_property
    def sparse_points(self) -> LinkPoints:
        """Surface points that guide: few, to be fast."""
        return self._points(dense=False)

    def _points(self, *, dense: bool) -> LinkPoints:
        points, normals, links = [], [], []
        for link, mesh in enumerate(self.link_meshes):
            if len(mesh.faces):
                spread = cached_surface_points(mesh, spacing=self.link_spacing(link, dense=dense), seed=link)
                points.append(spread.points)
                normals.append(spread.normals)
                links.append(np.full(len(spread.points), link, dtype=np.int32))
        return LinkPoints(np.concatenate(points), np.concatenate(normals), np.concatenate(links))

    @cached_property
    def self_collision_pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of links that must not touch.

        Neither parent and child, nor grandparent and grandchild, nor overlapping by 1 mm or more at zero joint angles.
        """
        transforms = self.forward_kinematics(self._zero)[0].numpy()
        solid = [link for link, mesh in enumerate(self.link_meshes) if len(mesh.faces)]
        distances = {link: ExactDistance(self.link_meshes[link]) for link in solid}
        dense = self.dense_points
        pairs = []
        for one, other in combinations(solid, 2):
            if not self.related(one, other):
                overlaps = (
                    _depth(dense.points[dense.link == a], transforms[a], distances[b], transforms[b])
                    for a, b in ((one, other), (other, one))
                )
                if max(overlaps) < ALWAYS_OVERLAPPING:
                    pairs.append((one, other))
        return tuple(pairs)

    def related(self, one: int, other: int) -> bool:
        """Whether two links are parent and child, or grandparent and grandchild: their contact is no collision."""
        parent = self.link_parent
        return any(
            parent[a] == b or (parent[a] >= 0 and parent[parent[a]] == b) for a, b in ((one, other), (other, one))
        )


def _axis_rotation(axis: Float[np.ndarray, " 3"], angle: Float[Tensor, " batch"]) -> Float[Tensor, "batch 4 4"]:
    x, y, z = (float(v) for v in axis)
    skew = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=angle.dtype, device=angle.device)
    rotation = torch.eye(4, dtype=angle.dtype, device=angle.device).repeat(len(angle), 1, 1)
    rotation[:, :3, :3] += angle.sin()[:, None, None] * skew + (1 - angle.cos())[:, None, None] * (skew @ skew)
    return rotation


def _axis_translation(axis: Float[np.ndarray, " 3"], value: Float[Tensor, " batch"]) -> Float[Tensor, "batch 4 4"]:
    along = value[:, None] * torch.as_tensor(axis, dtype=value.dtype, device=value.device)
    unmoved = torch.eye(4, dtype=value.dtype, device=value.device).repeat(len(value), 1, 1)
    return torch.cat([torch.cat([unmoved[:, :3, :3], along[:, :, None]], dim=2), unmoved[:, 3:]], dim=1)


def _depth(
    points: Float[np.ndarray, "n 3"],
    T_world_a: Float[np.ndarray, "4 4"],
    distance_b: ExactDistance,
    T_world_b: Float[np.ndarray, "4 4"],
) -> float:
    """Return the depth [m] of the deepest of link a's points inside link b; 0 if none is inside."""
    in_b = trimesh.transform_points(points, np.linalg.inv(T_world_b) @ T_world_a)
    low, high = distance_b.mesh.bounds
    near = in_b[((in_b >= low - BOX_MARGIN) & (in_b <= high + BOX_MARGIN)).all(axis=1)]
    return float(max(0.0, -distance_b(near).distance.min(initial=0.0))) if len(near) else 0.0
