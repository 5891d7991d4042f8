"""How a hand closes, found from its joints and its geometry: open, rest and closed pose, and where the palm faces.

Nothing here reads `Hand.palm_normal`: this is what finds it where nobody has stated it.
"""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.jobs.cached import cached_per_instance

SAME_WAY = np.cos(np.radians(35.0))  # between the pads of fingers that lie side by side
PARALLEL = np.cos(np.radians(20.0))  # axes of the joints that flex one finger
ROW = 0.5  # of a digit's length: the least length of a row of digits that stand side by side
AHEAD = np.cos(np.radians(30.0))  # of where the tips meet, seen from the digits' first joints
FACE = np.cos(np.radians(54.7))  # to the nearest of a box's axes at most
CLEAR = 0.15  # lead in the cues' agreement over any other direction that leaves no doubt
SNAP = np.cos(np.radians(15.0))  # a direction that near an axis of the palm's frame is meant to be that axis


@dataclass(frozen=True)
class Digits:
    """Of each digit, palm frame: its first joint, its direction to the tip and how far that is [m], the side of its pad.

    The pad's side is 0 where it is unknown.
    """

    base: Float[np.ndarray, "digit 3"]
    way: Float[np.ndarray, "digit 3"]
    length: Float[np.ndarray, " digit"]
    pad: Float[np.ndarray, "digit 3"]


def closing_digits(hand: Hand, start: Float[np.ndarray, " d"], met: Float[np.ndarray, " d"]) -> Digits:
    """Return the digits of a hand that moves from joint angles `start` (d,) to `met` (d,)."""
    q = hand.at_origin(np.stack([start, met]))
    transforms = hand.forward_kinematics(q)[0].numpy()
    base, way, length, pad = [], [], [], []
    for end in hand.fingertip_indices:
        turns, slide, first, link = [], np.zeros(3), end, end
        while link > 0:
            joint = hand.joints[link]
            assert joint is not None
            if joint.index is not None:
                move = joint.multiplier * (met[joint.index] - start[joint.index])
                turn = move * (transforms[link, :3, :3] @ joint.axis)
                if joint.slides:
                    slide += turn
                else:
                    turns.append((turn, transforms[link, :3, 3]))
                first = link
            link = int(hand.link_parent[link])
        axis, place = _flexion(turns)
        base.append(transforms[first, :3, 3] if place is None else place)
        tip = hand.link_meshes[end].bounds.mean(axis=0)
        reach = trimesh.transform_points(tip[None], transforms[end])[0] - base[-1]
        way.append(_unit(reach))
        length.append(np.linalg.norm(reach))
        pad.append(_unit(slide) if np.linalg.norm(slide) > 0 else _unit(np.cross(axis, way[-1])))
    return Digits(np.asarray(base), np.asarray(way), np.asarray(length), np.asarray(pad))


Turn = tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]


def _flexion(turns: list[Turn]) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"] | None]:
    """Return the unit axis about which a digit turns most, and the place of its first joint about that axis.

    `turns`: of each joint, from the tip inwards, its move times its axis [rad] and its place.
    """
    groups = [[each for each in turns if abs(_unit(each[0]) @ _unit(turn)) > PARALLEL] for turn, _ in turns]
    group = max(groups, key=lambda each: sum(float(np.linalg.norm(turn)) for turn, _ in each), default=[])
    if not group:
        return np.zeros(3), None
    return _unit(np.sum([turn for turn, _ in group], axis=0)), group[-1][1]


def _unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-9 else np.zeros(3)


def stand_in_two_rows(digits: Digits, normal: Float[np.ndarray, " 3"]) -> bool:
    """Whether all digits stand in two rows of at least two, side by side in each, that close towards each other."""
    inwards = digits.pad - digits.way
    inwards = np.array([_unit(each - (each @ normal) * normal) for each in inwards])
    alike = inwards @ inwards.T
    one = alike[0] > SAME_WAY
    if min(one.sum(), (~one).sum()) < 2 or not (alike[one][:, one] > SAME_WAY).all():
        return False
    if not (alike[~one][:, ~one] > SAME_WAY).all() or not (alike[one][:, ~one] < -SAME_WAY).all():
        return False
    places = digits.base @ np.cross(normal, inwards[0])
    return all(bool(np.ptp(places[row]) > ROW * digits.length[row].mean()) for row in (one, ~one))


