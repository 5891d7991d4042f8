"""Plans in physics: joints follow them, pads carry a block, and who reads the files alone gets the same."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dexnudge.cli.main import main
from dexnudge.planning.outcomes import Outcome
from dexnudge.trajectories.plan_episode import execute_plan
from dexnudge.trajectories.plan_folder import load_plan


@pytest.fixture(scope="module")
def episode(block_plan):
    return execute_plan(block_plan)


def test_a_block_is_carried_along_by_motors_alone(episode, block_press):
    assert episode.outcome is Outcome.SUCCESS
    assert episode.length_reached == pytest.approx(0.05, abs=0.002)
    assert episode.model.simulation.model.nmocap == 0
    assert not episode.model.simulation.data.xfrc_applied.any()
    trace = episode.trace
    steady = (trace.time > 1.0) & (trace.time < 2.2)
    normal = block_press.link_force["pad0"]
    pads = [episode.plan.robot.body.link_names.index(name) for name in ("pad0", "pad1")]
    np.testing.assert_allclose(trace.link_force[steady][:, pads], normal, rtol=0.1)
    assert trace.hand_object_force[trace.phase == "contact"].max() == 0.0
    assert trace.hand_object_force[-1, 0] == 0.0


def test_the_film_says_what_came_of_it(episode):
    film = episode.recording()
    assert film.success is True
    assert film.subtitle == "success; 50.0 mm, 50 asked"
    assert film.frames[0].arrow_length == pytest.approx(0.05)


def test_joints_follow_the_plan(episode):
    trace = episode.trace
    assert np.abs(trace.tracking_error[:, :2]).max() < 2e-4  # [m] of the slides
    free = trace.time < 0.2  # the pads close by 20 mrad; friction in their joints would keep them 4 mrad behind
    assert np.abs(trace.tracking_error[free, 2:]).max() < 1.5e-3
    assert np.abs(trace.velocity[free, 2:]).max() > 0.15
    assert trace.palm_error[:, 0].max() < 2e-4
    assert abs(episode.delay) < 0.004
    assert trace.torque_share.max() < 1.0


def test_without_efforts_the_block_stays_behind(block_plan):
    trajectory = replace(block_plan.trajectory, effort=np.zeros_like(block_plan.trajectory.effort))
    episode = execute_plan(replace(block_plan, trajectory=trajectory))
    assert episode.outcome is Outcome.FELL_SHORT
    assert episode.length_reached < 0.02


def test_a_block_that_is_dragged_back_as_the_hand_withdraws_fell_short(block_plan):
    trajectory = block_plan.trajectory
    position, effort = trajectory.position.copy(), trajectory.effort.copy()
    position[5], effort[5] = position[3], effort[3]  # the retreat goes back with the block in its grip
    position[6, :2] = 0.0
    time = trajectory.time + np.array([0, 0, 0, 0, 0, 1.5, 1.5])
    phases = (*block_plan.phases[:-1], replace(block_plan.phases[-1], end=time[-1]))
    moved = replace(trajectory, time=time, position=position, effort=effort)
    assert execute_plan(replace(block_plan, trajectory=moved, phases=phases)).outcome is Outcome.FELL_SHORT


def test_what_is_saved_opens_in_mujoco_and_holds_the_records(episode, tmp_path):
    folder = episode.save(tmp_path / "played", pictures=False)
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    assert model.nkey >= 10
    with np.load(folder / "episode.npz", allow_pickle=False) as saved:
        assert saved["joint_names"].tolist() == ["along", "up", "slide0", "slide1"]
        np.testing.assert_array_equal(saved["qpos"], episode.trace.qpos)
        np.testing.assert_allclose(saved["qpos"][-1], model.key_qpos[-1], atol=1e-8)
    assert (folder / "film.html").is_file()


def test_a_lift_is_judged_as_a_lift(lift_plan):
    episode = execute_plan(lift_plan)
    assert episode.outcome is Outcome.SUCCESS
    assert episode.lift.raised == pytest.approx(0.1, abs=0.005)
    assert episode.summary()["lift"]["least_held"] == pytest.approx(0.1, abs=0.005)
    effort = lift_plan.trajectory.effort.copy()
    effort[-3:] = 0.0
    weak = execute_plan(replace(lift_plan, trajectory=replace(lift_plan.trajectory, effort=effort)))
    assert weak.outcome is Outcome.SLIPPED
    assert weak.verdict.success


@pytest.fixture(scope="module")
def saved(block_plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans") / "PLAN"
    block_plan.save(folder, pictures=False)
    return folder


def replayed(folder, monkeypatch):
    """Play a plan as docs/plan_format.md shows it, without dexnudge."""
    page = Path(__file__).parents[2] / "docs/plan_format.md"
    code = re.search(r"## With MuJoCo.*?```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)[1]
    assert "dexnudge" not in code
    monkeypatch.chdir(folder.parent)
    found = {}
    exec(compile(code, str(page), "exec"), found)  # noqa: S102 - our own page
    return np.array(found["data"].joint("pushed object").qpos)


def test_the_world_starts_where_the_plan_does(saved):
    plan = json.loads((saved / "plan.json").read_text(encoding="utf-8"))
    model = mujoco.MjModel.from_xml_path(str(saved / "robot/world.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    assert [data.joint(name).qpos[0] for name in plan["joint_names"]] == plan["position"][0]


def test_who_reads_plan_json_and_world_xml_alone_moves_the_object_alike(saved, monkeypatch):
    episode = load_plan(saved).execute()
    assert episode.length_reached == pytest.approx(0.05, abs=0.002)
    place = replayed(saved, monkeypatch)
    np.testing.assert_allclose(place, episode.trace.qpos[-1][-7:], atol=1e-4)


def test_the_command_plays_a_plan_and_exits_3_where_the_object_stays(saved, tmp_path, capsys):
    out, folder = tmp_path / "played", Path(shutil.copytree(saved, tmp_path / "PLAN"))
    (folder / "robot/world.xml").write_text('<mujoco><include file="/etc/passwd"/></mujoco>')  # for others: never read
    assert main(["execute", str(folder), "--out", str(out), "--films", "0"]) == 0
    shown = capsys.readouterr().out
    assert "success: moved 50.0 mm, 50 asked, orientation off by 0.0 deg, 0.00 mm into the surroundings" in shown
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert [phase["name"] for phase in summary["phases"]] == ["pre-contact", "contact", "squeeze", "push", "retreat"]
    assert summary["length_reached"] == pytest.approx(0.05, abs=0.002)
    assert max(phase["arm_error"] for phase in summary["phases"]) < 2e-4
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    (folder / "plan.json").write_text(json.dumps(plan | {"effort": np.zeros_like(plan["effort"]).tolist()}))
    assert main(["execute", str(folder / "plan.json"), "--out", str(tmp_path / "weak"), "--films", "0"]) == 3
    assert "less than 80% of the length asked for" in capsys.readouterr().out


def test_options_of_samples_are_refused_for_a_plan(saved, capsys):
    assert main(["execute", str(saved), "--top", "2"]) == 2
    assert "--top was given with a plan" in capsys.readouterr().err
