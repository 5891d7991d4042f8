"""Any hand from a URDF and a short YAML beside it.

Geometry is what the YAML's `geometry` key says (`collision` by default) and never a mixture: a link without such elements
has no geometry. Several elements of one link are taken together. Read: mesh, box, cylinder, sphere, capsule.
"""

from collections import Counter
from itertools import takewhile
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
import yaml
from jaxtyping import Float

from dexnudge.errors import HandError
from dexnudge.hands import link_meshes
from dexnudge.hands.config import HandConfig, read_hand_config
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import load_link_mesh, mesh_path
from dexnudge.hands.tree import MAX_LINKS, Mimic, Tree, TreeJoint, check_tree, hand_from_tree
from dexnudge.hands.xml_text import read_xml

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
PLACING_TYPES = ("planar", "floating")  # read where they place the hand in the world, above the palm
LARGEST_LIMIT = 2 * np.pi + 0.1  # [rad] no joint of a hand turns farther: the number is in degrees
CONTINUOUS_LIMIT = np.pi  # [rad] either way: a joint without limits still needs a finite range to sample from


def hand_from_urdf(path: Path | str, config: HandConfig | Path | str | None = None, *, base: bool = True) -> Hand:
    """Return the hand that a URDF describes, its palm as the root.

    Args:
        path: the URDF. Meshes must lie in its folder or below.
        config: facts that URDF cannot state, or their YAML file; None: `<stem>.yaml` or `hand.yaml` beside the URDF.
        base: whether the links behind the palm (those on the side of `base_link`) are kept.

    Raises:
        HandError: anything that cannot be used as given, with the place and the remedy.
    """
    path = Path(path)
    robot = read_xml(path, root_tag="robot")
    joints = _joints(robot, path)
    link_names = [_attribute(link, "name", path, "link") for link in robot.findall("link")]
    _refuse_doubles("link", link_names, path)
    _refuse_doubles("joint", [joint.name for joint in joints], path)
    structure = Tree(robot.get("name") or path.stem, {name: trimesh.Trimesh() for name in link_names}, tuple(joints))
    if not 0 < len(link_names) <= MAX_LINKS:
        found = f"{len(link_names):,}" if link_names else "none"
        at_most = f"at most {MAX_LINKS:,} " if link_names else ""
        raise HandError(f"{path}: expected {at_most}<link> elements, found {found}; mend or re-export the URDF")
    check_tree(structure)
    settings = config if isinstance(config, HandConfig) else read_hand_config(config_path(path, config, structure))
    links = {
        name: _link_mesh(link, settings.geometry, path)
        for name, link in zip(link_names, robot.findall("link"), strict=True)
    }
    return hand_from_tree(Tree(structure.name, links, structure.joints), settings, base=base)


def config_path(path: Path, config: Path | str | None, tree: Tree) -> Path:
    """Return the YAML of a description file; without one, HandError says what to write, as far as the tree tells."""
    if config is not None:
        return Path(config)
    for candidate in (path.with_suffix(".yaml"), path.with_name("hand.yaml")):
        if candidate.is_file():
            return candidate
    names = " or ".join(dict.fromkeys([path.with_suffix(".yaml").name, "hand.yaml"]))
    template = yaml.safe_dump(_proposal(tree), sort_keys=False, default_flow_style=None, width=1000)
    raise HandError(
        f"{path} has no YAML beside it: expected {names} with the palm, "
        "the fingertips and the direction in which the palm faces; check these lines, write the direction in the palm's "
        f"frame in place of x, y and z, and save them there:\n{template}palm_normal: [x, y, z]"
    )


def _proposal(tree: Tree) -> dict[str, Any]:
    """Return what the tree tells of palm and fingertips: links by name, the digits named by what their links share."""
    carriers = [joint.parent for joint in tree.joints]
    moving = [joint.parent for joint in tree.joints if not (joint.fixed or joint.slides or joint.places)]
    named = sorted((link for link in tree.links if "palm" in link.lower()), key=len)
    branching = [link for link in tree.links if carriers.count(link) > 1]
    palm = [*named, *branching, *moving, *tree.links][0]
    parent = {joint.child: joint.parent for joint in tree.joints}
    fingertips = {}
    for tip in (link for link in tree.links if link not in carriers):
        chain = [tip]
        while chain[-1] in parent and parent[chain[-1]] not in (palm, *branching):
            chain.append(parent[chain[-1]])
        alike = takewhile(lambda letters: len(set(letters)) == 1, zip(*chain, strict=False))
        shared = "".join(letters[0] for letters in alike).rstrip("_-. 0123456789")
        fingertips[shared if shared and shared not in fingertips else tip] = tip
    return {"palm": palm, "fingertips": fingertips}


def _joints(robot: Element, path: Path) -> list[TreeJoint]:
    joints = []
    for element in robot.findall("joint"):
        name = _attribute(element, "name", path, "joint")
        where = f"{path}: joint '{name}'"
        kind = element.get("type")
        if kind not in (*JOINT_TYPES, *PLACING_TYPES):
            raise HandError(
                f"{where}: expected type {', '.join(JOINT_TYPES)}, got '{kind}'; replace the joint or fix it"
            )
        ends = []
        for role in ("parent", "child"):
            end = element.find(role)
            if end is None or not end.get("link"):
                raise HandError(f"{where}: expected <{role} link=...>, found none; add it")
            ends.append(end.get("link") or "")
        axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), where)
        length = np.linalg.norm(axis)
        if length == 0.0 and kind in ("fixed", "floating", "planar"):
            axis, length = np.asarray((1.0, 0.0, 0.0)), np.float64(1.0)
        if length == 0.0:
            raise HandError(f"{where}: expected an axis of non-zero length, got {axis.tolist()}; mend <axis>")
        parent, child = ends
        moves = kind in JOINT_TYPES and kind != "fixed"
        mimic = _mimic(element.find("mimic"), where) if moves else None
        lower, upper = _limits(element, kind, where) if moves and mimic is None else (0.0, 0.0)
        joints.append(
            TreeJoint(
                name,
                parent,
                child,
                _origin(element, where),
                axis / length,
                fixed=kind == "fixed",
                lower=lower,
                upper=upper,
                mimic=mimic,
                slides=kind == "prismatic",
                places=kind if kind in PLACING_TYPES else None,
            )
        )
    return joints


