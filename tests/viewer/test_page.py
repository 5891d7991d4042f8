import base64
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError, OutputError
from dexnudge.scenes.scene import Scene
from dexnudge.viewer.page import Figures, write_page
from dexnudge.viewer.visual_scene import Part, VisualScene, visual_scenes

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"q\" 'r' $title"


class Parsed(HTMLParser):
    """Rows of the table as texts, the scripts, and every tag with its attributes."""

    def __init__(self, path):
        super().__init__()
        self.rows, self.scripts, self.tags, self.texts, self.open = [], [], [], {}, []
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag == "td":
            self.rows[-1].append("")
        elif tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        if "script" in self.open:
            self.scripts[-1] += data
        elif "td" in self.open:
            self.rows[-1][-1] += data
        elif self.open:
            self.texts[self.open[-1]] = self.texts.get(self.open[-1], "") + data

    @property
    def data(self):
        return json.loads(self.scripts[0])


@pytest.fixture(scope="module")
def shown(shadow_hand):
    hand = shadow_hand
    slab = trimesh.creation.box((1.0, 1.0, 0.02), transform=trimesh.transformations.translation_matrix([0, 0, -0.02]))
    scene = Scene(trimesh.creation.box((0.15, 0.07, 0.02)), slab, np.eye(4), np.array([1.0, 0, 0]))
    rng = np.random.default_rng(0)
    q = np.concatenate([rng.normal(size=(32, 9)), rng.uniform(hand.lower, hand.upper, (32, hand.num_joints))], axis=1)
    return visual_scenes(scene, hand, q, contacts=[np.full((index % 3, 3), 0.01 * index) for index in range(32)])


@pytest.fixture(scope="module")
def figures():
    return [
        Figures(
            success=index % 3 == 1,
            values={
                "penetration_object": 1e-5 * index,
                "penetration_environment": 2e-5 * index,
                "penetration_self": 3e-5 * index,
                "force_margin": float("nan") if index == 5 else 3 - 0.05 * index,
            },
            contact_links=("ffdistal", "thdistal")[: index % 3],
            reason="" if index % 3 == 1 else f"reason {index}",
        )
        for index in range(32)
    ]


