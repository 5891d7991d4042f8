"""Hostile descriptions: hands as URDF, MJCF and xacro, and the YAML beside them."""

from __future__ import annotations

import random
import re
from functools import cache
from typing import Any

import trimesh

from hostile.case import CONTROL, MARKUP, Content, Draw, Hole, Hostile, Link, Pipe
from hostile.mutations import NAMES, NUMBERS, damaged_bytes, damaged_xml

WORDS = ("palm", "tip", "a1", "prismatic", "floating", "continuous", "planar", "sphere", "hinge", "ball", "free", "mesh",
         "0 0 0", "1 2", "1 1 1 1", "-0.001 0.001 0.001", "tip.stl", "package://hand/tip.stl", "100000000")  # fmt: skip
YAML_WORDS = (*NUMBERS, *NAMES, "null", "[1]", "{a: 1}", "~", "2020-01-01", "!!python/object/apply:os.system [ls]", "&a", "*a",
              "0x1f", "[", "- - -", "? ?", "|", ">-", "%YAML 9.9", "!!binary aGk=", "12:30:45", "<<: *a", ".nan", ".inf",
              "true", "---", "...")  # fmt: skip


def link(name: str, size: str, at: str) -> str:
    """Return a link of a box."""
    shape = f'<origin xyz="{at}"/><geometry><box size="{size}"/></geometry>'
    return f'<link name="{name}"><collision>{shape}</collision></link>'


def joint(name: str, parent: str, child: str, at: str, inside: str = "", kind: str = "revolute") -> str:
    """Return a joint with limits."""
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/><axis xyz="1 0 0"/>'
    return f'<joint name="{name}" type="{kind}">{ends}<limit lower="-0.3" upper="1.3" velocity="2" effort="5"/>{inside}</joint>'


def urdf(*further: str, name: str = "hand") -> str:
    """Return two fingers and a thumb on a palm, the second finger by <mimic>, a mesh at a tip."""
    mesh = '<collision><origin xyz="0 0 0.017"/><geometry><mesh filename="meshes/tip.stl" scale="0.001 0.001 0.001"/>'
    parts = [link("palm", "0.06 0.075 0.02", "0 -0.0275 -0.012")]
    for digit, at in (("a", "0.012 0 0"), ("b", "-0.012 0 0"), ("t", "0 -0.055 0")):
        mimic = '<mimic joint="a2" multiplier="1" offset="0"/>' if digit == "b" else ""
        parts += [
            link(f"{digit}near", "0.014 0.014 0.04", "0 0 0.022"),
            joint(f"{digit}2", "palm", f"{digit}near", at, mimic),
        ]
        tip = link(f"{digit}tip", "0.014 0.014 0.03", "0 0 0.017")
        parts += [f'<link name="{digit}tip">{mesh}</geometry></collision></link>' if digit == "t" else tip]
        parts += [joint(f"{digit}1", f"{digit}near", f"{digit}tip", "0 0 0.044")]
    return f'<robot name="{name}">{"".join(parts)}{"".join(further)}</robot>'


YAML = "palm: palm\nfingertips: {A: atip, B: btip, T: ttip}\npalm_normal: [0, -1, 0]\ncouplings: [[a1, a2]]\n"
XACRO = urdf().replace(
    '<robot name="hand">',
    '<robot name="hand" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="w" value="0.01"/>'
    '<xacro:macro name="pad" params="n:=1"><link name="pad${n}"><collision><geometry><box size="${w} 0.01 0.01"/>'
    '</geometry></collision></link><joint name="mount${n}" type="fixed"><parent link="palm"/><child link="pad${n}"/></joint>'
    '</xacro:macro><xacro:pad n="1"/>',
)
MJCF = """<mujoco model="hand"><compiler meshdir="meshes"/>
  <default><geom friction="1 .01 .001"/><default class="far"><joint axis="0 1 0" range="-10 60"/></default></default>
  <asset><mesh name="tip" file="tip.stl" scale="0.001 0.001 0.001"/></asset>
  <worldbody><body name="palm"><geom type="box" size=".03 .03 .01"/>
  <body name="crank" pos="0 0 .05"><joint name="crank" axis="0 1 0" range="-10 60"/>
    <geom type="capsule" fromto="0 0 0 0 0 .04" size=".004"/>
    <body name="coupler" pos="0 0 .04"><joint name="coupler" class="far"/>
      <geom type="mesh" mesh="tip"/><site name="a" pos=".02 0 0"/></body></body>
  <body name="rocker" pos=".02 0 .05"><joint name="rocker" axis="0 1 0" range="-90 90"/>
    <geom type="capsule" fromto="0 0 0 0 0 .04" size=".004"/><site name="b" pos="0 0 .04"/>
    <body name="tip" pos="0 0 .05"><joint name="tip" type="slide" range="0 .01"/>
      <geom type="sphere" size=".005"/></body></body>
  </body></worldbody><equality><connect site1="a" site2="b"/>
  <joint joint1="tip" joint2="crank" polycoef="0 .01 0 0 0"/></equality>
  <tendon><fixed name="t"><joint joint="crank" coef="1"/><joint joint="tip" coef="1"/></fixed></tendon>
  <actuator><position name="m" tendon="t"/></actuator></mujoco>"""
