"""A whole robot from a MuJoCo model: as a hand's tree, and with what an arm needs of it.

That is: joints of the topmost body, which are an arm's first, or its rail; sites, as links without geometry; the efforts of
motors; joints that follow others; the angles of the keyframe "home".
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from dexnudge.errors import HandError
from dexnudge.hands.mjcf import body_chain, body_name, body_tree, place_of
from dexnudge.hands.mjcf_files import compiled_model
from dexnudge.hands.tree import Mimic, Tree, TreeJoint

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
    root = _root(model, link)
    collides = (model.geom_contype | model.geom_conaffinity) != 0

    def wanted(geom: int) -> bool:
        of_these = only is None or body_name(model, int(model.geom_bodyid[geom])) in only
        return of_these and bool(collides[geom]) == (geometry == "collision")

    tree = body_tree(model, path.stem, root, wanted)
    links, joints = dict(tree.links), list(tree.joints)
    if model.body_jntnum[root]:
        first = body_chain(model, root, GROUND, body_name(model, root))
        links |= {name: trimesh.Trimesh() for name in (GROUND, *(joint.child for joint in first)) if name not in links}
        joints = [*first, *joints]
    for site in range(model.nsite):
        body, name = int(model.site_bodyid[site]), model.site(site).name
        if name and name not in links and model.body_rootid[body] == root:
            origin = place_of(model.site_pos[site], model.site_quat[site])
            carrier = body_name(model, body)
            joints.append(TreeJoint(f"{name}_mount", carrier, name, origin, np.array([1.0, 0.0, 0.0]), fixed=True))
            links[name] = trimesh.Trimesh()
    joints = [_with_motor(joint, model) for joint in joints]
    return replace(tree, links=links, joints=tuple(joints), notes=tuple(notes), home=_home(model))


def _root(model: mujoco.MjModel, link: str | None) -> int:
    if model.nbody < 2:
        raise HandError("the MJCF has no bodies: expected some below <worldbody>, found none; mend the file")
    names = {body_name(model, body): int(model.body_rootid[body]) for body in range(1, model.nbody)}
    sites = {model.site(site).name: int(model.body_rootid[model.site_bodyid[site]]) for site in range(model.nsite)}
    if link in names or link in sites:
        return {**sites, **names}[link]
    roots = sorted(set(names.values()))
    return max(roots, key=lambda root: int((model.body_rootid[model.jnt_bodyid] == root).sum()))


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
