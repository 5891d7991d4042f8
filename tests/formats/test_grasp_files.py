"""Files as the loaders of DexGraspNet, BODex and DexGraspBench read them; the twins here follow what those loaders do."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.errors import InputError
from dexnudge.formats import conversion
from dexnudge.formats.bodex import read_bodex, read_dexgraspbench, write_bodex, write_dexgraspbench
from dexnudge.formats.conversion import convert, read_back
from dexnudge.formats.dexgraspnet import read_dexgraspnet, their_joint_names, write_dexgraspnet
from dexnudge.formats.object_arrays import read_object_array, write_object_array
from dexnudge.hands.registry import load_hand
from dexnudge.verification.verdicts import verify

EXACT = 1e-12


def palms_and_angles(samples):
    """Poses of the palm in the world by the hand's own kinematics, and joint angles."""
    poses = samples.hand.forward_kinematics(torch.as_tensor(samples.q))[:, 0].numpy()
    return poses, samples.q[:, 9:]


def euler_matrix(x, y, z):
    """Rz Ry Rx, the fixed axes x, y, z one after the other."""
    turns = [
        trimesh.transformations.rotation_matrix(angle, axis) for angle, axis in zip((x, y, z), np.eye(3), strict=True)
    ]
    return (turns[2] @ turns[1] @ turns[0])[:3, :3]


def quaternion_pose(seven):
    pose = trimesh.transformations.quaternion_matrix(seven[3:7])  # wxyz
    pose[:3, 3] = seven[:3]
    return pose


def test_dexgraspnet_reads_the_same_hand_and_object(box_samples, tmp_path):
    write_dexgraspnet(box_samples, tmp_path, name="box")
    entries = np.load(tmp_path / "dataset/box.npy", allow_pickle=True)
    mesh = trimesh.load(tmp_path / "meshdata/box/coacd/decomposed.obj", process=False)
    assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(1.0)  # it fills the unit ball
    poses, angles = palms_and_angles(box_samples)
    for entry, pose, joints in zip(entries, poses, angles, strict=True):
        qpos, in_object = entry["qpos"], np.eye(4)
        assert np.allclose(mesh.vertices * entry["scale"], box_samples.scene.object_mesh.vertices, rtol=0, atol=EXACT)
        in_object[:3, 3] = [qpos[name] for name in ("WRJTx", "WRJTy", "WRJTz")]
        in_object[:3, :3] = euler_matrix(*(qpos[name] for name in ("WRJRx", "WRJRy", "WRJRz")))
        assert np.allclose(box_samples.scene.T_world_object @ in_object, pose, rtol=0, atol=EXACT)
        assert [qpos[name] for name in box_samples.hand.joint_names] == joints.tolist()


def test_dexgraspnets_shadow_hand_counts_its_joints_from_zero():
    hand = load_hand("shadow_full", base=False)
    names = their_joint_names(hand)
    digits = {"FF": 4, "MF": 4, "RF": 4, "LF": 5, "TH": 5}  # of shadow_hand_wrist_free.xml: robot0:FFJ3 ... robot0:THJ0
    assert sorted(names) == sorted(f"robot0:{digit}J{n}" for digit, count in digits.items() for n in range(count))
    assert names[hand.joint_names.index("FFJ4")] == "robot0:FFJ3"


