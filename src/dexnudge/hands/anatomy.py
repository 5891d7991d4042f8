"""Where a robot description has a hand: the palm from which digits branch, their tips, and what lies behind the palm."""

import re
from collections import Counter
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np
import trimesh
import yaml
from jaxtyping import Float

from dexnudge.errors import HandError
from dexnudge.hands.assembly import WRIST_JOINTS
from dexnudge.hands.tree import Tree

LONGEST_DIGIT = (
    0.3  # [m] stretched out, from its first joint; Barrett's 0.20, a claw's 0.23, a small quadruped's legs 0.32
)
LEAST_DIGITS = 2  # less has nothing to oppose
SIDES = r"(?:(?:left|right|[lr]h?)[_.-]|[_.-](?:left|right|[lr]h?))(?:hand[_.-]|[_.-]hand)?"  # in names of links
ON_THE_AXIS = 0.1  # of its size: a body whose middle is that near its only joint's axis is a wheel, an eye or a rotor


@dataclass(frozen=True)
class HandPart:
    """A hand within a description.

    Attributes:
        palm: the link that carries most of its digits.
        fingertips: digit name -> last link with geometry.
        base_link: the farthest link with geometry behind the palm, as far as a wrist reaches; None: none, or an arm.
    """

    palm: str
    fingertips: dict[str, str]
    base_link: str | None


def hands_in(tree: Tree, *, solid: bool = True) -> list[HandPart]:
    """Return the hands of a description, in its order.

    Links that fixed joints hold together are one body. A hand is the topmost body with at least two digits: branches that
    joints move, with geometry, of at most 0.3 m, and no wheels. Without `solid` no geometry is asked for.
    """
    return _Bodies(tree, solid=solid).hands()


def hand_at(tree: Tree, palm: str) -> HandPart:
    """Return the hand on a link that is said to be its palm.

    Raises:
        HandError: no such link, or fewer than two digits on it.
    """
    bodies = _Bodies(tree)
    if palm not in tree.links:
        raise HandError(f"`palm` is '{palm}'; expected one of {list(tree.links)}")
    part = bodies.hand(bodies.body[palm])
    if len(part.fingertips) < LEAST_DIGITS:
        raise HandError(
            f"`palm` is '{palm}', which carries {len(part.fingertips)} digits; expected a link from which at least "
            f"{LEAST_DIGITS} digits branch that joints move"
        )
    return replace(part, palm=palm)


def why_no_hand(tree: Tree) -> str:
    """Return what a description without a hand has instead."""
    bodies = _Bodies(tree)
    moving = [joint for joint in tree.joints if not joint.fixed]
    if not moving:
        return "no joint that moves"
    if len(moving) == 1:
        return f"one joint, '{moving[0].name}': what it moves has nothing to oppose"
    limbs = [body for body in bodies.members if len(bodies.limbs(body)) >= LEAST_DIGITS]
    if limbs:
        body = min(limbs, key=bodies.reach)
        return f"'{body}' with {len(bodies.limbs(body))} limbs of up to {bodies.reach(body):.2f} m: legs or arms, no fingers"
    turning = [body for body in bodies.members if sum(map(bodies.is_wheel, bodies.children[body])) >= LEAST_DIGITS]
    if turning:
        return f"'{turning[0]}' with bodies that only turn about their own middle: wheels, no fingers"
    if not any(map(bodies.is_solid, bodies.members)):
        return "no geometry: nothing to push with"
    ends = [body for body in bodies.members if not bodies.children[body]]
    what = "an arm, or one finger, without an opposite" if len(ends) == 1 else "limbs, no fingers"
    return f"{len(moving)} joints that end in {', '.join(map(repr, ends[:3]))}: {what}"


