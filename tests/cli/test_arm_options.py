"""The arm's options: poses typed by hand, files, and what contradicts itself."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dexnudge as dn
from dexnudge.cli.arm_options import ArmOptions, typed_pose
from dexnudge.cli.main import parse


@dataclass(frozen=True, kw_only=True)
class Command(ArmOptions):
    """A command with these options."""


def parsed(*words):
    return parse("arm", Command, list(words))


def test_three_numbers_are_a_place_and_six_a_pose():
    options = parsed(
        "--arm", "panda", "--arm-base", "-0.5", "0.2", "-.1", "--mount", "0", "0", "0.1", "10", "-20", "30"
    )
    place = typed_pose("arm_base", options.arm_base, "T_world_base")
    np.testing.assert_allclose(place[:3, 3], [-0.5, 0.2, -0.1])
    np.testing.assert_allclose(place[:3, :3], np.eye(3))
    turn = options.T_flange_mount()[:3, :3]
    about = [
        Rotation.from_rotvec(np.radians(angle) * axis) for angle, axis in zip((10, -20, 30), np.eye(3), strict=True)
    ]
    np.testing.assert_allclose(turn, (about[2] * about[1] * about[0]).as_matrix(), atol=1e-12)


def test_a_file_holds_the_pose_as_a_named_matrix_a_bare_one_or_a_quaternion(tmp_path):
    pose = np.eye(4)
    pose[:3, 3] = [1.0, 2.0, 3.0]
    quaternion = {"position": [1.0, 2.0, 3.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    for content in ({"T_world_base": pose.tolist()}, pose.tolist(), quaternion):
        file = tmp_path / "base.json"
        file.write_text(json.dumps(content))
        np.testing.assert_allclose(typed_pose("arm_base", (str(file),), "T_world_base"), pose)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("1", "2"), r"`mount` got 1 2; expected a JSON file, or X Y Z"),
        (("1", "2", "3", "4"), r"`mount` got 1 2 3 4"),
        (("1", "2", "phone"), r"`mount` got 1 2 phone"),
        (("7",), r"`mount` got 7; expected a JSON file"),
        (("nan", "0", "0"), "expected finite numbers"),
        (("0", "0", "0", "inf", "0", "0"), "expected finite numbers"),
        (("0", "0", "5000"), "at most 1000 m"),
        (("nowhere.json",), r"`mount`: nowhere.json: no such file"),
    ],
)
def test_what_is_no_pose_is_refused(words, message):
    with pytest.raises(dn.ArmError, match=message):
        typed_pose("mount", words, "T_flange_mount")


def test_a_file_of_another_pose_is_refused(tmp_path):
    (tmp_path / "object.json").write_text(json.dumps({"T_world_object": np.eye(4).tolist()}))
    with pytest.raises(dn.ArmError, match="expected 'T_flange_mount'"):
        typed_pose("mount", (str(tmp_path / "object.json"),), "T_flange_mount")


def test_the_robot_stands_and_carries_as_asked():
    hand, scene = dn.load_hand("allegro"), dn.build_scene("table", "phone", seed=0)
    assert parsed().robot(hand, scene) is None
    robot = parsed("--arm", "panda").robot(hand, scene)
    np.testing.assert_allclose(robot.arm.T_world_base, dn.default_base(robot.arm, scene))
    x, y, z = robot.arm.T_world_base[:3, 3] + [0.0, 0.0, 0.05]
    moved = parsed("--arm", "panda", "--arm-base", str(x), str(y), str(z)).robot(hand, scene)
    np.testing.assert_allclose(moved.arm.T_world_base[:3, 3], [x, y, z])
    with pytest.raises(dn.ArmError, match="`arm_base` and `mount` given without `arm`"):
        parsed("--arm-base", "1", "0", "0", "--mount", "0", "0", "0").robot(hand, scene)
    with pytest.raises(dn.ArmError, match="out of reach"):
        parsed("--arm", "panda", "--arm-base", "5", "0", "0").robot(hand, scene)
