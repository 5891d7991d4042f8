"""A hand that is exported and read back is the same hand, and other tools can read it."""

import warnings

import mujoco
import numpy as np
import pytest
import torch
import trimesh
import yourdfpy
from scipy.spatial.transform import Rotation

from dexnudge.hands.export import euler_angles, export_hand
from dexnudge.hands.registry import load_hand


@pytest.fixture(params=["lite", "full", "small"])
def hand(request):
    return request.getfixturevalue(request.param)


def test_round_trip_keeps_everything(hand, tmp_path, random_q):
    again = load_hand(export_hand(hand, tmp_path / "a" / "hand"))
    for name in ("name", "joint_names", "link_names", "fingertips", "couplings", "base_link"):
        assert getattr(again, name) == getattr(hand, name), name
    for name in ("lower", "upper", "link_parent", "palm_normal"):
        np.testing.assert_array_equal(getattr(again, name), getattr(hand, name), err_msg=name)
    for ours, theirs in zip(hand.link_meshes, again.link_meshes, strict=True):
        np.testing.assert_array_equal(theirs.vertices, ours.vertices)
        np.testing.assert_array_equal(theirs.faces, ours.faces)
    q = torch.as_tensor(random_q(hand, 10))
    torch.testing.assert_close(again.forward_kinematics(q), hand.forward_kinematics(q), atol=1e-12, rtol=0)


def test_round_trip_keeps_points_and_pairs(lite, tmp_path):
    again = load_hand(export_hand(lite, tmp_path))
    for part in ("points", "normals", "link"):
        ours, theirs = getattr(lite.dense_points, part), getattr(again.dense_points, part)
        np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-15)
    assert again.self_collision_pairs == lite.self_collision_pairs


def test_exporting_twice_writes_the_same_bytes(small, tmp_path):
    first, second = (export_hand(small, tmp_path / name).parent for name in "ab")
    names = sorted(str(path.relative_to(first)) for path in first.rglob("*") if path.is_file())
    assert names[:3] == ["hand.urdf", "hand.xml", "hand.yaml"]
    assert all((first / name).read_bytes() == (second / name).read_bytes() for name in names)


def test_yourdfpy_reads_the_same_hand(hand, tmp_path, random_q):
    path = export_hand(hand, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # yourdfpy calls what trimesh is about to remove
        robot = yourdfpy.URDF.load(str(path), load_collision_meshes=True, build_collision_scene_graph=True)
    assert robot.base_link == "palm"
    assert tuple(robot.actuated_joint_names) == hand.joint_names
    q = random_q(hand, 1)
    q[:, :9] = (0, 0, 0, 1, 0, 0, 0, 1, 0)
    robot.update_cfg(q[0, 9:])
    ours = hand.forward_kinematics(torch.as_tensor(q))[0].numpy()
    for link, name in enumerate(hand.link_names):
        if hand.joints[link] is None or hand.joints[link].name in hand.joint_names:  # it does not chain mimic joints
            np.testing.assert_allclose(robot.get_transform(name, "palm"), ours[link], atol=1e-9)
    faces = sum(len(mesh.faces) for mesh in hand.link_meshes)
    assert sum(len(mesh.faces) for mesh in robot.collision_scene.geometry.values()) == faces


def test_pinocchio_reads_the_same_hand(lite, tmp_path, random_q):
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromUrdf(str(export_hand(lite, tmp_path)))
    geometry = pinocchio.buildGeomFromUrdf(
        model, str(tmp_path / "hand.urdf"), pinocchio.COLLISION, package_dirs=[str(tmp_path)]
    )
    assert len(geometry.geometryObjects) == sum(len(mesh.faces) > 0 for mesh in lite.link_meshes)
    q = random_q(lite, 1)
    q[:, :9] = (0, 0, 0, 1, 0, 0, 0, 1, 0)
    angles = [q[0, 9 + lite.joint_names.index(name)] for name in list(model.names)[1:]]
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, np.asarray(angles))
    ours = lite.forward_kinematics(torch.as_tensor(q))[0].numpy()
    for link, name in enumerate(lite.link_names):
        np.testing.assert_allclose(data.oMf[model.getFrameId(name)].homogeneous, ours[link], atol=1e-9)


