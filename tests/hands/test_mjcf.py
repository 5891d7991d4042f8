"""Hands from MuJoCo models: joints away from the origin, several joints on a body, reference angles, shapes, refusals."""

import mujoco
import numpy as np
import pytest
import torch

from dexnudge.errors import HandError
from dexnudge.hands.registry import load_hand

MODEL = """<mujoco>
  <compiler angle="degree"/>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="arm" pos="1 2 3" euler="10 20 30">
      <freejoint/>
      <geom type="capsule" size="0.02 0.05"/>
      <body name="palm" pos="0 0 0.1" euler="0 90 0">
        <joint name="wrist" axis="1 0 0" pos="0 0.01 -0.02" range="-30 30"/>
        <geom type="ellipsoid" size="0.03 0.01 0.04"/>
        <geom type="sphere" size="0.5" contype="0" conaffinity="0"/>
        <body name="finger" pos="0.01 0 0.04">
          <joint name="spread" axis="0 1 0" range="-20 20"/>
          <joint name="bend" axis="1 0 1" ref="15" range="0 90"/>
          <geom type="cylinder" size="0.008 0.02" pos="0 0 0.02"/>
          <body name="tip" pos="0 0 0.04">
            <joint name="end" axis="1 0 0"/>
            <geom type="box" size="0.005 0.004 0.01" pos="0 0 0.01"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="end" joint2="bend" polycoef="0.1 0.7 0 0 0"/></equality>
</mujoco>"""
CONFIG = "palm: palm\nfingertips: {F: tip}\npalm_normal: [0, 1, 0]\nbase_link: arm\n"


@pytest.fixture
def path(tmp_path):
    (tmp_path / "hand.yaml").write_text(CONFIG)
    file = tmp_path / "model.xml"
    file.write_text(MODEL)
    return file


def test_kinematics_and_limits(path, random_q, mujoco_transforms):
    hand = load_hand(path)
    assert hand.joint_names == ("wrist", "spread", "bend")
    np.testing.assert_allclose(np.degrees(hand.upper), (30, 20, 90))
    model = mujoco.MjModel.from_xml_string(MODEL)
    q = random_q(hand, 10)
    worlds = hand.forward_kinematics(torch.as_tensor(q)).numpy()
    ours = np.linalg.inv(worlds[:, :1]) @ worlds
    for row in range(len(q)):
        angles = dict(zip(hand.joint_names, q[row, 9:], strict=True))
        angles["end"] = 0.1 + 0.7 * (angles["bend"] - np.radians(15))
        theirs = mujoco_transforms(model, angles, ["finger", "tip", "arm"], "palm")
        for link, transform in zip(("finger", "tip"), theirs, strict=False):
            np.testing.assert_allclose(ours[row, hand.link_names.index(link)], transform, atol=1e-6)
        # The arm was above the palm: its frame has moved, its capsule must not have.
        arm = hand.link_names.index("arm")
        centre = hand.link_meshes[arm].bounds.mean(axis=0)
        np.testing.assert_allclose((ours[row, arm] @ [*centre, 1])[:3], theirs[2][:3, 3], atol=1e-6)


def test_only_colliding_geoms_are_judged(path):
    hand = load_hand(path)
    np.testing.assert_allclose(hand.link_meshes[0].extents, (0.06, 0.02, 0.08), atol=1e-3)


def message(path):
    with pytest.raises(HandError) as caught:
        load_hand(path)
    return str(caught.value).replace(str(path.parent), "DIR")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            '<joint name="wrist" axis="1 0 0" pos="0 0.01 -0.02" range="-30 30"/>',
            '<joint name="wrist" type="ball"/>',
            "joint 'wrist': expected type revolute, continuous, prismatic, fixed, got 'ball'; replace the joint or fix it",
        ),
        (
            'polycoef="0.1 0.7 0 0 0"',
            'polycoef="0.1 0.7 1 0 0"',
            (
                "joint 'end' follows 'bend' along a curve: expected one within 3 deg of a straight line, got "
                "polycoef [0.1, 0.7, 1.0, 0.0, 0.0], up to 17.7 deg off; narrow the range of 'bend', or give the last three "
                "coefficients as 0"
            ),
        ),
        (
            "<mujoco>",
            '<!DOCTYPE m [<!ENTITY a "b">]><mujoco>',
            (
                "DIR/model.xml: document types and entities are not read: expected plain XML, got '<!DOCTYPE'; "
                "remove it (for xacro: expand the file first)"
            ),
        ),
        (
            "<worldbody>",
            '<asset><mesh name="m" file="../m.stl"/></asset><worldbody>',
            (
                "DIR/model.xml: '../m.stl' lies outside the description's folder: expected a file below DIR; "
                "copy the files beside the description and name them relative to it"
            ),
        ),
        (
            'angle="degree"',
            'meshdir="/etc"',
            (
                "DIR/model.xml: '/etc' lies outside the description's folder: expected a file below DIR; "
                "copy the files beside the description and name them relative to it"
            ),
        ),
        (
            '<body name="palm"',
            '<body name="hand"',
            (
                "the hand's YAML names an unknown link: key 'palm': expected one of ['arm', 'hand', 'finger', 'tip'], "
                "got 'palm'; mend it"
            ),
        ),
    ],
)
def test_refusals(path, old, new, expected):
    assert old in MODEL
    path.write_text(MODEL.replace(old, new, 1))
    assert message(path) == expected