def test_bodex_reads_three_moments_of_the_same_hand(box_samples, tmp_path):
    write_bodex(box_samples, tmp_path, name="box")
    record = np.load(tmp_path / "box_grasp.npy", allow_pickle=True).item()
    scene = np.load(tmp_path / record["scene_path"], allow_pickle=True).item()
    assert record["robot_pose"].shape == (1, 5, 3, 7 + 4)
    assert record["joint_names"] == list(box_samples.hand.joint_names)
    thing = scene["scene"][scene["task"]["obj_name"]]
    assert np.allclose(quaternion_pose(thing["pose"]), box_samples.scene.T_world_object, rtol=0, atol=EXACT)
    assert np.allclose(record["obj_pose"][0], thing["pose"], rtol=0, atol=EXACT)
    mesh = trimesh.load(tmp_path / thing["file_path"], process=False)
    assert np.array_equal(mesh.vertices * thing["scale"], box_samples.scene.object_mesh.vertices)
    poses, angles = palms_and_angles(box_samples)
    pregrasp, grasp, squeeze = record["robot_pose"][0].swapaxes(0, 1)
    for row, pose in enumerate(poses):
        for stage in (pregrasp, grasp, squeeze):
            assert np.allclose(quaternion_pose(stage[row]), pose, rtol=0, atol=EXACT)
    assert np.array_equal(grasp[:, 7:], angles)
    assert (np.abs(pregrasp[:, 7:]) <= np.abs(angles) + EXACT).all()  # nearer to the open hand, which is at zero
    free = np.delete(np.arange(4), [0, 1])  # of couplings
    assert np.allclose(squeeze[:, 7:][:, free], np.clip(1.1 * angles[:, free], -1, 1), rtol=0, atol=1e-9)


def test_dexgraspbench_reads_one_record_for_each_grasp(box_samples, tmp_path):
    write_dexgraspbench(box_samples, tmp_path, name="box")
    files = sorted((tmp_path / "graspdata/box").glob("*.npy"))
    poses, angles = palms_and_angles(box_samples)
    assert len(files) == 5
    for file, pose, joints in zip(files, poses, angles, strict=True):
        record = np.load(file, allow_pickle=True).item()
        assert (tmp_path / record["obj_path"] / "info/simplified.json").is_file()
        assert np.allclose(quaternion_pose(record["grasp_qpos"]), pose, rtol=0, atol=EXACT)
        assert record["grasp_qpos"][7:].tolist() == joints.tolist()
        assert record["pregrasp_qpos"].shape == record["squeeze_qpos"].shape == record["grasp_qpos"].shape == (11,)
        assert np.allclose(quaternion_pose(record["obj_pose"]), box_samples.scene.T_world_object, rtol=0, atol=EXACT)


def in_object_frame(samples):
    poses = np.linalg.inv(samples.scene.T_world_object) @ palms_and_angles(samples)[0]
    return np.concatenate([poses[:, :3, 3], poses[:, :3, 0], poses[:, :3, 1], samples.q[:, 9:]], axis=1)


def test_what_was_written_is_read_back(box_samples, tmp_path):
    write_dexgraspnet(box_samples, tmp_path / "d", name="box")
    (tmp_path / "b").mkdir()
    write_bodex(box_samples, tmp_path / "b", name="box")
    write_dexgraspbench(box_samples, tmp_path / "g", name="box")
    expected, hand = in_object_frame(box_samples), box_samples.hand
    entries = read_object_array(tmp_path / "d/dataset/box.npy")
    assert np.allclose(read_dexgraspnet(entries, hand, where="d"), expected, rtol=0, atol=EXACT)
    path = tmp_path / "b/box_grasp.npy"
    content = read_object_array(path)
    assert np.allclose(read_bodex(content, hand, path=path), expected, rtol=0, atol=EXACT)
    del content["obj_pose"]  # newer files name the scene alone
    assert np.allclose(read_bodex(content, hand, path=path), expected, rtol=0, atol=EXACT)
    record = read_object_array(tmp_path / "g/graspdata/box/002.npy")
    assert np.allclose(read_dexgraspbench(record, hand, where="g")[0], expected[2], rtol=0, atol=EXACT)


def test_the_folder_of_dexgraspbench_is_read_where_it_has_one_object(box_samples, tmp_path):
    scene, hand = box_samples.scene, box_samples.hand
    write_dexgraspbench(box_samples, tmp_path / "g", name="box")
    own = read_back(tmp_path / "g/graspdata/box", scene, hand)
    for folder in (tmp_path / "g", tmp_path / "g/graspdata"):
        assert np.array_equal(read_back(folder, scene, hand).q, own.q)
    (tmp_path / "g/graspdata/second").mkdir()
    (tmp_path / "g/graspdata/box/000.npy").rename(tmp_path / "g/graspdata/second/000.npy")
    with pytest.raises(InputError) as caught:
        read_back(tmp_path / "g", scene, hand)
    assert str(caught.value) == (
        f"{tmp_path / 'g'} holds grasps of 2 objects; expected those of one; give one of "
        f"{tmp_path / 'g/graspdata/box'}, {tmp_path / 'g/graspdata/second'}"
    )
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match=r"none holds 0 \.npy files; expected 1 to 10000"):
        read_back(tmp_path / "none", scene, hand)


