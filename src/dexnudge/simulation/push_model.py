"""The same model with another friction or mass than was thought: what was planned for the one is played in the other."""

import copy
from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.hands.export import mjcf_of_hand
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.hands.physical import body_inertia
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.convex_pieces import convex_pieces, link_pieces
from dexnudge.simulation.environment_pieces import environment_pieces
from dexnudge.simulation.hand_indices import HandIndices, hand_indices

TIMESTEP = 0.002  # [s]
NORMAL_TO_TANGENT_STIFFNESS = 10.0  # MuJoCo's impratio: friction holds as firmly as the normal force, little creep
NOSLIP_ITERATIONS = 3  # MuJoCo's soft friction creeps below the limit of Coulomb's law; these passes stop it
PAD_RADIUS = 0.005  # [m] of a rubber fingertip's patch, whose torque about the normal is 2/3 friction * radius * force
ROLLING_FRICTION = 1.0e-4  # [m] MuJoCo's default; without effect at four contact dimensions
CONTACT_TIME = (
    2 * TIMESTEP
)  # [s] time constant of contacts, the shortest that is stable: a softer one swallows the press
# MuJoCo's friction lifts a sliding body off its support by friction * speed * damping / stiffness of the contact: 0.16 mm at
# the time constant above. On contacts stiffer than that a body hops every few steps, and walks sideways. Those with the
# surroundings are as stiff, but have a quarter of the damping, and begin soft, so that they stay closed 0.1 mm deep.
SLIDING_CONTACT = (2 * CONTACT_TIME, 0.5)  # [s], [-] MuJoCo's solref: time constant, damping ratio
SLIDING_IMPEDANCE = (0.1, 0.95, 0.0002, 0.5, 2.0)  # MuJoCo's solimp: from 0.1 at touch to 0.95 at a depth of 0.2 mm
BASE_STIFFNESS = 1000.0  # [N/m] of an arm under impedance control: what contacts give way by costs little of the force
BASE_ROTATION_STIFFNESS = 100.0  # [N m/rad] the same at a lever of 0.2 m
ARM_MASS, ARM_INERTIA = (
    1.0,
    0.01,
)  # [kg], [kg m^2] of an arm's flange: a hand of some grams stays stable on these springs
OBJECT, DRIVER, ARM, SURROUNDINGS = (
    "pushed object",
    "base driver",
    "arm flange",
    "surroundings",
)  # no link of a hand is called so
BASE_MOTORS = tuple(f"base {kind} {axis}" for kind in ("force", "torque") for axis in "xyz")
HAND_SIDE, OBJECT_SIDE, ENVIRONMENT_SIDE = 1, 2, 4  # bits of MuJoCo's contype and conaffinity
# Of two touching geoms the one of higher priority gives friction and softness; by default both would be mixed.
PRIORITY = {OBJECT_SIDE: 0, HAND_SIDE: 1, ENVIRONMENT_SIDE: 2}
COLOURS = {
    HAND_SIDE: (0.75, 0.75, 0.80, 1.0),
    OBJECT_SIDE: (0.95, 0.60, 0.20, 1.0),
    ENVIRONMENT_SIDE: (0.70, 0.62, 0.50, 0.35),
}


