"""Films show what the simulation held: poses against MuJoCo's own kinematics, curves against the verdict's figures."""

import base64
import json
import re

import mujoco
import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError
from dexnudge.execution.film import film_of_trace, film_trace, read_trace, write_film
from dexnudge.hands.shadow_lite import shadow_lite
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.drive import PHASES
from dexnudge.simulation.push import PushRun, judge_push
from dexnudge.simulation.push_model import OBJECT, load_push_model, push_model_xml

RECORDS = 12
NAMES = ["settle"] * 3 + ["approach", "squeeze"] + ["push"] * 5 + ["stop"] * 2


@pytest.fixture(scope="module")
def scene():
    block = trimesh.creation.box((0.14, 0.07, 0.02))
    block.apply_translation([0.03, 0.01, 0.0])  # the centre of mass is not the frame's origin
    slab = trimesh.creation.box(bounds=[[-0.5, -0.5, -0.05], [0.5, 0.5, -0.01]])
    return Scene(block, slab, np.eye(4), np.array([0.6, 0.8, 0.0]))


@pytest.fixture(scope="module")
def push(scene):
    hand = shadow_lite()
    return load_push_model(push_model_xml(hand, scene), hand, scene)


@pytest.fixture(scope="module")
def run(push):
    """Records with the hand anywhere and the object on its way; no simulation has to make them."""
    rng = np.random.default_rng(0)
    model, data = push.model, push.data
    qpos, pose = np.zeros((RECORDS, model.nq)), np.zeros((RECORDS, 7))
    for record in range(RECORDS):
        low, high = model.jnt_range[:, 0], model.jnt_range[:, 1]
        for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE):
            qpos[record, model.jnt_qposadr[joint]] = rng.uniform(low[joint], high[joint])
        qpos[record, push.palm_position : push.palm_position + 7] = rng.normal(size=7)
        turned = 0.02 * max(0, record - 2)
        free = push.object_position
        qpos[record, free : free + 3] = 0.008 * max(0, record - 2) * np.array([0.6, 0.8, 0.0]) + [0.0, 0.001, 0.0]
        qpos[record, free + 3 : free + 7] = [np.cos(turned / 2), 0, 0, np.sin(turned / 2)]
        palm = push.palm_position
        qpos[record, palm + 3 : palm + 7] /= np.linalg.norm(qpos[record, palm + 3 : palm + 7])
        data.qpos[:] = qpos[record]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        pose[record] = np.concatenate([data.xipos[push.object_body], qpos[record, free + 3 : free + 7]])
    return PushRun(
        time=0.02 * np.arange(RECORDS),
        phase=np.array([PHASES.index(name) for name in NAMES]),
        qpos=qpos,
        ctrl=np.zeros((RECORDS, model.nu)),
        mocap=np.zeros((RECORDS, 7)),
        object_pose=pose,
        base_pose=np.zeros((RECORDS, 7)),
        hand_object_force=rng.uniform(0, 5, (RECORDS, 2)),
        hand_environment_clearance=rng.uniform(0, 0.05, RECORDS),
        hand_environment_depth=np.zeros(RECORDS),
        diverged_at=-1,
        last_state=np.zeros(1),
        last_step=0,
        seconds=0.0,
    )


def embedded(folder):
    text = (folder / "film.html").read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text)[1])


def test_the_pages_bodies_stand_where_mujoco_has_them(scene, push, run, tmp_path):
    write_film(film_of_trace(scene, push, film_trace(run)), tmp_path, pictures=False)
    data, hand = embedded(tmp_path), push.hand
    links = [name for name, mesh in zip(hand.link_names, hand.link_meshes, strict=True) if len(mesh.faces)]
    assert len(data["configurations"]) == RECORDS
    for record, entry in enumerate(data["configurations"]):
        poses = np.frombuffer(base64.b64decode(entry["poses"]), dtype="<f4").reshape(-1, 3, 4)
        push.data.qpos[:] = run.qpos[record]
        mujoco.mj_kinematics(push.model, push.data)
        for pose, body in zip(poses, [OBJECT, None, *links], strict=True):
            there = push.data.body(body) if body else None
            rotation = there.xmat.reshape(3, 3) if there else np.eye(3)
            np.testing.assert_allclose(pose[:, :3], rotation, atol=2e-6)
            np.testing.assert_allclose(pose[:, 3], there.xpos if there else 0.0, atol=2e-6)
    assert not (tmp_path / "film.gif").exists()


def test_the_curves_are_those_of_the_verdict(scene, push, run):
    film = film_of_trace(scene, push, film_trace(run))
    verdict = judge_push(run, motion=scene.motion, length=0.1)
    along, up = film.charts["object's way"]
    (turned,) = film.charts["object's turn"]
    assert along.values[-1] == pytest.approx(1e3 * verdict.advanced, abs=1e-6)
    assert np.abs(up.values).max() < 1e-6
    assert turned.values.max() == pytest.approx(verdict.turned_deg, abs=1e-6)
    assert along.values[:3] == pytest.approx(0.0, abs=1e-9)
    normal, tangential = film.charts["hand on object"]
    np.testing.assert_array_equal(np.stack([normal.values, tangential.values], axis=1), run.hand_object_force)
    (clearance,) = film.charts["hand to surroundings"]
    np.testing.assert_array_equal(clearance.values, 1e3 * run.hand_environment_clearance)


def test_a_longer_trace_with_its_own_phases_is_read_and_shown(scene, push, run, tmp_path):
    phase = np.array([*NAMES[:6], "release", "regrasp", "lift", "lift", "hold", "hold"])
    kept = {name: getattr(run, name) for name in ("time", "qpos", "hand_object_force", "hand_environment_clearance")}
    np.savez(tmp_path / "trace.npz", phase=phase, **kept)
    film = film_of_trace(scene, push, read_trace(tmp_path / "trace.npz"))
    assert film.phase == tuple(phase.tolist())
    assert [bool(np.any(frame.motion)) for frame in film.frames] == [True] * 6 + [False] * 6


def test_a_trace_without_phases_is_read(run, tmp_path):
    kept = {name: getattr(run, name) for name in ("time", "qpos", "hand_object_force", "hand_environment_clearance")}
    np.savez(tmp_path / "trace.npz", **kept)
    assert read_trace(tmp_path / "trace.npz").phase == ("",) * RECORDS


def test_a_damaged_trace_is_refused(run, tmp_path):
    path = tmp_path / "trace.npz"
    with pytest.raises(InputError, match="cannot be read"):
        read_trace(path)
    np.savez(path, time=run.time)
    with pytest.raises(InputError, match="expected the arrays time, qpos, hand_object_force"):
        read_trace(path)
    np.savez(path, time=run.time[:3], qpos=run.qpos, hand_object_force=run.hand_object_force)
    with pytest.raises(InputError, match="with one row for each record"):
        read_trace(path)
