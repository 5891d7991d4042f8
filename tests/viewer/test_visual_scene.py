from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.errors import InputError
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.scene import Scene
from dexnudge.viewer.page_data import page_data
from dexnudge.viewer.visual_scene import Part, VisualScene, visual_scenes

T_OBJECT = trimesh.transformations.translation_matrix([0.3, -0.2, 0.01])


@pytest.fixture(scope="module")
def hand(shadow_hand):
    return shadow_hand


@pytest.fixture(scope="module")
def scene():
    slab = trimesh.creation.box((1.0, 1.0, 0.02), transform=trimesh.transformations.translation_matrix([0, 0, -0.01]))
    return Scene(trimesh.creation.box((0.15, 0.07, 0.02)), slab, T_OBJECT, np.array([0.0, 2.0, 0.0]))


def random_q(hand, count):
    rng = np.random.default_rng(1)
    angles = rng.uniform(hand.lower, hand.upper, (count, hand.num_joints))
    return np.concatenate([rng.normal(size=(count, 9)), angles], axis=1)


def test_links_stand_where_forward_kinematics_puts_them(hand, scene):
    q = random_q(hand, 3)
    poses = hand.forward_kinematics(torch.as_tensor(q)).numpy()
    for shown, T_world_links in zip(visual_scenes(scene, hand, q), poses, strict=True):
        links = {part.name: part for part in shown.with_role("link", "fingertip", "base")}
        expected = {name for name, mesh in zip(hand.link_names, hand.link_meshes, strict=True) if len(mesh.faces)}
        assert set(links) == expected
        for index, name in enumerate(hand.link_names):
            if name in links:
                np.testing.assert_allclose(links[name].T_world_part, T_world_links[index])


def test_roles_object_and_contacts(hand, scene):
    points = np.array([[0.1, 0.2, 0.3]])
    shown = visual_scenes(scene, hand, random_q(hand, 1), contacts=[points])[0]
    assert {part.name for part in shown.with_role("fingertip")} == set(hand.fingertip_links)
    assert [part.name for part in shown.with_role("base")] == ["base"]
    np.testing.assert_allclose(
        shown.with_role("object")[0].vertices_in_world().mean(axis=0), T_OBJECT[:3, 3], atol=1e-12
    )
    np.testing.assert_array_equal(shown.contacts, points)
    np.testing.assert_allclose(shown.motion, [0, 1, 0])


def test_configurations_share_their_meshes(hand, scene):
    one, two = visual_scenes(scene, hand, random_q(hand, 2))
    assert all(a.mesh is b.mesh for a, b in zip(one.parts, two.parts, strict=True))


def test_an_arrow_may_start_where_the_object_was():
    box = trimesh.creation.box((0.1, 0.06, 0.02))
    there = trimesh.transformations.translation_matrix([0.08, 0.0, 0.0])
    frame = VisualScene((Part("object", "object", box, there),), np.zeros((0, 3)), np.array([1.0, 0.0, 0.0]))
    for from_, begin in ((None, 0.13), (np.eye(4), 0.05)):
        arrow = replace(frame, arrow_from=from_).arrow().mesh
        assert arrow.vertices[:, 0].min() == pytest.approx(begin, abs=0.005)


@pytest.mark.parametrize("motion", [(1, 0, 0), (0, -1, 0), (0.6, 0, 0.8), (0, 0, 1), (0, 0, -1)])
def test_arrow_is_a_closed_body_that_starts_at_the_leading_edge(motion):
    motion = np.asarray(motion, dtype=float)
    box = Part("object", "object", trimesh.creation.box((0.15, 0.07, 0.02)), T_OBJECT)
    arrow = VisualScene((box,), np.zeros((0, 3)), motion).arrow().mesh
    assert arrow.is_watertight
    assert arrow.volume > 0
    along = arrow.vertices @ motion
    leading = (box.vertices_in_world() @ motion).max()
    assert 0 < along.min() - leading < 0.01
    tip = arrow.vertices[along > along.max() - 1e-9]
    middle = T_OBJECT[:3, 3]
    assert np.linalg.norm(np.cross(tip - middle, motion), axis=1).max() < 0.005


def test_contacts_must_be_given_for_each_configuration(hand, scene):
    with pytest.raises(InputError, match=r"contacts of 1 configurations were given for 2; expected one entry for each"):
        visual_scenes(scene, hand, random_q(hand, 2), contacts=[np.zeros((0, 3))])


def test_a_visual_scene_needs_an_object():
    with pytest.raises(InputError, match="needs a part with the role 'object'"):
        VisualScene((), np.zeros((0, 3)), np.array([1.0, 0, 0]))


def test_of_what_turns_an_arc_the_slide_after_it_and_both_ends_are_shown(hand, scene):
    turn = Turn(np.pi / 2, np.array([0.0, 0.0, 1.0]), scene.centre_of_mass)
    for length, names in ((0.0, ["turn", "after 0"]), (0.05, ["turn", "after 0", "after 1", "slide"])):
        turning = replace(scene, turn=turn, motion_length=length)
        shown = visual_scenes(turning, hand, random_q(hand, 1))[0]
        assert [part.name for part in shown.with_role("arrow", "ghost")] == names
        assert not shown.has_arrow
        assert len(shown.arrow().mesh.faces) == 0
        label, end = shown.stations[-1]
        assert label == ("90 deg, 50 mm" if length else "90 deg")
        np.testing.assert_allclose(end[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
        moved = end[:3, :3] @ scene.centre_of_mass + end[:3, 3] - scene.centre_of_mass
        np.testing.assert_allclose(moved, length * scene.motion, atol=1e-12)
        (*_, last) = shown.with_role("ghost")
        np.testing.assert_allclose(last.T_world_part, end @ scene.T_world_object, atol=1e-12)
        assert not page_data([shown])["has_arrow"]