def _limits(joint: Element, kind: str, where: str) -> tuple[float, float]:
    if kind == "continuous":
        return -CONTINUOUS_LIMIT, CONTINUOUS_LIMIT
    limit = joint.find("limit")
    missing = [key for key in ("lower", "upper") if limit is None or limit.get(key) is None]
    if missing and kind == "prismatic":  # one that places the hand in the world needs none
        return -np.inf, np.inf
    if missing:
        raise HandError(f"{where}: expected <limit lower=... upper=...> in radians, missing {missing}; add them")
    lower, upper = (float(_numbers(limit, key, (0.0,), where)[0]) for key in ("lower", "upper"))
    if lower > upper:
        raise HandError(f"{where}: expected lower limit <= upper limit, got {lower} > {upper}; swap or mend them")
    if kind != "prismatic" and max(-lower, upper) > LARGEST_LIMIT:
        raise HandError(
            f"{where}: expected limits in radians, got {lower:g} to {upper:g}, that is up to "
            f"{np.degrees(max(-lower, upper)):.0f} degrees; in degrees? write {np.radians(lower):.4f} to "
            f"{np.radians(upper):.4f}"
        )
    return lower, upper


def _mimic(element: Element | None, where: str) -> Mimic | None:
    if element is None:
        return None
    leader = element.get("joint")
    if not leader:
        raise HandError(f"{where}: expected <mimic joint=...>, found no joint; add it")
    multiplier = float(_numbers(element, "multiplier", (1.0,), where)[0])
    return Mimic(leader, multiplier, float(_numbers(element, "offset", (0.0,), where)[0]))


def _link_mesh(link: Element, geometry: str, path: Path) -> trimesh.Trimesh:
    where = f"{path}: link '{link.get('name')}'"
    pieces = []
    for element in link.findall(geometry):
        shape = element.find("geometry")
        if shape is None or len(shape) != 1:
            raise HandError(f"{where}: expected <{geometry}> with one shape in <geometry>, found none; add it")
        piece = _shape(shape[0], where, path.parent)
        piece.apply_transform(_origin(element, where))
        pieces.append(piece)
    if not pieces:
        return trimesh.Trimesh()
    return pieces[0] if len(pieces) == 1 else trimesh.util.concatenate(pieces)


def _shape(shape: Element, where: str, folder: Path) -> trimesh.Trimesh:
    if shape.tag == "mesh":
        file = mesh_path(shape.get("filename") or "", folder)
        scale = _numbers(shape, "scale", (1.0, 1.0, 1.0), where)
        return load_link_mesh(file, scale)
    if shape.tag not in ("box", "cylinder", "sphere", "capsule"):
        raise HandError(
            f"{where}: expected mesh, box, cylinder, sphere or capsule, got <{shape.tag}>; replace it by a mesh"
        )
    keys = {"box": ("size",), "sphere": ("radius",)}.get(shape.tag, ("radius", "length"))
    sizes = [_numbers(shape, key, (0.0,) * (3 if key == "size" else 1), where) for key in keys]
    if not all((size > 0.0).all() for size in sizes):
        raise HandError(
            f"{where}: <{shape.tag}>: expected {' and '.join(keys)} above zero, got {shape.attrib}; mend it"
        )
    if shape.tag == "box":
        return link_meshes.box(sizes[0])
    return getattr(link_meshes, shape.tag)(*(float(size[0]) for size in sizes))


def _origin(element: Element, where: str) -> Float[np.ndarray, "4 4"]:
    origin = element.find("origin")
    transform = trimesh.transformations.euler_matrix(*_numbers(origin, "rpy", (0.0, 0.0, 0.0), where), axes="sxyz")
    transform[:3, 3] = _numbers(origin, "xyz", (0.0, 0.0, 0.0), where)
    return transform


def _numbers(element: Element | None, key: str, default: tuple[float, ...], where: str) -> np.ndarray:
    """Return the numbers in an attribute, as many as the default has; the default where there is no such attribute."""
    text = None if element is None else element.get(key)
    if text is None:
        return np.asarray(default)
    try:
        values = np.asarray([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != len(default) or not np.isfinite(values).all():
        raise HandError(f"{where}: expected {len(default)} finite number(s) in '{key}', got '{text}'; mend it")
    return values


def _attribute(element: Element, key: str, path: Path, kind: str) -> str:
    value = element.get(key)
    if not value:
        raise HandError(f"{path}: expected a {key} on every <{kind}>, found one without; add it")
    return value


def _refuse_doubles(kind: str, names: list[str], path: Path) -> None:
    doubles = [name for name, count in Counter(names).items() if count > 1]
    if doubles:
        raise HandError(f"{path}: expected each {kind} name once, got {doubles} more than once; rename them")
