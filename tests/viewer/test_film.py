from dataclasses import replace

import numpy as np
import pytest

from dexnudge.errors import InputError
from dexnudge.viewer.film_chart import phase_spans
from dexnudge.viewer.recording import Curve, film_camera


def test_moments_are_spaced_evenly_in_time(film):
    np.testing.assert_allclose(film.time[film.evenly(5)], [0.0, 0.5, 1.0, 1.5, 2.0], atol=1e-9)
    assert film.evenly(1000).tolist() == list(range(41))


def test_eventful_moments_are_spaced_evenly_along_the_way(film):
    chosen = film.eventful(6)
    assert (chosen[0], chosen[-1]) == (0, 40)
    slid = [film.frames[index].with_role("object")[0].T_world_part[0, 3] for index in chosen[1:]]
    np.testing.assert_allclose(slid, [0.02, 0.04, 0.06, 0.08, 0.10], atol=0.005)


def test_a_part_keeps_what_belongs_together(film):
    some = film.part(np.array([3, 30]))
    assert some.time.tolist() == film.time[[3, 30]].tolist()
    assert some.phase == ["wait", "push"]
    assert [curve.values[1] for curve in some.charts["way"]] == pytest.approx([50.0, -1e-9])
    assert some.frames[1] is film.frames[30]
    assert some.caption(1) == "1.50 s  push"


def test_phases_follow_each_other_without_a_gap(film):
    assert phase_spans(film) == [("wait", 0.0, pytest.approx(1.0)), ("push", pytest.approx(1.0), 2.0)]


def test_the_camera_sees_object_and_fingertip_at_every_moment(film):
    camera = film_camera(film, aspect=4 / 3)
    for frame in film.frames:
        points = np.concatenate([part.vertices_in_world() for part in frame.with_role("object", "fingertip")])
        local = (points - camera.position) @ np.stack([camera.right, camera.up, camera.forward]).T
        assert (np.abs(local[:, 0]) <= camera.tan_width * local[:, 2]).all()
        assert (np.abs(local[:, 1]) <= camera.tan_height * local[:, 2]).all()


def test_what_does_not_fit_together_is_refused(film):
    with pytest.raises(InputError, match="a film of 41 frames has 40 entries of time"):
        replace(film, time=film.time[:40])
    with pytest.raises(InputError, match="has 2 entries of short"):
        replace(film, charts={"one": (Curve("short", "mm", np.zeros(2)),)})
    with pytest.raises(InputError, match="a film of 0 frames has 0 entries"):
        replace(film, frames=[], time=np.zeros(0), phase=[], charts={})
