"""Whether grasps hold: Coulomb's law for two pads, and a grasp of the Shadow Hand."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from dexnudge.geometry.transforms import resting_origin
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.resting import resting_pose
from dexnudge.simulation import hold
from dexnudge.simulation.hold import HoldTest
from dexnudge.simulation.model import GRASP_FRICTION, OBJECT, grasp_model

HALF_WIDTH = 0.02  # [m] of the block, along y


@pytest.fixture(scope="module")
def pads(pad_hand, block) -> HoldTest:
    return HoldTest(pad_hand, block)


def test_contacts_are_as_soft_as_mujoco_has_them_by_default(pads):
    model, default = (
        pads._grasp.model,
        mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"),
    )
    np.testing.assert_array_equal(model.geom_solref, np.repeat(default.geom_solref, model.ngeom, axis=0))
    np.testing.assert_array_equal(model.geom_solimp, np.repeat(default.geom_solimp, model.ngeom, axis=0))


@pytest.mark.parametrize(("share", "held"), [(1.1, True), (0.9, False)])
def test_two_pads_hold_exactly_what_coulomb_allows(pads, pad_grasp, monkeypatch, share, held):
    # Both pads press with N: along x and z the block holds while 2 * friction * N > F.
    normal = share * hold.PULL / (2 * GRASP_FRICTION)
    monkeypatch.setattr(hold, "SQUEEZE", 2 * normal)
    monkeypatch.setattr(hold, "EVENNESS", 1e-3)  # so that the sum is what is asked for
    q, contacts = pad_grasp
    (result,) = pads(q[None], [contacts])
    assert result.held is held
    if not held:
        assert result.reason == "drops"
        squeezed = hold.CLOSING_UPDATES * hold.CLOSING_STEPS + 2 * hold.SETTLING_STEPS
        assert squeezed < result.steps <= squeezed + hold.PULL_STEPS, "in the first pull, along x"
        assert result.translation > 0.05


@pytest.fixture(scope="module")
def standing(pad_hand):
    """The block on four feet, since a pair of pieces makes one contact, on a slab that is all there is of the hand."""
    feet = []
    for x in (-0.025, 0.025):
        for z in (-0.015, 0.015):
            foot = trimesh.creation.box((0.01, 2 * HALF_WIDTH, 0.01))
            foot.apply_translation((x, 0.0, z))
            feet.append(foot)
    slab, nothing = trimesh.creation.box((0.4, 0.1, 0.4)), trimesh.Trimesh()
    return grasp_model(replace(pad_hand, link_meshes=(slab, nothing, nothing)), trimesh.util.concatenate(feet))


@pytest.mark.parametrize(("share", "slips"), [(0.95, False), (1.05, True)])
def test_a_block_on_an_incline_slips_above_the_friction_angle(standing, share, slips):
    # Gravity turned by theta against the top of the slab: the block slides iff tan(theta) > friction.
    model, data = standing.model, standing.data
    velocity_of = int(model.joint(OBJECT).dofadr[0])
    theta = np.arctan(share * GRASP_FRICTION)
    model.opt.gravity[:] = 9.81 * np.array([np.sin(theta), -np.cos(theta), 0.0])
    standing.place(np.array([0.0, -HALF_WIDTH - 0.05, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    mujoco.mj_step(model, data, nstep=50)
    place, velocity = np.array(data.xipos[standing.object_body]), float(data.qvel[velocity_of])
    mujoco.mj_step(model, data, nstep=100)
    if slips:
        acceleration = (float(data.qvel[velocity_of]) - velocity) / (100 * model.opt.timestep)
        friction = np.tan(theta) - acceleration / (9.81 * np.cos(theta))  # Coulomb
        assert friction == pytest.approx(GRASP_FRICTION, rel=0.05)
    else:
        assert np.linalg.norm(data.xipos[standing.object_body] - place) < 1e-4


# q and contacts of a grasp that the generator made of the built-in box, rounded to 0.1 mm.
GRASP = json.loads(Path(__file__).with_name("shadow_grasp.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_a_shadow_hand_holds_a_box_until_it_opens_its_fingers(shadow_hand):
    hand, mesh = shadow_hand, builtin_object("box")
    mesh.apply_transform(resting_pose(mesh))
    mesh.apply_translation(-resting_origin(mesh))
    contacts = HandContacts(
        points=np.array(GRASP["points"]), normals=np.array(GRASP["normals"]), link=np.array(GRASP["link"])
    )
    closed = np.array(GRASP["q"])
    opened = closed.copy()
    opened[9:] = np.clip(0.0, hand.lower, hand.upper)
    opened[9 + hand.joint_names.index("THJ4")] = 0.0
    test = HoldTest(hand, mesh)
    grasped, dropped = test(np.stack([closed, opened]), [contacts, _none()])
    assert (grasped.held, grasped.reason) == (True, "")
    assert grasped.translation < 0.005
    assert (dropped.held, dropped.reason) == (False, "no contact")
    # the same forces asked of open fingers do not hold it either; nor does what came before change a verdict
    (opened_with_forces, again) = test(np.stack([opened, closed]), [contacts, contacts])
    assert not opened_with_forces.held
    assert again == grasped
    (whole,) = HoldTest(hand, mesh, full_length=True)(closed[None], [contacts])
    assert whole.held
    assert whole.steps > 3000 > 2 * grasped.steps


def _none() -> HandContacts:
    return HandContacts(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), link=np.zeros(0, dtype=np.int64))
