"""Any hand from a MuJoCo model (MJCF) and a short YAML beside it, and the tree of a whole robot, as an arm needs it.

MuJoCo itself compiles the file, so defaults, includes and every way to write an orientation mean here what they mean there.
Of a hand joints of the topmost body are left out: they place it in the world, and the root of q does that. Of a robot they
are an arm's first, or its rail; read are also sites, as links without geometry, the efforts of motors, joints that follow
others, and the angles of the keyframe "home".
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from dexnudge.errors import HandError, printable_name
from dexnudge.geometry.mesh_repair import wind_outward
from dexnudge.hands import link_meshes
from dexnudge.hands.assembly import hand_from_tree, without_arm
from dexnudge.hands.config import HandConfig
from dexnudge.hands.hand import Hand
from dexnudge.hands.loops.couplings import coupled
from dexnudge.hands.mjcf_files import compiled_model
from dexnudge.hands.tree import CONTINUOUS_LIMIT, Mimic, Tree, TreeJoint, check_tree
from dexnudge.hands.urdf import config_beside


def hand_from_mjcf(
    path: Path | str,
    config: HandConfig | None = None,
    *,
    base: bool = True,
    packages: Mapping[str, Path | str] | None = None,
) -> Hand:
    """Return the hand that an MJCF file describes, its palm as the root.

    Args:
        path: the MJCF. Every file that it names must lie in its folder or below, in the ROS package around it, or in
            one of `packages`.
        config: facts that MJCF does not state; None: those of `<stem>.yaml` or `hand.yaml` beside it.
        base: whether the links behind the palm (those on the side of `base_link`) are kept.
        packages: further folders whose files may be named.

    Raises:
        HandError: anything that cannot be used as given, with the place and the remedy.
    """
    path = Path(path)
    notes: list[str] = []
    model = compiled_model(path, packages or {}, notes)
    config = config or config_beside(path, tree_of_model(model, printable_name(path.stem), None, lambda _: False))
    tree = tree_of_model(model, printable_name(path.stem), config.palm, _geoms(model, config.geometry))
    tree, config = coupled(without_arm(replace(tree, notes=tuple(notes)), config), model, config)
    return hand_from_tree(tree, config, base=base)


def mjcf_tree(path: Path, geometry: str, packages: Mapping[str, Path | str] | None = None) -> Tree:
    """Return the tree of an MJCF file with its "collision" or "visual" geoms; of several trees the one of most joints."""
    model = compiled_model(path, packages or {})
    return _body_tree(model, printable_name(path.stem), _root_with(model, None), _geoms(model, geometry))


def _geoms(model: mujoco.MjModel, geometry: str) -> Callable[[int], bool]:
    """Return which geoms are of "collision" or "visual" geometry: those that can collide, or not."""
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    return lambda geom: bool(collides[geom]) == (geometry == "collision")


def tree_of_model(model: mujoco.MjModel, name: str, palm: str | None, select: Callable[[int], bool]) -> Tree:
    """Return the bodies of the tree in which the palm hangs, with the geoms that `select` admits.

    A body with several joints, or with one away from its origin, becomes several links.

    Raises:
        HandError: an unknown palm, non-linear joint equalities, or shapes without a volume.
    """
    _refuse_empty(model)
    names = [model.body(body).name for body in range(1, model.nbody)]
    if palm is not None and palm not in names:
        raise HandError(
            f"the hand's YAML names an unknown link: key 'palm': expected one of {names}, got '{palm}'; mend it"
        )
    return _body_tree(model, name, int(model.body_rootid[1 if palm is None else model.body(palm).id]), select)


def _body_tree(model: mujoco.MjModel, name: str, root: int, select: Callable[[int], bool]) -> Tree:
    """Return the tree of a body of the world's and all below it, as `tree_of_model` does; its own joints are left out."""
    bodies = [body for body in range(1, model.nbody) if model.body_rootid[body] == root]
    links: dict[str, trimesh.Trimesh] = {}
    joints: list[TreeJoint] = []
    for body in bodies:
        link = _body_name(model, body)
        if body != bodies[0]:
            chain = _body_chain(model, body, _body_name(model, int(model.body_parentid[body])), link)
            links |= {joint.child: trimesh.Trimesh() for joint in chain}
            joints += chain
        mine = np.flatnonzero(model.geom_bodyid == body).tolist()
        pieces = [_geom_mesh(model, geom) for geom in mine if select(geom)]
        links[link] = trimesh.util.concatenate(pieces) if pieces else trimesh.Trimesh()
    tree = Tree(name, links, tuple(joints))
    check_tree(tree)
    return tree


