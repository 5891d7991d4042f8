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
from dexnudge.arms.named.panda import panda
from dexnudge.arms.robot import Robot
from dexnudge.trajectories.plan import JointTrajectory, Phase, Plan
from dexnudge.trajectories.plan_json import FORMAT_VERSION


@pytest.fixture(scope="module")
def plan() -> Plan:
    """A Panda with Allegro that swings to a posture and back, 4 s; nothing of it is planned."""
    stand, mount = np.eye(4), np.eye(4)
    stand[:3, 3], mount[2, 3] = (-0.5, 0.1, 0.0), 0.03
    robot = Robot(panda().standing_at(stand), dn.load_hand("allegro"), mount)
    limits, joints = robot.limits, len(robot.joint_names)
    start = np.concatenate([robot.arm.home, np.clip(0.0, robot.hand.lower, robot.hand.upper)])
    end = np.clip(start + np.linspace(-0.4, 0.4, joints), limits.lower, limits.upper)
    end[-1] = limits.upper[-1]  # as far as it goes: no digit may be lost there
    end[-2] = limits.lower[-2]
    time = np.linspace(0.0, 4.0, 41)
    share = 0.5 - 0.5 * np.cos(np.pi * time / 2.0)[:, None]
    rate, bend = np.pi / 4.0 * np.sin(np.pi * time / 2.0)[:, None], np.pi**2 / 8.0 * np.cos(np.pi * time / 2.0)[:, None]
    way = end - start
    effort = np.where((time > 1.0) & (time < 3.0), 0.1234567, 0.0)[:, None] * np.ones(joints)
    trajectory = JointTrajectory(time, start + share * way, rate * way, bend * way, effort)
    scene = dn.build_scene("table", "phone", seed=0)
    moved = scene.T_world_object.copy()
    moved[:3, 3] += 0.05 * scene.motion
    phases = (
        Phase("pre-contact", 0.0, 1.0, 3, scene.T_world_object),
        Phase("push", 1.0, 3.0, 3, moved, {"link_3.0_tip": 1.5, "link_15.0_tip": 0.25}),
        Phase("retreat", 3.0, 4.0, 3, moved),
    )
    return Plan(robot, scene, trajectory, phases, length=0.05, seconds={"search": 1.25})


