"""Sliding joints: read from URDF and MJCF, placed as MuJoCo places them, exported, and those above the hand cut off."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from dexnudge.errors import HandError
from dexnudge.hands.export import export_hand
from dexnudge.hands.registry import load_hand

BOX = "<collision><origin xyz='0 0 0.02'/><geometry><box size='0.02 0.01 0.04'/></geometry></collision>"
URDF = f"""<robot name="gripper">
  <mujoco><compiler fusestatic="false" boundmass="1" boundinertia="1"/></mujoco>
  <link name="stand">{BOX}</link>
  <joint name="lift" type="prismatic">
    <parent link="stand"/><child link="palm"/><origin xyz="0.01 0.02 0.03" rpy="0.3 -0.2 0.5"/><axis xyz="0 3 4"/>
    <limit lower="-0.02" upper="0.05"/>
  </joint>
  <link name="palm">{BOX}</link>
  <joint name="left" type="prismatic">
    <parent link="palm"/><child link="jaw"/><origin xyz="0.02 0 0.05" rpy="0 1 0.4"/><axis xyz="1 2 0"/>
    <limit lower="0" upper="0.04"/>
  </joint>
  <joint name="right" type="prismatic">
    <parent link="palm"/><child link="other"/><origin xyz="-0.02 0 0.05" rpy="-1 0 2"/><axis xyz="0 0 -2"/>
    <limit lower="-1" upper="1"/><mimic joint="left" multiplier="-0.8" offset="0.005"/>
  </joint>
  <joint name="bend" type="revolute">
    <parent link="jaw"/><child link="tip"/><origin xyz="0 0 0.04"/><axis xyz="1 0 0"/><limit lower="-0.5" upper="1"/>
  </joint>
  <joint name="rack" type="prismatic">
    <parent link="tip"/><child link="pad"/><axis xyz="0 1 1"/><limit lower="-1" upper="1"/>
    <mimic joint="bend" multiplier="0.01" offset="0.002"/>
  </joint>
  <link name="jaw">{BOX}</link><link name="other">{BOX}</link><link name="tip">{BOX}</link><link name="pad">{BOX}</link>
</robot>"""
MJCF = """<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="stand">
      <geom type="box" size="0.01 0.01 0.02"/>
      <body name="palm" pos="0.01 0.02 0.03" euler="0.3 -0.2 0.5">
        <joint name="lift" type="slide" axis="0 3 4" pos="0 0.1 0" ref="0.01" range="-0.02 0.05"/>
        <geom type="box" size="0.01 0.01 0.02"/>
        <body name="jaw" pos="0.02 0 0.05" euler="0 1 0.4">
          <joint name="left" type="slide" axis="1 2 0" range="0 0.04"/>
          <joint name="bend" axis="1 0 0" pos="0 0 0.04" range="-0.5 1"/>
          <joint name="rack" type="slide" axis="0 1 1" pos="1 2 3" ref="0.003" range="-1 1"/>
          <geom type="box" size="0.01 0.01 0.02"/>
        </body>
        <body name="other" pos="-0.02 0 0.05">
          <joint name="right" type="slide" axis="0 0 -2" ref="0.002" range="-1 1"/>
          <geom type="box" size="0.01 0.01 0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
    <joint joint1="right" joint2="left" polycoef="0.005 -0.8 0 0 0"/>
    <joint joint1="rack" joint2="bend" polycoef="0.002 0.01 0 0 0"/>
  </equality>