class _Bodies:
    """The links of a tree, those that fixed joints hold together as one body, named after its topmost link."""

    def __init__(self, tree: Tree, *, solid: bool = True) -> None:
        self.tree, self.solid, self.carrier = tree, solid, tree.carrier
        self.body, self.poses = {tree.root: tree.root}, {tree.root: np.eye(4)}
        self.members = {tree.root: [tree.root]}
        for joint in tree.joints_below(tree.root):
            self.body[joint.child] = self.body[joint.parent] if joint.fixed else joint.child
            self.poses[joint.child] = self.poses[joint.parent] @ joint.origin
            self.members.setdefault(self.body[joint.child], []).append(joint.child)
        self.children: dict[str, list[str]] = {body: [] for body in self.members}
        for body in (link for link in tree.links if link in self.members and link in self.carrier):
            self.children[self.body[self.carrier[body].parent]].append(body)

    def is_solid(self, body: str) -> bool:
        return any(self._solid(link) for below in self.below(body) for link in self.members[below])

    def _solid(self, link: str) -> bool:
        return not self.solid or len(self.tree.links[link].faces) > 0

    def below(self, body: str) -> list[str]:
        """Return a body and all bodies below it."""
        found = [body]
        for each in found:
            found += self.children[each]
        return found

    def limbs(self, body: str) -> list[str]:
        """Return the bodies that joints carry on this one, without those that have no geometry and without wheels."""
        return [child for child in self.children[body] if self.is_solid(child) and not self.is_wheel(child)]

    def reach(self, body: str) -> float:
        """Return the length of the longest limb of a body, stretched out, from its own first joint [m]."""
        return max(self._length(limb) for limb in self.limbs(body))

    def _length(self, body: str) -> float:
        place = self.poses[body][:3, 3]
        ends = np.concatenate([self.poses[body][None, :3, 3], *map(self._corners, self.members[body])])
        own = float(np.linalg.norm(ends - place, axis=1).max())
        steps = [
            float(np.linalg.norm(self.poses[child][:3, 3] - place)) + self._length(child)
            for child in self.children[body]
        ]
        return max(own, *steps) if steps else own

    def _corners(self, link: str) -> Float[np.ndarray, "corner 3"]:
        """Return the corners of the box around a link's geometry; none without any."""
        mesh = self.tree.links[link]
        if not len(mesh.faces):
            return np.zeros((0, 3))
        return trimesh.transform_points(trimesh.bounds.corners(mesh.bounds), self.poses[link])

    def is_wheel(self, body: str) -> bool:
        """Whether a body, whose own joint is the last, has its middle on that joint's axis."""
        joint = self.carrier[body]
        if self.children[body] or joint.slides or not self.solid or not self.is_solid(body):
            return False
        corners = np.concatenate([self._corners(link) for link in self.members[body]])
        middle = (corners.min(axis=0) + corners.max(axis=0)) / 2 - self.poses[body][:3, 3]
        axis = self.poses[body][:3, :3] @ joint.axis
        return bool(np.linalg.norm(np.cross(axis, middle)) < ON_THE_AXIS * np.ptp(corners, axis=0).max())

    def hands(self) -> list[HandPart]:
        fits = [
            body for body in self.members if len(self.limbs(body)) >= LEAST_DIGITS and self.reach(body) <= LONGEST_DIGIT
        ]
        inner = {below for body in fits for below in self.below(body)[1:]}
        return [self.hand(body) for body in fits if body not in inner]

    def hand(self, body: str) -> HandPart:
        carriers = Counter(self.carrier[limb].parent for limb in self.limbs(body))
        palm = carriers.most_common(1)[0][0] if carriers else body
        tips = self._tips(body)
        behind = [link for link in self.tree.links_above(palm) if len(self.tree.links[link].faces)]
        wrist = sum(not joint.fixed for joint in self.tree.chain_to(body))
        base = behind[-1] if behind and wrist <= WRIST_JOINTS else None
        return HandPart(palm, digit_names(self.tree, tips, body=self.members[body]), base)

    def _tips(self, palm: str) -> list[str]:
        """Return the last link with geometry of each chain below the palm."""
        bodies = [body for limb in self.limbs(palm) for body in self.below(limb)]
        ends = [body for body in bodies if not any(map(self.is_solid, self.children[body]))]
        tips = [self._last_solid(end, palm) for end in ends]
        return list(dict.fromkeys(tip for tip in tips if tip is not None))

    def _last_solid(self, end: str, palm: str) -> str | None:
        body: str | None = end
        while body is not None and body != palm:
            solid = [link for link in self.members[body] if self._solid(link)]
            if solid:
                return solid[-1]
            body = self.body[self.carrier[body].parent] if body in self.carrier else None
        return None


def digit_names(tree: Tree, tips: list[str], *, body: list[str]) -> dict[str, str]:
    """Return the tips by digit: what the names of a digit's links share, or the tips' own names where these do not tell."""
    shared = []
    for tip in tips:
        chain = [tip, *takewhile(lambda link: link not in body, tree.links_above(tip))]
        alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*chain, strict=False))
        shared.append("".join(letters[0] for letters in alike).rstrip("_-. 0123456789"))
    count = Counter(shared)
    names = [name if name and count[name] == 1 else tip for name, tip in zip(shared, tips, strict=True)]
    return dict(zip(_without_side(names), tips, strict=True))


def _without_side(names: list[str]) -> list[str]:
    """Return names without the side of the body that all of them begin or end with, such as "left_" or "_L"."""
    for start, end in ((SIDES, ""), ("", SIDES)):
        found = [re.fullmatch(f"({start})((?!hand[_.-]).{{2,}}?)({end})", name, re.IGNORECASE) for name in names]
        sides = {(match[1], match[3]) for match in found if match}
        if all(found) and len(sides) == 1:
            names = [match[2] for match in found if match]
    return names


def template(tree: Tree) -> str:
    """Return the lines of a YAML with the palm and the fingertips of a tree's first hand, as far as its links tell."""
    hands = hands_in(replace(tree, links=dict.fromkeys(tree.links, trimesh.Trimesh())), solid=False)
    if hands:
        palm, fingertips = hands[0].palm, hands[0].fingertips
    else:
        named = sorted((link for link in tree.links if "palm" in link.lower()), key=len)
        palm = [*named, *(joint.parent for joint in tree.joints if not joint.fixed), *tree.links][0]
        ends = [link for link in tree.links if link not in tree.hanging]
        fingertips = digit_names(tree, ends, body=[palm])
    lines = {"palm": palm, "fingertips": fingertips}
    return yaml.safe_dump(lines, sort_keys=False, default_flow_style=None, width=1000)
