"""A scene as USD with UsdPhysics (extra `usd`), and as one MJCF file that needs no other: what executions simulate.

Of a result USD holds the hand at its best configuration, MJCF a key frame for each. USD: metres, kilograms, z up;
/World/object is a rigid body with its mass, /World/environment a static collider, /World/hand/LINK kinematic bodies. A mesh
carries its points in its own frame, its prim the pose. Friction of two materials is averaged by USD's default, so the
hand's is chosen to give `friction_hand` against the object's.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import torch
import trimesh
from jaxtyping import Float

from dexnudge.errors import InputError
from dexnudge.geometry.meshes import centre_of_mass
from dexnudge.hands.hand import Hand
from dexnudge.jobs.atomic_files import replace_atomically
from dexnudge.mechanics.sliding_task import GRAVITY
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.convex_pieces import environment_pieces
from dexnudge.simulation.model import add_scene, scene_model

if TYPE_CHECKING:
    from pxr import Usd

SUFFIXES = (".usda", ".usdc", ".usd")


def write_usd(
    scene: Scene, path: Path, *, hand: Hand | None = None, q: Float[np.ndarray, " coordinates"] | None = None
) -> None:
    """Write the scene, with the hand at q (world) where one is given.

    Raises:
        InputError: usd-core is not installed, or another suffix than .usda, .usdc or .usd.
        OutputError: the file cannot be written.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path} ends in {path.suffix!r}; expected {', '.join(SUFFIXES)}")
    try:
        from pxr import Gf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade
    except ImportError as error:
        raise InputError(
            "USD needs usd-core, which is not installed; install it with pip install 'dexnudge[usd]'"
        ) from error
    stage: Usd.Stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    physics = UsdPhysics.Scene.Define(stage, "/World/physics")
    physics.CreateGravityDirectionAttr(Gf.Vec3f(0.0, 0.0, -1.0))
    physics.CreateGravityMagnitudeAttr(GRAVITY)
    materials = {}
    frictions = {"resting": scene.friction_environment, "hand": 2.0 * scene.friction_hand - scene.friction_environment}
    for name, friction in frictions.items():
        material = UsdShade.Material.Define(stage, f"/World/materials/{name}")
        surface = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
        surface.CreateStaticFrictionAttr(max(0.0, friction))
        surface.CreateDynamicFrictionAttr(max(0.0, friction))
        surface.CreateRestitutionAttr(0.0)
        materials[name] = material
    thing = _add_body(
        stage, "/World/object", scene.object_mesh, scene.T_world_object, materials["resting"], "convexDecomposition"
    )
    UsdPhysics.RigidBodyAPI.Apply(thing)
    mass = UsdPhysics.MassAPI.Apply(thing)
    mass.CreateMassAttr(scene.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*map(float, centre_of_mass(scene.object_mesh))))
    _add_body(stage, "/World/environment", scene.environment_mesh, np.eye(4), materials["resting"], "none")
    if hand is not None and q is not None:
        UsdGeom.Xform.Define(stage, "/World/hand")
        poses = hand.forward_kinematics(torch.as_tensor(q[None].astype(np.float64)))[0].numpy()
        for number, (mesh, pose) in enumerate(zip(hand.link_meshes, poses, strict=True)):
            if len(mesh.faces):
                name = hand.link_names[number]
                place = f"/World/hand/{Tf.MakeValidIdentifier(name)}"
                if stage.GetPrimAtPath(place):  # names that differ in characters which USD does not allow
                    place += f"_{number:02d}"
                link = _add_body(stage, place, mesh, pose, materials["hand"], "convexDecomposition")
                link.SetDisplayName(name)
                UsdPhysics.RigidBodyAPI.Apply(link).CreateKinematicEnabledAttr(True)
    with replace_atomically(path) as part:
        try:
            stage.GetRootLayer().Export(str(part))
        except Tf.ErrorException as error:
            raise OSError(str(error).strip()) from error


def _add_body(
    stage: "Usd.Stage",
    place: str,
    mesh: trimesh.Trimesh,
    pose: Float[np.ndarray, "4 4"],
    material: Any,
    approximation: str,
) -> Any:
    """Add a posed prim with a mesh that collides; USD's matrices act on rows, so the pose is transposed."""
    from pxr import Gf, UsdGeom, UsdPhysics, UsdShade, Vt

    body = UsdGeom.Xform.Define(stage, place)
    body.AddTransformOp().Set(Gf.Matrix4d(*pose.T.ravel().tolist()))
    shape = UsdGeom.Mesh.Define(stage, f"{place}/mesh")
    shape.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.vertices, dtype=np.float32)))
    shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(mesh.faces.ravel(), dtype=np.int32)))
    shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, dtype=np.int32)))
    shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    shape.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(mesh.bounds, dtype=np.float32)))
    UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(shape.GetPrim()).CreateApproximationAttr(approximation)
    UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material, materialPurpose="physics")
    return body.GetPrim()


def write_mujoco(
    scene: Scene, path: Path, *, hand: Hand | None = None, q: Float[np.ndarray, "n coordinates"] | None = None
) -> None:
    """Write the scene, with the hand and key frames of it at each q (world) where one is given.

    Raises:
        MeshError: object or surroundings cannot be cut into convex pieces.
        OutputError: the file cannot be written.
    """
    if hand is None or q is None:
        spec = mujoco.MjSpec()
        add_scene(spec, scene, environment_pieces(scene.environment_mesh, scene.way_bounds()))
        text = str(spec.to_xml())
    else:
        simulation = scene_model(hand, scene)
        root = ElementTree.fromstring(simulation.xml)  # noqa: S314 - the text is our own
        keys = ElementTree.SubElement(root, "keyframe")
        for number, configuration in enumerate(q.astype(np.float64)):
            simulation.place(configuration)
            data = simulation.data
            values = {"qpos": data.qpos, "ctrl": data.ctrl, "mpos": data.mocap_pos[0], "mquat": data.mocap_quat[0]}
            texts = {name: " ".join(f"{each:.9g}" for each in value) for name, value in values.items()}
            ElementTree.SubElement(keys, "key", texts, name=f"configuration {number}")
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding="unicode")
    with replace_atomically(path) as part:
        part.write_text(text, encoding="utf-8")
