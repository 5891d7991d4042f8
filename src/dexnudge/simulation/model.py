"""Hand, object and surroundings as one MuJoCo model: the scene in which pushes, grasps and lifts are played.

Variants come from the same builder: `scene_model`, a hand on a compliant arm in a whole scene, `grasp_model`, a hand whose
palm is fixed and one free object, with DexGraspBench's settings, and `robot_model` (in a file of its own), a hand that a
real arm carries.
"""

import copy
from dataclasses import dataclass, replace
from itertools import product
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import torch
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from dexnudge.errors import InputError, SceneError
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.hands.export import body_inertia, mjcf_of_hand
from dexnudge.hands.hand import ROOT_COORDINATES, Hand
from dexnudge.jobs.cached import cached_per_instance
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.convex_pieces import Vertices, environment_pieces, link_pieces, object_pieces
from dexnudge.verification.criteria import PENETRATION_LIMIT

TIMESTEP = 0.002  # [s]
NORMAL_TO_TANGENT_STIFFNESS = 10.0  # MuJoCo's impratio: friction holds as firmly as the normal force, little creep
NOSLIP_ITERATIONS = 3  # MuJoCo's soft friction creeps below the limit of Coulomb's law; these passes stop it
PAD_RADIUS = 0.005  # [m] of a rubber fingertip's patch, whose torque about the normal is 2/3 friction * radius * force
ROLLING_FRICTION = 1.0e-4  # [m] MuJoCo's default; without effect at four contact dimensions
CONTACT_TIME = 2 * TIMESTEP  # [s] time constant of contacts, the shortest stable one: a softer one swallows the press
# MuJoCo's friction lifts a sliding body off its support by friction * speed * damping / stiffness of the contact: 0.16 mm at
# the time constant above. So a body on stiff contacts hops every few steps, and what hops under a sliding hand creeps along.
# Contacts of hand and surroundings are as stiff, but have a quarter of the damping, and begin soft, so that they stay closed
# 0.1 mm deep.
SLIDING_CONTACT = (2 * CONTACT_TIME, 0.5)  # [s], [-] MuJoCo's solref: time constant, damping ratio
SLIDING_IMPEDANCE = (0.1, 0.95, 0.0002, 0.5, 2.0)  # MuJoCo's solimp: from 0.1 at touch to 0.95 at a depth of 0.2 mm
BASE_STIFFNESS = 1000.0  # [N/m] of an arm under impedance control: what contacts give way by costs little of the force
BASE_ROTATION_STIFFNESS = 100.0  # [N m/rad] the same at a lever of 0.2 m
# What an arm's flange exerts beyond carrying the hand, along and about each axis of the base's target. The Panda's rated
# payload is 3 kg: 30 N. Each of its three wrist joints makes 12 N m; a hand of 2 kg, 0.15 m from them, takes 3 N m of it.
BASE_FORCE_LIMIT, BASE_TORQUE_LIMIT = 30.0, 9.0  # [N], [N m]
IDLE_TORQUE = 1.0e-3  # [N m] below which a motor has no part in a squeeze and keeps its place
ARM_MASS, ARM_INERTIA = 1.0, 0.01  # [kg], [kg m^2] of an arm's flange: a light hand stays stable on these springs

# Links of the hand touch each other where their pieces are as deep as verified links may be: pieces are coarser than the
# links, by millimetres at knuckles, and of verified configurations one in six has some in each other, by up to this much.
SELF_CONTACT_DEPTH = PENETRATION_LIMIT  # [m]

MANY_PIECES = 200  # surroundings in more of them may touch an object in hundreds of places at once
MEMORY = 2**30  # [byte] for the contacts of those; MuJoCo's own 15 MB hold 400. What is not needed is never touched

GRASP_TIMESTEP = 0.004  # [s] this and the next five are DexGraspBench's (Chen et al., 2025)
GRASP_NOSLIP_ITERATIONS = 2
GRASP_FRICTION = 0.6
GRASP_TORSIONAL_FRICTION = 0.02  # [m] torque about the normal per newton
GRASP_MASS = 0.1  # [kg] of the object
GRASP_SOLREF = (0.02, 1.0)  # [s], [-] MuJoCo's default

# No link of a hand has one of these names.
OBJECT, DRIVER, ARM, SURROUNDINGS = "pushed object", "base driver", "arm flange", "surroundings"
BASE_MOTORS = tuple(f"base {kind} {axis}" for kind in ("force", "torque") for axis in "xyz")
HAND_SIDE, OBJECT_SIDE, ENVIRONMENT_SIDE = 1, 2, 4  # bits of MuJoCo's contype and conaffinity


