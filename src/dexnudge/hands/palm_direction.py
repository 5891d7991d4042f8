"""Where a palm faces, from how its digits move when they close, where their joints stand and how the palm is shaped."""

from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.hands.hand import Hand

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
    axes = _palm_axes(hand)
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


def _palm_axes(hand: Hand) -> Float[np.ndarray, "axis 3"]:
    """Return the axes of the palm's frame and those of the smallest box around its geometry."""
    mesh = hand.link_meshes[0]
    own = np.eye(3)
    return np.concatenate([own, mesh.bounding_box_oriented.transform[:3, :3].T]) if len(mesh.faces) else own


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
