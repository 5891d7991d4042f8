"""Forward kinematics against MuJoCo's, which reads the same descriptions on its own."""

import mujoco
import numpy as np
import pytest
import torch

from dexnudge.hands.export import export_hand
from dexnudge.hands.named.shadow import compiled_model
from dexnudge.hands.registry import load_hand

TOLERANCE = 1e-6  # [m], and as much in the rotation's entries


def palm_frame(hand, q):
    worlds = hand.forward_kinematics(torch.as_tensor(q)).numpy()
    return np.linalg.inv(worlds[:, :1]) @ worlds


@pytest.mark.parametrize("file", ["hand.xml", "hand.urdf"])
@pytest.mark.parametrize("name", ["shadow_lite", "shadow_full"])
def test_exported_hands_move_in_mujoco_as_here(name, file, request, tmp_path, random_q, mujoco_transforms):
    hand = request.getfixturevalue(name.removeprefix("shadow_"))
    path = export_hand(hand, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(path.with_name(file)))
    q = random_q(hand, 20)
    ours = palm_frame(hand, q)
    for row in range(len(q)):
        angles = dict(zip(hand.joint_names, q[row, 9:], strict=True))
        theirs = mujoco_transforms(model, angles, list(hand.link_names), "palm")
        np.testing.assert_allclose(ours[row], theirs, atol=TOLERANCE)


def test_full_hand_moves_as_the_model_that_the_package_ships(full, random_q, mujoco_transforms):
    model = compiled_model()
    moved = ["wrist", "forearm"]  # their frames lie at their joints here, because the tree hangs from the palm
    links = [link for link in full.link_names if link not in moved]
    kept = [full.link_names.index(link) for link in links]
    q = random_q(full, 20, seed=1)
    ours = palm_frame(full, q)
    for row in range(len(q)):
        angles = {
            f"robot0:{name[:-1]}{int(name[-1]) - 1}": angle
            for name, angle in zip(full.joint_names, q[row, 9:], strict=True)
        }
        theirs = mujoco_transforms(model, angles, [f"robot0:{link}" for link in links], "robot0:palm")
        np.testing.assert_allclose(ours[row, kept], theirs, atol=TOLERANCE)
        for link, geom in (("wrist", "V_wrist"), ("forearm", "C_forearm")):
            index = full.link_names.index(link)
            vertices = full.link_meshes[index].vertices @ ours[row, index, :3, :3].T + ours[row, index, :3, 3]
            np.testing.assert_allclose(vertices, geom_vertices(model, angles, f"robot0:{geom}"), atol=TOLERANCE)


def geom_vertices(model, angles, geom):
    data = mujoco.MjData(model)
    for name, angle in angles.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    mesh = model.geom(geom).dataid[0]
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    world = vertices @ data.geom(geom).xmat.reshape(3, 3).T + data.geom(geom).xpos
    palm = data.body("robot0:palm")
    return (world - palm.xpos) @ palm.xmat.reshape(3, 3)


def mimicked(angles):
    """The rules of the small hand's <mimic> elements, written out."""
    middle = 0.8 * angles["near"] - 0.2
    return {**angles, "middle": middle, "far": -0.5 * middle + 0.1}


def test_small_hand_with_mimic_joints_moves_as_mujoco_reads_its_urdf(small, small_urdf, random_q, mujoco_transforms):
    spec = mujoco.MjSpec.from_string(
        small_urdf.read_text().replace(
            '<robot name="small">',
            '<robot name="small"><mujoco><compiler fusestatic="false" boundmass="1" boundinertia="1"/></mujoco>',
        ),
        assets={"wedge.stl": (small_urdf.parent / "wedge.stl").read_bytes()},
    )
    model = spec.compile()
    links = [link for link in small.link_names if link != "forearm"]
    kept = [small.link_names.index(link) for link in links]
    q = random_q(small, 20)
    ours = palm_frame(small, q)
    forearm = small.link_names.index("forearm")
    for row in range(len(q)):
        angles = mimicked(dict(zip(small.joint_names, q[row, 9:], strict=True)))
        theirs = mujoco_transforms(model, angles, [*links, "forearm"], "palm")
        np.testing.assert_allclose(ours[row, kept], theirs[:-1], atol=TOLERANCE)
        # The forearm was the root: its frame has moved to the wrist, its box must not have.
        corners = small.link_meshes[forearm].vertices @ ours[row, forearm, :3, :3].T + ours[row, forearm, :3, 3]
        np.testing.assert_allclose(
            np.sort(corners, axis=0), np.sort(forearm_corners(theirs[-1]), axis=0), atol=TOLERANCE
        )


def forearm_corners(T_palm_forearm):
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    cosine, sine = np.cos(0.1), np.sin(0.1)
    tilt = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    box = signs * (0.04, 0.05, 0.06) @ tilt.T + (0, 0, 0.02)
    return box @ T_palm_forearm[:3, :3].T + T_palm_forearm[:3, 3]


def test_mjcf_of_a_small_hand_reads_back_with_its_mimic_joints(small, tmp_path, random_q):
    path = export_hand(small, tmp_path)
    again = load_hand(path.with_name("hand.xml"))
    assert set(again.joint_names) == set(small.joint_names)  # MJCF orders links and joints depth first
    links = [again.link_names.index(link) for link in small.link_names]
    joints = [small.joint_names.index(joint) for joint in again.joint_names]
    q = random_q(small, 10)
    transforms = again.forward_kinematics(torch.as_tensor(np.concatenate([q[:, :9], q[:, 9:][:, joints]], axis=1)))
    torch.testing.assert_close(transforms[:, links], small.forward_kinematics(torch.as_tensor(q)), atol=1e-12, rtol=0)


def test_root_pose_moves_the_whole_hand(lite, random_q):
    q = random_q(lite, 5)
    at_origin = q.copy()
    at_origin[:, :9] = (0, 0, 0, 1, 0, 0, 0, 1, 0)
    first, second = q[:, 3:6], q[:, 6:9]
    root = np.zeros((5, 1, 4, 4))
    root[:, 0, :3, :] = np.stack([first, second, np.cross(first, second), q[:, :3]], axis=2)
    root[:, 0, 3, 3] = 1.0
    moved = root @ lite.forward_kinematics(torch.as_tensor(at_origin)).numpy()
    np.testing.assert_allclose(lite.forward_kinematics(torch.as_tensor(q)).numpy(), moved, atol=1e-12)


def test_gradient_equals_finite_differences(small, random_q):
    q = torch.as_tensor(random_q(small, 2)).requires_grad_(True)
    assert torch.autograd.gradcheck(small.forward_kinematics, (q,))


def test_single_precision_stays_single_and_close(full, random_q):
    q = random_q(full, 10)
    single = full.forward_kinematics(torch.as_tensor(q, dtype=torch.float32))
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), full.forward_kinematics(torch.as_tensor(q)).numpy(), atol=2e-6)
