"""Robotiq's 2F-85, whose fingers are closed loops: coupled joints hold MuJoCo's constraints and meet what it settles at."""

import re

import mujoco
import numpy as np
import pytest
import torch

from .catalogue import LOOPS

SOFT = 0.0015  # [m] MuJoCo's constraints are springs, and the pads hang on those of both loops


def joint_values(hand, value):
    """Every joint's value where the one independent joint has this one."""
    return {j.name: j.multiplier * value + j.offset for j in hand.joints if j is not None and j.index is not None}


def transforms(hand, value):
    q = torch.zeros(1, 9 + hand.num_joints, dtype=torch.float64)
    q[0, 3] = q[0, 7] = 1.0
    q[0, 9] = value
    return hand.forward_kinematics(q)[0].numpy()


def in_mujoco(data, palm, body):
    return data.body(palm).xmat.reshape(3, 3).T @ (data.body(body).xpos - data.body(palm).xpos)


@pytest.mark.parametrize("name", LOOPS)
def test_followers_hold_the_loop_within_the_residual_that_a_note_states(name, real_hand):
    hand, model = real_hand(name), mujoco.MjModel.from_xml_path(str(LOOPS[name].path))
    assert hand.num_joints == LOOPS[name].joints
    stated = [re.search(r"off by at most ([\d.e-]+) mm", note) for note in hand.notes]
    residual = max(float(match[1]) for match in stated if match) * 1e-3
    assert residual < 0.001
    data = mujoco.MjData(model)
    for value in np.linspace(hand.lower[0], hand.upper[0], 9):
        values = joint_values(hand, value)
        assert len(values) == (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).sum()
        for joint, angle in values.items():
            data.qpos[model.joint(joint).qposadr[0]] = angle
        mujoco.mj_forward(model, data)
        loops = [row for row in range(data.ne) if model.eq_type[data.efc_id[row]] == mujoco.mjtEq.mjEQ_CONNECT]
        assert np.linalg.norm(data.efc_pos[loops].reshape(-1, 3), axis=1).max() <= residual * 1.01 + 1e-6
        placed = transforms(hand, value)
        for body in ("left_pad", "right_pad", "left_follower", "right_coupler"):
            ours = placed[hand.link_names.index(body), :3, 3]
            np.testing.assert_allclose(ours, in_mujoco(data, "base", body), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", LOOPS)
def test_the_pads_stand_where_mujoco_brings_them(name, real_hand):
    hand, model = real_hand(name), mujoco.MjModel.from_xml_path(str(LOOPS[name].path))
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    for share in (0.2, 0.5, 0.8):
        low, high = model.actuator_ctrlrange[0]
        data.ctrl[0] = low + share * (high - low)
        mujoco.mj_step(model, data, nstep=2000)
        placed = transforms(hand, float(data.joint(hand.joint_names[0]).qpos[0]))
        for body in ("left_pad", "right_pad"):
            ours = placed[hand.link_names.index(body), :3, 3]
            assert np.linalg.norm(ours - in_mujoco(data, "base", body)) < SOFT
