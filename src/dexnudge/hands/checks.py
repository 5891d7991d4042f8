"""What can be wrong with a hand as it was read: joints that move nothing, links that overlap, tips that never meet."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.finding import Finding, length_text
from dexnudge.hands.closing import Closing, tip_distance
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import shown_meshes

LEAST_MOVE = 0.001  # [m] of some link while a joint goes through its range; less is a joint that moves nothing
MEETING = 0.03  # [m] between the tips of a closed hand: fingers that pass beside the thumb still pinch a thin object
LONGEST_LINK = 0.25  # [m] of a digit: twice the longest of the hands that are known, less than any in centimetres
ELSEWHERE = 0.4  # of a link's size, between the middles of its two descriptions; boxes around virtual links reach 0.37
APART = np.cos(np.radians(60.0))  # between the stated and the found direction of the palm: they contradict each other
TRUSTED = 0.5  # confidence from which the found direction may contradict
SHARES = (0.0, 0.13, 0.38, 0.71, 1.0)  # of a joint's range; uneven, as what turns in full circles comes back
MOST_NAMED = 4  # links or pairs in one sentence


def hand_findings(hand: Hand, way: Closing) -> list[Finding]:
    """Return the checks of a hand: warnings with a remedy, and notes of what was measured."""
    found = [*_joints(hand), *_sizes(hand), *_elsewhere(hand), _overlaps(hand), *_opening(hand, way)]
    return [*found, *_palm(hand, way), _surfaces(hand)]


def direction_numbers(direction: Float[np.ndarray, " 3"]) -> str:
    """Return a direction as messages show it."""
    return f"({', '.join(f'{value:.3g}' for value in np.round(direction, 3) + 0.0)})"


def _placed(hand: Hand, angles: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n link 4 4"]:
    return hand.forward_kinematics(hand.at_origin(angles)).numpy()


def _joints(hand: Hand) -> Iterator[Finding]:
    """Yield joints that move no geometry, that cannot move, and digits that nothing moves."""
    rest = np.clip(0.0, hand.lower, hand.upper)
    shares = np.asarray(SHARES)[:, None] * (hand.upper - hand.lower) + hand.lower
    samples = np.concatenate([np.where(np.eye(hand.num_joints), share, rest) for share in shares])
    poses = _placed(hand, samples).reshape(len(SHARES), hand.num_joints, len(hand.link_names), 4, 4)
    solid = [link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)]
    corners = {link: trimesh.bounds.corners(hand.link_meshes[link].bounds) for link in solid}

    def way(link: int) -> Float[np.ndarray, " d"]:
        """Return the farthest that a link's corners come from where they are at each joint's lower limit [m]."""
        pose = poses[:, :, link]
        places = np.einsum("sdij,cj->sdci", pose[..., :3, :3], corners[link]) + pose[..., None, :3, 3]
        return np.asarray(np.linalg.norm(places - places[0], axis=-1).max(axis=(0, 2)))

    ways = np.stack([way(link) for link in solid], axis=1)
    idle = [name for name, far in zip(hand.joint_names, ways.max(axis=1), strict=True) if far < LEAST_MOVE]
    if idle:
        sentence = f"joint {_listed(idle)} moves no geometry by {length_text(LEAST_MOVE)} within its limits"
        yield Finding("warning", "joints", sentence, "fix it, mend its limits, or give its links geometry")
    still = [
        digit
        for digit, tip in zip(hand.fingertips, hand.fingertip_indices, strict=True)
        if ways[:, solid.index(tip)].max() < LEAST_MOVE
    ]
    if still:
        sentence = f"digit {_listed(still)} is moved by no joint"
        yield Finding("warning", "joints", sentence, "leave it out of 'fingertips' in the hand's YAML")
    wide = [
        name
        for name, lower, upper, slides in zip(hand.joint_names, hand.lower, hand.upper, hand.sliding, strict=True)
        if not slides and upper - lower > np.pi * 1.5
    ]
    if wide:
        sentence = f"joint {_listed(wide)} turns by more than 270 degrees"
        yield Finding("warning", "limits", sentence, "state its limits, if it has some, in the description")
    outside = [name for name, angle in zip(hand.joint_names, rest, strict=True) if angle != 0.0]
    if outside:
        yield Finding("note", "limits", f"zero lies outside the limits of {_listed(outside)}")


def _sizes(hand: Hand) -> Iterator[Finding]:
    """Yield that links of digits are longer than any hand's."""
    lengths = {
        name: float(mesh.bounding_box_oriented.primitive.extents.max())
        for name, mesh in zip(hand.link_names, hand.link_meshes, strict=True)
        if len(mesh.faces) and hand.digit_of_link[name]
    }
    if long := [name for name, length in lengths.items() if length > LONGEST_LINK]:
        sentence = f"{_listed(long)} of a digit: up to {max(lengths.values()):.2f} m long"
        yield Finding("warning", "sizes", sentence, "in centimetres or inches? scale the meshes in the description")


