"""What of a tree cannot be a hand's: names in the YAML that do not exist, sizes in another unit, joints of another kind."""

import math

from scipy.spatial import ConvexHull, QhullError

from dexnudge.errors import HandError
from dexnudge.hands.config import HandConfig
from dexnudge.hands.tree import Tree

LONGEST_LINK = 2.0  # [m] a forearm or a stand; longer is in another unit
FLATTEST_LINK = 1e-9  # volume of the hull / longest side cubed


def check_names(tree: Tree, config: HandConfig) -> None:
    """Refuse a YAML that names links or joints that do not exist, or couples joints that cannot be."""
    named = {"palm": config.palm, "base_link": config.base_link}
    named |= {f"fingertips.{digit}": link for digit, link in config.fingertips.items()}
    for key, link in named.items():
        if link is not None and link not in tree.links:
            raise HandError(
                f"the hand's YAML names an unknown link: key '{key}': "
                f"expected one of {list(tree.links)}, got '{link}'; mend it"
            )
    above = {joint.child: joint.parent for joint in tree.joints}
    for digit, link in config.fingertips.items():
        chain = [link]
        while chain[-1] in above and chain[-1] != config.palm:
            chain.append(above[chain[-1]])
        if config.base_link in chain[:-1] and chain[-1] == config.palm:
            raise HandError(
                f"the hand's YAML names '{config.base_link}' as 'base_link', which is part of digit '{digit}': expected a "
                "link behind the palm; mend it"
            )
    movable = [joint.name for joint in tree.joints if not joint.fixed and joint.mimic is None]
    for follower, leader in config.couplings:
        for name in (follower, leader):
            if name not in movable:
                raise HandError(
                    "the hand's YAML couples an unknown joint: key 'couplings': "
                    f"expected some of {movable}, got '{name}'; mend it"
                )
        if follower == leader or (leader, follower) in config.couplings:
            raise HandError(
                f"coupling {follower} <= {leader} holds a joint to itself: expected pairs [follower, leader] without a "
                "circle; remove one"
            )
        limits = {joint.name: joint for joint in tree.joints}
        if limits[follower].lower > limits[leader].upper:
            raise HandError(
                f"coupling {follower} <= {leader} cannot hold: expected {follower}'s lower limit at most {leader}'s upper, "
                f"got {limits[follower].lower} and {limits[leader].upper} rad; swap the pair or mend the limits"
            )


def check_sizes(tree: Tree, longest_link: float = LONGEST_LINK) -> None:
    """Refuse links that are too long [m] or too far from each other, or flat."""
    for joint in tree.joints:
        distance = math.hypot(*joint.origin[:3, 3])
        if distance > longest_link:
            raise HandError(
                f"joint '{joint.name}' lies {distance:.3g} m from the frame of '{joint.parent}': expected at most "
                f"{longest_link:g} m; in millimetres? give its origin in metres"
            )
    for link, mesh in tree.links.items():
        if not len(mesh.faces):
            continue
        longest = float(mesh.extents.max())
        if longest > longest_link:
            raise HandError(
                f"link '{link}' is {longest:.3g} m long: expected at most {longest_link:g} m; in millimetres? "
                'give its mesh scale="0.001 0.001 0.001", or a basic shape its size in metres'
            )
        try:
            volume = ConvexHull(mesh.vertices / longest).volume
        except QhullError:
            volume = 0.0
        if volume < FLATTEST_LINK:
            raise HandError(
                f"the geometry of link '{link}' is flat: expected a body with a thickness, which physics needs; "
                "give it one, or replace it by a thin box"
            )


def check_joints(tree: Tree, config: HandConfig) -> None:
    """Refuse joints that neither turn nor slide, and couplings of a slide with an angle."""
    for joint in tree.joints:
        if joint.places is not None:
            raise HandError(
                f"joint '{joint.name}': expected type revolute, continuous, prismatic, fixed, got '{joint.places}'; "
                "replace the joint or fix it"
            )
    slides = {joint.name: joint.slides for joint in tree.joints}
    for follower, leader in config.couplings:
        if slides[follower] != slides[leader]:
            raise HandError(
                f"coupling {follower} <= {leader} compares a slide with an angle: expected joints of one kind; mend the pair"
            )