def test_joints_may_stand_in_any_order(box_samples, tmp_path):
    write_bodex(box_samples, tmp_path, name="box")
    path = tmp_path / "box_grasp.npy"
    content = read_object_array(path)
    content["joint_names"] = content["joint_names"][::-1]
    poses = content["robot_pose"]
    content["robot_pose"] = np.concatenate([poses[..., :7], poses[..., :6:-1]], axis=-1)
    assert np.allclose(
        read_bodex(content, box_samples.hand, path=path), in_object_frame(box_samples), rtol=0, atol=EXACT
    )


def wrong_entries(entries):
    yield [{"scale": 0.1}], "entry 0 is"
    yield [{**entries[0], "scale": -1.0}], "scale is -1.0"
    yield [], "holds no grasps; expected at least one"
    yield [entries[0], {**entries[1], "scale": 2.0}], "at the scales .* name it as `scale`"
    yield [{**entries[0], "qpos": {**entries[0]["qpos"], "WRJTx": np.nan}}], "NaN or infinity"
    yield [{**entries[0], "qpos": {**entries[0]["qpos"], "one": np.nan}}], "pose 0: a joint angle is NaN"
    yield [{**entries[0], "qpos": {**entries[0]["qpos"], "one": "x"}}], "no number"
    yield [{**entries[0], "qpos": {**entries[0]["qpos"], "WRJTx": "0.1"}}], "no number"
    yield [{**entries[0], "qpos": {**entries[0]["qpos"], "WRJTx": 10**400}}], "no number"
    yield [{**entries[0], "scale": "0.1"}], "scale is '0.1'"
    yield [{**entries[0], "scale": 10**400}], "scale is an integer of 401 digits"
    yield [{**entries[0], "qpos": {k: v for k, v in entries[0]["qpos"].items() if k != "two"}}], "has not 'two'"
    yield [{**entries[0], "qpos": {**entries[0]["qpos"], "LFJ5": 0.0}}], "has but 'LFJ5'"


def test_wrong_entries_of_dexgraspnet_are_told(box_samples, tmp_path):
    write_dexgraspnet(box_samples, tmp_path, name="box")
    entries = read_object_array(tmp_path / "dataset/box.npy")
    for wrong, message in wrong_entries(entries):
        with pytest.raises(InputError, match=message):
            read_dexgraspnet(wrong, box_samples.hand, where="box.npy")
    other = {**entries[1], "scale": 2.0}
    assert len(read_dexgraspnet([entries[0], other], box_samples.hand, where="box.npy", scale=2.0)) == 1


