"""Arguments of another kind or out of range are refused by an error of ours, whatever a caller passes."""

import subprocess
import sys

import pytest

import dexnudge as dn

PREPARE = """
import sys
from dataclasses import replace
from pathlib import Path
import numpy as np
import torch
import dexnudge as dn

hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone")
samples = dn.Sampler(hand).sample(scene, num=2, method="random_start_projection")
surroundings = dict(environment=scene.environment_mesh, object_pose=scene.T_world_object, motion=(1, 0, 0))
mesh = "phone.stl"
scene.object_mesh.export(mesh)

def from_files(object="phone", **changes):
    return dn.Scene.from_files(object, **{**surroundings, **changes})

def sample(**options):
    return dn.Sampler(hand).sample(scene, method="random_start_projection", **options)
"""
MISTAKEN = {  # expression -> beginning of the message
    "samples[0:0].picture('p.png')": "there are no samples to show",
    "samples.picture('p.png', index=99)": "`index` is 99; expected at most 1",
    "samples.picture('p.png', index=0.5)": "`index` is 0.5; expected an integer",
    "samples.picture('p.txt')": "`path` is 'p.txt'; expected a name that ends in .png",
    "samples.picture('p\\0.png')": r"`path` is 'p\x00.png'; expected the path",
    "samples.page('p\\0.html')": r"`path` is 'p\x00.html'; expected the path",
    "samples.save('p\\0')": r"`out` is 'p\x00'; expected the path",
    "samples[True]": "samples[True] of 2 samples; expected an integer",
    "samples[[True]]": "samples[[True]] of 2 samples; expected an integer",
    "samples[torch.tensor([0.5])]": "samples[tensor([0.5000])] of 2 samples; expected an integer",
    "dn.build_scene('table', 'phone', seed=-1)": "`seed` is -1; expected a whole number from 0",
    "dn.build_scene('table', 'phone', seed=1.5)": "`seed` is 1.5; expected a whole number",
    "dn.build_scene(None, 'phone')": "`family` is a NoneType",
    "from_files(foo=1)": "unknown physical parameter 'foo'",
    "from_files(mass=10**400)": "`mass` is an integer of 401 digits; expected a finite number",
    "from_files(environment=None)": "`environment` is None; expected the path",
    "from_files(None)": "`object` is None; expected the name of a built-in object",
    "from_files(length='0.1')": "`length` is '0.1'; expected the longest side",
    "from_files(motion=np.array([1, 0, 1j]))": "motion is not a vector of numbers; expected three (they are complex)",
    "from_files(motion=['1', '0', '0'])": "motion is not a vector of numbers; expected three ('1' is none)",
    "from_files(motion=[True, 0, 0])": "motion is not a vector of numbers; expected three (True is none)",
    "dn.Turn('1', (0, 0, 1), (0, 0, 0))": "the angle of a turn is '1'; expected a number of radians",
    "dn.Turn(None, (0, 0, 1), (0, 0, 0))": "the angle of a turn is None; expected a number of radians",
    "dn.Turn(1j, (0, 0, 1), (0, 0, 0))": "the angle of a turn is 1j; expected a number of radians",
    "dn.Turn(np.ones(2), (0, 0, 1), (0, 0, 0))": "the angle of a turn is array([1., 1.]); expected a number of radians",
    "dn.Turn(np.float64(3.2), (0, 0, 1), (0, 0, 0))": "the angle of a turn is 3.2; expected a number of radians",
    "dn.Turn(1.0, None, (0, 0, 0))": "the axis of a turn is None; expected three finite numbers",
    "replace(scene, turn=1.0)": "`turn` is a float; expected a Turn, such as dn.Turn(np.pi / 2, axis=(0, 0, 1), point=",
    "replace(scene, object_mesh=None)": "`object_mesh` is a NoneType; expected a Trimesh",
    "dn.load_dataset(3)": "`folder` is 3; expected the path",
    "dn.execute(samples[0], alternatives=None)": "`alternatives` is None; expected samples of one scene",
    "dn.execute(samples[0], alternatives=samples[1])": "`alternatives` is Sample of shadow_lite in",
    "dn.execute(samples[0], alternatives=[3])": "`alternatives` is a int; expected a Sample",
    "dn.execute(samples[0], draws=10**9)": "`draws` is 1000000000; expected at most 10000",
    "dn.execute(samples[0], then_grasp=True, seed=-1)": "`seed` is -1; expected a whole number from 0",
    "dn.plan(samples, dn.load_arm('panda'), floor='high')": "`floor` is 'high'; expected the height of its top",
    "dn.verify(scene, hand, [[1], [1, 2]])": "`q` cannot be read as an array (setting an array element",
    "dn.verify(scene, hand, torch.zeros(2, 25).to_sparse())": "`q` cannot be read as an array (can't convert Sparse",
    "dn.verify(scene, hand, torch.zeros(2, 25, device='meta'))": "`q` cannot be read as an array (Cannot copy out",
    "sample(num=None)": "`num` is None; expected an integer of at least 1",
    "sample(problem=3)": "`problem` is a int; expected a SamplingProblem",
    "sample(hand=dn.load_hand('allegro'))": "`hand` is 'allegro', whose joints are not those of the sampler's",
    "dn.load_mesh(None)": "`path` is None; expected the path",
    "dn.load_mesh(mesh, length='0.1')": "`length` is '0.1'; expected the longest side",
    "dn.load_hand(None)": "`name_or_urdf` is None",
    "dn.load_arm(None)": "`name_or_path` is None",
    "dn.load_arm('panda', packages={'a': 3})": "`packages` is {'a': 3}; expected names of packages",
    "dn.load_arm('panda', base='here')": "T_world_base is not a matrix of numbers",
    "dn.mount('panda', hand)": "`arm` is 'panda'; expected a Arm",
    "dn.mount(dn.load_arm('panda'), 'allegro')": "`hand` is 'allegro'; expected a Hand",
    "dn.default_base(dn.load_arm('panda'), 'table')": "`scene` is 'table'; expected a Scene",
    "dn.load_samples(None)": "`folder` is None",
    "dn.check(None)": "`folder` is None",
    "dn.load_scene(None)": "`folder` is None",
    "dn.load_plan(None)": "`path` is None",
    "dn.export_hand(hand, None)": "`folder` is None",
    "dn.verify(scene, hand, samples.q, 3)": "`criteria` is a int; expected a sequence",
    "dn.verify(scene, hand, samples.q, dn.default_criteria()[0])": "`criteria` is a BuiltinCriterion; expected a sequence",
    "dn.find_criterion(3)": "`name` is a int",
    "dn.find_term(None)": "`name` is a NoneType",
    "dn.builtin_object(None)": "`name` is a NoneType",
    "sample(num=1.5)": "`num` is 1.5; expected an integer",
    "sample(num=-10**5000)": "`num` is an integer of 5001 digits; expected at least 1",
    "sample(seed=1.5)": "`seed` is 1.5; expected a whole number",
    "sample(seed=-1)": "`seed` is -1; expected a whole number from 0",
}
FINE = (  # expressions that hold
    "samples[torch.tensor([1])].q.tolist() == samples.q[[1]].tolist()",
    "samples[torch.tensor(1)].q.tolist() == samples[1].q.tolist()",
    "len(samples[[True, False]]) == len(samples[[0]]) == 1 and len(samples[[]]) == 0",
    "from_files(motion=[1e300, 0, 0]).motion.tolist() == [1, 0, 0]",
    "dn.Turn(1, (0, 0, 2), (0, 0, 0)).axis.tolist() == [0, 0, 1]",
    "from_files(motion=[-1e-300, 0, 0]).motion.tolist() == [-1, 0, 0]",
)


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What each expression gave, in a process of its own: here, annotations are checked before functions are called."""
    code = (
        f"{PREPARE}\nfor expression in {[*MISTAKEN, *FINE]!r}:\n    try:\n        print(ascii(eval(expression)))\n"
        "    except dn.DexnudgeError as error:\n        print(str(error).splitlines()[0])\n"
        "    except Exception as error:\n        print('not ours:', type(error).__name__)\n"
    )
    folder = tmp_path_factory.mktemp("mistaken")
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    assert {path.name for path in folder.iterdir()} == {"phone.stl"}
    return dict(zip([*MISTAKEN, *FINE], done.stdout.splitlines(), strict=True))


@pytest.mark.parametrize("expression", MISTAKEN)
def test_it_is_refused_by_name(said, expression):
    assert said[expression].startswith(MISTAKEN[expression])


@pytest.mark.parametrize("expression", FINE)
def test_what_makes_sense_is_taken(said, expression):
    assert said[expression] == "True"


def test_a_pose_that_is_given_twice_is_refused(tmp_path):
    pose = tmp_path / "pose.json"
    pose.write_text('{"T_world_object": [], "position": [0, 0, 0], "quaternion_wxyz": [1, 0, 0, 0]}')
    scene = dn.build_scene("table", "phone")
    with pytest.raises(dn.SceneError, match="holds the pose twice"):
        dn.Scene.from_files("phone", environment=scene.environment_mesh, object_pose=pose, motion=(1, 0, 0))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cut.off", "OFF\n8 12 0\n0 0 0\n1 0 0\n", "8 vertices announced, lines for 2"),
        ("words.obj", "v 0 0 0\nv 1 x 0\nv 0 1 0\nf 1 2 3\n", "the line 'v 1 x 0' holds what is no number"),
    ],
)
def test_what_a_parser_says_of_its_arrays_is_not_shown(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(dn.MeshError, match=message) as caught:
        dn.load_mesh(tmp_path / name)
    assert "ValueError" not in str(caught.value)
    assert isinstance(caught.value.__cause__, ValueError)


def test_a_file_in_the_place_of_a_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(dn.OutputError, match=r"file: a file stands where a folder is needed"):
        dn.build_scene("table", "phone").save(tmp_path / "file" / "scene")


def test_a_missing_hand_yaml_is_named_once(tmp_path):
    (tmp_path / "hand.urdf").write_text('<robot name="r"><link name="palm"/></robot>')
    with pytest.raises(dn.HandError) as caught:
        dn.load_hand(tmp_path / "hand.urdf")
    assert "expected hand.yaml with the palm" in str(caught.value)
