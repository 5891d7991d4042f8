"""Films show what the simulation held: poses against MuJoCo's own kinematics, curves against the verdict's figures."""

import base64
import json
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from dexnudge.execution.film import film_of_trace, told, write_film
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.model import OBJECT, scene_model
from dexnudge.simulation.rollout import Trace
from dexnudge.simulation.success import judge_push

RECORDS = 12
NAMES = ["settle"] * 3 + ["approach", "squeeze"] + ["push"] * 5 + ["stop"] * 2


@pytest.fixture(scope="module")
def scene():
    block = trimesh.creation.box((0.14, 0.07, 0.02))
    block.apply_translation([0.03, 0.01, 0.0])  # the centre of mass is not the frame's origin
    slab = trimesh.creation.box(bounds=[[-0.5, -0.5, -0.05], [0.5, 0.5, -0.01]])
    return Scene(block, slab, np.eye(4), np.array([0.6, 0.8, 0.0]))


@pytest.fixture(scope="module")
def simulation(shadow_hand, scene):
    return scene_model(shadow_hand, scene)


@pytest.fixture(scope="module")
def trace(simulation):
    """Records with the hand anywhere and the object on its way; no simulation has to make them."""
    rng = np.random.default_rng(0)
    model, data = simulation.model, simulation.data
    qpos, pose = np.zeros((RECORDS, model.nq)), np.zeros((RECORDS, 7))
    for record in range(RECORDS):
        low, high = model.jnt_range[:, 0], model.jnt_range[:, 1]
        for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE):
            qpos[record, model.jnt_qposadr[joint]] = rng.uniform(low[joint], high[joint])
        qpos[record, simulation.palm_position : simulation.palm_position + 7] = rng.normal(size=7)
        turned = 0.02 * max(0, record - 2)
        free = simulation.object_position
        qpos[record, free : free + 3] = 0.008 * max(0, record - 2) * np.array([0.6, 0.8, 0.0]) + [0.0, 0.001, 0.0]
        qpos[record, free + 3 : free + 7] = [np.cos(turned / 2), 0, 0, np.sin(turned / 2)]
        palm = simulation.palm_position
        qpos[record, palm + 3 : palm + 7] /= np.linalg.norm(qpos[record, palm + 3 : palm + 7])
        data.qpos[:] = qpos[record]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        pose[record] = np.concatenate([data.xipos[simulation.object_body], qpos[record, free + 3 : free + 7]])
    return Trace(
        time=0.02 * np.arange(RECORDS),
        phase=np.array(NAMES),
        attempt=np.ones(RECORDS, dtype=int),
        qpos=qpos,
        ctrl=np.zeros((RECORDS, model.nu)),
        mocap=np.zeros((RECORDS, 7)),
        object_pose=pose,
        hand_object_force=rng.uniform(0, 5, (RECORDS, 2)),
        link_force=rng.uniform(0, 5, (RECORDS, len(simulation.hand.link_names))),
        motor_force=np.zeros((RECORDS, model.nu)),
        torque_share=np.zeros((RECORDS, model.nu)),
        base_wrench=np.zeros((RECORDS, 6)),
        hand_environment_clearance=rng.uniform(0, 0.05, RECORDS),
        hand_environment_depth=np.zeros(RECORDS),
        support_force=np.zeros(RECORDS),
    )


def embedded(folder):
    text = (folder / "film.html").read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text)[1])


def test_the_pages_bodies_stand_where_mujoco_has_them(scene, simulation, trace, tmp_path):
    write_film(film_of_trace(scene, simulation, trace), tmp_path, pictures=False)
    data, hand = embedded(tmp_path), simulation.hand
    links = [name for name, mesh in zip(hand.link_names, hand.link_meshes, strict=True) if len(mesh.faces)]
    assert len(data["configurations"]) == RECORDS
    for record, entry in enumerate(data["configurations"]):
        poses = np.frombuffer(base64.b64decode(entry["poses"]), dtype="<f4").reshape(-1, 3, 4)
        simulation.data.qpos[:] = trace.qpos[record]
        mujoco.mj_kinematics(simulation.model, simulation.data)
        for pose, body in zip(poses, [OBJECT, None, *links], strict=True):
            there = simulation.data.body(body) if body else None
            rotation = there.xmat.reshape(3, 3) if there else np.eye(3)
            np.testing.assert_allclose(pose[:, :3], rotation, atol=2e-6)
            np.testing.assert_allclose(pose[:, 3], there.xpos if there else 0.0, atol=2e-6)
    assert not (tmp_path / "film.gif").exists()


def test_the_curves_are_those_of_the_verdict(scene, simulation, trace):
    film = film_of_trace(scene, simulation, trace)
    verdict = judge_push(trace, motion=scene.object_motion, length=0.1, max_normal_force=5.0, diverged=False)
    along, up = film.charts["object's way"]
    (turned,) = film.charts["object's turn"]
    assert along.values[-1] == pytest.approx(1e3 * verdict.length_reached, abs=1e-6)
    assert np.abs(up.values).max() < 1e-6
    assert turned.values.max() == pytest.approx(verdict.turned_deg, abs=1e-6)
    assert along.values[:3] == pytest.approx(0.0, abs=1e-9)
    normal, tangential = film.charts["hand on object"]
    np.testing.assert_array_equal(np.stack([normal.values, tangential.values], axis=1), trace.hand_object_force)
    (clearance,) = film.charts["hand to surroundings"]
    np.testing.assert_array_equal(clearance.values, 1e3 * trace.hand_environment_clearance)


def test_the_strip_of_a_push_shows_approach_contact_way_and_end(scene, simulation, trace):
    moments = told(film_of_trace(scene, simulation, trace)).tolist()
    assert moments[:2] == [0, NAMES.index("push") - 1]
    assert moments[-2:] == [NAMES.index("stop") - 1, RECORDS - 1]
    assert len(moments) == 6
    lifted = replace(trace, phase=np.array([*NAMES[:6], "release", "regrasp", "lift", "lift", "hold", "hold"]))
    film = film_of_trace(scene, simulation, lifted)
    np.testing.assert_array_equal(told(film), film.eventful(6))


def test_the_arrow_goes_with_the_push(scene, simulation, trace):
    phase = np.array([*NAMES[:6], "release", "regrasp", "lift", "lift", "hold", "hold"])
    film = film_of_trace(scene, simulation, replace(trace, phase=phase))
    assert film.phase == tuple(phase.tolist())
    assert [bool(np.any(frame.motion)) for frame in film.frames] == [True] * 6 + [False] * 6


@pytest.mark.parametrize("length", [None, 0.04])
def test_the_arrow_stays_and_ends_where_the_leading_edge_shall_come(scene, simulation, trace, length):
    film = film_of_trace(scene, simulation, trace, length=length)
    edge = (scene.object_mesh.vertices @ scene.motion).max()
    for frame in film.frames[:10]:
        along = frame.arrow().mesh.vertices @ scene.motion
        assert along.min() == pytest.approx(edge, abs=0.005)
        assert np.ptp(along) == pytest.approx(length or scene.motion_length)
