"""How a hand closes on an object, measured by MuJoCo."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dexnudge.hands.registry import load_hand
from dexnudge.objects.builtin import builtin_object
from dexnudge.scenes import build_scene
from dexnudge.simulation.push_forces import closed_configuration
from dexnudge.simulation.push_model import OBJECT_SIDE, load_push_model, push_model_xml
from dexnudge.verification.verdicts import contacts_of

STORED = json.loads((Path(__file__).parent / "two_segments.json").read_text())


@pytest.fixture(scope="module")
def touching():
    """A hand that touches with two segments each of two fingers, which cannot all reach, and with its thumb."""
    hand = load_hand("shadow_lite")
    scene = build_scene(STORED["scene"], builtin_object(STORED["object"]), seed=STORED["seed"])
    q = np.array(STORED["q"])
    (contacts,) = contacts_of(scene, hand, q[None])
    return load_push_model(push_model_xml(hand, scene), hand, scene), q, np.unique(contacts.link).tolist()


def gap(push, link):
    """Distance from a link's pieces to the object's [m], negative inside, at most 50 mm."""
    ours = np.flatnonzero(push.model.geom_bodyid == push.indices.link_body[link])
    theirs = np.flatnonzero(push.side == OBJECT_SIDE)
    pairs = [(int(one), int(other)) for one in ours for other in theirs]
    return min(mujoco.mj_geomDistance(push.model, push.data, *pair, 0.05, None) for pair in pairs)


def test_segments_that_cannot_all_reach_leave_the_other_links_at_the_object(touching):
    push, q, links = touching
    names = [push.hand.link_names[link] for link in links]
    assert {"ffmiddle", "ffdistal", "mfmiddle", "mfdistal", "thdistal"} <= set(names)
    push.place(closed_configuration(push, q, links))
    gaps = {name: gap(push, link) for name, link in zip(names, links, strict=True)}
    assert max(map(abs, gaps.values())) < 3e-4, gaps


def test_a_link_that_need_not_press_stays_where_it_is(touching):
    push, q, links = touching
    thumb = push.hand.link_names.index("thdistal")
    closed = closed_configuration(push, q, [link for link in links if link != thumb])
    turned = np.abs(closed - q)[9:] @ push.indices.angle_of_motor
    motors = [push.model.actuator(index).name for index in range(len(turned))]
    np.testing.assert_array_equal([turn for turn, name in zip(turned, motors, strict=True) if "TH" in name], 0.0)