MJCF_YAML = "palm: palm\nfingertips: {a: tip, b: coupler}\npalm_normal: [0, 1, 0]\n"


@cache
def tip() -> bytes:
    """Return the mesh of a fingertip in millimetres."""
    return trimesh.creation.cone(radius=8, height=20).export(file_type="stl")


def hand_files(folder: str) -> dict[str, Content]:
    """Return the files of the hand in a folder."""
    return {
        f"{folder}/hand.urdf": urdf().encode(),
        f"{folder}/hand.yaml": YAML.encode(),
        f"{folder}/meshes/tip.stl": tip(),
    }


@cache
def sphere() -> bytes:
    """Return a mesh as large as one may be, nearly."""
    return trimesh.creation.uv_sphere(radius=8, count=(300, 300)).export(file_type="stl")


def urdf_case(
    name: str, text: str | bytes | Content, expected: Any = "either", says: str = "", **files: Any
) -> Hostile:
    """Return the case of `dexnudge hand` with a URDF and what lies beside it; `yaml`, `mesh` take the place of the valid."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    beside = {"hand.yaml": files.pop("yaml", YAML.encode()), "meshes/tip.stl": files.pop("mesh", tip())}
    beside = {key: value for key, value in beside.items() if value is not None}
    return Hostile("urdf", name, {"hand.urdf": data, **beside}, ("hand", "hand.urdf"), expected, says)


def mjcf_case(name: str, text: str | bytes, expected: Any = "either", says: str = "", **files: Content) -> Hostile:
    """Return the case of `dexnudge hand` with an MJCF."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    beside = {"hand.yaml": MJCF_YAML.encode(), "meshes/tip.stl": tip(), **files}
    return Hostile("mjcf", name, {"hand.xml": data, **beside}, ("hand", "hand.xml"), expected, says)


def xacro_case(name: str, data: bytes, expected: Any = "either") -> Hostile:
    """Return the case of `dexnudge hand` with a xacro file."""
    files = {"hand.urdf.xacro": data, "hand.yaml": YAML.encode(), "meshes/tip.stl": tip()}
    return Hostile("xacro", name, files, ("hand", "hand.urdf.xacro"), expected)


def yaml_case(name: str, text: str | Content, expected: Any = "either", says: str = "") -> Hostile:
    """Return the case of `dexnudge hand` with a YAML beside a valid URDF."""
    data = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    files = {"hand.urdf": urdf().encode(), "hand.yaml": data, "meshes/tip.stl": tip()}
    return Hostile("yaml", name, files, ("hand", "hand.urdf"), expected, says)


def damaged_lines(text: str, rng: random.Random) -> tuple[str, bytes]:
    """Return what was done, and YAML with words, lines or bytes changed."""
    if rng.random() < 0.2:
        return damaged_bytes(text.encode(), rng)
    lines = text.splitlines()
    for _ in range(rng.choice((1, 1, 2, 3))):
        number = rng.randrange(len(lines))
        words = lines[number].split(" ")
        words[rng.randrange(len(words))] = rng.choice(YAML_WORDS)
        lines[number] = rng.choice(
            (" ".join(words), " ".join(words), lines[number][: rng.randrange(len(lines[number]) + 1)])
        )
        if rng.random() < 0.3:
            lines.insert(rng.randrange(len(lines)), lines[number])
    return "words or lines changed", "\n".join(lines).encode("utf-8", "surrogatepass")