def palm_direction(hand: Hand, digits: Digits, met: Float[np.ndarray, " d"]) -> tuple[Float[np.ndarray, " 3"], float]:
    """Return the candidate direction for which most cues speak, and its confidence."""
    centre = hand.keypoints(hand.at_origin(met[None]))[0].numpy().mean(axis=0) - digits.base.mean(axis=0)
    mesh, axes = hand.link_meshes[0], np.eye(3)  # of the palm's frame, and of the smallest box around its geometry
    if len(mesh.faces):
        axes = np.concatenate([axes, mesh.bounding_box_oriented.transform[:3, :3].T])
    beside = [digits.pad[digits.pad @ pad > SAME_WAY].mean(axis=0) for pad in digits.pad if pad.any()]
    candidates = [_snapped(_unit(way)) for way in (*beside, digits.pad.mean(axis=0), digits.way.mean(axis=0))]
    candidates = [way for way in candidates if way.any()]
    if not candidates:  # nothing moves the tips
        return np.array([0.0, 0.0, 1.0]), 0.0
    agreement = np.array([_cues(digits, centre, axes, way).mean() for way in candidates])
    best = candidates[int(agreement.argmax())]
    rivals = [each for way, each in zip(candidates, agreement, strict=True) if way @ best < SAME_WAY]
    clear = min(1.0, (agreement.max() - max(rivals, default=0.0)) / CLEAR)
    return best, float(np.clip(agreement.max() * clear, 0.0, 1.0))


