"""The film of a plan shows what the plan says: arm and hand by the robot's kinematics, the object carried by the push."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

import dexnudge as dn
from dexnudge.trajectories.interpolation import at
from dexnudge.trajectories.plan_film import ends_of_phases, film_of_plan
from dexnudge.viewer.picture import HEAD_HEIGHT
from dexnudge.viewer.recording import recording_camera


@pytest.fixture(scope="module")
def film(block_plan):
    return film_of_plan(block_plan)


def test_links_and_object_are_where_the_plan_has_them(block_plan, film):
    robot = block_plan.robot
    positions = at(block_plan.trajectory, film.time).position
    poses = robot.body.forward_kinematics(torch.as_tensor(robot.coordinates(positions))).numpy()
    for frame, T_world_links in zip(film.frames, poses, strict=True):
        for part in frame.with_role("arm", "link", "fingertip"):
            index = robot.body.link_names.index(part.name)
            np.testing.assert_allclose(part.T_world_part, T_world_links[index], atol=1e-9)
    assert {part.name for part in film.frames[0].with_role("arm")} == {"stand", "carriage"}
    np.testing.assert_array_equal(film.frames[0].with_role("object")[0].T_world_part, block_plan.scene.T_world_object)


def test_the_object_goes_with_the_palm_in_the_push_and_rests_else(crane_plan):
    film = film_of_plan(crane_plan)
    moved = np.array([frame.with_role("object")[0].T_world_part[0, 3] for frame in film.frames])
    moved -= crane_plan.scene.T_world_object[0, 3]
    names = np.array(film.phase)
    np.testing.assert_allclose(moved[names == "pre-contact"], 0.0, atol=1e-12)
    np.testing.assert_allclose(moved[names == "retreat"], 0.05, atol=1e-12)
    assert (np.diff(moved[names == "push"]) >= -1e-12).all()


def test_the_object_keeps_its_place_before_the_palm_while_it_is_pushed(block_plan):
    T_end = block_plan.scene.T_world_object.copy()
    T_end[0, 3] += block_plan.length
    phases = tuple(
        replace(phase, T_world_object=T_end) if phase.name in ("push", "retreat") else phase
        for phase in block_plan.phases
    )
    plan = replace(block_plan, phases=phases)
    film = film_of_plan(plan)
    palm = plan.robot.palm_poses(at(plan.trajectory, film.time).position)[:, 0, 3]
    block = np.array([frame.with_role("object")[0].T_world_part[0, 3] for frame in film.frames])
    pushing = np.array(film.phase) == "push"
    np.testing.assert_allclose(np.ptp((block - palm)[pushing]), 0.0, atol=1e-9)


def test_the_film_says_what_is_planned_and_its_arrow_how_far(block_plan, film):
    assert film.subtitle.endswith(f": 50 mm in {block_plan.trajectory.duration:.1f} s")
    pushing = next(index for index, name in enumerate(film.phase) if name == "push")
    for frame in film.frames[: pushing + 5]:
        along = frame.arrow().mesh.vertices[:, 0]
        leading = block_plan.scene.object_in_world().bounds[1, 0]
        assert (along.min(), along.max()) == pytest.approx((leading, leading + 0.05), abs=0.005)


def test_the_charts_are_shares_of_the_limits_and_the_palms_speed(block_plan, film):
    arm, hand = film.charts["fastest joint, of its limit"]
    joints = at(block_plan.trajectory, film.time)
    share = 100 * np.abs(joints.velocity) / block_plan.robot.limits.velocity
    np.testing.assert_allclose(arm.values, share[:, :2].max(axis=1))
    np.testing.assert_allclose(hand.values, share[:, 2:].max(axis=1))
    (speed,) = film.charts["palm's speed"]
    # The palm is carried by the slides alone: its speed is theirs, at rest 0.
    slides = 1e3 * np.linalg.norm(joints.velocity[:, :2], axis=1)
    np.testing.assert_allclose(speed.values, slides, rtol=1e-6, atol=1e-6)
    assert speed.values[0] == speed.values[-1] == 0.0
    loaded = film.charts["torque that presses, of its limit"][1].values
    assert loaded[0] == loaded[-1] == 0.0
    assert loaded[np.searchsorted(film.time, 1.5)] > 1.0


def test_the_strip_has_the_end_of_each_phase_and_the_camera_the_whole_arm(block_plan, film):
    ends = ends_of_phases(block_plan, film)
    np.testing.assert_allclose(film.time[ends], [phase.end for phase in block_plan.phases])
    assert [film.phase[index] for index in ends] == [phase.name for phase in block_plan.phases]
    camera = recording_camera(film, aspect=4 / 3)
    points = np.concatenate([frame.vertices("object", "arm", "link", "fingertip") for frame in film.frames])
    local = (points - camera.position) @ np.stack([camera.right, camera.up, camera.forward]).T
    assert (local[:, 2] > 0).all()
    assert (np.abs(local[:, :2] / local[:, 2:]) < [camera.tan_width, camera.tan_height]).all()
    near = recording_camera(film, aspect=4 / 3, near=True)
    assert np.linalg.norm(near.position - camera.position) > 0.05
    assert (near.azimuth, near.elevation) == pytest.approx((camera.azimuth, camera.elevation))


def test_a_plan_is_saved_with_its_page_and_on_request_with_pictures(block_plan, tmp_path):
    block_plan.save(tmp_path / "plain", pictures=False)
    assert (tmp_path / "plain" / "plan.html").is_file()
    assert not (tmp_path / "plain" / "plan.gif").exists()
    text = (tmp_path / "plain" / "plan.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text)[1])
    assert data["time"][-1] == pytest.approx(block_plan.trajectory.duration)
    arms = [index for index, body in enumerate(data["bodies"]) if body["role"] == "arm"]
    poses = [
        np.frombuffer(base64.b64decode(each["poses"]), dtype="<f4").reshape(-1, 3, 4)[arms[-1]]
        for each in data["configurations"]
    ]
    assert np.ptp([pose[0, 3] for pose in poses]) == pytest.approx(block_plan.length, abs=1e-4)
    assert list(dict.fromkeys(data["phase"])) == [phase.name for phase in block_plan.phases]


def test_a_film_is_a_strip_an_animation_or_a_page(block_plan, size_of_films, tmp_path, monkeypatch):
    monkeypatch.setattr("dexnudge.viewer.recording.TILE", size_of_films)
    with Image.open(block_plan.film(tmp_path / "plan.png")) as strip:
        width, height = strip.size
    phases = len(block_plan.phases)
    assert (width, height) == (phases * 480 + (phases - 1) * 6, HEAD_HEIGHT + 2 * 320 + 6)
    with pytest.raises(dn.InputError, match=r"expected a name that ends in \.gif, \.png, \.html"):
        block_plan.film(tmp_path / "plan.mp4")