</mujoco>"""
YAML = "palm: palm\nfingertips: {{A: {tip}, B: other}}\npalm_normal: [0, 1, 0]\nbase_link: stand\n"
FOLLOWERS = {  # at values x of the independent joints, as the two files state them
    "hand.urdf": lambda x: {"right": 0.005 - 0.8 * x["left"], "rack": 0.002 + 0.01 * x["bend"]},
    "hand.xml": lambda x: {"right": 0.002 + 0.005 - 0.8 * x["left"], "rack": 0.003 + 0.002 + 0.01 * x["bend"]},
}


def write(folder, file, text=None, yaml=YAML):
    (folder / "hand.yaml").write_text(yaml.format(tip="pad" if file == "hand.urdf" else "jaw"))
    (folder / file).write_text(text or (URDF if file == "hand.urdf" else MJCF))
    return folder / file


@pytest.fixture(params=["hand.urdf", "hand.xml"])
def path(request, tmp_path):
    return write(tmp_path, request.param)


def test_they_move_as_in_mujoco_also_below_a_palm_that_was_no_root(path, random_q, mujoco_transforms):
    hand = load_hand(path)
    assert hand.joint_names == ("lift", "left", "bend")
    assert hand.sliding.tolist() == [True, True, False]
    np.testing.assert_allclose(hand.upper, (0.05, 0.04, 1.0))
    np.testing.assert_allclose(hand.joint_scales, (0.05, 0.05, 1.0))
    model = mujoco.MjModel.from_xml_path(str(path))
    links = [name for name in ("jaw", "other", "tip", "pad") if name in hand.link_names]
    kept, stand = [hand.link_names.index(link) for link in links], hand.link_names.index("stand")
    q = random_q(hand, 20)
    worlds = hand.forward_kinematics(torch.as_tensor(q)).numpy()
    ours = np.linalg.inv(worlds[:, :1]) @ worlds
    for row in range(len(q)):
        values = dict(zip(hand.joint_names, q[row, 9:], strict=True))
        values |= FOLLOWERS[path.name](values)
        theirs = mujoco_transforms(model, values, [*links, "stand"], "palm")
        np.testing.assert_allclose(ours[row, kept], theirs[:-1], atol=1e-6)
        # The stand was the root: its frame has moved to the palm's joint, its box must not have.
        vertices = hand.link_meshes[stand].vertices @ ours[row, stand, :3, :3].T + ours[row, stand, :3, 3]
        box = np.array([0, 0, 0.02 if path.suffix == ".urdf" else 0.0])
        np.testing.assert_allclose(vertices.mean(axis=0), theirs[-1, :3, :3] @ box + theirs[-1, :3, 3], atol=1e-6)


def test_the_gradient_equals_finite_differences(path, random_q):
    hand = load_hand(path)
    q = torch.as_tensor(random_q(hand, 2)).requires_grad_(True)
    assert torch.autograd.gradcheck(hand.forward_kinematics, (q,))


@pytest.mark.parametrize("file", ["hand.urdf", "hand.xml"])
def test_an_exported_hand_is_the_same_hand(path, file, tmp_path, random_q, mujoco_transforms):
    hand = load_hand(path)
    written = export_hand(hand, tmp_path / "out").with_name(file)
    again = load_hand(written)
    order = [again.joint_names.index(name) for name in hand.joint_names]
    np.testing.assert_array_equal(again.lower[order], hand.lower)
    np.testing.assert_array_equal(again.sliding[order], hand.sliding)
    links = [again.link_names.index(link) for link in hand.link_names]
    q = random_q(hand, 10)
    theirs = np.concatenate([q[:, :9], q[:, 9:][:, np.argsort(order)]], axis=1)
    ours = hand.forward_kinematics(torch.as_tensor(q))
    torch.testing.assert_close(again.forward_kinematics(torch.as_tensor(theirs))[:, links], ours, atol=1e-9, rtol=0)
    model = mujoco.MjModel.from_xml_path(str(written))
    for row in range(len(q)):
        values = dict(zip(hand.joint_names, q[row, 9:], strict=True))
        values |= {
            j.name: j.multiplier * q[row, 9 + j.index] + j.offset for j in hand.joints if j and j.index is not None
        }
        found = mujoco_transforms(model, values, list(hand.link_names), "palm")
        np.testing.assert_allclose((torch.linalg.inv(ours[row, :1]) @ ours[row]).numpy(), found, atol=1e-6)


WITHOUT_BASE = YAML.replace("base_link: stand\n", "")


def test_what_slides_above_the_hand_is_cut_off(tmp_path):
    path = write(tmp_path, "hand.urdf", yaml=WITHOUT_BASE)
    hand = load_hand(path)
    assert hand.joint_names == ("left", "bend")
    assert hand.notes == ("'lift', which moves 'palm' along, was cut off with 1 links",)


def test_a_palm_on_three_slides_is_free_of_them(tmp_path):
    links = "".join(f'<link name="cart_{axis}"/>' for axis in "xyz")
    slides = "".join(
        f'<joint name="move_{axis}" type="prismatic"><parent link="cart_{axis}"/><child link="{child}"/></joint>'
        for axis, child in zip("xyz", ("cart_y", "cart_z", "stand"), strict=True)
    )
    path = write(tmp_path, "hand.urdf", URDF.replace("</robot>", links + slides + "</robot>"))
    hand = load_hand(path)
    assert hand.joint_names == ("lift", "left", "bend")
    assert hand.notes == ("joints that place the hand in the world were cut off: move_x, move_y, move_z",)


def test_a_jaw_as_the_palm_keeps_the_other_jaw(tmp_path):
    yaml = YAML.format(tip="pad").replace("palm: palm", "palm: jaw")
    hand = load_hand(write(tmp_path, "hand.urdf", yaml=yaml.replace("{", "{{").replace("}", "}}")))
    assert set(hand.joint_names) == {"lift", "left", "bend"}
    assert hand.link_names[0] == "jaw"


def test_a_coupling_of_a_slide_with_an_angle_is_refused(tmp_path):
    yaml = YAML + "couplings: [[bend, left]]\n"
    with pytest.raises(HandError) as caught:
        load_hand(write(tmp_path, "hand.urdf", yaml=yaml))
    assert str(caught.value) == (
        "coupling bend <= left compares a slide with an angle: expected joints of one kind; mend the pair"
    )


def test_open_jaws_are_apart_and_keypoints_lie_on_them(two_jaws):
    np.testing.assert_allclose(two_jaws.apart, [0.04])
    for tip, keypoint in zip(two_jaws.fingertip_indices, two_jaws.fingertip_keypoints, strict=True):
        low, high = two_jaws.link_meshes[tip].bounds
        assert (keypoint > low).all()
        assert (keypoint < high).all()
        assert keypoint[2] > (low[2] + high[2]) / 2  # on the half away from the palm


@pytest.mark.parametrize(
    ("normal", "axis", "faces"),
    [((0, 0, 1), (1, 0, 0), True), ((1, 0, 0), (0, 0, 1), False), ((0, 1, 0), (0, 0, 1), False)],
)
def test_jaws_may_point_where_the_palm_faces_or_along_it(two_jaws, normal, axis, faces):
    hand = replace(two_jaws, palm_normal=np.array(normal, dtype=float))
    assert hand.fingers_face == faces
    np.testing.assert_allclose(np.abs(hand.finger_axis), axis, atol=1e-9)
    np.testing.assert_allclose(hand.finger_middle, (0, 0, hand.keypoints(hand._zero)[0, 0, 2] / 2), atol=1e-9)


def test_motors_of_slides_push_as_fingers_do(two_jaws, tmp_path):
    model = mujoco.MjModel.from_xml_path(str(export_hand(two_jaws, tmp_path).with_name("hand.xml")))
    assert model.actuator("left_slide").gainprm[0] == pytest.approx(5.0 / 0.05**2)  # [N/m] of 5 N m/rad at 0.05 m
    np.testing.assert_allclose(model.actuator("left_slide").forcerange, (-40.0, 40.0))  # [N] of 2 N m there
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.03
    for _ in range(1000):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos[:2], (0.03, 0.03), atol=5e-4)  # the follower goes along