def _body_chain(model: mujoco.MjModel, body: int, parent: str, link: str) -> list[TreeJoint]:
    """Return the joints from a body's parent to the body; several, with empty links between, where one does not say it."""
    origin = _place_of(model.body_pos[body], model.body_quat[body])
    moving = [joint for joint in range(model.njnt) if model.jnt_bodyid[joint] == body]
    chain = []
    for joint in moving:
        name = model.joint(joint).name or f"joint{joint}"
        kind = mujoco.mjtJoint(model.jnt_type[joint])
        turns = kind == mujoco.mjtJoint.mjJNT_HINGE
        slides, axis = kind == mujoco.mjtJoint.mjJNT_SLIDE, model.jnt_axis[joint].copy()
        if (turns or slides) and not np.isclose(np.linalg.norm(axis), 1.0):  # MuJoCo makes 0 of an axis of 1e200
            raise HandError(f"joint '{name}': expected an axis of some length from 1e-10 to 1e100; mend its `axis`")
        zero = float(model.qpos0[model.jnt_qposadr[joint]])
        at = model.jnt_pos[joint] if turns else np.zeros(3)  # what slides has no anchor
        anchor, most = trimesh.transformations.translation_matrix(at), np.inf if slides else CONTINUOUS_LIMIT
        low, high = model.jnt_range[joint].tolist() if model.jnt_limited[joint] else (-most, most)
        # The model's reference angle goes into the origin: R(axis, angle - zero) = R(axis, -zero) R(axis, angle).
        back = trimesh.transformations.rotation_matrix(-zero, axis)
        if slides:
            back = trimesh.transformations.translation_matrix(-zero * axis)
        child = link if joint == moving[-1] and not at.any() else f"{link}@{name}"
        places = None if turns or slides else kind.name.removeprefix("mjJNT_").lower()
        place = origin @ anchor @ back
        endless = turns and not model.jnt_limited[joint]
        chain.append(TreeJoint(name, parent, child, place, axis, False, low, high, None, slides, places, endless))
        parent, origin = child, np.linalg.inv(anchor)
    return chain if parent == link else [*chain, _mount(parent, link, origin)]


def _mount(parent: str, link: str, origin: np.ndarray) -> TreeJoint:
    """Return the joint that holds a link fast, pose `origin` in its parent's frame."""
    return TreeJoint(f"{link}_mount", parent, link, origin, np.array([1.0, 0.0, 0.0]), fixed=True)


