"""What of a description is the hand: without the arm, the joints that place it in the world and, on request, the base."""

from dataclasses import replace

from dexnudge.hands.config import HandConfig
from dexnudge.hands.tree import Tree, TreeJoint, chain_to, check_names, check_tree, joints_below

WORLD = "world"  # MuJoCo's name for what does not move
WRIST_JOINTS = 3  # above the palm; more are an arm's


def without_arm(tree: Tree, config: HandConfig) -> Tree:
    """Return what hangs in the world as a hand, without an arm and other joints that place it; see `notes`.

    Raises:
        HandError: a structure that is no tree, or names that do not exist.
    """
    check_tree(tree)
    check_names(tree, config)
    notes: list[str] = []
    cut = _without_placing_joints(tree, config, notes)
    cut = _without_slides_above(_without_long_chain(cut, config, notes), config, notes)
    return replace(_without_empty_world(cut, config), notes=(*tree.notes, *notes))


def _without_empty_world(tree: Tree, config: HandConfig) -> Tree:
    """Return the tree without an empty root called "world" to which the hand is fixed."""
    mounts = [joint for joint in tree.joints if joint.parent == WORLD]
    named = {config.palm, config.base_link, *config.fingertips.values()}
    root = WORLD in tree.links and WORLD not in named and all(joint.child != WORLD for joint in tree.joints)
    if not root or len(mounts) != 1 or not mounts[0].fixed or len(tree.links[WORLD].faces):
        return tree
    return below(tree, mounts[0].child)


def renamed_world(tree: Tree, config: HandConfig) -> tuple[Tree, HandConfig]:
    """Return tree and facts with another name for a link called "world", which is MuJoCo's own; see `notes`."""
    if WORLD not in tree.links:
        return tree, config
    name = f"{WORLD}_link"
    while name in tree.links:
        name += "_"
    new = {link: name if link == WORLD else link for link in tree.links}
    joints = tuple(replace(joint, parent=new[joint.parent], child=new[joint.child]) for joint in tree.joints)
    config = replace(
        config,
        palm=new[config.palm],
        fingertips={digit: new[link] for digit, link in config.fingertips.items()},
        base_link=None if config.base_link is None else new[config.base_link],
    )
    note = f"link '{WORLD}' is called '{name}' here: MuJoCo keeps that name for what does not move"
    links = {new[link]: mesh for link, mesh in tree.links.items()}
    return replace(tree, links=links, joints=joints, notes=(*tree.notes, note)), config


def _without_placing_joints(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree without the empty links at its root, if a joint among them does not turn: it places the hand.

    The root of q places the hand.
    """
    hanging: dict[str, list[TreeJoint]] = {link: [] for link in tree.links}
    for joint in tree.joints:
        hanging[joint.parent].append(joint)
    link = next(iter(set(tree.links) - {joint.child for joint in tree.joints}))
    cut: list[TreeJoint] = []
    while len(hanging[link]) == 1 and not len(tree.links[link].faces) and link not in (config.palm, config.base_link):
        cut += hanging[link]
        link = hanging[link][0].child
    if any(joint.slides or joint.places for joint in cut):
        moving = ", ".join(joint.name for joint in cut if not joint.fixed)
        notes.append(f"joints that place the hand in the world were cut off: {moving}")
        gone = {joint.parent for joint in cut}
        links = {name: mesh for name, mesh in tree.links.items() if name not in gone}
        tree = replace(tree, links=links, joints=tuple(joint for joint in tree.joints if joint not in cut))
    return tree


def _without_long_chain(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below `base_link`, or below the palm where more joints than a wrist has lie above it.

    What is cut off is an arm, or a whole robot with its other arm.
    """
    place = _place(tree, config)
    above = reversed(chain_to(tree, place))
    cut = [joint.name for joint in above if not (joint.fixed or joint.slides or joint.places)]
    if len(cut) <= (0 if place != config.palm else WRIST_JOINTS):
        return tree
    kept = below(tree, place)
    notes.append(
        f"an arm of {len(cut)} joints, {cut[-1]} to {cut[0]}, was cut off above '{place}' with "
        f"{len(tree.links) - len(kept.links)} links; "
        "'base_link' in the hand's YAML names the last link behind the palm that stays"
    )
    return kept


def _without_slides_above(tree: Tree, config: HandConfig, notes: list[str]) -> Tree:
    """Return the tree below the last joint that slides above palm and fingertips, such as a gantry's or a lift's."""
    for joint in reversed(chain_to(tree, _place(tree, config))):
        kept = below(tree, joint.child)
        if (joint.slides or joint.places) and set(config.fingertips.values()) <= set(kept.links):
            notes.append(
                f"'{joint.name}', which moves '{joint.child}' along, was cut off with "
                f"{len(tree.links) - len(kept.links)} links"
            )
            return kept
    return tree


def without_base(tree: Tree, config: HandConfig) -> Tree:
    """Return the tree without the links on the base's side of the palm that lead to no fingertip."""
    parent = {joint.child: joint.parent for joint in tree.joints}

    def above(link: str) -> list[str]:
        chain = [link]
        while chain[-1] in parent:
            chain.append(parent[chain[-1]])
        return chain

    assert config.base_link is not None
    if config.base_link == config.palm:
        return tree
    arm = above(config.base_link)[-2]
    kept = {link for tip in config.fingertips.values() for link in above(tip)}
    gone = {link for link in tree.links if arm in above(link) and link not in kept}
    links = {name: mesh for name, mesh in tree.links.items() if name not in gone}
    return replace(tree, links=links, joints=tuple(joint for joint in tree.joints if joint.child not in gone))


def _place(tree: Tree, config: HandConfig) -> str:
    """Return the link at which the hand hangs in the world: the base where the palm hangs from it, else the palm."""
    if config.base_link is not None and config.palm in below(tree, config.base_link).links:
        return config.base_link
    return config.palm


def below(tree: Tree, link: str) -> Tree:
    """Return the tree of a link and all links below it."""
    kept = {link, *(joint.child for joint in joints_below(tree, link))}
    links = {name: mesh for name, mesh in tree.links.items() if name in kept}
    return replace(tree, links=links, joints=tuple(joint for joint in tree.joints if joint.parent in kept))