def _urdf(rng: random.Random) -> Hostile:
    if rng.random() < 0.1:
        what, data = damaged_bytes(tip(), rng)
        return urdf_case(f"its mesh: {what}", urdf(), mesh=data)
    what, data = damaged_xml(urdf().encode(), rng, WORDS)
    return urdf_case(what, data, yaml=rng.choice((None, YAML.encode())))


def _mjcf(rng: random.Random) -> Hostile:
    what, data = damaged_xml(MJCF.encode(), rng, WORDS)
    return mjcf_case(what, data)


def _yaml(rng: random.Random) -> Hostile:
    return yaml_case(*damaged_lines(YAML, rng))


def _xacro(rng: random.Random) -> Hostile:
    what, data = damaged_bytes(XACRO.encode(), rng)
    return xacro_case(what, data)


def chain(count: int, *, child_first: bool = False, branch: bool = False) -> str:
    """Return so many links below one another, or all below one."""
    links = "".join(f'<link name="x{i}"/>' for i in range(count))
    joints = [joint(f"y{i}", "atip" if branch or i == 0 else f"x{i - 1}", f"x{i}", "0 0 0.01") for i in range(count)]
    return links + "".join(reversed(joints) if child_first else joints)


def _bomb(levels: int) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
    return "\n".join([*lines, f"palm: *a{levels - 1}", "fingertips: {A: atip}", "palm_normal: [0, 0, 1]"])


