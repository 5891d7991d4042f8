"""Reach of a SCARA, whose wrist gets to every place of an annulus and to no other."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

import dexnudge as dn
from dexnudge.planning.object_path import push_length
from dexnudge.planning.reach import FILE, Reach

WRIST = 0.1  # [m] behind the palm, which is mounted on the flange
INNER, OUTER = 0.1, 0.7  # [m]


def hands(hand, x, y, yaw, z):
    q = np.zeros((len(x), 9 + hand.num_joints))
    q[:, :3] = np.stack([x, y, np.broadcast_to(z, x.shape)], axis=1)
    q[:, 3], q[:, 4] = np.cos(yaw), np.sin(yaw)
    q[:, 6], q[:, 7] = -np.sin(yaw), np.cos(yaw)
    return dn.HandBatch(hand, torch.as_tensor(q), dense=True)


def expected(batch, length, base=(0.0, 0.0)):
    """Whether the wrist stays in the annulus while the hand goes along x, and the distance from where that changes [m]."""
    q = batch.q.numpy()
    start = q[:, :2] - WRIST * q[:, 3:5] - np.asarray(base)
    places = start[:, None] + np.linspace(0, length, 200)[None, :, None] * np.array([1.0, 0.0])
    radius = np.linalg.norm(places, axis=2)
    room = np.minimum(radius - INNER, OUTER - radius).min(axis=1)
    return room > 0, np.abs(room)


def test_a_scara_reaches_what_its_wrist_can_follow_within_the_annulus(scara, boxy_hand, block_scene):
    generator = np.random.default_rng(0)
    x, y, yaw = generator.uniform((-0.8, -0.8, -0.7), (0.8, 0.8, 0.7), (150, 3)).T
    batch = hands(boxy_hand, x, y, np.arctan2(y, x) + yaw, 0.1)
    found = Reach(scara, mount=np.eye(4))(batch, block_scene)
    inside, room = expected(batch, push_length(block_scene))
    clear = room > 0.03
    assert inside[clear].sum() > 20
    assert (~inside[clear]).sum() > 20
    assert not found.passed[clear & ~inside].any()
    assert (
        found.passed[clear & inside].mean() > 0.9
    )  # the wedge behind the base, where joints end, is not in the closed form
    assert ((found.value >= 0) & (found.value <= 1)).all()
    assert (found.value[clear & ~inside] == 0).all()
    again = Reach(scara, mount=np.eye(4))(batch, block_scene)
    np.testing.assert_array_equal(found.value, again.value)


def test_the_margin_is_that_of_the_joint_nearest_its_limit(scara, boxy_hand, block_scene):
    """The lift goes 0.5 m either way: at height z, and 30 mm higher before contact, (0.47 - z) / 0.5 of it is left."""
    batch = hands(boxy_hand, np.array([0.4, 0.4]), np.array([0.1, 0.1]), np.array([0.2, 0.2]), np.array([0.42, 0.465]))
    found = Reach(scara, mount=np.eye(4))(batch, block_scene)
    np.testing.assert_allclose(found.value, [0.1, 0.01], atol=2e-3)
    assert found.passed.tolist() == [True, False]


def test_near_the_stretched_arm_the_margin_goes_to_zero(scara, boxy_hand, block_scene):
    still = replace(block_scene, motion_length=1e-3)
    batch = hands(boxy_hand, np.array([0.6, 0.75, 0.78, 0.797]), np.zeros(4), np.zeros(4), 0.0)
    value = Reach(scara, mount=np.eye(4))(batch, still).value
    assert value[1] > value[2] > value[3]
    assert value[3] < 0.02


def test_where_the_arm_stands_and_how_the_hand_is_mounted_count(scara, boxy_hand, block_scene):
    here = hands(boxy_hand, np.array([0.4]), np.array([0.1]), np.array([0.2]), 0.1)
    away = trimesh.transformations.translation_matrix((1.5, 0.0, 0.0))
    found = Reach(scara.standing_at(away), mount=np.eye(4))(here, block_scene)
    assert not found.passed[0]
    assert found.sentence.startswith("the arm reaches none of the hands even at contact; move the `arm_base`")
    assert Reach(scara, mount=np.eye(4))(here, block_scene).passed[0]
    assert Reach(scara, mount=trimesh.transformations.rotation_matrix(0.4, (0, 0, 1)))(here, block_scene).passed[0]
    assert not Reach(scara, mount=trimesh.transformations.rotation_matrix(0.4, (0, 1, 0)))(here, block_scene).passed[0]


def test_a_way_on_which_the_arm_is_in_the_surroundings_does_not_count(scara, boxy_hand, block_scene, tmp_path):
    """A mast of 0.2 m on the flange, which is lifted by 3 cm before contact, under a plate 0.25 m over the floor."""
    mast = trimesh.creation.box(bounds=[[-0.01, -0.01, 0.02], [0.01, 0.01, 0.2]])
    arm = replace(scara, tree=replace(scara.tree, links={**scara.tree.links, "link5": mast}))
    plate = trimesh.creation.box(bounds=[[-0.4, -0.4, 0.25], [0.4, 0.4, 0.27]])
    roofed = replace(block_scene, environment_mesh=block_scene.environment_mesh + plate)
    batch = hands(boxy_hand, np.full(3, 0.3), np.full(3, 0.1), np.full(3, 0.2), np.array([0.0, 0.04, 0.1]))
    reach = Reach(arm, mount=np.eye(4))
    assert reach(batch, block_scene).passed.tolist() == [True, True, True]
    under = reach(batch, roofed)
    assert under.passed.tolist() == [True, False, False]
    assert "through the surroundings" in under.sentence
    reach.save(tmp_path, boxy_hand)
    np.testing.assert_array_equal(Reach.load(tmp_path)(batch, roofed).value, under.value)


@pytest.fixture
def samples(boxy_hand, block_scene, touching):
    """Two alike, on the block's nearer and farther half."""
    q = np.stack([touching, touching]).astype(np.float32)
    q[:, 0] = 0.06, -0.06
    return dn.Samples(block_scene, boxy_hand, q, dn.verify(block_scene, boxy_hand, q))