@dataclass(frozen=True)
class ContactSurface:
    """Contact parameters of one side's geoms, in MuJoCo's terms.

    side: HAND_SIDE, OBJECT_SIDE or ENVIRONMENT_SIDE. touches: the sides with which it makes contacts. friction: sliding [-]
    and torsional [m]. dimensions: of a contact, condim. priority: of two touching geoms the one of higher priority gives
    friction and softness; by default MuJoCo mixes both. solimp: None for MuJoCo's default.
    """

    side: int
    touches: int
    friction: tuple[float, float] = (0.0, 0.0)
    dimensions: int = 3
    priority: int = 0
    solref: tuple[float, float] = (CONTACT_TIME, 1.0)
    solimp: tuple[float, float, float, float, float] | None = None
    colour: tuple[float, float, float, float] = (0.95, 0.60, 0.20, 1.0)

    def apply(self, geom: Any) -> None:
        """Set the parameters of a geom of MuJoCo's spec."""
        geom.contype, geom.conaffinity, geom.condim = self.side, self.touches, self.dimensions
        geom.priority = self.priority
        geom.friction = (*self.friction, ROLLING_FRICTION)
        geom.rgba = self.colour
        geom.solref = self.solref
        if self.solimp is not None:
            geom.solimp = self.solimp


