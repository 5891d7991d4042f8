"""Ranges in which the numbers of a scene may lie: what is read, and what is refused in which words."""

import json

import numpy as np
import pytest
import trimesh

from dexnudge.errors import InputError
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.uncertainty import Uncertainty

KEYS = "friction, friction_environment, mass, max_normal_force, pose_mm, pose_deg, height_mm, worlds, seed"
RANGE = "expected LEAST..MOST, factors on the scene's own above 0 and at most 100, the least first, such as 0.5..1"


def test_words_are_read_as_they_are_meant():
    read = Uncertainty.parse(["friction=0.5..1", "mass=.5..2", "pose_mm=2", "worlds=32", "seed=7"])
    assert read == Uncertainty(friction=(0.5, 1.0), mass=(0.5, 2.0), pose_mm=2.0, worlds=32, seed=7)
    assert read.disturbs
    assert read.displaces
    assert Uncertainty.from_json(json.loads(json.dumps(read.to_json()))) == read


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["friction"], "`uncertain` got 'friction'; expected KEY=VALUE, such as friction=0.5..1 or pose_mm=2"),
        (["frction=1..2"], f"`uncertain` has no key 'frction' (did you mean 'friction'?); expected some of {KEYS}"),
        (["mass=1..2", "mass=1..3"], "`uncertain` names mass twice; expected each key once"),
        (["mass=2..1"], f"the mass of `uncertain` is '2..1'; {RANGE}"),
        (["mass=-1..1"], f"the mass of `uncertain` is '-1..1'; {RANGE}"),
        (["mass=nan..1"], f"the mass of `uncertain` is 'nan..1'; {RANGE}"),
        (["mass=0..1"], f"the mass of `uncertain` is '0..1'; {RANGE}"),
        (["mass=1..inf"], f"the mass of `uncertain` is '1..inf'; {RANGE}"),
        (["mass="], f"the mass of `uncertain` is ''; {RANGE}"),
        (["mass=2"], f"the mass of `uncertain` is '2'; {RANGE}"),
        (["friction=0.5...1"], f"the friction of `uncertain` is '0.5...1'; {RANGE}"),
        (["friction=1_0..2_0"], f"the friction of `uncertain` is '1_0..2_0'; {RANGE}"),
        (["pose_mm=1_0"], "the pose_mm of `uncertain` is '1_0'; expected a number from 0 to 50"),
        (["pose_mm=-1"], "the pose_mm of `uncertain` is -1; expected a number from 0 to 50"),
        (["pose_deg=nan"], "the pose_deg of `uncertain` is nan; expected a number from 0 to 45"),
        (["pose_mm=few"], "the pose_mm of `uncertain` is 'few'; expected a number from 0 to 50"),
        (["worlds=0"], "`worlds` is 0; expected at least 1"),
        (["worlds=1.5"], "`worlds` is 1.5; expected an integer of at least 1"),
        (["seed=-1"], "`seed` is -1; expected a whole number from 0 to 9223372036854775807"),
    ],
)
def test_what_makes_no_sense_is_refused(words, message):
    with pytest.raises(InputError) as refused:
        Uncertainty.parse(words)
    assert str(refused.value) == message


@pytest.mark.parametrize("value", [3, [], {"mass": 2}, {"mass": [1, 10**400]}, {"other": 1}, {"mass": ["a", "b"]}])
def test_nothing_in_a_file_is_trusted(value):
    with pytest.raises(InputError, match="`uncertain`"):
        Uncertainty.from_json(value)


def test_a_scene_keeps_what_is_uncertain_in_its_files(tmp_path):
    pose = np.eye(4)
    pose[2, 3] = 0.01
    floor = box((-0.4, -0.4, -0.02), (0.4, 0.4, 0.0))
    uncertainty = Uncertainty(friction=(0.5, 1.0), friction_environment=(1.0, 1.5), pose_deg=3.0)
    scene = Scene(trimesh.creation.box((0.1, 0.1, 0.02)), floor, pose, np.array([1.0, 0, 0]), uncertainty=uncertainty)
    scene.save(tmp_path)
    assert Scene.load(tmp_path).uncertainty == uncertainty
    hardest = {"friction_hand": 0.4, "friction_environment": 0.6, "mass": 0.15, "max_normal_force": 5.0}
    assert uncertainty.hardest(scene) == pytest.approx(hardest)