def _elsewhere(hand: Hand) -> Iterator[Finding]:
    """Yield that links of digits are judged elsewhere than they are shown, as where a collision mesh was not turned."""
    shown = shown_meshes(hand)
    apart = [
        name
        for name, mesh in zip(hand.link_names, hand.link_meshes, strict=True)
        if hand.digit_of_link[name] and len(mesh.faces) and name in shown and len(shown[name].faces)
        if np.linalg.norm(mesh.bounds.mean(axis=0) - shown[name].bounds.mean(axis=0))
        > ELSEWHERE * max(np.linalg.norm(mesh.extents), np.linalg.norm(shown[name].extents))
    ]
    if apart:
        sentence = f"collision geometry of {_listed(apart)} lies elsewhere than what is shown of it"
        yield Finding("warning", "geometry", sentence, "try `geometry` visual, or mend <collision> in the description")


def _overlaps(hand: Hand) -> Finding:
    """Return which pairs of links are left out of self-collision because they overlap at zero joint angles."""
    solid = [link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)]
    checked = set(hand.self_collision_pairs)
    pairs = [pair for pair in combinations(solid, 2) if pair not in checked and not hand.related(*pair)]
    if not pairs:
        sentence = f"no links overlap at zero joint angles; {len(checked)} pairs are checked"
        return Finding("note", "self_collision", sentence)
    named = [f"{hand.link_names[one]} and {hand.link_names[other]}" for one, other in pairs]
    sentence = (
        f"links overlap by 1 mm or more at zero joint angles, which is taken as their normal state: {_listed(named)}; "
        f"{len(checked)} other pairs are checked for self-collision"
    )
    remedy = "if they do not touch on the real hand, mend their geometry or try `geometry`"
    return Finding("warning", "self_collision", sentence, remedy)


def _opening(hand: Hand, way: Closing) -> Iterator[Finding]:
    if len(hand.fingertips) == 1:
        return
    opened, closed = tip_distance(hand, way.open), tip_distance(hand, way.closed)
    sentence = (
        f"tips come {length_text(closed)} near each other when the hand closes, from {length_text(opened)} when open"
    )
    if closed > MEETING:
        yield Finding("warning", "closing", sentence, "mend the joints' limits, or 'fingertips' in the hand's YAML")
        return
    yield Finding("note", "closing", sentence)
    poses = _placed(hand, np.stack([way.closed]))[0]
    centres = np.stack(
        [
            trimesh.transform_points(hand.link_meshes[link].bounds.mean(axis=0)[None], poses[link])[0]
            for link in (0 if len(hand.link_meshes[0].faces) else hand.fingertip_indices[0], *hand.fingertip_indices)
        ]
    )
    heights = (centres[1:] - centres[0]) @ hand.palm_normal
    behind = [digit for digit, height in zip(hand.fingertips, heights, strict=True) if height <= 0.0]
    if behind and len(hand.link_meshes[0].faces):
        sentence = f"digit {_listed(behind)} closes behind the palm's middle, away from where it faces"
        yield Finding("warning", "closing", sentence, "check `palm_normal` on the picture")


def _palm(hand: Hand, way: Closing) -> Iterator[Finding]:
    """Yield what is doubtful about holding between the digits, and about where the palm faces."""
    if way.doubt:
        sentence = f"{way.doubt}: it can push and press; nothing says that it can hold"
        yield Finding("warning", "closing", sentence, "look at the closed hand on the picture, and check `palm_normal`")
    if way.confidence >= TRUSTED and not way.palm_normal @ hand.palm_normal > APART:
        sentence = (
            f"the palm is said to face {direction_numbers(hand.palm_normal)}, but the fingers close towards "
            f"{direction_numbers(way.palm_normal)} (confidence {way.confidence:.2f})"
        )
        yield Finding(
            "warning", "palm_normal", sentence, "check it on the picture, and mend 'palm_normal' or the limits"
        )


def _surfaces(hand: Hand) -> Finding:
    solid = sum(len(mesh.faces) > 0 for mesh in hand.link_meshes)
    points = len(hand.dense_points.points)
    sentence = (
        f"{solid} of {len(hand.link_names)} links have geometry, {points} points judge it; masses, efforts and velocities "
        "in hand.urdf and hand.xml are nominal, and no verdict depends on them"
    )
    return Finding("note", "surfaces", sentence)


def _listed(names: list[str]) -> str:
    more = [f"{len(names) - MOST_NAMED} more"] if len(names) > MOST_NAMED else []
    return ", ".join([*names[:MOST_NAMED], *more])
