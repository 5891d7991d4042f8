from dataclasses import replace

import numpy as np
import pytest

from dexnudge.errors import InputError
from dexnudge.viewer.page import phase_spans
from dexnudge.viewer.recording import Curve, recording_camera


def test_moments_are_spaced_evenly_in_time(recording):
    np.testing.assert_allclose(recording.time[recording.evenly(5)], [0.0, 0.5, 1.0, 1.5, 2.0], atol=1e-9)
    assert recording.evenly(1000).tolist() == list(range(41))


def test_eventful_moments_are_spaced_evenly_along_the_way(recording):
    chosen = recording.eventful(6)
    assert (chosen[0], chosen[-1]) == (0, 40)
    slid = [recording.frames[index].with_role("object")[0].T_world_part[0, 3] for index in chosen[1:]]
    np.testing.assert_allclose(slid, [0.02, 0.04, 0.06, 0.08, 0.10], atol=0.005)


def test_a_part_keeps_what_belongs_together(recording):
    some = recording.part(np.array([3, 30]))
    assert some.time.tolist() == recording.time[[3, 30]].tolist()
    assert some.phase == ["wait", "push"]
    assert [curve.values[1] for curve in some.charts["way"]] == pytest.approx([50.0, -1e-9])
    assert some.frames[1] is recording.frames[30]
    assert some.caption(1) == "1.50 s  push"


def test_phases_follow_each_other_without_a_gap(recording):
    assert phase_spans(recording) == [("wait", 0.0, pytest.approx(1.0)), ("push", pytest.approx(1.0), 2.0)]


@pytest.mark.parametrize("near", [False, True])
def test_the_camera_sees_object_fingertip_and_goal_at_every_moment(recording, near):
    camera = recording_camera(recording, aspect=4 / 3, near=near)
    goal = recording.frames[0].vertices("object") + np.array([0.1, 0.0, 0.0])
    for frame in recording.frames:
        points = np.concatenate([goal, *(part.vertices_in_world() for part in frame.with_role("object", "fingertip"))])
        local = (points - camera.position) @ np.stack([camera.right, camera.up, camera.forward]).T
        assert (np.abs(local[:, 0]) <= camera.tan_width * local[:, 2]).all()
        assert (np.abs(local[:, 1]) <= camera.tan_height * local[:, 2]).all()


def test_what_does_not_fit_together_is_refused(recording):
    with pytest.raises(InputError, match="a recording of 41 frames has 40 entries of time"):
        replace(recording, time=recording.time[:40])
    with pytest.raises(InputError, match="has 2 entries of short"):
        replace(recording, charts={"one": (Curve("short", "mm", np.zeros(2)),)})
    with pytest.raises(InputError, match="a recording of 0 frames has 0 entries"):
        replace(recording, frames=[], time=np.zeros(0), phase=[], charts={})