@dataclass(frozen=True)
class PushModel:
    """A compiled model, its state, and where hand and object stand in it.

    model, data: MuJoCo's; `data` is overwritten by every run. palm: first entries of the root's free joint in qpos and
    qvel. object_position: the same of the object's. side: of each geom, HAND_SIDE, OBJECT_SIDE or ENVIRONMENT_SIDE.
    T_world_object: where the scene has the object. base_motor: the six of the base, force then torque, in the axes of
    the mocap body. base_stiffness [N/m, N m/rad] and base_damping [N s/m, N m s/rad] of each.
    """

    hand: Hand
    model: Any
    data: Any
    indices: HandIndices
    palm_position: int
    object_body: int
    object_position: int
    side: Int[np.ndarray, " geom"]
    T_world_object: Float[np.ndarray, "4 4"]
    base_motor: Int[np.ndarray, " 6"]
    base_stiffness: Float[np.ndarray, " 6"]
    base_damping: Float[np.ndarray, " 6"]

    def place(self, q: Float[np.ndarray, " coordinates"]) -> None:
        """Reset everything, warm starts included; the hand at q, at rest, and the object where the scene has it."""
        model, data, palm = self.model, self.data, self.palm_position
        mujoco.mj_resetData(model, data)
        root = self.hand.forward_kinematics(torch.as_tensor(q, dtype=torch.float64)[None])[0, 0].numpy()
        data.mocap_pos[0] = data.qpos[palm : palm + 3] = root[:3, 3]
        data.mocap_quat[0] = data.qpos[palm + 3 : palm + 7] = _quaternion(root)
        self.indices.place_joints(self.hand, data, q[ROOT_COORDINATES:])
        free = self.object_position
        data.qpos[free : free + 3] = self.T_world_object[:3, 3]
        data.qpos[free + 3 : free + 7] = _quaternion(self.T_world_object)
        mujoco.mj_forward(model, data)

    def configurations(self, qpos: Float[np.ndarray, "n nq"]) -> Float[np.ndarray, "n coordinates"]:
        """The hand's q of MuJoCo's coordinates."""
        palm = self.palm_position
        rotation = Rotation.from_quat(qpos[:, palm + 3 : palm + 7], scalar_first=True).as_matrix()
        q = np.zeros((len(qpos), ROOT_COORDINATES + self.hand.num_joints))
        q[:, :3], q[:, 3:6], q[:, 6:9] = qpos[:, palm : palm + 3], rotation[:, :, 0], rotation[:, :, 1]
        for index, name in enumerate(self.hand.joint_names):
            q[:, ROOT_COORDINATES + index] = qpos[:, self.model.joint(name).qposadr[0]]
        return q


def push_model_xml(hand: Hand, scene: Scene) -> str:
    """The model as MJCF that needs no other file, so that what is simulated is what a file of this text holds.

    Args:
        hand: its joints and motors.
        scene: object, surroundings, frictions, mass.

    Raises:
        MeshError: object or surroundings cannot be cut into convex bodies.
    """
    no_files: list[str | None] = [None] * len(hand.link_names)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(mjcf_of_hand(hand, no_files, ""), encoding="unicode"))
    _set_options(spec)
    _drive_base(spec, hand)
    torsion = 2.0 / 3.0 * scene.friction_hand * PAD_RADIUS
    for name, hulls in zip(hand.link_names, link_pieces(hand), strict=True):
        body = spec.body(name)
        body.gravcomp = 1.0
        _add_pieces(spec, body, hulls, HAND_SIDE, (scene.friction_hand, torsion))
    _add_object(spec, scene)
    surroundings = spec.worldbody.add_body(name=SURROUNDINGS)
    _add_pieces(
        spec,
        surroundings,
        environment_pieces(scene.environment_mesh),
        ENVIRONMENT_SIDE,
        (scene.friction_environment, 0.0),
    )
    spec.compile()
    return str(spec.to_xml())


def load_push_model(xml: str, hand: Hand, scene: Scene) -> PushModel:
    """Compile what `push_model_xml` wrote of the same hand and scene."""
    model = mujoco.MjModel.from_xml_string(xml)
    base_motor = np.array([model.actuator(name).id for name in BASE_MOTORS])
    return PushModel(
        hand=hand,
        model=model,
        data=mujoco.MjData(model),
        indices=hand_indices(hand, model),
        palm_position=int(model.joint(DRIVER).qposadr[0]),
        object_body=int(model.body(OBJECT).id),
        object_position=int(model.joint(OBJECT).qposadr[0]),
        side=np.array(model.geom_contype),
        T_world_object=scene.T_world_object,
        base_motor=base_motor,
        base_stiffness=-model.actuator_biasprm[base_motor, 1],
        base_damping=-model.actuator_biasprm[base_motor, 2],
    )