@dataclass(frozen=True)
class SimulationModel:
    """A compiled model, its state, and where hand and object stand in it.

    Attributes:
        hand: the hand.
        xml: MJCF from which it was compiled; "" for a grasp model.
        model, data: MuJoCo's; `data` is overwritten by every rollout.
        T_world_object: where `place` puts the object.
        palm_position: first entry of the palm's free joint in qpos; -1 where the palm is fixed.
        object_body: the object's body, whose frame is the object mesh's frame.
        object_position: first entry of the object's free joint in qpos.
        side: of each geom, HAND_SIDE, OBJECT_SIDE or ENVIRONMENT_SIDE.
        link_body: body of each link.
        joint_position: entry in qpos of the joint that carries each link, -1 where it is fixed.
        dof_of_angle: velocity of every degree of freedom for unit velocity of a joint angle of q.
        motor_of_angle: length of every motor for unit joint angle; of a tendon that two joints share both are one.
        motor_gain: of every motor [N m/rad], [N/m] of one that slides.
        motor_scale: what counts as a radian of every motor, see `Hand.joint_scales`; 1 of the base's.
        base_motor: the six motors of the base, force then torque, in the axes of the base's target; none for a fixed palm.
        link_of_geom: link that a geom belongs to, -1 for object and surroundings.
        base_stiffness [N/m, N m/rad], base_damping [N s/m, N m s/rad]: of each.
    """

    hand: Hand
    xml: str
    model: Any
    data: Any
    T_world_object: Float[np.ndarray, "4 4"]
    palm_position: int
    object_body: int
    object_position: int
    side: Int[np.ndarray, " geom"]
    link_body: Int[np.ndarray, " link"]
    joint_position: Int[np.ndarray, " link"]
    dof_of_angle: Float[np.ndarray, "dof angle"]
    motor_of_angle: Float[np.ndarray, "motor angle"]
    motor_gain: Float[np.ndarray, " motor"]
    motor_scale: Float[np.ndarray, " motor"]
    base_motor: Int[np.ndarray, " base"]
    base_stiffness: Float[np.ndarray, " base"]
    base_damping: Float[np.ndarray, " base"]
    link_of_geom: Int[np.ndarray, " geom"]

    @property
    def angle_of_motor(self) -> Float[np.ndarray, "angle motor"]:
        """Joint angles for unit length of a motor: the joints of a shared tendon move alike."""
        return self.motor_of_angle.T / np.maximum(self.motor_of_angle.sum(axis=1), 1.0)

    def idle(self, motor_torque: Float[np.ndarray, " motor"]) -> Bool[np.ndarray, " motor"]:
        """Return which motors have no part in a squeeze with these torques [N m], or forces [N] where they slide."""
        return np.abs(motor_torque) * self.motor_scale < IDLE_TORQUE

    def place(self, q: Float[np.ndarray, " coordinates"]) -> None:
        """Reset everything, warm starts included: the hand at q, at rest, the object at `T_world_object`.

        Pieces of links that are deeper than `SELF_CONTACT_DEPTH` in each other at q touch from that depth on.

        Raises:
            SceneError: there are more contacts than MuJoCo has memory for.
        """
        model, data, palm = self.model, self.data, self.palm_position
        mujoco.mj_resetData(model, data)
        root = self.hand.forward_kinematics(torch.as_tensor(q, dtype=torch.float64)[None])[0, 0].numpy()
        if model.nmocap:
            data.mocap_pos[0], data.mocap_quat[0] = root[:3, 3], _quaternion(root)
        if palm >= 0:
            data.qpos[palm : palm + 3], data.qpos[palm + 3 : palm + 7] = root[:3, 3], _quaternion(root)
        joint_angles = q[ROOT_COORDINATES:]
        for link, joint in enumerate(self.hand.joints):
            if joint is not None and joint.index is not None:
                data.qpos[self.joint_position[link]] = joint.multiplier * joint_angles[joint.index] + joint.offset
        data.ctrl[:] = self.motor_of_angle @ joint_angles
        free = self.object_position
        data.qpos[free : free + 3] = self.T_world_object[:3, 3]
        data.qpos[free + 3 : free + 7] = _quaternion(self.T_world_object)
        model.pair_margin[:], model.pair_gap[:] = -SELF_CONTACT_DEPTH, SELF_CONTACT_DEPTH
        try:
            mujoco.mj_forward(model, data)
            if self._touch_from_here():
                mujoco.mj_forward(model, data)
        except mujoco.FatalError as error:
            raise SceneError(
                f"MuJoCo cannot place hand and object ({str(error).splitlines()[0]}): they touch the surroundings in "
                f"{data.ncon} places; expected fewer; give an `environment` that is smoother around the object"
            ) from error

    def _touch_from_here(self) -> bool:
        """Let the links that press each other now touch only where they are deeper; return whether there are some."""
        model, contact = self.model, self.data.contact
        deep = np.asarray(contact.dist) < -SELF_CONTACT_DEPTH
        deep &= (self.side[np.asarray(contact.geom).reshape(-1, 2)] == HAND_SIDE).all(axis=1)
        pairs = np.sort(np.stack([model.pair_geom1, model.pair_geom2], axis=1), axis=1)
        for geoms, distance in zip(np.sort(contact.geom[deep], axis=1), contact.dist[deep], strict=True):
            pair = (pairs == geoms).all(axis=1)
            model.pair_margin[pair] = np.minimum(model.pair_margin[pair], distance)
            model.pair_gap[pair] = -model.pair_margin[pair]
        return bool(deep.any())

    def configurations(self, qpos: Float[np.ndarray, "n nq"]) -> Float[np.ndarray, "n coordinates"]:
        """Return the hand's q for MuJoCo's coordinates."""
        palm, root = self.palm_position, self.model.body(int(self.link_body[0]))
        poses = qpos[:, palm : palm + 7] if palm >= 0 else np.tile([*root.pos, *root.quat], (len(qpos), 1))
        rotation = Rotation.from_quat(poses[:, 3:], scalar_first=True).as_matrix()
        q = np.zeros((len(qpos), ROOT_COORDINATES + self.hand.num_joints))
        q[:, :3], q[:, 3:6], q[:, 6:9] = poses[:, :3], rotation[:, :, 0], rotation[:, :, 1]
        for index, name in enumerate(self.hand.joint_names):
            q[:, ROOT_COORDINATES + index] = qpos[:, self.model.joint(name).qposadr[0]]
        return q

    def object_poses(self, qpos: Float[np.ndarray, "n nq"]) -> Float[np.ndarray, "n 4 4"]:
        """Return T_world_object for MuJoCo's coordinates; exactly rigid."""
        free = self.object_position
        poses = np.tile(np.eye(4), (len(qpos), 1, 1))
        poses[:, :3, :3] = Rotation.from_quat(qpos[:, free + 3 : free + 7], scalar_first=True).as_matrix()
        poses[:, :3, 3] = qpos[:, free : free + 3]
        return poses

    def point_jacobian(self, point: np.ndarray, link: int) -> Float[np.ndarray, "3 angle"]:
        """Return d point / d joint angles [m/rad], [m/m] of slides, of a point of a link.

        The point is in the world [m], the palm is fixed.
        """
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jac(self.model, self.data, jacobian, None, point, int(self.link_body[link]))
        return np.asarray(jacobian @ self.dof_of_angle)

    def contact_jacobians(self, contacts: HandContacts) -> Float[np.ndarray, "contact 3 angle"]:
        """Return the same for the points of the hand at the contacts."""
        found = np.zeros((len(contacts.points), 3, self.hand.num_joints))
        for index, (point, link) in enumerate(zip(contacts.points, contacts.link, strict=True)):
            found[index] = self.point_jacobian(point, int(link))
        return found