def test_mujoco_urdf_keeps_every_link_and_its_mesh(hand, tmp_path):
    model = mujoco.MjModel.from_xml_path(str(export_hand(hand, tmp_path)))
    assert {model.body(body).name for body in range(1, model.nbody)} == set(hand.link_names)
    solid = [link for link, mesh in enumerate(hand.link_meshes) if len(mesh.faces)]
    assert model.ngeom == len(solid)
    for geom in range(model.ngeom):
        mesh = hand.link_meshes[hand.link_names.index(model.body(model.geom_bodyid[geom]).name)]
        assert model.mesh_facenum[model.geom_dataid[geom]] == pytest.approx(len(mesh.faces), abs=5)  # slivers go


def test_mjcf_has_one_motor_for_each_motor_of_the_hand(lite, tmp_path):
    model = mujoco.MjModel.from_xml_path(str(export_hand(lite, tmp_path).with_name("hand.xml")))
    names = [model.actuator(motor).name for motor in range(model.nu)]
    assert len(names) == 13
    assert names[-3:] == ["FFJ1+FFJ2", "MFJ1+MFJ2", "RFJ1+RFJ2"]


def test_mjcf_tendon_holds_the_coupling(lite, tmp_path):
    # The shared motor alone would bend J1 as well as J2; a push on the last link must not make J1 overtake J2.
    model = mujoco.MjModel.from_xml_path(str(export_hand(lite, tmp_path).with_name("hand.xml")))
    data = mujoco.MjData(model)
    data.actuator("FFJ1+FFJ2").ctrl = 1.0
    data.joint("FFJ1").qfrc_applied = 0.2
    for _ in range(1500):
        mujoco.mj_step(model, data)
    follower, leader = data.joint("FFJ1").qpos[0], data.joint("FFJ2").qpos[0]
    assert leader > 0.3
    assert follower - leader < 0.02
    assert abs(data.qvel).max() < 0.05


def test_mjcf_contact_pairs_are_the_self_collision_pairs(lite, tmp_path):
    model = mujoco.MjModel.from_xml_path(str(export_hand(lite, tmp_path).with_name("hand.xml")))
    excluded = {tuple(sorted((int(pair) >> 16, int(pair) & 0xFFFF))) for pair in model.exclude_signature}
    solid = [link + 1 for link, mesh in enumerate(lite.link_meshes) if len(mesh.faces)]  # MuJoCo counts the world
    pairs = {(a, b) for a in solid for b in solid if a < b} - excluded
    assert pairs == {(a + 1, b + 1) for a, b in lite.self_collision_pairs}


def test_link_names_cannot_lead_out_of_the_folder(write_hand, tmp_path):
    path = write_hand()
    evil = path.read_text().replace('"thumbtip"', '"../../evil tip"')
    path.write_text(evil)
    (path.parent / "hand.yaml").write_text(
        (path.parent / "hand.yaml").read_text().replace("thumbtip", '"../../evil tip"')
    )
    folder = export_hand(load_hand(path), tmp_path / "deep" / "er" / "hand").parent
    assert (folder / "meshes" / "05_______evil_tip.obj").is_file()
    assert load_hand(folder / "hand.urdf").fingertips["T"] == "../../evil tip"


@pytest.mark.parametrize("pitch", [0.0, 1.0, -1.3, np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-8])
def test_euler_angles_are_exact_near_the_poles_too(pitch):
    rotation = Rotation.from_euler("ZYX", [0.7, pitch, -2.1]).as_matrix()
    roll, pitch, yaw = euler_angles(rotation)
    np.testing.assert_allclose(trimesh.transformations.euler_matrix(roll, pitch, yaw)[:3, :3], rotation, atol=1e-14)