@pytest.fixture(scope="module")
def page(shown, figures, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "view.html"
    return Parsed(write_page(shown, path, title="phone, table", figures=figures))


def test_page_loads_nothing_from_anywhere(page):
    assert not re.search(r"https?:|//[a-z]+\.|url\(|@import|import\s*\(|fetch\(|XMLHttpRequest", page.text)
    for tag, attributes in page.tags:
        assert not {"src", "href", "srcset", "data", "action"} & set(attributes), tag
    policy = next(
        attributes
        for tag, attributes in page.tags
        if tag == "meta" and "content" in attributes and "http-equiv" in attributes
    )
    assert policy["content"].startswith("default-src 'none'")


def test_table_holds_the_numbers_verified_ones_first(page, figures):
    rows = page.rows[1:]
    expected = [index for index in range(32) if figures[index].success] + [
        i for i in range(32) if not figures[i].success
    ]
    assert [int(row[0]) for row in rows] == expected
    for row in rows:
        own = figures[int(row[0])]
        assert row[1] == ("verified" if own.success else own.reason)
        millimetres = [1e3 * depth for depth in list(own.values.values())[:3]]
        np.testing.assert_allclose([float(cell) for cell in row[2:5]], millimetres, atol=0.005 + 1e-9)
        margin = own.values["force_margin"]
        assert row[5] == ("–" if np.isnan(margin) else f"{margin:.2f}")
        assert row[6] == ", ".join(own.contact_links)


def test_poses_and_contacts_are_those_of_the_configurations(page, shown):
    data, rows = page.data, page.rows[1:]
    assert len(data["configurations"]) == len(rows) == 32
    for entry, row in zip(data["configurations"], rows, strict=True):
        own = shown[int(row[0])]
        poses = np.frombuffer(base64.b64decode(entry["poses"]), dtype="<f4").reshape(-1, 3, 4)
        np.testing.assert_allclose(poses, [part.T_world_part[:3] for part in own.parts], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(np.reshape(entry["contacts"], (-1, 3)), own.contacts, atol=1e-5)
    assert [body["role"] for body in data["bodies"]] == [part.role for part in shown[0].parts]


def test_the_forearm_alone_may_be_glass(page, shown, shadow_hand):
    glass = [part.name for part, body in zip(shown[0].parts, page.data["bodies"], strict=True) if body["glass"]]
    assert glass == [shadow_hand.base_link]


def test_meshes_are_stored_once_and_the_page_is_small(page, shown, figures, tmp_path):
    assert len(page.text) < 2e6
    alone = write_page(shown[:1], tmp_path / "one.html", title="one", figures=figures[:1]).stat().st_size
    assert (len(page.text) - alone) / 31 < 4000  # bytes for each further configuration


def test_hostile_names_are_shown_and_not_run(shown, figures, tmp_path):
    own = Figures(False, {HOSTILE: 1.0}, (HOSTILE,), HOSTILE)
    parts = (Part(HOSTILE, "object", trimesh.creation.box((0.1, 0.1, 0.1)), np.eye(4)),)
    hostile = VisualScene(parts, np.zeros((0, 3)), np.array([1.0, 0, 0]))
    page = Parsed(write_page([hostile], tmp_path / "x.html", title=HOSTILE, figures=[own]))
    assert page.texts["title"].strip() == HOSTILE
    assert page.texts["h1"].strip() == HOSTILE
    assert page.rows[1][1] == page.rows[1][3] == HOSTILE
    assert page.texts["th"].count(HOSTILE) == 1
    assert len(page.scripts) == 2
    assert not any(tag == "img" for tag, _ in page.tags)
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)


def test_a_criterion_of_ones_own_is_a_column(shown, tmp_path):
    figures = [Figures(True, {"force_margin": 2.0, "room_behind_palm": 0.01234}), Figures(False, {"force_margin": 1.0})]
    page = Parsed(write_page(shown[:2], tmp_path / "own.html", title="own", figures=figures))
    assert "room behind palm" in page.texts["th"]
    assert [row[2:4] for row in page.rows[1:]] == [["2.00", "0.01234"], ["1.00", "–"]]


def test_percentages_have_no_decimals(shown, tmp_path):
    figures = [Figures(True, {"probability": p, "share_of_worlds": 0.52}) for p in (0.923, 0.985, 0.01)]
    page = Parsed(write_page(shown[:3], tmp_path / "percent.html", title="percent", figures=figures))
    heads = (tmp_path / "percent.html").read_text()
    assert "<th>probability<br>%</th>" in heads  # as everywhere else
    assert "verdict or<br>first reason</th>" in heads
    assert [row[2:4] for row in page.rows[1:]] == [["90", "52"], [">95", "52"], ["<5", "52"]]


def test_only_the_first_of_very_many_are_shown(shown, figures, tmp_path):
    page = Parsed(write_page(shown * 20, tmp_path / "many.html", title="many", figures=figures * 20))
    assert len(page.rows) - 1 == len(page.data["configurations"]) == 500
    assert "The first 500 of 640 are shown." in page.text


def test_what_does_not_fit_together_is_refused(shown, figures, tmp_path):
    path = tmp_path / "view.html"
    with pytest.raises(InputError, match="a page of no configurations"):
        write_page([], path, title="", figures=[])
    with pytest.raises(InputError, match="figures of 1 configurations were given for 2"):
        write_page(shown[:2], path, title="", figures=figures[:1])
    other = VisualScene(shown[0].parts[:3], np.zeros((0, 3)), shown[0].motion)
    with pytest.raises(InputError, match="visual scene 1 shows other bodies than scene 0"):
        write_page([shown[0], other], path, title="", figures=figures[:2])
    assert not path.exists()
    with pytest.raises(OutputError, match="cannot write"):
        write_page(shown[:1], tmp_path / "missing" / "view.html", title="", figures=figures[:1])