def _geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom].astype(float)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        data = model.geom_dataid[geom]
        vertices = model.mesh_vert[model.mesh_vertadr[data] :][: model.mesh_vertnum[data]]
        faces = model.mesh_face[model.mesh_faceadr[data] :][: model.mesh_facenum[data]]
        mesh = trimesh.Trimesh(vertices.astype(float), faces, process=False)
        if not np.abs(mesh.vertices).max(initial=0.0) <= link_meshes.MAX_COORDINATE:  # also where some are no numbers
            raise HandError(
                f"mesh '{model.mesh(data).name}': expected corners within {link_meshes.MAX_COORDINATE:g} m, got "
                f"{np.abs(mesh.vertices).max():.3g} m; mend the mesh or its scale"
            )
        wind_outward(mesh, surroundings=False)
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        mesh = link_meshes.box(2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        mesh = link_meshes.cylinder(size[0], 2 * size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        mesh = link_meshes.capsule(size[0], 2 * size[1])
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        mesh = link_meshes.sphere(size[0])
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        mesh = link_meshes.ellipsoid(size)
    else:
        raise HandError(
            f"geom '{model.geom(geom).name}': expected mesh, box, cylinder, capsule, sphere or ellipsoid, got {kind.name}; "
            "replace it by a mesh"
        )
    mesh.apply_transform(_place_of(model.geom_pos[geom], model.geom_quat[geom]))
    return mesh


def _place_of(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return the (4, 4) pose of a position and a quaternion."""
    transform = trimesh.transformations.quaternion_matrix(quaternion)
    transform[:3, 3] = position
    return transform


def _body_name(model: mujoco.MjModel, body: int) -> str:
    """Return a body's name, or one that says which it is."""
    return model.body(body).name or f"body{body}"


GROUND = "ground"  # the link below the joints of the topmost body; "world" is MuJoCo's own name
HOME = "home"


def mjcf_robot_tree(
    path: Path, geometry: str, packages: Mapping[str, Path | str], link: str | None, only: Collection[str] | None = None
) -> Tree:
    """Return the tree of an MJCF file that holds a link or site, or else the one of most joints.

    geometry: that is read, of all links or of some `only`.

    Raises:
        HandError: the file cannot be read, or has no bodies.
    """
    notes: list[str] = []
    model = compiled_model(path, packages, notes)
    root, judged = _root_with(model, link), _geoms(model, geometry)

    def wanted(geom: int) -> bool:
        return judged(geom) and (only is None or _body_name(model, int(model.geom_bodyid[geom])) in only)

    tree = _body_tree(model, printable_name(path.stem), root, wanted)
    links, joints = dict(tree.links), list(tree.joints)
    if model.body_jntnum[root]:
        first = _body_chain(model, root, GROUND, _body_name(model, root))
        links |= {name: trimesh.Trimesh() for name in (GROUND, *(joint.child for joint in first)) if name not in links}
        joints = [*first, *joints]
    for site in range(model.nsite):
        body, name = int(model.site_bodyid[site]), model.site(site).name
        if name and name not in links and model.body_rootid[body] == root:
            joints.append(_mount(_body_name(model, body), name, _place_of(model.site_pos[site], model.site_quat[site])))
            links[name] = trimesh.Trimesh()
    joints = [_with_motor(joint, model) for joint in joints]
    return replace(tree, links=links, joints=tuple(joints), notes=tuple(notes), home=_home(model))


def _root_with(model: mujoco.MjModel, link: str | None) -> int:
    """Return the body of the world's that holds a link or site, or else the one of most joints."""
    _refuse_empty(model)
    names = {_body_name(model, body): int(model.body_rootid[body]) for body in range(1, model.nbody)}
    sites = {model.site(site).name: int(model.body_rootid[model.site_bodyid[site]]) for site in range(model.nsite)}
    if link in names or link in sites:
        return {**sites, **names}[link]
    roots = sorted(set(names.values()))
    return max(roots, key=lambda root: int((model.body_rootid[model.jnt_bodyid] == root).sum()))


def _refuse_empty(model: mujoco.MjModel) -> None:
    if model.nbody < 2:
        raise HandError("the MJCF has no bodies: expected some below <worldbody>, found none; mend the file")


def _with_motor(joint: TreeJoint, model: mujoco.MjModel) -> TreeJoint:
    """Return a joint with the greatest force of its motors, and the joint that it follows."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint.name)
    if joint.fixed or index < 0:
        return joint
    effort = None
    if model.jnt_actfrclimited[index]:
        effort = float(np.abs(model.jnt_actfrcrange[index]).max())
    else:
        driven = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)) & (model.actuator_trnid[:, 0] == index)
        limited = driven & model.actuator_forcelimited.astype(bool)
        if limited.any() and limited.sum() == driven.sum():
            most = np.abs(model.actuator_forcerange).max(axis=1) * np.abs(model.actuator_gear[:, 0])
            effort = float(most[limited].sum())
    return replace(joint, effort=effort, mimic=_followed(index, model))


def _followed(index: int, model: mujoco.MjModel) -> Mimic | None:
    """Return what an equality makes of a joint, where that is a straight line."""
    for equality in range(model.neq):
        kind, one, other = int(model.eq_type[equality]), model.eq_obj1id[equality], model.eq_obj2id[equality]
        if kind == int(mujoco.mjtEq.mjEQ_JOINT) and one == index and other >= 0 and model.eq_active0[equality]:
            constant, slope, *higher = model.eq_data[equality][:5]
            zero, leader_zero = (float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (one, other))
            if not np.any(higher):
                offset = float(constant - slope * leader_zero + zero)
                return Mimic(model.joint(int(other)).name, float(slope), offset)
    return None


def _home(model: mujoco.MjModel) -> dict[str, float]:
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, HOME)
    single = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    joints = [joint for joint in range(model.njnt) if model.jnt_type[joint] in single] if key >= 0 else []
    return {model.joint(joint).name: float(model.key_qpos[key][model.jnt_qposadr[joint]]) for joint in joints}