def scene_model(hand: Hand, scene: Scene) -> SimulationModel:
    """Return the model of a hand in a scene, compiled from MJCF that needs no other file: what its file holds is simulated.

    Raises:
        MeshError: object or surroundings cannot be cut into convex pieces.
    """
    spec = _hand_spec(hand, link_surface(scene))
    _drive_base(spec, hand)
    for name in hand.link_names:
        spec.body(name).gravcomp = 1.0
    add_self_contacts(spec, hand)
    add_scene(spec, scene, environment_pieces(scene.environment_mesh, scene.way_bounds()))
    return load_scene_model(str(spec.to_xml()), hand, scene)


def link_surface(scene: Scene) -> ContactSurface:
    """Return what the links of hand and arm are like in a scene."""
    torsion = 2.0 / 3.0 * scene.friction_hand * PAD_RADIUS
    return ContactSurface(
        HAND_SIDE,
        touches=OBJECT_SIDE | ENVIRONMENT_SIDE,
        friction=(scene.friction_hand, torsion),
        dimensions=4,
        priority=1,
        solref=SLIDING_CONTACT,
        solimp=SLIDING_IMPEDANCE,
        colour=(0.75, 0.75, 0.80, 1.0),
    )


def add_self_contacts(spec: Any, hand: Hand) -> None:
    """Let the links touch each other that `Hand.self_collision_pairs` names, from `SELF_CONTACT_DEPTH` on.

    Without friction: that between hand and object says nothing of the hand's housings.
    """
    for pair in hand.self_collision_pairs:
        one, other = (spec.body(hand.link_names[link]).geoms for link in pair)
        for first, second in product(one, other):
            touching = spec.add_pair(geomname1=first.name, geomname2=second.name)
            touching.condim, touching.solref = 1, first.solref
            touching.margin, touching.gap = -SELF_CONTACT_DEPTH, SELF_CONTACT_DEPTH


def add_scene(spec: Any, scene: Scene, surroundings: list[Vertices]) -> None:
    """Add object, surroundings in convex pieces, and MuJoCo's options, to a spec; then compile it.

    Raises:
        MeshError: the object cannot be cut into convex pieces.
    """
    environment_surface = ContactSurface(
        ENVIRONMENT_SIDE,
        touches=HAND_SIDE | OBJECT_SIDE,
        friction=(scene.friction_environment, 0.0),
        priority=2,
        solref=SLIDING_CONTACT,
        solimp=SLIDING_IMPEDANCE,
        colour=(0.70, 0.62, 0.50, 0.35),
    )
    _set_options(spec.option, timestep=TIMESTEP, noslip_iterations=NOSLIP_ITERATIONS, gravity=GRAVITY)
    body = _add_object(spec, scene.object_mesh, scene.mass)
    body.pos, body.quat = scene.T_world_object[:3, 3], _quaternion(scene.T_world_object)
    object_surface = ContactSurface(OBJECT_SIDE, touches=HAND_SIDE | ENVIRONMENT_SIDE)
    add_pieces(spec, body, object_pieces(scene.object_mesh), object_surface)
    add_pieces(spec, spec.worldbody.add_body(name=SURROUNDINGS), surroundings, environment_surface)
    if len(surroundings) > MANY_PIECES:
        spec.memory = MEMORY
    spec.compile()


def load_scene_model(xml: str, hand: Hand, scene: Scene) -> SimulationModel:
    """Compile the `xml` of the model of the same hand and scene, without cutting anything into pieces again."""
    return indexed(hand, mujoco.MjModel.from_xml_string(xml), xml, scene.T_world_object)


