"""Small descriptions with elements, attributes or lines changed at random: a hand, or one message, never a traceback."""

import copy
import random
from xml.etree import ElementTree

import pytest

from dexnudge.errors import DexnudgeError
from dexnudge.hands.registry import load_hand

DRAWS = {"urdf": 60, "yaml": 60, "mjcf": 20}  # hundreds of each found nothing that these do not
VALUES = (
    "", "0", "-1", "nan", "inf", "1e300", "-1e300", "1e400", "abc", "0 0 0", "1 2", "palm", "crank", "true", "\u00e9",
    "a" * 300, "1e-300", "1 1 1 1", "mesh", "../x", "100000000", "prismatic", "floating", "sphere", "hinge", "ball",
    "-0.001 0.001 0.001",
)  # fmt: skip
WORDS = (*VALUES, "null", "[1]", "{a: 1}", "~", "2020-01-01", "!!python/object:x", "&a", "*a", "0x1f", "[", "- - -")
MODEL = """<mujoco><asset><mesh name="wedge" file="wedge.stl" scale="0.001 0.001 0.001"/></asset>
  <worldbody><body name="palm">
  <geom type="mesh" mesh="wedge"/>
  <body name="crank" pos="0 0 .05"><joint name="crank" axis="0 1 0" range="-10 60"/>
    <geom type="capsule" fromto="0 0 0 0 0 .04" size=".004"/>
    <body name="coupler" pos="0 0 .04"><joint name="coupler" axis="0 1 0" range="-90 90"/>
      <geom type="box" size=".01 .004 .004"/><site name="a" pos=".02 0 0"/></body></body>
  <body name="rocker" pos=".02 0 .05"><joint name="rocker" axis="0 1 0" range="-90 90"/>
    <geom type="capsule" fromto="0 0 0 0 0 .04" size=".004"/><site name="b" pos="0 0 .04"/>
    <body name="tip" pos="0 0 .05"><joint name="tip" type="slide" range="0 .01"/>
      <geom type="sphere" size=".005"/></body></body>
  </body></worldbody><equality><connect site1="a" site2="b"/>
  <joint joint1="tip" joint2="crank" polycoef="0 .01 0 0 0"/></equality>
  <tendon><fixed name="t"><joint joint="crank" coef="1"/><joint joint="tip" coef="1"/></fixed></tendon>
  <actuator><position name="m" tendon="t"/></actuator></mujoco>"""
CONFIG = "palm: palm\nfingertips: {a: tip, b: coupler}\npalm_normal: [0, 1, 0]\n"


def mutated_xml(text: str, rng: random.Random) -> str:
    root = ElementTree.fromstring(text)  # noqa: S314 - our own
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        elements = list(root.iter())
        above = {child: parent for parent in elements for child in parent}
        element, other, change = rng.choice(elements), rng.choice(elements), rng.randrange(6)
        key = rng.choice([*element.attrib, "extra"])
        if change == 0 and element in above:
            above[element].remove(element)
        elif change == 1 and element in above:
            above[element].append(copy.deepcopy(element))
        elif change == 2:
            element.attrib.pop(key, None)
        elif change == 3 and other.attrib:
            element.attrib[key] = rng.choice(list(other.attrib.values()))
        else:
            element.attrib[key] = rng.choice(VALUES)
    return ElementTree.tostring(root, encoding="unicode")


def mutated_lines(text: str, rng: random.Random) -> str:
    lines = text.splitlines()
    for _ in range(rng.choice([1, 2, 3])):
        number = rng.randrange(len(lines))
        words = lines[number].split(" ")
        words[rng.randrange(len(words))] = rng.choice(WORDS)
        lines[number] = rng.choice([" ".join(words), lines[number][: rng.randrange(len(lines[number]) + 1)]])
        lines.insert(rng.randrange(len(lines)), lines.pop())
    return "\n".join(lines)


@pytest.mark.parametrize("kind", ["urdf", "yaml", "mjcf"])
def test_a_hand_or_a_message(write_hand, kind):
    path = write_hand()
    urdf, config = path.read_text(), (path.parent / "hand.yaml").read_text()
    model = path.with_name("model.xml")
    model.with_suffix(".yaml").write_text(CONFIG)
    read = refused = 0
    for seed in range(DRAWS[kind]):
        rng = random.Random(seed)
        if kind == "urdf":
            path.write_text(mutated_xml(urdf, rng))
        elif kind == "yaml":
            (path.parent / "hand.yaml").write_text(mutated_lines(config, rng))
        else:
            model.write_text(mutated_xml(MODEL, rng))
        try:
            hand = load_hand(model if kind == "mjcf" else path)
            assert hand.num_joints > 0
            read += 1
        except DexnudgeError:
            refused += 1
    assert read > 0
    assert refused > 0