U = urdf()
PEA = link("x199", "0.01 0.01 0.01", "0 0 0")
LIMIT = '<limit lower="-0.3" upper="1.3" velocity="2" effort="5"/>'
BOX = '<box size="0.06 0.075 0.02"/>'
SHAPE = '<collision><geometry><mesh filename="meshes/tip.stl" scale="0.001 0.001 0.001"/></geometry></collision>'
INCLUDE = '<include file="{}"/></mujoco>'
URDF = {  # what was done: the description, what is expected, and what the message says
    "valid": (U, "accepted", ""),
    "no links": ('<robot name="x"/>', "refused", ""),
    "another root": ("<sdf/>", "refused", "robot"),
    "an entity": ('<!DOCTYPE robot [<!ENTITY a "b">]>' + U, "refused", "DOCTYPE"),
    "entities by doubling": ('<!DOCTYPE r [<!ENTITY a "' + "x" * 9999 + '"><!ENTITY b "&a;&a;">]>' + U, "refused", "DOCTYPE"),
    "UTF-16": (U.encode("utf-16"), "refused", "UTF-8"),
    "elements nested 100,000 deep": (U.replace("</robot>", "<a>" * 100_000 + "</a>" * 100_000 + "</robot>"), "either", ""),
    "an attribute of 5 MB": (U.replace('name="hand"', f'name="{"x" * 5_000_000}"'), "either", ""),
    "11 MB": (U.replace("</robot>", " " * 11_000_000 + "</robot>"), "refused", "too large"),
    "5,000 joints": (urdf(chain(5000)), "refused", ""),
    "5,000 joints, child first": (urdf(chain(5000, child_first=True)), "refused", ""),
    "5,000 joints on one link": (urdf(chain(5000, branch=True)), "refused", ""),
    "200 joints in a row": (urdf(chain(200).replace('<link name="x199"/>', PEA)), "refused", "joints"),
    "200 joints in a row that move nothing": (urdf(chain(200)), "accepted", ""),
    "a cycle": (urdf(joint("back", "atip", "palm", "0 0 0")), "refused", ""),
    "a link below itself": (urdf('<link name="z"/>', joint("self", "z", "z", "0 0 0")), "refused", ""),
    "a link with two parents": (urdf(joint("second", "ttip", "atip", "0 0 0")), "refused", ""),
    "two links of one name": (urdf(link("palm", "1 1 1", "0 0 0")), "refused", "palm"),
    "two joints of one name": (U.replace('"b1"', '"a1"'), "refused", "a1"),
    "a mimic of itself": (U.replace('<mimic joint="a2"', '<mimic joint="b2"'), "refused", "b2"),
    "mimics in a circle": (U.replace(f"{LIMIT}</joint>", f'{LIMIT}<mimic joint="b2"/></joint>', 1), "refused", ""),
    "a mimic of nothing": (U.replace('<mimic joint="a2"', '<mimic joint="nothing"'), "refused", "nothing"),
    "an axis of length 0": (U.replace('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>', 1), "refused", ""),
    "an axis of 1e200": (U.replace('<axis xyz="1 0 0"/>', '<axis xyz="1e200 1e200 0"/>', 1), "accepted", ""),
    "a velocity of -1": (re.sub('velocity="[^"]*"', 'velocity="-1"', U), "refused", "velocity"),
    "an effort of -1": (re.sub('effort="[^"]*"', 'effort="-1"', U), "refused", "effort"),
    "an axis of NaN": (U.replace('<axis xyz="1 0 0"/>', '<axis xyz="nan 0 0"/>', 1), "refused", ""),
    "an axis of two numbers": (U.replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0"/>', 1), "refused", ""),
    "limits of infinity": (U.replace('upper="1.3"', 'upper="inf"', 1), "accepted", ""),
    "limits the wrong way round": (U.replace('upper="1.3"', 'upper="-1.3"', 1), "refused", ""),
    "limits in degrees": (U.replace('upper="1.3"', 'upper="90"'), "refused", "degrees"),
    "a limit of text": (U.replace('upper="1.3"', 'upper="wide"', 1), "refused", ""),
    "no limits": (U.replace(LIMIT, "", 1), "refused", ""),
    "a type of joint that is none": (U.replace('"revolute"', '"hinge"', 1), "refused", "hinge"),
    "a box of 100 m": (U.replace(BOX, '<box size="100 100 100"/>'), "refused", ""),
    "a box of 1e300 m": (U.replace(BOX, '<box size="1e300 1e300 1e300"/>'), "refused", ""),
    "a box of NaN": (U.replace(BOX, '<box size="nan 1 1"/>'), "refused", ""),
    "a box of -1": (U.replace(BOX, '<box size="-0.06 0.075 0.02"/>'), "refused", ""),
    "a box of 0": (U.replace(BOX, '<box size="0 0.075 0.02"/>'), "either", ""),
    "a cylinder of radius 0": (U.replace(BOX, '<cylinder radius="0" length="1"/>'), "refused", ""),
    "a needle": (U.replace(BOX, '<cylinder radius="1e-9" length="0.1"/>'), "either", ""),
    "a sphere of 1 km": (U.replace(BOX, '<sphere radius="1000"/>'), "refused", ""),
    "a shape that is none": (U.replace(BOX, '<teapot size="1"/>'), "refused", ""),
    "an origin of 1e12 m": (U.replace('xyz="0 0 0.044"', 'xyz="0 0 1e12"', 1), "refused", ""),
    "a mesh outside": (U.replace("meshes/tip.stl", "../../../etc/passwd"), "refused", "outside"),
    "a mesh at an absolute path": (U.replace("meshes/tip.stl", "/etc/passwd"), "refused", ""),
    "a mesh on the web": (U.replace("meshes/tip.stl", "http://127.0.0.1:9/tip.stl"), "refused", ""),
    "a mesh of a package outside": (U.replace("meshes/tip.stl", "package://../../etc/passwd"), "refused", ""),
    "a mesh with a NUL": (U.replace("meshes/tip.stl", "meshes/&#0;"), "refused", ""),
    "a mesh's name of 300 letters": (U.replace("meshes/tip.stl", "a" * 300 + ".stl"), "refused", ""),
    "a mesh that is a folder": (U.replace("meshes/tip.stl", "meshes"), "refused", ""),
    "a mesh's scale of 0": (U.replace("0.001 0.001 0.001", "0 0 0"), "refused", ""),
    "a mesh's scale of 1e6": (U.replace("0.001 0.001 0.001", "1e6 1e6 1e6"), "refused", ""),
    "a mesh's scale of NaN": (U.replace("0.001 0.001 0.001", "nan nan nan"), "refused", ""),
    "20,000 shapes of a link": (U.replace("<collision>", f"<collision><geometry>{BOX}</geometry></collision>" * 20_000 + "<collision>", 1),
                                "refused", ""),
    "names of markup": (U.replace("atip", MARKUP.replace("<", "&lt;")), "refused", ""),
    "control characters in names": (U.replace("btip", "&#10;&#9;x\u202e\x7f"), "refused", ""),
    "a name of 100,000 letters": (U.replace("btip", "b" * 100_000), "refused", ""),
    "an empty name": (U.replace("btip", ""), "refused", ""),
    "two axes": (U.replace('<axis xyz="1 0 0"/>', '<axis xyz="1 0 0"/><axis xyz="0 1 0"/>', 1), "refused", ""),
    "two parents": (U.replace('<parent link="palm"/>', '<parent link="palm"/><parent link="atip"/>', 1), "refused", ""),
    "two limits": (U.replace(LIMIT, LIMIT + '<limit lower="0" upper="0.1"/>', 1), "refused", ""),
    "two origins": (U.replace('<origin xyz="0 0 0.044"/>', '<origin xyz="0 0 0.044"/><origin xyz="0 0 1"/>', 1), "refused", ""),
    "two geometries": (U.replace(BOX, BOX + '<sphere radius="0.02"/>'), "refused", ""),
    "a mimic by NaN": (U.replace('multiplier="1"', 'multiplier="nan"'), "refused", ""),
    "a mimic by 1e300": (U.replace('multiplier="1"', 'multiplier="1e300"'), "refused", ""),
    "a mimic by 0": (U.replace('multiplier="1"', 'multiplier="0"'), "either", ""),
    "one number for a scale": (U.replace("0.001 0.001 0.001", "0.001"), "either", ""),
    "500 shapes of one mesh": (U.replace("<collision>", SHAPE * 500 + "<collision>", 1), "either", ""),
    "a turn of NaN": (U.replace('<origin xyz="0 0 0.044"/>', '<origin xyz="0 0 0.044" rpy="nan 0 0"/>', 1), "refused", ""),
    "a turn of 1e300": (U.replace('<origin xyz="0 0 0.044"/>', '<origin xyz="0 0 0.044" rpy="1e300 0 0"/>', 1), "refused", "rpy"),
    "an include of xacro": (U.replace("</robot>", '<xacro:include filename="/etc/passwd"/></robot>'), "refused", ""),
}  # fmt: skip
MESHES: dict[str, Content | None] = {
    "a mesh that is missing": None,
    "a mesh that is a pipe": Pipe(),
    "a mesh that leads outside": Link("../../../../../etc/passwd"),
    "a mesh that is a device": Link("/dev/zero"),
    "a mesh that is empty": b"",
}
MODELS = {
    "valid": (MJCF, "accepted", ""),
    "a replicate of 1e8": (MJCF.replace("<site", '<replicate count="100000000"><geom size="1"/></replicate><site', 1), "refused", "replicate"),
    "replicates in replicates": (MJCF.replace("<site", '<replicate count="99"><replicate count="99"><geom size="1"/></replicate></replicate><site', 1),
                                 "refused", "replicate"),
    "a texture outside": (MJCF.replace("<asset>", '<asset><texture type="cube" fileright="/etc/passwd"/>'), "refused", "outside"),
    "a height field": (MJCF.replace("<asset>", '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/>'), "refused", "hfield"),
    "a texture of 1e9 pixels": (MJCF.replace("<asset>", '<asset><texture name="x" type="2d" builtin="flat" width="40000" height="40000"/>'),
                                "refused", "texture"),
    "an include outside": (MJCF.replace("</mujoco>", INCLUDE.format("../../../etc/passwd")), "refused", "outside"),
    "an include of itself": (MJCF.replace("</mujoco>", INCLUDE.format("hand.xml")), "refused", ""),
    "a plugin": (MJCF.replace("<asset>", '<extension><plugin plugin="mujoco.elasticity.cable"/></extension><asset>'), "either", ""),
    "memory of 1e18": (MJCF.replace("<asset>", '<size memory="1000P"/><asset>'), "refused", "size"),
    "NaN": (MJCF.replace('pos="0 0 .05"', 'pos="nan 0 .05"', 1), "refused", ""),
    "an axis of 1e200": (MJCF.replace('axis="0 1 0"', 'axis="0 1e200 1e200"', 1), "either", ""),
    "an axis of length 0": (MJCF.replace('axis="0 1 0"', 'axis="0 0 0"', 1), "refused", ""),
    "a body of 1 km": (MJCF.replace('size=".03 .03 .01"', 'size="1000 1000 1000"'), "refused", ""),
    "a mesh of 1e12 m": (MJCF.replace('scale="0.001 0.001 0.001"', 'scale="0.001 0.001 1e12"'), "refused", "corners"),
    "bodies nested 2,000 deep": (MJCF.replace("<site", "<body>" * 2000 + "</body>" * 2000 + "<site", 1), "refused", ""),
    "defaults nested 10,000 deep": (MJCF.replace("<asset>", "<default>" * 10_000 + "</default>" * 10_000 + "<asset>"), "refused", ""),
    "an entity": ('<!DOCTYPE x [<!ENTITY a "b">]>' + MJCF, "refused", "DOCTYPE"),
    "names of markup": (MJCF.replace('name="rocker"', f'name="{MARKUP.replace("<", "&lt;")}"'), "accepted", ""),
    "control characters in names": (MJCF.replace('name="rocker"', 'name="&#27;[31m\u202e"'), "refused", ""),
    "a flex": (MJCF.replace("<site", '<flexcomp name="f" type="grid" count="1000 1000 1000"/><site', 1), "refused", "flex"),
    "numbers of 8 GB": (MJCF.replace("<asset>", '<custom><numeric name="n" size="1000000000"/></custom><asset>'), "refused", ""),
    "a sensor of 8 GB": (MJCF.replace("<actuator>", '<sensor><user dim="1000000000"/></sensor><actuator>'), "refused", ""),
    "an actuator of 1e9 states": (MJCF.replace("<position", '<general joint="crank" actdim="1000000000" dyntype="user"/><position'), "refused", ""),
    "a history of 1e9": (MJCF.replace("<position", '<motor joint="crank" nsample="1000000000" delay="1"/><position'), "refused", ""),
    "a grid of 1e10": (MJCF.replace("<asset>", '<asset><texture name="x" type="cube" gridsize="100000 100000" file="tip.stl"/>'), "refused", ""),
    "a skin outside": (MJCF.replace("<asset>", '<asset><skin name="s" file="/etc/passwd"/>'), "refused", "outside"),
    "a meshdir outside": (MJCF.replace('meshdir="meshes"', 'meshdir="/etc"'), "refused", "outside"),
    "a library": (MJCF.replace("<asset>", '<extension><plugin plugin="/tmp/x.so"/></extension><asset>'), "refused", ""),
    "a replicate of a hand": (MJCF.replace('<body name="palm">', '<replicate count="50" offset="1 0 0"><body name="palm">').replace("</worldbody>", "</replicate></worldbody>"), "refused", ""),
    "a mesh of text": (MJCF.replace("<asset>", '<asset><mesh name="v" vertex="' + "0 1 2 " * 300_000 + '"/>'), "either", ""),
    "a bar without inertia": (MJCF.replace('.04" size=".004"/><site name="b"', '99999999999999999999" size=".004"/><site name="b"'), "refused", "flat"),
    "a key of the wrong size": (MJCF.replace("</mujoco>", '<keyframe><key qpos="1"/></keyframe></mujoco>'), "either", ""),
    "a mesh of 1e9 points": (MJCF.replace("<asset>", '<asset><mesh name="g" builtin="sphere" params="99999"/>'), "refused", ""),
}  # fmt: skip
CONFIGS = {
    "a bomb of aliases": (_bomb(9), "refused", "alias"),
    "a merge key": (f"a: &a {{palm: palm}}\n<<: *a\n{YAML}", "refused", "alias"),
    "an object of Python": (YAML.replace("palm: palm", "palm: !!python/object/apply:os.system [ls]"), "refused", ""),
    "lists nested 100,000 deep": ("palm: " + "[" * 49_000 + "]" * 49_000, "refused", ""),
    "lists nested 3,000 deep": ("palm: " + "[" * 3000 + "]" * 3000, "refused", ""),
    "a key twice": (YAML + "palm: atip\n", "refused", "twice"),
    "a digit twice": (YAML.replace("{A: atip", "{A: atip, A: atip"), "refused", "twice"),
    "two documents": (f"{YAML}---\n{YAML}", "refused", ""),
    "a palm that is none": (YAML.replace("palm: palm", "palm: nothing"), "refused", "nothing"),
    "a list for a palm": (YAML.replace("palm: palm", "palm: [palm]"), "refused", "palm"),
    "a normal of zeros": (YAML.replace("[0, -1, 0]", "[0, 0, 0]"), "refused", "palm_normal"),
    "a normal of NaN": (YAML.replace("[0, -1, 0]", "[.nan, 0, 0]"), "refused", "palm_normal"),
    "a normal of infinity": (YAML.replace("[0, -1, 0]", "[.inf, 0, 0]"), "refused", "palm_normal"),
    "a normal of 400 digits": (YAML.replace("[0, -1, 0]", f"[{'9' * 400}, 0, 0]"), "refused", "palm_normal"),
    "a coupling of a joint with itself": (YAML.replace("[[a1, a2]]", "[[a1, a1]]"), "refused", ""),
    "couplings in a circle": (YAML.replace("[[a1, a2]]", "[[a1, a2], [a2, a1]]"), "refused", ""),
    "control characters": (YAML.replace("A: atip", '"\\e[31m\\u202e": atip'), "either", ""),
    "a name of markup": (f"name: {MARKUP}\n{YAML}", "accepted", ""),
    "tabs": (YAML.replace("palm: ", "\tpalm:\t"), "refused", ""),
    "100,001 bytes": (YAML + "#" * 100_000, "refused", "too large"),
    "10,000 unknown keys": (YAML + "\n".join(f"k{i}: 1" for i in range(10_000)), "refused", "unknown"),
}
XACROS = {
    "10 GB of text": XACRO.replace('value="0.01"', """value="${'x' * 10000000000}\""""),
    "a power of powers": XACRO.replace('value="0.01"', 'value="${9**9**9**9}"'),
    "code of Python": XACRO.replace('value="0.01"', """value="${__import__('os').system('touch pwned')}\""""),
    "classes of Python": XACRO.replace('value="0.01"', 'value="${().__class__.__bases__[0].__subclasses__()}"'),
    "an eval": XACRO.replace('value="0.01"', """value="$(eval __import__('os').system('touch pwned'))\""""),
    "the environment": XACRO.replace('value="0.01"', 'value="$(env HOME)"'),
    "a file outside": XACRO.replace('value="0.01"', """value="${xacro.load_yaml('/etc/passwd')}\""""),
    "an include outside": XACRO.replace("<xacro:macro", '<xacro:include filename="../../../../etc/passwd"/><xacro:macro'),
    "a macro of itself": XACRO.replace("<link", '<xacro:pad n="1"/><link'),
    "an include of itself": XACRO.replace("<xacro:macro", '<xacro:include filename="hand.urdf.xacro"/><xacro:macro'),
    "a number of 100 MB": XACRO.replace('value="0.01"', "value=\"${'%099999999d' % 1}\""),
}  # fmt: skip
MODEL_OUTSIDE = MJCF.replace("<asset>", '<asset><model name="m" file="sub.xml"/>')
HANDMADE = [
    *(urdf_case(name, *values) for name, values in URDF.items()),
    *(urdf_case(name, U, "refused", mesh=content) for name, content in MESHES.items()),
    *(mjcf_case(name, *values) for name, values in MODELS.items()),
    *(yaml_case(name, *values) for name, values in CONFIGS.items()),
    xacro_case("valid", XACRO.encode(), "accepted"),
    *(xacro_case(name, text.encode(), "either" if "number" in name else "refused") for name, text in XACROS.items()),
    mjcf_case("a model whose mesh is outside, attached", MODEL_OUTSIDE, "refused", "outside",
              **{"sub.xml": b'<mujoco><asset><mesh name="x" file="/etc/passwd.stl"/></asset></mujoco>'}),
    urdf_case("a mesh that is a hole of 4 GB", U, "refused", mesh=Hole(2**32, tip()[:200])),
    urdf_case("a mesh of 200,000 triangles, 500 times", URDF["500 shapes of one mesh"][0], "refused", mesh=sphere()),
    urdf_case("a description that is a hole of 10 GB", Hole(10**10), "refused"),
    yaml_case("a hole of 10 GB", Hole(10**10), "refused"),
    urdf_case("a YAML that is a pipe", U, "either", yaml=Pipe()),
    urdf_case("a YAML that is a device", U, "either", yaml=Link("/dev/zero")),
    Hostile("urdf", "a description that is a pipe", {"hand.urdf": Pipe()}, ("hand", "hand.urdf"), "refused"),
    Hostile("urdf", "a folder of that name", {"hand.urdf/x": b""}, ("hand", "hand.urdf"), "refused"),
    Hostile("urdf", "control characters in the file's name", {}, ("hand", f"{CONTROL}.urdf"), "refused"),
    Hostile("urdf", "prepared with names of markup", {
        "hand.urdf": urdf(name=MARKUP.replace("<", "&lt;")).replace("anear", MARKUP.replace("<", "&lt;")).encode(),
        "hand.yaml": YAML.encode(), "meshes/tip.stl": tip()}, ("hand", "hand.urdf", "--prepare", "out")),
]  # fmt: skip
DRAWS: dict[str, Draw] = {"urdf": _urdf, "mjcf": _mjcf, "yaml": _yaml, "xacro": _xacro}
