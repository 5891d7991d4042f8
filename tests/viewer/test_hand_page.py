"""The 3-D page of a hand: its data, and that its sliders move what the hand's joints move."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dexnudge.hands.closing import closing
from dexnudge.viewer.hand_view import hand_views, write_hand_page

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"q\" 'r' $title"


def data_of(path):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', path.read_text())[1])


@pytest.fixture(scope="module")
def page(toy_hand, tmp_path_factory):
    return write_hand_page(toy_hand(), tmp_path_factory.mktemp("page") / "hand.html")


def test_the_page_loads_nothing_and_names_no_place_of_the_machine(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"https?:|url\(|@import|import\s*\(|fetch\(|XMLHttpRequest|\ssrc=|href=", text)
    assert str(Path.home()) not in text
    assert str(page.parent) not in text


def test_a_hand_alone_hides_nothing_and_is_solid(page):
    assert not any(body["glass"] for body in data_of(page)["bodies"])


def test_each_joint_has_a_slider_between_its_limits_and_each_pose_a_button(page, toy_hand):
    text, hand = page.read_text(encoding="utf-8"), toy_hand()
    sliders = re.findall(r'<span>(\w+)</span><input type="range" min="([-.\d]+)" max="([-.\d]+)"', text)
    assert [name for name, *_ in sliders] == list(hand.joint_names)
    np.testing.assert_allclose([[float(low), float(high)] for _, low, high in sliders], [[-0.3, 1.5]] * 8)
    assert re.findall(r"<button[^>]*>(\w+)<", text) == ["rest", "open", "closed"]
    found = closing(hand)
    np.testing.assert_allclose(
        [pose["angles"] for pose in data_of(page)["poses"]], [found.rest, found.open, found.closed]
    )


def test_the_tree_in_the_page_places_links_as_the_hand_does(tmp_path, toy_hand, toy_gripper):
    sliding = replace(toy_gripper, joints=(None, *(replace(joint, slides=True) for joint in toy_gripper.joints[1:])))
    for hand in (toy_hand(size=1.3, mirrored=True), sliding):
        angles = np.linspace(0.3, -0.2, hand.num_joints)
        (view,) = hand_views(hand, [angles])
        data = data_of(write_hand_page(hand, tmp_path / f"{hand.name}.html"))
        assert [joint["slides"] for joint in data["joints"]] == hand.sliding.tolist()
        links = []
        for link in data["links"]:
            if link["parent"] < 0:
                links.append(pose(data["root"]))
                continue
            by, axis = link["multiplier"] * angles[link["index"]] + link["offset"], np.asarray(link["axis"])
            moved = np.eye(4)
            if link["slides"]:
                moved[:3, 3] = by * axis
            else:
                moved[:3, :3] = Rotation.from_rotvec(by * axis).as_matrix()
            links.append(links[link["parent"]] @ pose(link["origin"]) @ moved)
        for part, link in zip(view.parts, data["body_links"], strict=True):
            np.testing.assert_allclose(np.eye(4) if link is None else links[link], part.T_world_part, atol=1e-12)
        assert data["body_links"].count(None) == 1  # the arrow


def test_bodies_have_the_colours_of_the_legend(page, toy_hand):
    (view,) = hand_views(toy_hand(), [np.zeros(8)])
    assert [body["colour"] for body in data_of(page)["bodies"]] == [list(part.colour) for part in view.parts]
    for digit in toy_hand().fingertips:
        assert f"</i>{digit}</span>" in page.read_text(encoding="utf-8")


def test_hostile_names_are_shown_and_not_run(tmp_path, toy_gripper):
    hostile = replace(
        toy_gripper,
        name=HOSTILE,
        joint_names=(HOSTILE, "other"),
        link_names=(HOSTILE, "jaw0", "jaw1"),
        fingertips={HOSTILE: "jaw0", "other": "jaw1"},
    )
    text = write_hand_page(hostile, tmp_path / "hand.html").read_text(encoding="utf-8")
    assert text.count("<script") == 2
    assert "<img" not in text


def pose(rows):
    return np.vstack([np.reshape(rows, (3, 4)), [0, 0, 0, 1]])