def test_wrong_records_of_bodex_are_told(box_samples, tmp_path):
    write_bodex(box_samples, tmp_path, name="box")
    path = tmp_path / "box_grasp.npy"
    content = read_object_array(path)
    unnormalised, not_finite = content["robot_pose"].copy(), content["robot_pose"].copy()
    unnormalised[0, 0, 1, 3:7] *= 1.1
    not_finite[0, 0, 1, 0] = np.inf
    far, bent = content["robot_pose"].copy(), content["robot_pose"].copy()
    far[0, 0, 1, 0], bent[0, 0, 1, 7] = 1e30, 1e30
    for change, message in (
        ({"robot_pose": unnormalised}, "unit quaternion"),
        ({"robot_pose": not_finite}, "finite numbers"),
        ({"robot_pose": far}, "more than 1000 m away"),
        ({"obj_pose": np.array([[1e300, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])}, "more than 1000 m away"),
        ({"robot_pose": bent}, "a joint angle is NaN, infinite or above 1000"),
        ({"robot_pose": content["robot_pose"][0]}, "shape"),
        ({"joint_names": ["one", "one", "three", "four"]}, "has twice 'one'"),
        ({"joint_names": 3}, "list of names"),
        ({"obj_pose": "here"}, "obj_pose is"),
        ({"robot_pose": [[1.0], [1.0, 2.0]]}, "robot_pose has rows of different lengths"),
    ):
        with pytest.raises(InputError, match=message):
            read_bodex({**content, **change}, box_samples.hand, path=path)
    outside = {key: value for key, value in content.items() if key != "obj_pose"}
    write_object_array(tmp_path.parent / "scene.npy", {})
    for place in ("../scene.npy", str(tmp_path.parent / "scene.npy"), 3):
        with pytest.raises(InputError, match="scene_path"):
            read_bodex({**outside, "scene_path": place}, box_samples.hand, path=path)


def test_grasps_of_an_object_of_another_size_are_refused(box_samples, tmp_path):
    scene, hand = box_samples.scene, box_samples.hand
    write_dexgraspnet(box_samples, tmp_path, name="box")
    write_dexgraspbench(box_samples, tmp_path, name="box")
    record, path = read_object_array(tmp_path / "graspdata/box/000.npy"), tmp_path / "a.npy"
    for content in (
        [{**entry, "scale": 1e3 * entry["scale"]} for entry in read_object_array(tmp_path / "dataset/box.npy")],
        {**record, "obj_scale": 100.0},
    ):
        write_object_array(path, content)
        with pytest.raises(InputError, match=r"at the scale .* reaches 0\.0678233 m"):  # of 120 x 60 x 20 mm, halved
            read_back(path, scene, hand)
    write_object_array(path, {**record, "obj_scale": "1"})
    with pytest.raises(InputError, match="scale is '1'"):
        read_back(path, scene, hand)


def test_the_folder_one_stands_in_gives_its_name(box_samples, tmp_path, monkeypatch):
    verdicts = verify(box_samples.scene, box_samples.hand, box_samples.q)
    replace(box_samples, verdicts=verdicts).save(tmp_path / "run")
    (tmp_path / "run/below").mkdir()
    monkeypatch.chdir(tmp_path / "run/below")
    said = convert(Path(".."), "dexgraspbench", tmp_path / "out", every=True)
    assert said == f"{len(box_samples)} configurations"
    assert convert(Path(".."), "usd", tmp_path / "out.usda", every=True) == "the scene and 1 configuration"
    assert len(list((tmp_path / "out/graspdata/run").glob("*.npy"))) == len(box_samples)


def test_a_hand_of_another_name_keeps_its_joints(boxy_hand):
    assert their_joint_names(replace(boxy_hand, name="mine")) == list(boxy_hand.joint_names)


def test_hands_are_verified_in_parts_as_they_are_at_once_and_parts_are_told(box_samples, tmp_path, monkeypatch):
    write_dexgraspnet(box_samples, tmp_path, name="box")
    path, number, told = tmp_path / "dataset/box.npy", len(box_samples), []
    monkeypatch.setattr(conversion, "AT_ONCE", number - 1)
    back = read_back(path, box_samples.scene, box_samples.hand, on_verified=lambda *done: told.append(done))
    assert told == [(number - 1, number), (number, number)]
    whole = verify(box_samples.scene, box_samples.hand, back.q)
    assert back.verdicts.reasons == whole.reasons
    for name, values in whole.values.items():
        assert np.array_equal(back.verdicts.values[name], values), name


def test_more_hands_than_one_conversion_takes_are_refused(box_samples, tmp_path, monkeypatch):
    write_dexgraspnet(box_samples, tmp_path, name="box")
    path, number = tmp_path / "dataset/box.npy", len(box_samples)
    monkeypatch.setattr(conversion, "MOST_HANDS", number)
    assert len(read_back(path, box_samples.scene, box_samples.hand)) == number
    monkeypatch.setattr(conversion, "MOST_HANDS", number - 1)
    monkeypatch.setattr(conversion, "verify", lambda *_: pytest.fail("verified"))
    with pytest.raises(InputError, match=rf"box.npy holds {number} hands; expected at most {number - 1}; split it"):
        read_back(path, box_samples.scene, box_samples.hand)
