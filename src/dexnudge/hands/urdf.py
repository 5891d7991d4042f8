"""Any hand from a URDF and a short YAML beside it.

Geometry is what the YAML's `geometry` key says (`collision` by default) and never a mixture: a link without such elements
has no geometry. Several elements of one link are taken together. Read: mesh, box, cylinder, sphere, capsule.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import trimesh
from jaxtyping import Float

from dexnudge.errors import HandError, printable_name
from dexnudge.hands import link_meshes
from dexnudge.hands.anatomy import template
from dexnudge.hands.assembly import hand_from_tree
from dexnudge.hands.config import GEOMETRIES, HandConfig, read_hand_config, yaml_beside
from dexnudge.hands.hand import Hand
from dexnudge.hands.link_meshes import load_link_mesh, mesh_path
from dexnudge.hands.tree import CONTINUOUS_LIMIT, MAX_LINKS, MAX_SHAPES, Mimic, Tree, TreeJoint, check_tree
from dexnudge.hands.xacro_expansion import expand_xacro
from dexnudge.hands.xml_text import read_xml

SHAPES = ("mesh", "box", "cylinder", "sphere", "capsule")
MOST_NAMES = 5  # links that a note names


def link_mesh(
    link: Element, geometry: str, path: Path, packages: Mapping[str, Path | str] | None, notes: list[str]
) -> trimesh.Trimesh:
    """Return all of a link's `collision` or `visual` shapes as one mesh in the link frame [m].

    An element without a shape is left out with a note where the link has others.

    Raises:
        HandError: no shape at all in a link's elements, or one that is not read or has no size.
    """
    where = f"{path}: link '{link.get('name')}'"
    pieces, empty = [], []
    for element in link.findall(geometry):
        shape = element.find("geometry")
        if shape is None or len(shape) != 1:
            empty.append(
                f"expected <{geometry}> with one shape in <geometry>, found {'none' if not shape else 'several'}"
            )
        elif shape[0].tag not in SHAPES:
            empty.append(f"expected {', '.join(SHAPES[:-1])} or {SHAPES[-1]}, got <{shape[0].tag}>")
        else:
            piece = _shape(shape[0], where, path.parent, packages)
            piece.apply_transform(origin(element, where))
            pieces.append(piece)
    if empty and not pieces:
        raise HandError(f"{where}: {empty[0]}; add one, replace it by a mesh, or remove the element")
    if empty:
        notes.append(f"link '{link.get('name')}': {empty[0]}: left out, the link has others")
    return trimesh.util.concatenate(pieces) if len(pieces) > 1 else next(iter(pieces), trimesh.Trimesh())


def _shape(shape: Element, where: str, folder: Path, packages: Mapping[str, Path | str] | None) -> trimesh.Trimesh:
    if shape.tag == "mesh":
        file = mesh_path(shape.get("filename") or "", folder, packages)
        return load_link_mesh(file, numbers_of(shape, "scale", (1.0, 1.0, 1.0), where))
    keys = {"box": ("size",), "sphere": ("radius",)}.get(shape.tag, ("radius", "length"))
    sizes = [numbers_of(shape, key, (0.0,) * (3 if key == "size" else 1), where) for key in keys]
    if not all((size > 0.0).all() for size in sizes):
        raise HandError(
            f"{where}: <{shape.tag}>: expected {' and '.join(keys)} above zero, got {shape.attrib}; mend it"
        )
    return getattr(link_meshes, shape.tag)(*(size if len(size) > 1 else float(size[0]) for size in sizes))


def note_masses(links: list[Element], path: Path, notes: list[str]) -> None:
    """Note the links whose mass or moments of inertia cannot be; HandError where one is no number."""
    wrong = []
    for link in links:
        if (inertial := link.find("inertial")) is None:
            continue
        where = f"{path}: link '{link.get('name')}'"
        mass = numbers_of(inertial.find("mass"), "value", (0.0,), where)
        moments = [numbers_of(inertial.find("inertia"), key, (0.0,), where) for key in ("ixx", "iyy", "izz")]
        if min(mass, *moments) <= 0.0:
            wrong.append(str(link.get("name")))
    if wrong:
        more = f" and {len(wrong) - MOST_NAMES} more" if len(wrong) > MOST_NAMES else ""
        notes.append(
            f"mass or moments of inertia of {', '.join(wrong[:MOST_NAMES])}{more} are not above zero: each link has that of "
            "its geometry in plastic"
        )


def origin(element: Element, where: str) -> Float[np.ndarray, "4 4"]:
    """Return the pose in an element's <origin>, that of its parent's frame where there is none."""
    place = element.find("origin")
    rpy = numbers_of(place, "rpy", (0.0, 0.0, 0.0), where)
    if (np.abs(rpy) > MOST_TURNED).any():
        raise HandError(
            f"{where}: expected angles of at most {MOST_TURNED:g} rad in 'rpy', got {rpy.tolist()}; mend <origin>"
        )
    transform = trimesh.transformations.euler_matrix(*rpy, axes="sxyz")
    transform[:3, 3] = numbers_of(place, "xyz", (0.0, 0.0, 0.0), where)
    return transform


def numbers_of(
    element: Element | None, key: str, default: tuple[float, ...], where: str, *, finite: bool = True
) -> np.ndarray:
    """Return the numbers in an attribute, as many as the default has; the default where there is no such attribute."""
    text = None if element is None else element.get(key)
    if text is None:
        return np.asarray(default)
    try:
        values = np.asarray([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != len(default) or np.isnan(values).any() or (finite and np.isinf(values).any()):
        raise HandError(f"{where}: expected {len(default)} finite number(s) in '{key}', got '{text}'; mend it")
    return values


MOST_TURNED = 1000.0  # [rad] of a roll, pitch or yaw; beyond some 1e16 a double is no angle any more
ONCE = ("parent", "child", "origin", "axis", "limit", "mimic")  # in a joint: of two, readers take one or the other
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
PLACING_TYPES = ("planar", "floating")  # read where they place the hand in the world, above the palm


def hand_from_urdf(
    path: Path | str,
    config: HandConfig | None = None,
    *,
    base: bool = True,
    packages: Mapping[str, Path | str] | None = None,
) -> Hand:
    """Return the hand that a URDF describes, its palm as the root.

    Args:
        path: the URDF, or a xacro file where the package xacro is installed. Meshes must lie in its folder or below, in the
            ROS package around it, or in one of `packages`.
        config: facts that URDF cannot state; None: those of `<stem>.yaml` or `hand.yaml` beside the URDF.
        base: whether the links behind the palm (those on the side of `base_link`) are kept.
        packages: folders of packages that `package://NAME/...` and `$(find NAME)` name.

    Raises:
        HandError: anything that cannot be used as given, with the place and the remedy.
    """
    path = Path(path)
    with _read(path, packages) as robot:
        structure = _structure(robot, path)
        config = config or config_beside(path, structure)
        return hand_from_tree(_with_geometry(structure, robot, config.geometry, path, packages), config, base=base)


def urdf_tree(
    path: Path,
    geometry: str,
    packages: Mapping[str, Path | str] | None = None,
    *,
    only: Collection[str] | None = None,
) -> Tree:
    """Return the tree of a URDF with its "collision" or "visual" geometry, of some links `only` where they are named.

    Raises:
        HandError: what `hand_from_urdf` refuses, whatever the palm.
    """
    with _read(path, packages) as robot:
        return _with_geometry(_structure(robot, path), robot, geometry, path, packages, only)


@contextmanager
def _read(path: Path, packages: Mapping[str, Path | str] | None) -> Iterator[Element]:
    """Give the root element; what is refused of a file that xacro expanded says where its URDF can be seen."""
    expanded: list[str] = []

    def expand(file: Path) -> str | None:
        text = expand_xacro(file, packages)
        expanded.extend([text] if text else [])
        return text

    robot = read_xml(path, root_tag="robot", expand=expand)
    try:
        yield robot
    except HandError as error:
        if not expanded:
            raise
        raise HandError(f"{error}; {path.name} is xacro, look at what it gives: xacro {path.name}") from error


def _structure(robot: Element, path: Path) -> Tree:
    """Return the links, without geometry, and the joints."""
    elements = robot.findall("link")
    if not 0 < len(elements) <= MAX_LINKS:
        found = f"{len(elements):,}" if elements else "none"
        at_most = f"at most {MAX_LINKS:,} " if elements else ""
        raise HandError(f"{path}: expected {at_most}<link> elements, found {found}; mend or re-export the URDF")
    shapes = max(len(robot.findall(f"link/{kind}")) for kind in GEOMETRIES)
    if shapes > MAX_SHAPES:
        raise HandError(f"{path}: expected at most {MAX_SHAPES:,} shapes, found {shapes:,}; join them to meshes")
    notes: list[str] = []
    joints = _joints(robot, path)
    link_names = [_name(link, path) for link in elements]
    _refuse_doubles("link", link_names, path)
    _refuse_doubles("joint", [joint.name for joint in joints], path)
    if (missing := _missing_base(link_names, joints)) is not None:
        notes.append(f"link '{missing}', from which the others hang, does not exist: an empty one stands for it")
        link_names.insert(0, missing)
    structure = Tree(
        robot.get("name") or printable_name(path.stem), {name: trimesh.Trimesh() for name in link_names}, tuple(joints)
    )
    check_tree(structure)
    note_masses(elements, path, notes)
    return replace(structure, notes=tuple(notes))


def _with_geometry(
    structure: Tree,
    robot: Element,
    geometry: str,
    path: Path,
    packages: Mapping[str, Path | str] | None,
    only: Collection[str] | None = None,
) -> Tree:
    links, notes = dict(structure.links), list(structure.notes)
    for link in robot.findall("link"):
        if only is None or link.get("name") in only:
            links[str(link.get("name"))] = link_mesh(link, geometry, path, packages, notes)
    return replace(structure, links=links, notes=tuple(notes))


def _missing_base(link_names: list[str], joints: list[TreeJoint]) -> str | None:
    """Return the link from which all others hang, where the file has only its name."""
    children = {joint.child for joint in joints}
    unknown = {joint.parent for joint in joints} - set(link_names)
    hangs = len(unknown) == 1 and set(link_names) <= children and not unknown & children
    return unknown.pop() if hangs else None


def config_beside(path: Path, tree: Tree) -> HandConfig:
    """Return what the YAML beside a description states; HandError says what to write, as far as the tree tells."""
    if (beside := yaml_beside(path)) is not None:
        return read_hand_config(beside)
    names = " or ".join(dict.fromkeys([path.with_suffix(".yaml").name, "hand.yaml"]))
    raise HandError(
        f"{path} has no YAML beside it: expected {names} with the palm, the fingertips and the direction in which the palm "
        "faces; let `prepare` find them, or check these lines, write the direction in the palm's frame in place of x, y and "
        f"z, and save them there:\n{template(tree)}palm_normal: [x, y, z]"
    )


def _joints(robot: Element, path: Path) -> list[TreeJoint]:
    joints = []
    for element in robot.findall("joint"):
        name = _name(element, path)
        where = f"{path}: joint '{name}'"
        kind = element.get("type")
        if kind not in (*JOINT_TYPES, *PLACING_TYPES):
            raise HandError(
                f"{where}: expected type {', '.join(JOINT_TYPES)}, got '{kind}'; replace the joint or fix it"
            )
        _refuse_doubles("element of a joint", [each.tag for each in element if each.tag in ONCE], where)
        ends = []
        for role in ("parent", "child"):
            end = element.find(role)
            if end is None or not end.get("link"):
                raise HandError(f"{where}: expected <{role} link=...>, found none; add it")
            ends.append(end.get("link") or "")
        axis = numbers_of(element.find("axis"), "xyz", (1.0, 0.0, 0.0), where)
        axis = np.ldexp(axis, -np.frexp(np.abs(axis).max())[1])  # the square of 1e200 is infinite
        length = np.linalg.norm(axis)
        if length == 0.0 and kind in ("fixed", "floating", "planar"):
            axis, length = np.asarray((1.0, 0.0, 0.0)), np.float64(1.0)
        if length == 0.0:
            raise HandError(f"{where}: expected an axis of non-zero length, got {axis.tolist()}; mend <axis>")
        parent, child = ends
        moves = kind in JOINT_TYPES and kind != "fixed"
        mimic = _mimic(element.find("mimic"), where) if moves else None
        lower, upper = _limits(element, kind, where, follows=mimic is not None) if moves else (0.0, 0.0)
        joints.append(
            TreeJoint(
                name,
                parent,
                child,
                origin(element, where),
                axis / length,
                fixed=kind == "fixed",
                lower=lower,
                upper=upper,
                mimic=mimic,
                slides=kind == "prismatic",
                places=kind if kind in PLACING_TYPES else None,
                endless=kind == "continuous",
                velocity=_most(element, "velocity", where),
                effort=_most(element, "effort", where),
            )
        )
    return joints


def _limits(joint: Element, kind: str, where: str, *, follows: bool) -> tuple[float, float]:
    """Return a joint's limits; infinite ones of a follower that states none."""
    if kind == "continuous":
        return (-np.inf, np.inf) if follows else (-CONTINUOUS_LIMIT, CONTINUOUS_LIMIT)
    limit = joint.find("limit")
    missing = [key for key in ("lower", "upper") if limit is None or limit.get(key) is None]
    if missing and (follows or kind == "prismatic"):  # one that places the hand in the world needs none
        return -np.inf, np.inf
    if missing:
        raise HandError(f"{where}: expected <limit lower=... upper=...> in radians, missing {missing}; add them")
    lower, upper = (float(numbers_of(limit, key, (0.0,), where, finite=False)[0]) for key in ("lower", "upper"))
    if lower > upper:
        raise HandError(f"{where}: expected lower limit <= upper limit, got {lower} > {upper}; swap or mend them")
    return lower, upper


