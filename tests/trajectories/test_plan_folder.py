"""A plan's folder: what is written is read back, by ourselves and by others, and nothing wrong is taken."""

import csv
import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yourdfpy

import dexnudge as dn
from dexnudge.arms.export import export_robot
from dexnudge.arms.registry import panda
from dexnudge.arms.robot import Robot
from dexnudge.trajectories.plan import PHASES, JointTrajectory, Phase, Plan
from dexnudge.trajectories.plan_json import FORMAT_VERSION

JOINTS = ["crane_a1", "lift", "bend", "a2", "a1", "b2", "b1", "t2", "t1"]


@pytest.fixture(scope="module")
def saved(crane_plan, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "PLAN"
    crane_plan.save(folder, pictures=False)
    return folder


@pytest.fixture
def copy(saved, tmp_path) -> Path:
    return Path(shutil.copytree(saved, tmp_path / "copy"))


@pytest.fixture(scope="module")
def content(saved) -> dict:
    return json.loads((saved / "plan.json").read_text())


def test_what_is_loaded_is_what_was_saved(crane_plan, saved):
    again = dn.load_plan(saved)
    assert again.robot.joint_names == crane_plan.robot.joint_names
    assert again.robot.body.link_names == crane_plan.robot.body.link_names
    np.testing.assert_allclose(again.trajectory.time, crane_plan.trajectory.time, rtol=0, atol=1e-12)
    for name, digits in (("position", 1e-12), ("velocity", 1e-9), ("acceleration", 1e-9), ("effort", 1e-6)):
        np.testing.assert_allclose(
            getattr(again.trajectory, name), getattr(crane_plan.trajectory, name), rtol=0, atol=digits
        )
    for own, read in zip(crane_plan.phases, again.phases, strict=True):
        np.testing.assert_array_equal(own.T_world_object, read.T_world_object)
        assert vars(own) | {"T_world_object": None} == vars(read) | {"T_world_object": None}
    assert (again.length, again.seconds) == (crane_plan.length, crane_plan.seconds)
    for name, values in vars(crane_plan.robot.limits).items():
        np.testing.assert_allclose(getattr(again.robot.limits, name), values, rtol=1e-12)
    np.testing.assert_array_equal(again.robot.arm.home, crane_plan.robot.arm.home)
    np.testing.assert_allclose(again.scene.T_world_object, crane_plan.scene.T_world_object, atol=1e-9)


def test_the_loaded_robot_stands_and_moves_as_the_saved_one(crane_plan, saved):
    again = dn.load_plan(saved).robot
    positions = np.random.default_rng(0).uniform(crane_plan.robot.limits.lower, crane_plan.robot.limits.upper, (5, 9))
    np.testing.assert_allclose(again.configurations(positions), crane_plan.robot.configurations(positions), atol=1e-9)
    for own, read in zip(crane_plan.robot.body.link_meshes, again.body.link_meshes, strict=True):
        np.testing.assert_allclose(
            read.bounds if len(read.faces) else 0, own.bounds if len(own.faces) else 0, atol=1e-9
        )


def test_saving_twice_writes_the_same_bytes_and_what_was_loaded_the_same_plan(crane_plan, saved, tmp_path):
    crane_plan.save(tmp_path / "again", pictures=False)
    dn.load_plan(saved).save(tmp_path / "loaded", pictures=False)
    files, again, loaded = (
        {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (saved, tmp_path / "again", tmp_path / "loaded")
    )
    assert files == again
    assert set(files) == set(loaded)
    differing = {name for name in files if files[name] != loaded[name]} - {
        "plan.html"
    }  # where links are, to the last bit
    assert all(name.startswith("robot/") and name.endswith((".urdf", ".xml")) for name in differing)  # Euler angles


def test_no_number_leaves_its_limits_by_rounding(crane_plan, content):
    limits = np.array([content["limits"][name] for name in content["joint_names"]])
    position = np.array(content["position"])
    assert (position >= limits[:, 0]).all()
    assert (position <= limits[:, 1]).all()
    assert position[:, -1].max() == crane_plan.robot.limits.upper[-1]


def test_the_json_is_small_and_complete(crane_plan, saved, content):
    numbers = len(crane_plan.trajectory.time) * len(crane_plan.robot.joint_names)
    assert (saved / "plan.json").stat().st_size / numbers * 2000 * 23 < 4e6  # 20 s of 23 joints at 10 ms
    assert content["format_version"] == FORMAT_VERSION
    assert content["joint_names"] == JOINTS == list(content["limits"])
    assert (content["unit"], content["units"]) == ("rad", ["rad", "m", *["rad"] * 7])
    assert (content["arm"], content["hand"], content["scene"]) == ("crane", "gripper", "scene")
    assert (content["flange"], content["mount"]) == ("flange", "palm")
    assert content["limits"]["lift"] == [-0.2, 0.3, 0.5, 5.0, 200.0]
    assert [phase["name"] for phase in content["phases"]] == list(PHASES[:5])
    assert set(content["phases"][3]) == {"name", "start", "end", "configuration", "link_force", "T_world_object"}
    assert content["phases"][3]["link_force"] == {"atip": 1.5, "ttip": 0.25}
    assert content["versions"]["dexnudge"] == dn.__version__


def test_actuators_drive_every_joint_and_two_on_a_tendon_share_one(content, saved):
    motors = content["actuators"]
    assert [motor["name"] for motor in motors] == ["crane_a1", "lift", "bend", "t2", "t1", "a1+a2", "b1+b2"]
    assert {name for motor in motors for name in motor["joints"]} == set(JOINTS)
    assert motors[-1]["joints"] == {"b1": 1.0, "b2": 1.0}
    model = mujoco.MjModel.from_xml_path(str(saved / "robot" / "robot.xml"))
    assert [model.actuator(index).name for index in range(model.nu)] == [motor["name"] for motor in motors]
    assert model.actuator_gainprm[:, 0] == pytest.approx([motor["kp"] for motor in motors])


@pytest.mark.parametrize("hand", ["shadow_lite", "panda_gripper"])
def test_a_robot_that_is_bought_is_read_back(block_scene, tmp_path, hand):
    robot = Robot(panda(), dn.load_hand(hand), np.eye(4))
    middle = np.clip(np.zeros((2, len(robot.joint_names))), robot.limits.lower, robot.limits.upper)
    here, there = block_scene.T_world_object, block_scene.T_world_object.copy()
    there[:3, 3] += 0.1 * block_scene.motion
    phases = tuple(
        Phase(name, place / 5, (place + 1) / 5, 0, here if place < 3 else there)
        for place, name in enumerate(PHASES[:5])
    )
    still = JointTrajectory(np.array([0.0, 1.0]), middle, *(np.zeros_like(middle) for _ in range(3)))
    Plan(robot, block_scene, still, phases, 0.1).save(tmp_path / "plan.json")
    content = json.loads((tmp_path / "plan.json").read_text()) | {"scene": "."}
    (tmp_path / "plan.json").write_text(json.dumps(content))
    export_robot(robot, tmp_path / "robot")
    block_scene.save(tmp_path)
    loaded = dn.load_plan(tmp_path)
    positions = np.random.default_rng(1).uniform(robot.limits.lower, robot.limits.upper, (3, middle.shape[1]))
    np.testing.assert_allclose(loaded.robot.configurations(positions), robot.configurations(positions), atol=1e-9)
    assert vars(loaded.robot.limits).keys() == vars(robot.limits).keys()
    for name, values in vars(robot.limits).items():
        np.testing.assert_allclose(getattr(loaded.robot.limits, name), values, rtol=1e-12)


def test_the_csv_holds_time_and_positions(saved, content):
    with (saved / "plan.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["time", *JOINTS]
    table = np.array(rows, dtype=float)
    np.testing.assert_array_equal(table[:, 0], content["time"])
    np.testing.assert_array_equal(table[:, 1:], content["position"])


def test_others_read_the_robot_and_agree_with_the_plan(crane_plan, saved, content):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # yourdfpy calls what trimesh is about to remove
        read = yourdfpy.URDF.load(str(saved / "robot" / "robot.urdf"))
    assert read.actuated_joint_names == content["joint_names"]
    model = mujoco.MjModel.from_xml_path(str(saved / "robot" / "robot.xml"))
    data = mujoco.MjData(model)
    for sample in (0, 40):
        position = content["position"][sample]
        read.update_cfg(position)
        for name, value in zip(content["joint_names"], position, strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        palm = crane_plan.robot.palm_poses(crane_plan.trajectory.position[sample : sample + 1])[0]
        np.testing.assert_allclose(read.get_transform("palm", "world"), palm, atol=1e-6)
        np.testing.assert_allclose(data.body("palm").xpos, palm[:3, 3], atol=1e-6)
        np.testing.assert_allclose(data.body("palm").xmat.reshape(3, 3), palm[:3, :3], atol=1e-6)


def test_the_readme_names_arm_hand_and_phases(saved):
    text = (saved / "README.md").read_text()
    assert "crane with gripper pushes the object of 'user' by 50 mm" in text
    assert "| push | 1.50 | 2.50 |" in text
    assert "- **Arm**: crane_a1, lift, bend." in text
    assert "$" not in text


def test_a_path_that_ends_in_json_is_that_file_only(crane_plan, saved, tmp_path):
    crane_plan.save(tmp_path / "only.json")
    assert [path.name for path in tmp_path.iterdir()] == ["only.json"]
    alone, whole = (json.loads(path.read_text()) for path in (tmp_path / "only.json", saved / "plan.json"))
    assert alone.pop("scene") is None
    whole.pop("scene")
    assert alone == whole
    with pytest.raises(dn.OutputError, match=r"only\.json exists; expected a new file"):
        crane_plan.save(tmp_path / "only.json")
    crane_plan.save(tmp_path / "only.json", overwrite=True)
    with pytest.raises(dn.InputError, match=r"robot.urdf is missing; expected the robot of .*only\.json beside it"):
        dn.load_plan(tmp_path / "only.json")


def test_a_plan_is_replaced_and_what_else_is_there_stays(crane_plan, copy):
    (copy / "notes.txt").write_text("mine")
    (copy / "plan.gif").write_text("old")
    with pytest.raises(dn.OutputError, match="exists; expected a new one"):
        crane_plan.save(copy)
    crane_plan.save(copy, overwrite=True, pictures=False)
    assert (copy / "notes.txt").read_text() == "mine"
    assert not (copy / "plan.gif").exists()


def test_a_plan_may_be_given_by_its_plan_json(saved):
    assert dn.load_plan(saved / "plan.json").length == 0.05


def test_what_no_controller_may_be_given_is_not_saved(crane_plan, tmp_path):
    position = crane_plan.trajectory.position.copy()
    position[7, 3] = np.nan
    wrong = replace(crane_plan, trajectory=replace(crane_plan.trajectory, position=position))
    with pytest.raises(dn.InputError, match=r"^plan.json: position\[7\] holds NaN or infinity"):
        wrong.save(tmp_path / "PLAN")
    position[7, 1], position[7, 3] = 1.0, 0.1
    position[7, 3] = 0.1
    wrong = replace(crane_plan, trajectory=replace(crane_plan.trajectory, position=position))
    with pytest.raises(dn.InputError, match=r"position of 'lift' at 0.35 s is 1; expected it within its limits"):
        wrong.save(tmp_path / "plan.json")
    assert not list(tmp_path.iterdir())


def at(*keys):
    """A change of one value in plan.json, deep in it."""

    def change(content, value):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


def swap_joints(content, _):
    names = content["joint_names"]
    names[0], names[1] = names[1], names[0]


def drop_joint(content, _):
    del content["limits"][content["joint_names"].pop(0)]
    for name in ("position", "velocity", "acceleration", "effort"):
        content[name] = [row[1:] for row in content[name]]


def rename(content, value):
    content["limits"][value] = content["limits"].pop(content["joint_names"][0])
    content["joint_names"][0] = value


BAD = {
    "nan": (at("position", 3, 2), float("nan"), r"plan.json: position\[3\] holds NaN or infinity; expected finite"),
    "infinity": (at("velocity", 3, 2), float("inf"), r"velocity\[3\] holds NaN or infinity"),
    "too large": (at("effort", 0, 0), 10**400, r"effort\[0\] holds an integer of too many digits"),
    "text": (at("position", 5, 0), "0.5", r"position\[5\] is \['0.5', .*expected 9 numbers"),
    "true": (at("position", 5, 0), True, r"position\[5\] is \[True, .*expected 9 numbers"),
    "short row": (at("position", 5), [0.0] * 8, r"position\[5\] has 8 numbers; expected 9"),
    "short array": (at("acceleration"), [[0.0] * 9], r"acceleration is 1 rows; expected 81 rows"),
    "no array": (at("effort"), "none", r"effort is 'none'; expected 81 rows"),
    "reordered": (
        swap_joints,
        None,
        "'lift' stands where robot.urdf has 'crane_a1'.*were the joints reordered",
    ),
    "missing joint": (drop_joint, None, "joint_names lacks crane_a1; expected the joints of"),
    "unknown joint": (
        rename,
        "elbow",
        "lacks crane_a1 and has elbow, which robot.urdf has not.*another arm or hand?",
    ),
    "joint twice": (at("joint_names", 1), "crane_a1", "joint_names has crane_a1 twice"),
    "no names": (at("joint_names"), [1, 2], r"joint_names\[0\] is 1; expected a text"),
    "time stands": (at("time", 3), 0.1, r"time\[3\] is 0.1 s, after 0.1 s; expected increasing times"),
    "time from 1": (at("time", 0), 0.005, r"time begins with \[0.005, 0.05\]; expected two samples or more from 0 s"),
    "one sample": (at("time"), [0.0], r"time begins with \[0.0\]"),
    "gap": (at("phases", 3, "start"), 1.75, "phase 'push' is from 1.75 to 2.5 s; expected it to start at 1.5 s"),
    "backwards": (at("phases", 4, "end"), 2.0, "phase 'retreat' is from 2.5 to 2 s; expected .* to end later"),
    "too long": (at("phases", 4, "end"), 9.0, "the phases end at 9 s, the trajectory at 4 s; expected the same"),
    "too early": (at("phases", 0, "start"), -1.0, r"phases\[0\]: start is -1.0; expected at least 0"),
    "no phases": (at("phases"), [], r"phases is \[\]; expected a list of objects"),
    "strange phase": (
        at("phases", 0, "name"),
        "dance",
        r"phases\[0\]: name is 'dance'; expected one of pre-contact, ",
    ),
    "half a phase": (at("phases", 0), {"name": "push"}, r"phases\[0\] lacks start, end, configuration"),
    "no place": (at("phases", 0, "T_world_object"), [[1.0]], r"phases\[0\]: T_world_object has shape \(1, 1\)"),
    "force of nothing": (
        at("phases", 3, "link_force"),
        {"elbow": 1.0},
        "phase 'push' names 'elbow'; expected links",
    ),
    "pulling": (
        at("phases", 3, "link_force"),
        {"palm": -1.0},
        "link_force of 'palm' is -1.0; expected at least 0",
    ),
    "configuration": (
        at("phases", 3, "configuration"),
        1.5,
        "configuration is 1.5; expected an integer of 0 to 1000000",
    ),
    "no limits": (at("limits"), {}, "limits of crane_a1, .* are missing"),
    "limits of another": (at("limits", "elbow"), [0, 1, 1, 1, 1], "limits of elbow are there, of no joint of the plan"),
    "four limits": (at("limits", "a2"), [0, 1, 2, 3], "limits of 'a2' has 4 numbers; expected 5"),
    "negative limit": (
        at("limits", "a2", 2),
        -2.0,
        "limits of 'a2': velocity is -2; expected more than 0",
    ),
    "zero jerk": (at("limits", "a2", 4), 0.0, "limits of 'a2': jerk is 0; expected more than 0"),
    "reversed": (at("limits", "a2"), [1, -1, 1, 1, 1], "limits of 'a2': lower 1 > upper -1"),
    "of another arm": (
        at("limits", "crane_a1", 2),
        3.0,
        "velocity is 3; expected 2, as robot.urdf has it",
    ),
    "outside": (
        at("position", 9, 1),
        0.5,
        r"position of 'lift' at 0.45 s is 0.5; expected it within its limits -0.2 to 0.3",
    ),
    "jerky": (at("position", 9, 1), 0.25, r"joint 'lift' uses .*% of its jerk limit at 0.* s, between samples"),
    "at speed": (at("velocity", -1, 1), 1e-3, "velocity of 'lift' at the end is 0.001; expected 0, at rest"),
    "too strong": (
        at("effort", 9, 2),
        -21.0,
        "effort of 'bend' at 0.45 s is -21; expected at most 20, its motor's limit",
    ),
    "elsewhere": (at("T_world_base", 0, 3), 0.7, "link 'stand' hangs otherwise than plan.json and hand/ say"),
    "other mount": (at("T_flange_mount", 2, 3), 0.7, "link 'palm' hangs otherwise than plan.json and hand/ say"),
    "no rotation": (at("T_world_base", 0, 0), 2.0, "T_world_base is not a rigid transform"),
    "mounted by a tip": (at("mount"), "atip", "mount is 'atip'; expected 'palm'"),
    "no flange": (at("flange"), "elbow", "has no link 'elbow' beside the hand's; expected the arm's flange"),
    "home": (at("home"), [0.0], "the arm has 3 joints, home 1 numbers"),
    "degrees": (at("unit"), "deg", "unit is 'deg'; expected 'rad'"),
    "length": (at("length"), -0.1, "length is -0.1; expected at least 0"),
    "scene outside": (at("scene"), "../other", "scene is '../other', outside the folder of plan.json"),
    "scene absolute": (at("scene"), "/etc", "scene is '/etc', outside the folder of plan.json"),
    "no scene": (at("scene"), None, "scene is None; expected a path relative to the folder of plan.json"),
    "later": (at("format_version"), FORMAT_VERSION + 1, "from a later dexnudge; expected at most 1; update dexnudge"),
    "foreign": (at("format_version"), "x", "format_version is 'x'; expected the plan.json that Plan.save"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_value_is_refused_with_its_place(saved, tmp_path, case):
    change, value, message = BAD[case]
    content = json.loads((saved / "plan.json").read_text())
    change(content, value)
    (tmp_path / "plan.json").write_text(json.dumps(content))
    (tmp_path / "robot").symlink_to(saved / "robot")
    with pytest.raises(dn.InputError, match=message):
        dn.load_plan(tmp_path)


@pytest.mark.parametrize(
    "key", ["joint_names", "time", "position", "limits", "phases", "T_world_base", "mount", "scene"]
)
def test_a_missing_key_is_refused_by_name(saved, tmp_path, key):
    content = json.loads((saved / "plan.json").read_text())
    del content[key]
    (tmp_path / "plan.json").write_text(json.dumps(content))
    with pytest.raises(dn.InputError, match="expected the plan.json that" if key == "joint_names" else f"lacks {key}"):
        dn.load_plan(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is truncated or damaged"),
        ('{"format_version": 1, "joint_na', "is truncated or damaged"),
        ("[" * 100_000, "is truncated or damaged"),
        ("[]", "holds a JSON list; expected an object"),
        ("{}", "format_version is None; expected the plan.json that Plan.save"),
        (b"\xff\xfe\x00", "it is not UTF-8[)]; save it as UTF-8"),
    ],
)
def test_a_foreign_file_is_refused(tmp_path, text, message):
    (tmp_path / "plan.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(dn.InputError, match=message):
        dn.load_plan(tmp_path)


def test_a_huge_file_is_refused_unread(tmp_path):
    with (tmp_path / "plan.json").open("wb") as file:
        file.truncate(2**36)
    with pytest.raises(dn.InputError, match="is no file, or larger than 67 MB"):
        dn.load_plan(tmp_path)


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("plan.json", "no such file; expected the folder that Plan.save"),
        ("robot/robot.urdf", "robot.urdf is missing; expected the robot of"),
        ("robot", "robot.urdf is missing; expected the robot of"),
        ("robot/hand", "unknown hand|missing"),
        ("scene", "no such file"),
    ],
)
def test_a_missing_file_is_refused(copy, missing, message):
    path = copy / missing
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(dn.InputError, match=message):
        dn.load_plan(copy)


def test_a_urdf_whose_joints_were_changed_is_refused(copy):
    path = copy / "robot" / "robot.urdf"
    text = path.read_text()
    joint = next(line for line in text.splitlines() if '<joint name="a1"' in line)
    path.write_text(text.replace(joint, joint.replace("a1", "elbow")))
    with pytest.raises(dn.InputError, match=r"joint_names lacks elbow and has a1, which robot.urdf has not"):
        dn.load_plan(copy)
    path.write_text(text.replace(joint, f"{joint}</joint>\n{joint}"))
    with pytest.raises(dn.InputError, match=r"joint_names lacks a1; expected the joints of"):
        dn.load_plan(copy)
    assert text.count('xyz="0.0 0.0 0.044"') == 3
    path.write_text(text.replace('xyz="0.0 0.0 0.044"', 'xyz="0.0 0.0 0.045"'))
    with pytest.raises(dn.InputError, match=r"link 'atip' hangs otherwise than plan.json and hand/ say"):
        dn.load_plan(copy)


def test_the_hand_of_another_plan_is_refused(copy):
    shutil.rmtree(copy / "robot" / "hand")
    dn.export_hand(dn.load_hand("panda_gripper"), copy / "robot" / "hand")
    with pytest.raises(dn.InputError, match="mount is 'palm'; expected 'panda_hand', by which the hand in"):
        dn.load_plan(copy)
