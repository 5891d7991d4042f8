"""The model in MuJoCo: its file is all that it needs, and a changed model is that of the changed scene."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
import trimesh

from dexnudge.errors import InputError, SceneError
from dexnudge.hands.motors import POSITION_GAIN
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.contact_forces import normal_forces
from dexnudge.simulation.hand_path import push_path
from dexnudge.simulation.model import (
    ARM,
    ARM_INERTIA,
    ARM_MASS,
    HAND_SIDE,
    MANY_PIECES,
    MEMORY,
    QUANTITIES,
    SELF_CONTACT_DEPTH,
    changed_physics,
    grasp_model,
    load_scene_model,
    scene_model,
)
from dexnudge.simulation.push_forces import PushForces
from dexnudge.simulation.rollout import Rollout

LEVER, HALF_WIDTH = 0.5, 0.02  # [m] of the hand of two pads
DECIDED = ("geom_friction", "body_mass", "body_inertia", "body_subtreemass", "body_invweight0", "dof_invweight0")


@pytest.fixture(scope="module")
def scene(block):
    return Scene(block, box((-0.5, -0.5, -0.06), (0.5, 0.5, -0.02)), np.eye(4), np.array([1.0, 0, 0]))


@pytest.fixture(scope="module")
def simulation(pad_hand, scene):
    return scene_model(pad_hand, scene)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_changed_model_equals_that_of_the_changed_scene(pad_hand, scene, simulation, quantity):
    expected = scene_model(pad_hand, replace(scene, **{quantity: 1.5 * getattr(scene, quantity)})).model
    before = {name: getattr(simulation.model, name).copy() for name in DECIDED}
    changed = changed_physics(simulation, **{quantity: 1.5}).model
    for name in DECIDED:
        np.testing.assert_allclose(getattr(changed, name), getattr(expected, name), rtol=1e-5, atol=1e-12, err_msg=name)
        np.testing.assert_array_equal(getattr(simulation.model, name), before[name])
    assert any(not np.allclose(getattr(changed, name), before[name], rtol=1e-3) for name in DECIDED)


def test_an_unknown_quantity_is_refused(simulation):
    with pytest.raises(InputError, match="'gravity' cannot be changed in a model; expected one of friction_hand"):
        changed_physics(simulation, gravity=2.0)


def test_one_hand_serves_many_models_and_none_changes_another(pad_hand, scene, simulation):
    slippery = scene_model(pad_hand, replace(scene, friction_hand=0.1))
    held = grasp_model(pad_hand, scene.object_mesh)
    again = scene_model(pad_hand, scene)
    assert again.xml == simulation.xml
    frictions = [one.model.geom_friction[one.side == 1, 0].max() for one in (simulation, slippery, held)]
    assert frictions == pytest.approx([scene.friction_hand, 0.1, 0.6])


def test_hand_and_object_stand_where_they_are_placed(pad_hand, pad_grasp, simulation, block):
    q = pad_grasp[0].copy()
    q[9:] = 0.1, -0.2
    expected = pad_hand.forward_kinematics(torch.as_tensor(q[None]))[0].numpy()
    for one in (simulation, grasp_model(pad_hand, block)):
        one.place(q)
        np.testing.assert_allclose(one.data.xpos[one.link_body], expected[:, :3, 3], atol=1e-12)
        np.testing.assert_allclose(one.data.xmat[one.link_body].reshape(-1, 3, 3), expected[:, :3, :3], atol=1e-12)
        np.testing.assert_allclose(one.object_poses(one.data.qpos[None])[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(simulation.configurations(simulation.data.qpos[None])[0], q, atol=1e-12)


@pytest.mark.parametrize("hand", ["shadow_hand", "boxy_hand", "pad_hand"])
def test_links_touch_each_other_exactly_where_self_collision_is_judged(hand, scene, request):
    hand = request.getfixturevalue(hand)
    model = scene_model(hand, scene).model
    body = [model.geom_bodyid[geoms] for geoms in (model.pair_geom1, model.pair_geom2)]
    names = {frozenset(model.body(int(one)).name for one in pair) for pair in zip(*body, strict=True)}
    assert names == {frozenset(hand.link_names[link] for link in pair) for pair in hand.self_collision_pairs}


@pytest.mark.parametrize("hand", ["shadow_hand", "pad_hand"])
def test_the_base_is_as_heavy_as_hand_and_flange(hand, scene, request):
    hand = request.getfixturevalue(hand)
    model = scene_model(hand, scene).model
    flange, palm = model.body(ARM), model.body(hand.link_names[0])
    assert flange.mass == pytest.approx(ARM_MASS)
    np.testing.assert_allclose(flange.inertia, ARM_INERTIA)
    links = sum(model.body(name).mass[0] for name in hand.link_names)
    assert model.body_subtreemass[palm.id] == pytest.approx(ARM_MASS + links)


def closing(simulation, q, target):
    """Close both pads to the angle `target` [rad], far from everything; return their depth in each other [m] at the end."""
    rollout = Rollout(simulation, q)
    path = np.tile(q, (400, 1))
    path[:, 9:] = np.minimum(target, q[9:] + np.linspace(0.0, 0.05, 400)[:, None])
    rollout.follow(path, "close")
    return depth_of_pads(simulation), rollout


def depth_of_pads(simulation):
    """Return how deep the pads are in each other [m]; negative: how far apart."""
    one, other = (int(np.flatnonzero(simulation.link_of_geom == link)[0]) for link in (1, 2))
    return -mujoco.mj_geomDistance(simulation.model, simulation.data, one, other, 1.0, None)


def test_links_that_meet_stop_each_other_where_a_configuration_may_have_them(pad_hand, pad_grasp, simulation):
    q = pad_grasp[0].copy()
    q[0], q[9:] = 1.0, 0.02
    depth, rollout = closing(simulation, q, 0.06)
    assert depth == pytest.approx(SELF_CONTACT_DEPTH, abs=1e-4)
    # Each pad presses with what its motor makes of the angle that it lacks, at its lever.
    sides = simulation.side[simulation.data.contact.geom].sum(axis=1)
    force = normal_forces(simulation)[sides == 2 * HAND_SIDE].sum()
    assert force == pytest.approx(POSITION_GAIN * (0.06 - rollout.q[9:].mean()) / LEVER, rel=0.02)
    assert rollout.trace.link_force.max() == 0.0  # on the object
    depth, rollout = closing(simulation, q, 0.0402)
    assert 0.0 < depth < SELF_CONTACT_DEPTH
    np.testing.assert_allclose(rollout.q[9:], 0.0402, atol=1e-6)  # pieces that meet less deep do not press


def test_links_that_start_in_each_other_are_not_pressed_apart(pad_hand, pad_grasp, simulation):
    q = pad_grasp[0].copy()
    q[0], q[9:] = 1.0, np.arcsin((HALF_WIDTH + 0.0025) / LEVER)
    simulation.place(q)
    assert np.abs(simulation.data.qacc[: simulation.model.nv - 6]).max() < 1e-9
    depth = depth_of_pads(simulation)
    assert depth > 0.004
    assert closing(simulation, q, q[9])[0] == pytest.approx(depth, abs=1e-6)
    assert closing(simulation, q, 0.06)[0] == pytest.approx(depth, abs=1e-4)
    q[9:] = 0.02
    assert closing(simulation, q, 0.06)[0] == pytest.approx(SELF_CONTACT_DEPTH, abs=1e-4)  # whatever was before


def test_a_push_lets_links_be_where_its_configuration_has_them(pad_hand, pad_grasp, scene, simulation):
    q = pad_grasp[0].copy()
    q[0], q[9:] = 1.0, np.arcsin((HALF_WIDTH + 0.0025) / LEVER)
    opened = q.copy()
    opened[9:] = 0.02
    none, links = np.zeros(simulation.model.nu), len(pad_hand.link_names)
    idle = PushForces(
        done=np.zeros(1),
        force=np.zeros((1, 0, 3)),
        motor_torque=none[None],
        base_wrench=np.zeros((1, 6)),
        cone_share=np.ones(1),
        surplus=np.ones(1),
        closing=none,
        base_closing=np.zeros(3),
        link_force=np.zeros((1, links)),
        link_torque=np.zeros((links, simulation.model.nu)),
        link_wrench=np.zeros((links, 6)),
        limit=5.0,
    )
    rollout = Rollout(simulation, opened)
    way = np.stack([opened, q])
    rollout.push(push_path(np.array([0.0, 0.5]), way, motion=scene.object_motion, length=0.02), idle)
    np.testing.assert_allclose(rollout.q[9:], q[9:], atol=1e-6)


def test_surroundings_of_many_pieces_have_room_for_their_contacts(pad_hand, scene, simulation, monkeypatch):
    blocks = [
        box((0.016 * column - 0.12, 0.016 * row - 0.12, -0.03), (0.016 * column - 0.106, 0.016 * row - 0.106, -0.02))
        for row in range(15)
        for column in range(15)
    ]
    many = scene_model(pad_hand, replace(scene, environment_mesh=trimesh.util.concatenate(blocks)))
    assert (many.side == 4).sum() > MANY_PIECES
    assert many.model.narena == MEMORY
    assert "<size" not in simulation.xml  # few pieces: as ever


def test_more_contacts_than_memory_holds_are_refused_and_end_a_rollout(pad_hand, pad_grasp, scene, simulation):
    q = pad_grasp[0]
    rollout = Rollout(simulation, q)
    size = '<size memory="8K"/>'
    short = load_scene_model(simulation.xml.replace("<worldbody", f"{size}<worldbody", 1), pad_hand, scene)
    with pytest.raises(SceneError, match="MuJoCo cannot place hand and object"):
        short.place(q)
    rollout.simulation = short
    rollout.follow(np.tile(q, (5, 1)), "wait")
    assert rollout.divergence is not None
