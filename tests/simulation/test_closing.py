"""How a hand closes on an object, measured by MuJoCo."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes.families import build_scene
from dexnudge.simulation.model import OBJECT_SIDE, scene_model
from dexnudge.simulation.push_forces import closed_configuration
from dexnudge.verification.verdicts import contacts_of

STORED = json.loads((Path(__file__).parent / "two_segments.json").read_text())


@pytest.fixture(scope="module")
def touching(shadow_hand):
    """A hand that touches with two segments each of two fingers, which cannot all reach, and with its thumb."""
    scene = build_scene(STORED["scene"], builtin_object(STORED["object"]), seed=STORED["seed"])
    q = np.array(STORED["q"])
    (contacts,) = contacts_of(scene, shadow_hand, q[None])
    return scene_model(shadow_hand, scene), q, np.unique(contacts.link).tolist()


def gap(simulation, link):
    """Distance from a link's pieces to the object's [m], negative inside, at most 50 mm."""
    ours = np.flatnonzero(simulation.model.geom_bodyid == simulation.link_body[link])
    theirs = np.flatnonzero(simulation.side == OBJECT_SIDE)
    pairs = [(int(one), int(other)) for one in ours for other in theirs]
    return min(mujoco.mj_geomDistance(simulation.model, simulation.data, *pair, 0.05, None) for pair in pairs)


def test_segments_that_cannot_all_reach_leave_the_other_links_at_the_object(touching):
    simulation, q, links = touching
    names = [simulation.hand.link_names[link] for link in links]
    assert {"ffmiddle", "ffdistal", "mfmiddle", "mfdistal", "thdistal"} <= set(names)
    simulation.place(closed_configuration(simulation, q, links))
    gaps = {name: gap(simulation, link) for name, link in zip(names, links, strict=True)}
    assert max(map(abs, gaps.values())) < 3e-4, gaps


def test_a_link_that_need_not_press_stays_where_it_is(touching):
    simulation, q, links = touching
    thumb = simulation.hand.link_names.index("thdistal")
    closed = closed_configuration(simulation, q, [link for link in links if link != thumb])
    turned = np.abs(closed - q)[9:] @ simulation.angle_of_motor
    motors = [simulation.model.actuator(index).name for index in range(len(turned))]
    np.testing.assert_array_equal([turn for turn, name in zip(turned, motors, strict=True) if "TH" in name], 0.0)
