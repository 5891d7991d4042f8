"""One hand and one free object in MuJoCo: compiled once, placed anew for every grasp.

Solver, friction and time step are DexGraspBench's (Chen et al., 2025). Only links against the object make contacts: a
verified grasp has no links in each other, and the motions that the test allows are small. Gravity is off.
"""

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import torch
import trimesh
from jaxtyping import Float

from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.hands.export import mjcf_of_hand
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.simulation.hand_indices import HandIndices, hand_indices

TIMESTEP = 0.004  # [s] this and the next five are DexGraspBench's
NORMAL_TO_TANGENT_STIFFNESS = 10.0  # MuJoCo's impratio
NOSLIP_ITERATIONS = 2
CONTACT_DIMENSIONS = 4  # normal, two tangents, torsion
FRICTION = 0.6
TORSIONAL_FRICTION = 0.02  # [m] torque about the normal per newton
ROLLING_FRICTION = 1.0e-4  # [m] MuJoCo's default; without effect at four contact dimensions
MASS = 0.1  # [kg] of the object
OBJECT = "grasped object"  # no link of a hand is called so
HAND_SIDE, OBJECT_SIDE = 1, 2  # bits of MuJoCo's contype and conaffinity


@dataclass(frozen=True)
class GraspModel:
    """A compiled model, its state, and where hand and object stand in it.

    Attributes:
        model, data: MuJoCo's; `data` is overwritten by every grasp.
        indices: where the hand's coordinates stand in it.
        object_body: the object's body, whose frame is the object mesh's frame.
        object_position, object_velocity: first entry of its free joint in qpos and in qvel.
    """

    hand: Hand
    model: Any
    data: Any
    indices: HandIndices
    object_body: int
    object_position: int
    object_velocity: int

    def place(self, q: Float[np.ndarray, " coordinates"]) -> None:
        """Reset everything, warm starts included, and put hand and object where the grasp q has them."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        root = self.hand.forward_kinematics(torch.as_tensor(q, dtype=torch.float64)[None])[0, 0].numpy()
        data.mocap_pos[0] = root[:3, 3]
        mujoco.mju_mat2Quat(data.mocap_quat[0], np.ascontiguousarray(root[:3, :3]).reshape(9))
        self.indices.place_joints(self.hand, data, q[ROOT_COORDINATES:])
        mujoco.mj_forward(model, data)


def build_grasp_model(
    hand: Hand,
    links: list[list[Float[np.ndarray, "_ 3"]]],
    object_mesh: trimesh.Trimesh,
    pieces: list[Float[np.ndarray, "_ 3"]],
) -> GraspModel:
    """The hand, its palm movable, and a free object.

    Args:
        hand: its joints and motors.
        links: convex pieces of each link, link frame: see `link_hulls`.
        object_mesh: metres; its mass is 100 g, its inertia that of an even density.
        pieces: convex pieces of the object, in the mesh's frame.
    """
    no_files: list[str | None] = [None] * len(hand.link_names)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(mjcf_of_hand(hand, no_files, ""), encoding="unicode"))
    _set_options(spec.option)
    spec.body(hand.link_names[0]).mocap = True
    for name, hulls in zip(hand.link_names, links, strict=True):
        _add_pieces(spec, spec.body(name), hulls, HAND_SIDE, OBJECT_SIDE)
    _add_object(spec, object_mesh, pieces)
    model = spec.compile()
    return _indexed(hand, model)


def _set_options(option: Any) -> None:
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = NORMAL_TO_TANGENT_STIFFNESS
    option.noslip_iterations = NOSLIP_ITERATIONS
    option.gravity = (0.0, 0.0, 0.0)
    # A state that is no longer finite must be seen, not silently replaced by the start.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    # One contact per pair of pieces, as in the MuJoCo that the settings come from; newer ones make several by default.
    option.disableflags |= int(getattr(mujoco.mjtDisableBit, "mjDSBL_MULTICCD", 0))


def _add_pieces(spec: Any, body: Any, pieces: list[Float[np.ndarray, "_ 3"]], side: int, other: int) -> None:
    for index, vertices in enumerate(pieces):
        name = f"{body.name} {index}"
        spec.add_mesh(name=name, uservert=np.asarray(vertices, dtype=np.float64).reshape(-1))
        geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
        geom.contype, geom.conaffinity = side, other
        geom.condim = CONTACT_DIMENSIONS
        geom.friction = (FRICTION, TORSIONAL_FRICTION, ROLLING_FRICTION)


def _add_object(spec: Any, mesh: trimesh.Trimesh, pieces: list[Float[np.ndarray, "_ 3"]]) -> None:
    body = spec.worldbody.add_body(name=OBJECT)
    body.add_freejoint(name=OBJECT)
    solid = mesh if mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0 else mesh.convex_hull
    inertia = np.asarray(solid.moment_inertia) * (MASS / solid.mass)
    body.mass, body.ipos, body.explicitinertial = MASS, centre_of_mass(mesh), True
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    _add_pieces(spec, body, pieces, OBJECT_SIDE, HAND_SIDE)


def _indexed(hand: Hand, model: Any) -> GraspModel:
    free = model.joint(OBJECT)
    return GraspModel(
        hand=hand,
        model=model,
        data=mujoco.MjData(model),
        indices=hand_indices(hand, model),
        object_body=int(model.body(OBJECT).id),
        object_position=int(free.qposadr[0]),
        object_velocity=int(free.dofadr[0]),
    )