def _snapped(direction: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    axis = np.zeros(3)
    longest = int(np.abs(direction).argmax())
    axis[longest] = np.sign(direction[longest])
    return axis if direction @ axis > SNAP else direction


def _cues(
    digits: Digits, centre: Float[np.ndarray, " 3"], axes: Float[np.ndarray, "axis 3"], normal: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " cue"]:
    """Return what speaks for a direction, -1 to 1 each.

    The share of the digits whose pads face it, or that point along it as far as the pads face each other; the plane of
    their first joints is square to it; the tips meet on that side of the plane; the palm has a face on that side.
    """
    pads, ways = (float((each @ normal > SAME_WAY).mean()) for each in (digits.pad, digits.way))
    share = max(pads, ways * (1.0 - float(np.linalg.norm(digits.pad.mean(axis=0)))))
    bases = digits.base - digits.base.mean(axis=0)
    tilt = np.linalg.norm(bases @ normal) / max(float(np.linalg.norm(bases)), 1e-9)
    ahead = centre @ normal / max(float(np.linalg.norm(centre)), 1e-9)
    face = np.abs(axes @ normal).max()
    return np.array([share, 1.0 - tilt**2, np.clip(ahead / AHEAD, -1.0, 1.0), (face - FACE) / (1.0 - FACE)])


STARTS = 8  # random ones of the search for the pose in which the tips meet, beside rest and mid-range
STEPS = 80  # of that search
STEP = 0.05  # of a joint's range, the first step; the last is a tenth of it
REST_WEIGHT = 0.02  # of a joint at its far end, against tips one hand's length apart
HYPEREXTENSION = 0.3  # [rad] of the open pose past straight; farther back a finger's back would count as its front
CLOSED_AT_REST = 2.0  # the spread of the tips at rest over that when closed, below which the rest pose is a closed one
NEAR_AT_REST = 0.015  # [m] between the tips at rest, below which it is one, too, however near they then come
PATH_POSES = 13  # from rest to where the tips meet, looked through for the first touch
HALVINGS = 4  # of the step in which they first touch
TOUCH = 0.003  # [m] between points 2 mm apart on surfaces that meet
BALANCED = 0.2  # of a joint's range that one side of rest is longer; less does not tell which side closes
NEAR_PALM = 0.03  # [m] between a tip and the palm that it closes onto
DOUBT = 0.45  # the most confidence in a palm of digits that oppose nothing, or that stand as legs do


@dataclass(frozen=True)
class Closing:
    """How a hand opens and closes.

    Attributes:
        open: joint angles of the open hand (d,) [rad].
        rest: the joint angles within limits that are nearest to zero (d,) [rad].
        closed: joint angles at which the tips meet, or come nearest to each other (d,) [rad].
        palm_normal: unit direction in which the palm faces, palm frame.
        confidence: 0 to 1, from how well independent cues agree on the palm's direction; below 0.5 it is a guess.
        doubt: what speaks against a hand that holds something between its digits; empty where nothing does.
    """

    open: Float[np.ndarray, " d"]
    rest: Float[np.ndarray, " d"]
    closed: Float[np.ndarray, " d"]
    palm_normal: Float[np.ndarray, " 3"]
    confidence: float
    doubt: str = ""


@cached_per_instance
def closing(hand: Hand) -> Closing:
    """Return how the hand closes.

    The closed pose brings the tips together with as little turning of the joints as that takes, and stops where the first
    opposing tips touch. Its joint moves give each digit's flexion axis a and, with the digit's direction d from its first
    joint to its tip, the side a x d of its pad. The palm faces where most pads do, as on a human hand, or, where the pads
    face each other, where the digits point, as on a gripper; of these candidates the one is taken that the place where
    the tips meet, the plane of the digits' first joints and the palm's own shape speak for.
    """
    rest = np.clip(0.0, hand.lower, hand.upper)
    met = _tips_together(hand, rest)
    start = rest
    closed_at_rest = _spread(hand, rest[None])[0] < CLOSED_AT_REST * _spread(hand, met[None])[0]
    if closed_at_rest or tip_distance(hand, rest) < NEAR_AT_REST:
        start = np.where(met - hand.lower > hand.upper - met, hand.lower, hand.upper)
    apart = _spread(hand, start[None])[0] <= CLOSED_AT_REST * _spread(hand, met[None])[0]
    onto_palm = _onto_palm(hand, rest) if apart else None
    if onto_palm is not None:
        start, met = rest, onto_palm
        near = _palm_distance(hand, met) < NEAR_PALM
        onto = "only the palm" if near else "neither another nor the palm"
        doubt = f"no digit opposes another: all close side by side, towards {onto}"
    else:
        doubt = "the digits come no nearer to each other when they close" if apart else ""
    closed = met if onto_palm is not None else _until_touch(hand, start, met)
    moves = met - start
    turned = np.abs(moves) > 0.1 * (hand.upper - hand.lower)
    opened = np.clip(start - HYPEREXTENSION * hand.joint_scales * np.sign(moves) * turned, hand.lower, hand.upper)
    digits = closing_digits(hand, start, met)
    normal, confidence = palm_direction(hand, digits, met)
    if not doubt and stand_in_two_rows(digits, normal):
        doubt = "the digits stand in two rows across the palm from each other, as a walker's legs do"
    if doubt and not (onto_palm is not None and near):
        confidence = min(confidence, DOUBT)
    return Closing(opened, rest, closed, normal, confidence, doubt)


def _onto_palm(hand: Hand, rest: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"] | None:
    """Return the pose in which digits that all close side by side come nearest to the palm; None where they do not.

    A joint closes towards the end of its range that is farther from rest.
    """
    above, below = hand.upper - rest, rest - hand.lower
    told = np.abs(above - below) > BALANCED * (hand.upper - hand.lower)
    ends = np.where(told, np.where(above > below, hand.upper, hand.lower), rest)
    pads = closing_digits(hand, rest, ends).pad
    if not (pads @ pads.T > SAME_WAY).all():
        return None
    poses = [rest + share * (ends - rest) for share in np.linspace(0.0, 1.0, PATH_POSES)[1:]]
    distances = np.array([_palm_distance(hand, pose) for pose in poses])
    touching = np.flatnonzero(distances < TOUCH)
    return poses[int(touching[0]) if len(touching) else int(distances.argmin())]


def _palm_distance(hand: Hand, angles: Float[np.ndarray, " d"]) -> float:
    """Return the least distance between surface points of any tip and of the palm [m]."""
    placed = _placed_points(hand, angles)
    if not len(placed[0]):
        return float("inf")
    tips = np.concatenate([placed[link] for link in hand.fingertip_indices])
    return float(cKDTree(placed[0]).query(tips)[0].min())


def _spread(hand: Hand, angles: Float[np.ndarray, "n d"]) -> Float[np.ndarray, " n"]:
    """Return the mean squared distance of the tips from their mean [m^2]."""
    return _tip_spread(hand.keypoints(hand.at_origin(angles))).numpy()


def _tip_spread(tips: Float[Tensor, "n digit 3"]) -> Float[Tensor, " n"]:
    return (tips - tips.mean(dim=1, keepdim=True)).square().sum(dim=2).mean(dim=1)


def _tips_together(hand: Hand, rest: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Return the pose of the least spread of the tips plus the least turning, by projected Adam from several starts."""
    ranges = np.maximum(hand.upper - hand.lower, 1e-6)
    starts = np.random.default_rng(0).uniform(hand.lower, hand.upper, (STARTS, hand.num_joints))
    starts = np.concatenate([rest[None], (hand.lower + hand.upper)[None] / 2, starts])
    scale, home = torch.as_tensor(ranges), torch.as_tensor(rest)
    size = float(np.square(hand.keypoints(hand.at_origin(rest[None]))[0].numpy()).sum(axis=1).max())

    def energy(q: Tensor) -> Tensor:
        turning = ((q[:, ROOT_COORDINATES:] - home) / scale).square().mean(dim=1)
        return _tip_spread(hand.keypoints(q)) / size + REST_WEIGHT * turning

    q = hand.at_origin(starts)
    mean, square = torch.zeros_like(q), torch.zeros_like(q)
    for step in range(1, STEPS + 1):
        q = q.detach().requires_grad_()
        gradient = torch.autograd.grad(energy(q).sum(), q)[0].detach()
        gradient[:, :ROOT_COORDINATES] = 0.0
        gradient[:, ROOT_COORDINATES:] *= scale
        mean, square = 0.9 * mean + 0.1 * gradient, 0.99 * square + 0.01 * gradient.square()
        way = (mean / (1 - 0.9**step)) / ((square / (1 - 0.99**step)).sqrt() + 1e-12)
        way[:, ROOT_COORDINATES:] *= scale
        q = hand.clamp(q.detach() - STEP * (1 - 0.9 * step / STEPS) * way)
    best = int(energy(q).argmin())
    return q[best, ROOT_COORDINATES:].numpy()


def _until_touch(hand: Hand, start: Float[np.ndarray, " d"], met: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Return the first pose on the way at which the thumb's tip touches another, else the one where it comes nearest."""
    shares = np.linspace(0.0, 1.0, PATH_POSES)[1:]
    distances: list[float] = []
    for share in shares:
        distances.append(tip_distance(hand, start + share * (met - start)))
        if distances[-1] < TOUCH:
            apart, touching = share - shares[0], share
            for _ in range(HALVINGS):
                middle = (apart + touching) / 2
                if tip_distance(hand, start + middle * (met - start)) < TOUCH:
                    touching = middle
                else:
                    apart = middle
            return start + touching * (met - start)
    return start + shares[int(np.argmin(distances))] * (met - start)


def tip_distance(hand: Hand, angles: Float[np.ndarray, " d"]) -> float:
    """Return the least distance between surface points of the thumb's tip and of any other tip [m]."""
    placed = _placed_points(hand, angles)
    tips = [placed[link] for link in hand.fingertip_indices]
    others = [points for digit, points in enumerate(tips) if digit != hand.thumb]
    if not others or not len(tips[hand.thumb]):
        return float("inf")
    return float(cKDTree(np.concatenate(others)).query(tips[hand.thumb])[0].min())


def _placed_points(hand: Hand, angles: Float[np.ndarray, " d"]) -> list[Float[np.ndarray, "p 3"]]:
    """Return the surface points of the palm and of the tips in the palm's frame [m], by link; none of the other links."""
    transforms = hand.forward_kinematics(hand.at_origin(angles[None]))[0].numpy()
    dense, asked = hand.dense_points, {0, *hand.fingertip_indices}
    return [
        trimesh.transform_points(dense.points[dense.link == link], transforms[link])
        if link in asked
        else np.zeros((0, 3))
        for link in range(len(hand.link_names))
    ]