def _set_options(spec: Any) -> None:
    option = spec.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = NORMAL_TO_TANGENT_STIFFNESS
    option.noslip_iterations = NOSLIP_ITERATIONS
    option.gravity = (0.0, 0.0, -GRAVITY)
    # A state that is no longer finite must be seen, not silently replaced by the start.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _drive_base(spec: Any, hand: Hand) -> None:
    palm = spec.body(hand.link_names[0])
    palm.add_freejoint(name=DRIVER)
    palm.add_site(name="palm")
    spec.worldbody.add_body(name=DRIVER, mocap=True).add_site(name=DRIVER)
    palm.add_body(name=ARM, mass=ARM_MASS, inertia=(ARM_INERTIA,) * 3, explicitinertial=True, gravcomp=1.0)
    hand_mass = sum(body_inertia(mesh).mass for mesh in hand.link_meshes)
    mass = ARM_MASS + hand_mass
    inertia = ARM_INERTIA + hand_mass * (hand.finger_length / 2) ** 2
    for index, name in enumerate(BASE_MOTORS):
        stiffness, inert = (BASE_STIFFNESS, mass) if index < 3 else (BASE_ROTATION_STIFFNESS, inertia)
        motor = spec.add_actuator(name=name, target="palm", refsite=DRIVER)
        motor.trntype = mujoco.mjtTrn.mjTRN_SITE
        motor.gear[:] = np.eye(6)[index]
        motor.set_to_position(kp=stiffness, kv=2.0 * np.sqrt(stiffness * inert))  # critically damped


def _add_object(spec: Any, scene: Scene) -> None:
    mesh = scene.object_mesh
    body = spec.worldbody.add_body(name=OBJECT)
    body.pos, body.quat = scene.T_world_object[:3, 3], _quaternion(scene.T_world_object)
    body.add_freejoint(name=OBJECT)
    solid = mesh if mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0 else mesh.convex_hull
    inertia = np.asarray(solid.moment_inertia) * (scene.mass / solid.mass)
    body.mass, body.ipos, body.explicitinertial = scene.mass, centre_of_mass(mesh), True
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    _add_pieces(spec, body, convex_pieces(mesh), OBJECT_SIDE, (0.0, 0.0))


def _add_pieces(spec: Any, body: Any, pieces: list[np.ndarray], side: int, friction: tuple[float, float]) -> None:
    """Add convex pieces [m, body frame] with (sliding friction, torsional friction [m])."""
    for index, vertices in enumerate(pieces):
        name = f"{body.name} {index}"
        spec.add_mesh(name=name, uservert=np.asarray(vertices, dtype=np.float64).reshape(-1))
        geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
        geom.contype, geom.conaffinity = side, (HAND_SIDE | OBJECT_SIDE | ENVIRONMENT_SIDE) & ~side
        geom.condim = 4 if side == HAND_SIDE else 3
        geom.priority = PRIORITY[side]
        geom.solref = (CONTACT_TIME, 1.0)
        if side == ENVIRONMENT_SIDE:
            geom.solref, geom.solimp = SLIDING_CONTACT, SLIDING_IMPEDANCE
        geom.friction = (*friction, ROLLING_FRICTION)
        geom.rgba = COLOURS[side]


def _quaternion(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 4"]:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(pose[:3, :3]).reshape(9))
    return quaternion


SIDES = {"friction_hand": HAND_SIDE, "friction_environment": ENVIRONMENT_SIDE}
QUANTITIES = (*SIDES, "mass")


def changed_physics(push: PushModel, quantity: str, factor: float) -> PushModel:
    """A model of its own in which one quantity of the scene is multiplied.

    It equals what `push_model_xml` makes of the changed scene; `push` stays as it is. A fingertip's torque about its
    normal is in proportion to its friction, an object's inertia to its mass.

    Raises:
        InputError: the quantity is none of `QUANTITIES`.
    """
    if quantity not in QUANTITIES:
        raise InputError(f"{quantity!r} cannot be changed in a model; expected one of {', '.join(QUANTITIES)}")
    model = copy.deepcopy(push.model)
    if quantity == "mass":
        model.body_mass[push.object_body] *= factor
        model.body_inertia[push.object_body] *= factor
    else:
        model.geom_friction[push.side == SIDES[quantity], :2] *= factor  # sliding and torsional
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)  # what MuJoCo derives from masses at compile time
    return replace(push, model=model, data=data)
