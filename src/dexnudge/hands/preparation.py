"""Any robot description made into a hand: palm, fingertips and the palm's direction are found where nobody stated them.

What is found so is an assumption: a note that says what, why, and how to change it. What is no hand is refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import HandError, check_path, quote
from dexnudge.finding import Finding, length_text
from dexnudge.geometry.devices import own_modes
from dexnudge.hands.anatomy import LEAST_DIGITS, LONGEST_DIGIT, HandPart, hand_at, hands_in, why_no_hand
from dexnudge.hands.checks import direction_numbers, hand_findings
from dexnudge.hands.closing import Closing, closing, tip_distance
from dexnudge.hands.config import GEOMETRIES, LONGEST_QUOTE, HandConfig, read_hand_config, unit_direction, yaml_beside
from dexnudge.hands.hand import Hand
from dexnudge.hands.named import HANDS
from dexnudge.hands.registry import PREPARED_NAME, check_packages, is_description, load_hand, read_hand, read_tree
from dexnudge.hands.tree import Tree, check_sizes

MOST_JOINTS = 40  # independent ones; the Shadow hand has 24, a human hand 27
LEAST_CONFIDENCE = 0.5  # of where the palm faces; below, it is asked for
FARTHEST_TIPS = 0.08  # [m] between tips when closed: a phone is 75 mm wide; what stays farther apart opposes nothing
BAR_REACH = 0.9  # of another digit's: a chain on the same motor that ends on that one, and is shorter, is its linkage
BAR_GAP = 0.002  # [m] between such a bar and what it drives
UNKNOWN = (0.0, 0.0, 1.0)  # in place of a palm's direction while that is being found


@dataclass(frozen=True)
class PreparedHand:
    """A hand, how it closes, and what was assumed and found out about it.

    Attributes:
        hand: the hand, palm as its root.
        closing: its open, rest and closed poses, and where its palm faces as far as its joints tell.
        assumptions: what nobody stated; the remedy says how to change it.
    """

    hand: Hand
    closing: Closing
    assumptions: tuple[Finding, ...]

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The assumptions, the notes of the reader, and the checks."""
        notes = [Finding("note", "description", note) for note in self.hand.notes]
        return (*self.assumptions, *notes, *hand_findings(self.hand, self.closing))


@own_modes()
def prepare_hand(
    name_or_path: str | Path,
    *,
    palm: str | None = None,
    palm_normal: Sequence[float] | None = None,
    geometry: str | None = None,
    base: bool = True,
    packages: Mapping[str, Path | str] | None = None,
) -> PreparedHand:
    """Return a hand from any URDF or MJCF, checked; a YAML beside it, if there is one, states what it states.

    Args:
        name_or_path: a description (.urdf or .xml), a prepared folder, or the name of a built-in hand.
        palm: the link from which the digits branch, where a description has several hands or another link is meant.
        palm_normal: direction in which the palm faces, palm frame; found from how the fingers close unless given.
        geometry: "collision" or "visual"; collision unless there is none.
        base: whether the forearm or adapter behind the palm is part of the hand.
        packages: folders of the ROS packages that a description names, by their names.

    Raises:
        UnknownNameError: neither a known name nor a path of a description.
        HandError: a description that cannot be used as given; one without a hand, with several, or one whose palm could
            face either way: the message says what to state.
    """
    check_path("name_or_path", name_or_path, HandError)
    check_packages(packages)
    if geometry not in (None, *GEOMETRIES):
        raise HandError(f"`geometry` is {geometry!r}; expected one of {', '.join(GEOMETRIES)}")
    path = Path(name_or_path)
    if (path / PREPARED_NAME).is_file():
        path /= PREPARED_NAME
    if str(name_or_path) in HANDS or not is_description(path):
        hand = load_hand(name_or_path, base=base)
        for argument, value in (("palm", palm), ("geometry", geometry), ("packages", packages)):
            if value:
                raise HandError(
                    f"`{argument}` is {quote(value)}, but {name_or_path} is a hand with a name, whose description states "
                    "its own; expected the path of a description with it; leave it out"
                )
        return _stated(hand, palm_normal)
    yaml = yaml_beside(path)
    config = None if yaml is None else read_hand_config(yaml)
    if config is not None and palm in (None, config.palm):
        config = replace(config, geometry=geometry or config.geometry)
        return _stated(read_hand(path, config, base=base, packages=packages), palm_normal)
    assumed: list[Finding] = []
    kind, tree = _tree(path, geometry, packages, assumed)
    part = _the_hand(path, tree, palm, assumed)
    config = HandConfig(part.palm, part.fingertips, UNKNOWN, base_link=part.base_link, geometry=kind)
    hand = _without_bars(read_hand(path, config, base=base, packages=packages))
    if hand.num_joints > MOST_JOINTS:
        raise HandError(
            f"{path}: the hand has {hand.num_joints} independent joints: expected at most {MOST_JOINTS}, as a human hand "
            "has 27; couple them with <mimic>, fix those that do not move fingers, or name the hand's own link with `palm`"
        )
    digits = ", ".join(link if digit == link else f"{digit}: {link}" for digit, link in hand.fingertips.items())
    tips = f"the fingertips are {digits}: the last links with geometry"
    assumed.append(Finding("note", "fingertips", tips, "mend 'fingertips' in the hand's YAML"))
    way = closing(hand)
    _refuse_far_tips(path, hand, way)
    if palm_normal is None:
        assumed.append(_assumed_direction(path, hand, way))
    facing = way.palm_normal if palm_normal is None else _unit(palm_normal)
    return PreparedHand(replace(hand, palm_normal=facing), way, tuple(assumed))