@pytest.mark.parametrize(
    ("element", "shown"),
    [
        ('<worldbody><replicate count="100000000"><geom size="1"/></replicate></worldbody>', "<replicate count="),
        (
            '<worldbody><replicate count="9"><replicate count="9"><geom size="1"/></replicate></replicate></worldbody>',
            "<replicate count=",
        ),
        ('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>', "<hfield name="),
        (
            '<asset><texture name="t" type="2d" builtin="flat" width="100000" height="100000"/></asset>',
            "<texture name=",
        ),
    ],
)
def test_a_few_letters_cannot_ask_for_much(path, element, shown):
    path.write_text(MODEL.replace("<worldbody>", f"{element}<worldbody>", 1))
    text = message(path)
    assert text.startswith(f"DIR/model.xml: {shown}")
    assert "expected what a robot consists of" in text


@pytest.mark.parametrize(
    "asset",
    [
        '<texture name="t" type="cube" fileright="/etc/hostname"/>',
        '<model name="s" file="sub.xml"/>',
        '<skin name="s" file="/etc/hostname"/>',
    ],
)
def test_no_file_outside_the_folder_is_opened(path, asset):
    path.write_text(MODEL.replace("<worldbody>", f"<asset>{asset}</asset><worldbody>", 1))
    (path.parent / "sub.xml").write_text('<mujoco><asset><mesh name="m" file="/etc/hostname"/></asset></mujoco>')
    assert "'/etc/hostname' lies outside the description's folder" in message(path)


def test_a_file_beside_the_folder_is_read_where_the_message_says_how(path):
    home = path.parent / "home"
    home.mkdir()
    (path.parent / "sub.xml").write_text("<mujoco><option/></mujoco>")
    path.rename(home / "model.xml").write_text(
        MODEL.replace("<worldbody>", '<include file="../sub.xml"/><worldbody>', 1)
    )
    (path.parent / "hand.yaml").rename(home / "hand.yaml")
    name, folder = path.parent.name, path.parent
    assert message(home / "model.xml").endswith(f", or allow the folder that holds both: `packages` {name}={folder}")
    assert load_hand(home / "model.xml", packages={name: folder}).num_joints == 3


def test_a_model_that_mujoco_refuses(path):
    path.write_text(MODEL.replace("<freejoint/>", "<unknown/>"))
    assert message(path).startswith("DIR/model.xml: MuJoCo cannot compile it: expected a valid MJCF model, got '")


def test_included_files_are_checked_too(path):
    path.write_text(MODEL.replace("<worldbody>", '<include file="more.xml"/><worldbody>', 1))
    (path.parent / "more.xml").write_text('<mujoco><asset><mesh name="m" file="/etc/hostname"/></asset></mujoco>')
    assert message(path).startswith("DIR/more.xml: '/etc/hostname' lies outside the description's folder")


def test_included_files_may_have_any_root_and_include_each_other(path):
    path.write_text(MODEL.replace("<worldbody>", '<include file="more.xml"/><worldbody>', 1))
    (path.parent / "more.xml").write_text("<mujocoinclude><option timestep='0.001'/></mujocoinclude>")
    assert load_hand(path).num_joints == 3
    (path.parent / "more.xml").write_text('<mujocoinclude><include file="model.xml"/></mujocoinclude>')
    assert message(path).startswith("DIR/model.xml: MuJoCo cannot compile it")


def test_without_yaml_the_message_says_what_to_write(path):
    (path.parent / "hand.yaml").unlink()
    assert message(path).endswith("save them there:\npalm: palm\nfingertips: {tip: tip}\npalm_normal: [x, y, z]")


@pytest.mark.parametrize(
    "inertial",
    ['<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>', '<inertial pos="0 0 0" mass="1" diaginertia="1 1 9"/>'],
)
def test_masses_that_mujoco_refuses_are_replaced(path, inertial):
    path.write_text(MODEL.replace('<joint name="end"', f'{inertial}<joint name="end"'))
    assert (
        load_hand(path)
        .notes[0]
        .startswith("masses of the geometry take the place of the file's, which MuJoCo refuses:")
    )


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            'size="0.02 0.05"',
            'size="nan 0.05"',
            "DIR/model.xml: <geom>: expected finite numbers in 'size', got 'nan 0.05'",
        ),
        (
            "<worldbody>",
            '<asset><model name="s" file="model.xml"/></asset><worldbody>',
            "DIR/model.xml: <model> in a model that is itself attached: expected one level; copy it in",
        ),
        (
            "<worldbody>",
            "<worldbody>" + "<body/>" * 2000,
            "DIR/model.xml: expected at most 1,000 bodies and 3,000 geoms, found 2,004 and 6",
        ),
    ],
)
def test_what_ends_mujoco_or_takes_long_is_refused_before(path, old, new, expected):
    path.write_text(MODEL.replace(old, new, 1))
    assert message(path).startswith(expected)