def _most(joint: Element, key: str, where: str) -> float | None:
    """Return a joint's greatest velocity or effort as the file has it, NaN for what is no number; None without one."""
    limit = joint.find("limit")
    text = None if limit is None else limit.get(key)
    try:
        most = None if text is None else float(text)
    except ValueError:
        return np.nan
    if most is not None and most < 0.0:
        raise HandError(f"{where}: expected a limit of {key} of at least 0, got {text}; mend <limit>")
    return most


def _mimic(element: Element | None, where: str) -> Mimic | None:
    if element is None:
        return None
    leader = element.get("joint")
    if not leader:
        raise HandError(f"{where}: expected <mimic joint=...>, found no joint; add it")
    multiplier = float(numbers_of(element, "multiplier", (1.0,), where)[0])
    return Mimic(leader, multiplier, float(numbers_of(element, "offset", (0.0,), where)[0]))


def _name(element: Element, path: Path) -> str:
    name = element.get("name")
    if not name:
        raise HandError(f"{path}: expected a name on every <{element.tag}>, found one without; add it")
    return name


def _refuse_doubles(kind: str, names: list[str], path: Path | str) -> None:
    doubles = [name for name, count in Counter(names).items() if count > 1]
    if doubles:
        raise HandError(f"{path}: expected each {kind} name once, got {doubles} more than once; rename them")