@pytest.fixture(scope="module")
def saved(plan, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "PLAN"
    plan.save(folder)
    return folder


@pytest.fixture
def copy(saved, tmp_path) -> Path:
    return Path(shutil.copytree(saved, tmp_path / "copy"))


def test_what_is_loaded_is_what_was_saved(plan, saved):
    again = dn.load_plan(saved)
    assert again.robot.joint_names == plan.robot.joint_names
    assert again.robot.body.link_names == plan.robot.body.link_names
    np.testing.assert_allclose(again.trajectory.time, plan.trajectory.time, rtol=0, atol=1e-12)
    for name, digits in (("position", 1e-12), ("velocity", 1e-9), ("acceleration", 1e-9), ("effort", 1e-6)):
        np.testing.assert_allclose(getattr(again.trajectory, name), getattr(plan.trajectory, name), rtol=0, atol=digits)
    for own, read in zip(plan.phases, again.phases, strict=True):
        np.testing.assert_array_equal(own.T_world_object, read.T_world_object)
        assert vars(own) | {"T_world_object": None} == vars(read) | {"T_world_object": None}
    assert (again.length, again.seconds) == (plan.length, plan.seconds)
    for name, values in vars(plan.robot.limits).items():
        np.testing.assert_allclose(getattr(again.robot.limits, name), values, rtol=1e-12)
    np.testing.assert_array_equal(again.robot.arm.home, plan.robot.arm.home)
    np.testing.assert_allclose(again.scene.T_world_object, plan.scene.T_world_object, atol=1e-9)


def test_the_loaded_robot_stands_and_moves_as_the_saved_one(plan, saved):
    again = dn.load_plan(saved).robot
    positions = np.random.default_rng(0).uniform(plan.robot.limits.lower, plan.robot.limits.upper, (5, 23))
    np.testing.assert_allclose(again.configurations(positions), plan.robot.configurations(positions), atol=1e-9)
    for own, read in zip(plan.robot.body.link_meshes, again.body.link_meshes, strict=True):
        np.testing.assert_allclose(
            read.bounds if len(read.faces) else 0, own.bounds if len(own.faces) else 0, atol=1e-9
        )


def test_saving_twice_writes_the_same_bytes_and_what_was_loaded_the_same_plan(plan, saved, tmp_path):
    plan.save(tmp_path / "again")
    dn.load_plan(saved).save(tmp_path / "loaded")
    files, again, loaded = (
        {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (saved, tmp_path / "again", tmp_path / "loaded")
    )
    assert files == again
    assert set(files) == set(loaded)
    differing = [name for name in files if files[name] != loaded[name]]
    assert all(name.startswith("robot/") and name.endswith((".urdf", ".xml")) for name in differing)  # Euler angles


def test_no_number_leaves_its_limits_by_rounding(plan, saved):
    content = json.loads((saved / "plan.json").read_text())
    limits = np.array([content["limits"][name] for name in content["joint_names"]])
    position = np.array(content["position"])
    assert (position >= limits[:, 0]).all()
    assert (position <= limits[:, 1]).all()
    assert position[:, -1].max() == plan.robot.limits.upper[-1]


def test_the_json_is_small_and_complete(plan, saved):
    content = json.loads((saved / "plan.json").read_text())
    samples = len(plan.trajectory.time)
    assert (saved / "plan.json").stat().st_size / samples * 2000 < 4e6  # 20 s at 10 ms
    assert content["format_version"] == FORMAT_VERSION
    assert content["unit"] == "rad"
    assert "units" not in content
    assert content["scene"] == "scene"
    assert list(content["limits"]) == content["joint_names"] == list(plan.robot.joint_names)
    assert [list(phase) for phase in content["phases"]] == [
        ["name", "start", "end", "configuration", "T_world_object", "link_force"]
    ] * 3
    assert (content["arm"], content["hand"]) == ("panda", "allegro")
    assert content["versions"]["dexnudge"] == dn.__version__
    assert {name for motor in content["actuators"] for name in motor["joints"]} == set(content["joint_names"])
    assert content["actuators"][0] == {
        "name": "panda_joint1",
        "joints": {"panda_joint1": 1.0},
        "kp": 3480.0,
        "kv": 174.0,
    }


def test_joints_on_one_tendon_and_joints_that_slide_are_said_to(plan, tmp_path):
    def content(hand):
        robot = Robot(panda(), dn.load_hand(hand), np.eye(4))
        middle = np.clip(np.zeros((2, len(robot.joint_names))), robot.limits.lower, robot.limits.upper)
        still = JointTrajectory(np.array([0.0, 1.0]), middle, *(np.zeros_like(middle) for _ in range(3)))
        Plan(robot, plan.scene, still, (Phase("push", 0.0, 1.0, 0, np.eye(4)),), 0.1).save(tmp_path / hand)
        loaded = dn.load_plan(tmp_path / hand)
        positions = np.random.default_rng(1).uniform(robot.limits.lower, robot.limits.upper, (3, middle.shape[1]))
        np.testing.assert_allclose(loaded.robot.configurations(positions), robot.configurations(positions), atol=1e-9)
        return json.loads((tmp_path / hand / "plan.json").read_text())

    motors = content("shadow_lite")["actuators"]
    assert motors[-1] == {"name": "RFJ1+RFJ2", "joints": {"RFJ1": 1.0, "RFJ2": 1.0}, "kp": 5.0, "kv": 0.05}
    assert content("panda_gripper")["units"] == ["rad"] * 7 + ["m"]


def test_the_csv_holds_time_and_positions(saved):
    content = json.loads((saved / "plan.json").read_text())
    with (saved / "plan.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["time", *content["joint_names"]]
    table = np.array(rows, dtype=float)
    np.testing.assert_array_equal(table[:, 0], content["time"])
    np.testing.assert_array_equal(table[:, 1:], content["position"])


def test_others_read_the_robot_and_agree_with_the_plan(plan, saved):
    content = json.loads((saved / "plan.json").read_text())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # yourdfpy calls what trimesh is about to remove
        read = yourdfpy.URDF.load(str(saved / "robot" / "robot.urdf"))
    assert read.actuated_joint_names == content["joint_names"]
    model = mujoco.MjModel.from_xml_path(str(saved / "robot" / "robot.xml"))
    data = mujoco.MjData(model)
    for sample in (0, 20):
        position = content["position"][sample]
        read.update_cfg(position)
        for name, value in zip(content["joint_names"], position, strict=True):
            data.joint(name).qpos = value
        mujoco.mj_kinematics(model, data)
        palm = plan.robot.palm_poses(plan.trajectory.position[sample : sample + 1])[0]
        np.testing.assert_allclose(read.get_transform("palm_link", "world"), palm, atol=1e-6)
        np.testing.assert_allclose(data.body("palm_link").xpos, palm[:3, 3], atol=1e-6)
        np.testing.assert_allclose(data.body("palm_link").xmat.reshape(3, 3), palm[:3, :3], atol=1e-6)


def test_the_readme_names_arm_hand_and_phases(saved):
    text = (saved / "README.md").read_text()
    assert "panda with allegro pushes the object of 'table' by 50 mm" in text
    assert "| push | 1.00 | 3.00 |" in text
    assert "$" not in text


def test_a_path_that_ends_in_json_is_that_file_only(plan, saved, tmp_path):
    plan.save(tmp_path / "only.json")
    assert [path.name for path in tmp_path.iterdir()] == ["only.json"]
    alone, whole = (json.loads(path.read_text()) for path in (tmp_path / "only.json", saved / "plan.json"))
    assert alone.pop("scene") is None
    whole.pop("scene")
    assert alone == whole
    with pytest.raises(dn.OutputError, match=r"only\.json exists; expected a new file"):
        plan.save(tmp_path / "only.json")
    plan.save(tmp_path / "only.json", overwrite=True)
    with pytest.raises(dn.InputError, match=r"robot.urdf is missing; expected the robot of .*only\.json beside it"):
        dn.load_plan(tmp_path / "only.json")


def test_a_plan_is_replaced_and_what_else_is_there_stays(plan, copy):
    (copy / "notes.txt").write_text("mine")
    (copy / "plan.gif").write_text("old")
    with pytest.raises(dn.OutputError, match="exists; expected a new one"):
        plan.save(copy)
    plan.save(copy, overwrite=True)
    assert (copy / "notes.txt").read_text() == "mine"
    assert not (copy / "plan.gif").exists()


def test_a_plan_may_be_given_by_its_plan_json(saved):
    assert dn.load_plan(saved / "plan.json").length == 0.05


def test_what_no_controller_may_be_given_is_not_saved(plan, tmp_path):
    position = plan.trajectory.position.copy()
    position[7, 3] = np.nan
    wrong = replace(plan, trajectory=replace(plan.trajectory, position=position))
    with pytest.raises(dn.InputError, match=r"position\[7\] holds NaN or infinity"):
        wrong.save(tmp_path / "PLAN")
    position[7, 3] = 1.0
    wrong = replace(plan, trajectory=replace(plan.trajectory, position=position))
    with pytest.raises(dn.InputError, match=r"position of 'panda_joint4' at 0.7 s is 1; expected it within its limits"):
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
    "text": (at("position", 5, 0), "0.5", r"position\[5\] is \['0.5', .*expected 23 numbers"),
    "true": (at("position", 5, 0), True, r"position\[5\] is \[True, .*expected 23 numbers"),
    "short row": (at("position", 5), [0.0] * 22, r"position\[5\] has 22 numbers; expected 23"),
    "short array": (at("acceleration"), [[0.0] * 23], r"acceleration is 1 rows; expected 41 rows"),
    "no array": (at("effort"), "none", r"effort is 'none'; expected 41 rows"),
    "reordered": (
        swap_joints,
        None,
        "'panda_joint2' stands where robot.urdf has 'panda_joint1'.*were the joints reordered",
    ),
    "missing joint": (drop_joint, None, "joint_names lacks panda_joint1; expected the joints of"),
    "unknown joint": (
        rename,
        "elbow",
        "lacks panda_joint1 and has elbow, which robot.urdf has not.*another arm or hand?",
    ),
    "joint twice": (at("joint_names", 1), "panda_joint1", "joint_names has panda_joint1 twice"),
    "no names": (at("joint_names"), [1, 2], r"joint_names is \[1, 2\]; expected a list of names"),
    "time stands": (at("time", 3), 0.2, r"time\[3\] is 0.2 s, after 0.2 s; expected increasing times"),
    "time from 1": (at("time", 0), 0.005, r"time begins with \[0.005, 0.1\]; expected two samples or more from 0 s"),
    "one sample": (at("time"), [0.0], r"time begins with \[0.0\]"),
    "gap": (at("phases", 1, "start"), 1.5, "phase 'push' is from 1.5 to 3 s; expected it to start at 1 s"),
    "backwards": (at("phases", 2, "end"), 2.0, "phase 'retreat' is from 3 to 2 s; expected .* to end later"),
    "too long": (at("phases", 2, "end"), 9.0, "the phases end at 9 s, the trajectory at 4 s; expected the same"),
    "too early": (at("phases", 0, "start"), -1.0, r"phases\[0\]: start is -1; expected at least 0"),
    "no phases": (at("phases"), [], r"phases is \[\]; expected a list of objects"),
    "strange phase": (
        at("phases", 0, "name"),
        "dance",
        r"phases\[0\] is called 'dance'; expected one of pre-contact, ",
    ),
    "half a phase": (at("phases", 0), {"name": "push"}, r"phases\[0\] lacks start, end, configuration"),
    "no place": (at("phases", 0, "T_world_object"), [[1.0]], r"phases\[0\]: T_world_object has shape \(1, 1\)"),
    "force of nothing": (
        at("phases", 1, "link_force"),
        {"elbow": 1.0},
        "phase 'push' names 'elbow'; expected links",
    ),
    "pulling": (
        at("phases", 1, "link_force"),
        {"palm_link": -1.0},
        "link_force of 'palm_link' is -1; expected at least 0",
    ),
    "configuration": (at("phases", 1, "configuration"), 1.5, "configuration is 1.5; expected an integer of at least 0"),
    "no limits": (at("limits"), {}, "limits of panda_joint1, .* are missing"),
    "limits of another": (at("limits", "elbow"), [0, 1, 1, 1, 1], "limits of elbow are there, of no joint of the plan"),
    "four limits": (at("limits", "joint_0.0"), [0, 1, 2, 3], "limits of 'joint_0.0' has 4 numbers; expected 5"),
    "negative limit": (
        at("limits", "joint_0.0", 2),
        -2.0,
        "limits of 'joint_0.0': velocity is -2; expected more than 0",
    ),
    "zero jerk": (at("limits", "joint_0.0", 4), 0.0, "limits of 'joint_0.0': jerk is 0; expected more than 0"),
    "reversed": (at("limits", "joint_0.0"), [1, -1, 1, 1, 1], "limits of 'joint_0.0': lower 1 > upper -1"),
    "of another arm": (
        at("limits", "panda_joint1", 2),
        3.0,
        "velocity is 3; expected 2.175, as robot/robot.urdf has it",
    ),
    "outside": (
        at("position", 9, 3),
        0.5,
        r"position of 'panda_joint4' at 0.9 s is 0.5; expected it within its limits",
    ),
    "elsewhere": (at("T_world_base", 0, 3), 0.7, "link 'panda_link0' hangs otherwise than plan.json and hand/ say"),
    "other mount": (at("T_flange_mount", 2, 3), 0.7, "link 'palm_link' hangs otherwise than plan.json and hand/ say"),
    "no rotation": (at("T_world_base", 0, 0), 2.0, "T_world_base is not a rigid transform"),
    "mounted by a tip": (at("mount"), "link_3.0_tip", "mount is 'link_3.0_tip'; expected 'palm_link'"),
    "no flange": (at("flange"), "elbow", "has no link 'elbow' beside the hand's; expected the arm's flange"),
    "home": (at("home"), [0.0], "the arm has 7 joints, home 1 numbers"),
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
        (b"\xff\xfe\x00", "is truncated or damaged"),
    ],
)
def test_a_foreign_file_is_refused(tmp_path, text, message):
    (tmp_path / "plan.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(dn.InputError, match=message):
        dn.load_plan(tmp_path)


def test_a_huge_file_is_refused_unread(tmp_path):
    with (tmp_path / "plan.json").open("wb") as file:
        file.truncate(2**36)
    with pytest.raises(dn.InputError, match="has 65536 MiB; expected at most 64 MiB"):
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


def test_a_urdf_whose_link_was_moved_is_refused(copy):
    path = copy / "robot" / "robot.urdf"
    text = path.read_text()
    assert text.count('xyz="0.0 0.0 0.333"') == 1
    path.write_text(text.replace('xyz="0.0 0.0 0.333"', 'xyz="0.0 0.0 0.334"'))
    moved = dn.load_plan(copy).robot  # an arm of its own: nothing else states its frames
    assert moved.arm.tree.joints[0].origin[2, 3] == 0.334
    hand = next(line for line in text.splitlines() if 'name="joint_1.0"' in line)
    path.write_text(text.replace(hand, hand.replace("joint_1.0", "joint_99")))
    with pytest.raises(dn.InputError, match=r"joint_names lacks joint_99 and has joint_1.0"):
        dn.load_plan(copy)


def test_the_hand_of_another_plan_is_refused(copy):
    shutil.rmtree(copy / "robot" / "hand")
    dn.export_hand(dn.load_hand("panda_gripper"), copy / "robot" / "hand")
    with pytest.raises(dn.InputError, match=r"."):
        dn.load_plan(copy)
