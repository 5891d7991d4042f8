"""The model in MuJoCo: its file is all that it needs, and a changed model is that of the changed scene."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.errors import InputError, SceneError
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import (
    MANY_PIECES,
    MEMORY,
    QUANTITIES,
    changed_physics,
    grasp_model,
    load_scene_model,
    scene_model,
)
from dexnudge.simulation.rollout import Rollout

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
    rollout.carry_on(np.tile(q, (5, 1)), "wait")
    assert rollout.divergence is not None