def _unit(direction: Sequence[float]) -> Float[np.ndarray, " 3"]:
    vector = unit_direction(direction)
    if vector is None:
        raise HandError(
            f"`palm_normal` is {str(direction)[:LONGEST_QUOTE]}; expected three finite numbers, not all zero"
        )
    return vector


def _stated(hand: Hand, palm_normal: Sequence[float] | None) -> PreparedHand:
    if palm_normal is not None:
        hand = replace(hand, palm_normal=_unit(palm_normal))
    return PreparedHand(hand, closing(hand), ())


def _tree(
    path: Path, geometry: str | None, packages: Mapping[str, Path | str] | None, assumed: list[Finding]
) -> tuple[str, Tree]:
    """Return the kind of geometry that a hand can be found with, and the tree with that; collision first."""
    trees: dict[str, Tree] = {}
    for kind in (geometry,) if geometry else GEOMETRIES:
        trees[kind] = read_tree(path, kind, packages=packages)
        if hands_in(trees[kind]):
            break
    else:  # errors name the kind that most links have
        kind = max(trees, key=lambda each: _solid_links(trees[each]))
    if geometry and not _solid_links(trees[kind]):
        other = next(each for each in GEOMETRIES if each != geometry)
        raise HandError(
            f"{path} has no {geometry} geometry, which `geometry` asks for; expected {other}, or leave it out"
        )
    if geometry is None and kind != GEOMETRIES[0] and hands_in(trees[kind]):
        sentence = f"{kind} geometry is judged: no hand has {GEOMETRIES[0]} geometry"
        assumed.append(Finding("note", "geometry", sentence, "`geometry` or 'geometry' in the hand's YAML choose"))
    return kind, trees[kind]


def _solid_links(tree: Tree) -> int:
    return sum(len(mesh.faces) > 0 for mesh in tree.links.values())