def grasp_model(hand: Hand, object_mesh: trimesh.Trimesh) -> SimulationModel:
    """Build the model of a hand whose palm stays where it is placed, and a free object of 100 g without gravity.

    Only links against the object make contacts: a verified grasp has no links in each other, and the motions that the hold
    test allows are small. The frame of `object_mesh` [m] is that of q.

    Raises:
        MeshError: the object cannot be cut into convex pieces.
    """
    links, thing = (
        ContactSurface(
            side, touches, friction=(GRASP_FRICTION, GRASP_TORSIONAL_FRICTION), dimensions=4, solref=GRASP_SOLREF
        )
        for side, touches in ((HAND_SIDE, OBJECT_SIDE), (OBJECT_SIDE, HAND_SIDE))
    )
    spec = _hand_spec(hand, links)
    _set_options(spec.option, timestep=GRASP_TIMESTEP, noslip_iterations=GRASP_NOSLIP_ITERATIONS, gravity=0.0)
    # One contact per pair of pieces, as in the MuJoCo that the settings come from; newer ones make several by default.
    spec.option.disableflags |= int(getattr(mujoco.mjtDisableBit, "mjDSBL_MULTICCD", 0))
    spec.body(hand.link_names[0]).mocap = True
    body = _add_object(spec, object_mesh, GRASP_MASS)
    add_pieces(spec, body, object_pieces(object_mesh), thing)
    return indexed(hand, spec.compile(), "", np.eye(4))


SIDES = {"friction_hand": HAND_SIDE, "friction_environment": ENVIRONMENT_SIDE}
QUANTITIES = (*SIDES, "mass")


def changed_physics(simulation: SimulationModel, **factors: float) -> SimulationModel:
    """Return a model of its own in which quantities of the scene are multiplied, such as `mass=1.25`.

    It equals the model of the changed scene; `simulation` stays as it is. A fingertip's torque about its normal is in
    proportion to its friction, an object's inertia to its mass.

    Raises:
        InputError: a quantity is none of `QUANTITIES`.
    """
    model = copy.deepcopy(simulation.model)
    for quantity, factor in factors.items():
        if quantity == "mass":
            model.body_mass[simulation.object_body] *= factor
            model.body_inertia[simulation.object_body] *= factor
        elif quantity in SIDES:
            model.geom_friction[simulation.side == SIDES[quantity], :2] *= factor  # sliding and torsional
        else:
            raise InputError(f"{quantity!r} cannot be changed in a model; expected one of {', '.join(QUANTITIES)}")
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)  # what MuJoCo derives from masses at compile time
    return replace(simulation, model=model, data=data)


def _hand_spec(hand: Hand, surface: ContactSurface) -> Any:
    """Return a spec of its own with the hand's joints, motors and convex pieces."""
    spec = _pieces_spec(hand).copy()
    for name in hand.link_names:
        for geom in spec.body(name).geoms:
            surface.apply(geom)
    return spec


@cached_per_instance
def _pieces_spec(hand: Hand) -> Any:
    no_files: list[str | None] = [None] * len(hand.link_names)
    return spec_of_links(mjcf_of_hand(hand, no_files, ""), hand, ContactSurface(HAND_SIDE, OBJECT_SIDE))


def spec_of_links(mjcf: ElementTree.Element, hand: Hand, surface: ContactSurface) -> Any:
    """Return the spec of MJCF without geometry, its links filled with the convex pieces of the hand's."""
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(mjcf, encoding="unicode"))
    for name, pieces in zip(hand.link_names, link_pieces(hand), strict=True):
        add_pieces(spec, spec.body(name), pieces, surface)
    return spec


def _set_options(option: Any, *, timestep: float, noslip_iterations: int, gravity: float) -> None:
    option.timestep = timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = NORMAL_TO_TANGENT_STIFFNESS
    option.noslip_iterations = noslip_iterations
    option.gravity = (0.0, 0.0, -gravity)
    # A state that is no longer finite must be seen, not silently replaced by the start.
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _drive_base(spec: Any, hand: Hand) -> None:
    """Hang the palm on six critically damped springs to a target, as an arm under impedance control carries it.

    Springs and dampers together exert no more than the arm can.
    """
    palm = spec.body(hand.link_names[0])
    palm.add_freejoint(name=DRIVER)
    palm.add_site(name="palm")
    spec.worldbody.add_body(name=DRIVER, mocap=True).add_site(name=DRIVER)
    flange = palm.add_body(name=ARM, explicitinertial=True, gravcomp=1.0)
    # MuJoCo's XML leaves out an inertia without a place.
    flange.mass, flange.ipos, flange.inertia = ARM_MASS, (0.0, 0.0, 0.0), (ARM_INERTIA,) * 3
    hand_mass = sum(body_inertia(mesh).mass for mesh in hand.link_meshes)
    mass = ARM_MASS + hand_mass
    inertia = ARM_INERTIA + hand_mass * (hand.finger_length / 2) ** 2
    for index, name in enumerate(BASE_MOTORS):
        stiffness, inert, most = (
            (BASE_STIFFNESS, mass, BASE_FORCE_LIMIT)
            if index < 3
            else (BASE_ROTATION_STIFFNESS, inertia, BASE_TORQUE_LIMIT)
        )
        motor = spec.add_actuator(name=name, target="palm", refsite=DRIVER)
        motor.trntype = mujoco.mjtTrn.mjTRN_SITE
        motor.gear[:] = np.eye(6)[index]
        motor.set_to_position(kp=stiffness, kv=2.0 * np.sqrt(stiffness * inert))
        motor.forcelimited, motor.forcerange = True, (-most, most)