def test_samples_are_ranked_by_an_arm_saved_with_it_and_checked_without(samples, scara, tmp_path):
    """The wrist of an arm at x = 0.8 that looks back gets to x = 0.1; those of the hands are to be at 0.16 and 0.04."""
    assert samples.num_verified == 2
    turned = trimesh.transformations.rotation_matrix(np.pi, (0, 0, 1))
    arm = scara.standing_at(trimesh.transformations.translation_matrix((0.8, 0.0, 0.0)) @ turned)
    ranked = samples.rank(arm, mount=turned)
    assert ranked.reasons == ["", "reach"]
    assert ranked.q[0, 0] > 0
    assert ranked.verdicts.values["reach"][1] == 0.0
    written = ranked.save(tmp_path / "out")
    assert written.reasons == ["", "reach"]
    again = dn.check(tmp_path / "out")
    assert again.agrees, again.differences
    assert again.not_recomputed == {}
    np.testing.assert_array_equal(again.found.values["reach"], written.verdicts.values["reach"])
    assert "reach" in (tmp_path / "out" / "view.html").read_text()
    read = dn.load_samples(tmp_path / "out")
    assert read.rank(arm.standing_at(np.eye(4))).num_verified < 2


gone, null = "gone", "null"  # what a key of the file may be in place of a value


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("home", [0.0], r"is no list of 4 finite numbers; expected the arm that `dexnudge sample` wrote"),
        ("T_flange_mount", [[1, 0], [0, 1]], r"mount has shape \(2, 2\)"),
        ("joints", [], "its flange is none of its links"),
        ("flange", gone, "lacks the key 'flange'"),
        *(
            (key, null, f"reach.json: {key} is None; expected ")
            for key in ("arm", "joints", "joint_names", "limits", "home", "flange", "T_world_base", "T_flange_mount")
        ),
        ("limits", [1.0], r"limits is \[1.0\]; expected an object"),
        ("home", [10**400, 0.0, 0.0, 0.0], "reach.json: .*; expected the arm that"),
        ("point_joint", [0, 7], "its points do not belong to 4 joints"),
    ],
)
def test_a_damaged_arm_in_a_result_is_refused(samples, scara, tmp_path, key, value, message):
    file = tmp_path / FILE
    Reach(scara, mount=np.eye(4)).save(tmp_path, samples.hand)
    content = json.loads(file.read_text())
    content[key] = None if value == null else value
    if value == gone:
        del content[key]
    file.write_text(json.dumps(content))
    with pytest.raises(dn.InputError, match=message):
        Reach.load(tmp_path)


def test_a_result_without_the_arm_that_judged_it_is_refused(samples, scara, tmp_path):
    samples.rank(scara, mount=np.eye(4)).save(tmp_path / "out")
    (tmp_path / "out" / "criteria" / "reach" / FILE).unlink()
    with pytest.raises(dn.InputError, match=r"reach\.json: no such file"):
        dn.check(tmp_path / "out")