def _the_hand(path: Path, tree: Tree, palm: str | None, assumed: list[Finding]) -> HandPart:
    if palm is not None:
        return hand_at(tree, palm)
    hands = hands_in(tree)
    if not hands:
        check_sizes(tree)
        raise HandError(
            f"{path} holds no hand: expected a link from which at least {LEAST_DIGITS} digits branch that joints move, each "
            f"at most {LONGEST_DIGIT:g} m long, got {why_no_hand(tree)}; `palm` names the link if there is one"
        )
    if len(hands) > 1:
        names = ", ".join(hand.palm for hand in hands)
        raise HandError(f"{path} holds {len(hands)} hands: expected one; choose with `palm`, one of {names}")
    hand = hands[0]
    sentence = f"'{hand.palm}' is the palm: {len(hand.fingertips)} digits branch from it"
    assumed.append(Finding("note", "palm", sentence, "`palm` or 'palm' in the hand's YAML name another link"))
    if hand.base_link is not None:
        behind = f"'{hand.base_link}' stands behind the palm and is part of the hand"
        assumed.append(
            Finding("note", "base_link", behind, "leave it out with `base`, or mend 'base_link' in the hand's YAML")
        )
    return hand


def _refuse_far_tips(path: Path, hand: Hand, way: Closing) -> None:
    gap = tip_distance(hand, way.closed)
    if gap > FARTHEST_TIPS:
        raise HandError(
            f"{path}: no fingertip meets another: expected two within {length_text(FARTHEST_TIPS)} when the hand closes, "
            f"came {length_text(gap)} near; a hand needs an opposing surface: mend the limits, or state palm and fingertips "
            "in a YAML"
        )


def _assumed_direction(path: Path, hand: Hand, way: Closing) -> Finding:
    text = direction_numbers(way.palm_normal)
    if way.confidence < LEAST_CONFIDENCE:
        why = f"; {way.doubt}" if way.doubt else ""
        raise HandError(
            f"{path}: where the palm '{hand.link_names[0]}' faces is not clear: confidence {way.confidence:.2f} for {text}, "
            f"expected at least {LEAST_CONFIDENCE}{why}; state it with `palm_normal` X Y Z in the frame of "
            f"'{hand.link_names[0]}'"
        )
    sentence = (
        f"the palm faces {text} in the frame of '{hand.link_names[0]}', with confidence {way.confidence:.2f}: there the "
        "pads face and the tips meet when the hand closes"
    )
    return Finding("note", "palm_normal", sentence, "`palm_normal` or 'palm_normal' in the hand's YAML state another")


def _without_bars(hand: Hand) -> Hand:
    """Return the hand without the digits that are bars of another's linkage.

    Such a bar has no motor of its own, reaches less far, and touches the other digit however far that is closed.
    """
    shares = np.array([0.0, 0.5, 1.0])[:, None]
    poses = hand.forward_kinematics(hand.at_origin(hand.lower + shares * (hand.upper - hand.lower))).numpy()
    links = {
        digit: [name for name in hand.link_names if hand.digit_of_link[name] == digit] for digit in hand.fingertips
    }
    joints = dict(zip(hand.link_names, hand.joints, strict=True))
    motors = {digit: {joint.index for name in links[digit] if (joint := joints[name])} - {None} for digit in links}

    def corners(link: str, pose: int) -> Float[np.ndarray, "corner 3"]:
        index = hand.link_names.index(link)
        return trimesh.transform_points(hand.link_meshes[index].vertices, poses[pose, index])

    def touches(tip: str, link: str, pose: int) -> bool:
        index = hand.link_names.index(link)
        if not len(hand.link_meshes[index].faces):
            return False
        points = trimesh.transform_points(corners(tip, pose), np.linalg.inv(poses[pose, index]))
        low, high = hand.link_meshes[index].bounds
        return bool(((points > low - BAR_GAP) & (points < high + BAR_GAP)).all(axis=1).any())

    reach = {digit: np.linalg.norm(corners(tip, 1), axis=1).max() for digit, tip in hand.fingertips.items()}
    bars = {
        digit
        for digit, tip in hand.fingertips.items()
        for other in hand.fingertips
        if other != digit and motors[digit] <= motors[other] and reach[digit] < BAR_REACH * reach[other]
        if all(any(touches(tip, link, pose) for link in links[other]) for pose in range(3))
    }
    kept = {digit: tip for digit, tip in hand.fingertips.items() if digit not in bars}
    return replace(hand, fingertips=kept) if len(kept) >= LEAST_DIGITS else hand