def _add_object(spec: Any, mesh: trimesh.Trimesh, mass: float) -> Any:
    """Add a free body with the mesh's centre of mass and the inertia of an even density."""
    body = spec.worldbody.add_body(name=OBJECT)
    body.add_freejoint(name=OBJECT)
    solid = mesh if mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0 else mesh.convex_hull
    inertia = np.asarray(solid.moment_inertia) * (mass / solid.mass)
    body.mass, body.ipos, body.explicitinertial = mass, centre_of_mass(mesh), True
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return body


def add_pieces(spec: Any, body: Any, pieces: list[Vertices], surface: ContactSurface) -> None:
    """Add convex pieces [m, body's frame] to a body of a spec."""
    for index, vertices in enumerate(pieces):
        name = f"{body.name} {index}"
        spec.add_mesh(name=name, uservert=np.asarray(vertices, dtype=np.float64).reshape(-1))
        surface.apply(body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name))


def indexed(hand: Hand, model: Any, xml: str, T_world_object: Float[np.ndarray, "4 4"]) -> SimulationModel:
    """Return a compiled model with the places of hand and object in it; its base is driven where it has springs."""
    joint_position = np.full(len(hand.link_names), -1)
    dof_of_angle = np.zeros((model.nv, hand.num_joints))
    for link, joint in enumerate(hand.joints):
        if joint is not None and joint.index is not None:
            joint_position[link] = model.joint(joint.name).qposadr[0]
            dof_of_angle[model.joint(joint.name).dofadr[0], joint.index] = joint.multiplier
    motor_of_angle = np.zeros((model.nu, hand.num_joints))
    coupled = {name for pair in hand.couplings for name in pair}
    for index, name in enumerate(hand.joint_names):
        if name not in coupled:
            motor_of_angle[model.actuator(name).id, index] = 1.0
    for (follower, leader), pair in zip(hand.couplings, hand.coupled_indices, strict=True):
        motor_of_angle[model.actuator(f"{follower}+{leader}").id, pair] = 1.0
    motor_scale = np.ones(model.nu)
    np.copyto(motor_scale, (motor_of_angle * hand.joint_scales).max(axis=1), where=motor_of_angle.any(axis=1))
    sprung = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, DRIVER) >= 0
    base_motor = np.array([model.actuator(name).id for name in BASE_MOTORS if sprung], dtype=np.int64)
    link_of_body = np.full(model.nbody, -1)
    link_body = np.asarray([model.body(name).id for name in hand.link_names])
    link_of_body[link_body] = np.arange(len(link_body))
    return SimulationModel(
        hand=hand,
        xml=xml,
        model=model,
        data=mujoco.MjData(model),
        T_world_object=T_world_object,
        palm_position=int(model.joint(DRIVER).qposadr[0]) if sprung else -1,
        object_body=int(model.body(OBJECT).id),
        object_position=int(model.joint(OBJECT).qposadr[0]),
        side=np.array(model.geom_contype),
        link_body=link_body,
        joint_position=joint_position,
        dof_of_angle=dof_of_angle,
        motor_of_angle=motor_of_angle,
        motor_gain=np.array(model.actuator_gainprm[:, 0]),
        motor_scale=motor_scale,
        base_motor=base_motor,
        base_stiffness=-model.actuator_biasprm[base_motor, 1],
        base_damping=-model.actuator_biasprm[base_motor, 2],
        link_of_geom=link_of_body[model.geom_bodyid],
    )


def _quaternion(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 4"]:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(pose[:3, :3]).reshape(9))
    return quaternion
