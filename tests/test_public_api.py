"""`import dexnudge as dn`: every public name is there, and nothing heavy is loaded before it is used."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import dexnudge as dn
from dexnudge.jobs.processes import SPIN_COUNT, THREAD_VARIABLES, available_cores

HEAVY = ("torch", "warp", "trimesh", "mujoco", "scipy", "numpy")


def test_every_public_name_is_there():
    for name in dn.__all__:
        assert getattr(dn, name) is not None
    assert dir(dn) == sorted(dn.__all__)
    assert len(dn.__all__) == len(set(dn.__all__))
    with pytest.raises(AttributeError, match="module 'dexnudge' has no attribute 'nothing'"):
        dn.nothing  # noqa: B018


def test_type_checkers_see_the_names_where_they_are_found():
    assert dn.__file__ is not None
    tree = ast.parse(Path(dn.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    seen = {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("dexnudge.")
        for alias in node.names
    }
    assert set(seen) == set(dn.__all__)
    for name, module in seen.items():
        assert getattr(dn, name) is getattr(sys.modules[module], name)


def test_importing_it_loads_nothing_heavy():
    code = f"import sys, dexnudge; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_drawing_loads_nothing_that_it_does_not_need():
    code = "import sys, dexnudge as dn; dn.Sampler(dn.load_hand('shadow_lite')).load('steered_noise'); dn.build_scene; "
    code += "import dexnudge.results.folder; "  # by which every command writes
    code += "unneeded = 'pyarrow', 'mujoco', 'matplotlib', 'rich', 'tyro', 'scipy.stats'; "
    code += "print([name for name in unneeded if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("before", "given", "threads", "spin"),
    [
        ("", {}, str(available_cores()), SPIN_COUNT),
        ("", {"OMP_NUM_THREADS": "7", "GOMP_SPINCOUNT": "5"}, "7", "5"),
        ("", {"OMP_WAIT_POLICY": "active"}, str(available_cores()), "None"),
        ("sys.modules['torch'] = sys", {}, "None", "None"),
    ],
)
def test_importing_it_before_torch_sets_its_threads_unless_the_user_has(before, given, threads, spin):
    names = (*THREAD_VARIABLES, "GOMP_SPINCOUNT", "OMP_WAIT_POLICY")
    environment = {name: value for name, value in os.environ.items() if name not in names} | given
    code = (
        f"import os, sys; {before}\nimport dexnudge; print(*map(os.environ.get, ('OMP_NUM_THREADS', 'GOMP_SPINCOUNT')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.split() == [threads, spin]


def test_the_page_on_performance_gives_the_number_that_is_set():
    page = Path(__file__).parents[1] / "docs/concepts/performance.md"
    assert f'os.environ.setdefault("GOMP_SPINCOUNT", "{SPIN_COUNT}")' in page.read_text(encoding="utf-8")


def test_a_scene_takes_a_name_a_file_or_a_mesh(tmp_path):
    by_name = dn.build_scene("table", "phone", seed=3)
    by_name.object_mesh.export(tmp_path / "phone.stl")
    for given in (dn.builtin_object("phone"), tmp_path / "phone.stl", str(tmp_path / "phone.stl")):
        other = dn.build_scene("table", given, seed=3)
        np.testing.assert_allclose(other.T_world_object, by_name.T_world_object, atol=1e-5)
    assert "table" in dn.scene_families()


def test_a_scene_in_surroundings_of_ones_own(tmp_path):
    trimesh.creation.box((150, 70, 10)).export(tmp_path / "phone.stl")
    trimesh.creation.box(bounds=[[-500, -500, -20], [500, 500, 0]]).export(tmp_path / "kitchen.ply")
    pose = np.eye(4)
    pose[2, 3] = 0.005
    scene = dn.Scene.from_files(
        tmp_path / "phone.stl",
        environment=tmp_path / "kitchen.ply",
        object_pose=pose,
        motion=[2, 0, 0],
        motion_length=0.12,
        units="mm",
        mass=0.2,
    )
    np.testing.assert_allclose(scene.object_mesh.extents, [0.15, 0.07, 0.01])
    np.testing.assert_allclose(scene.motion, [1, 0, 0])
    assert (scene.mass, scene.motion_length) == (0.2, 0.12)
    assert repr(scene).startswith(
        "Scene 'user': object 150 x 70 x 10 mm, 200 g, to slide 120 mm along (1.00, 0.00, 0.00)"
    )
    pose[2, 3] = -0.004
    with pytest.raises(dn.SceneError, match="already penetrates the object"):
        dn.Scene.from_files(
            tmp_path / "phone.stl", environment=tmp_path / "kitchen.ply", object_pose=pose, motion=[1, 0, 0], units="mm"
        )


def test_what_a_hand_says_of_itself(boxy_hand):
    assert repr(boxy_hand) == "Hand 'boxy': 4 joints, 5 links, digits a, b, 1 couplings"


def test_what_a_sampler_says_of_itself(boxy_hand, tmp_path):
    assert repr(dn.Sampler(dn.load_hand("shadow_lite"))) == "Sampler of shadow_lite on cpu, weights: shipped"
    assert repr(dn.Sampler(boxy_hand)) == "Sampler of boxy on cpu, weights: none"
    assert repr(dn.Sampler(boxy_hand, weights=tmp_path)) == f"Sampler of boxy on cpu, weights: {tmp_path}"


MISTAKEN = """
import numpy as np
import dexnudge as dn

class Left:
    name, weight = "left", 1.0
    def __call__(self, hands, scene):
        return hands.q[:, 0] ** 2

hand, scene = dn.load_hand("shadow_lite"), dn.build_scene("table", "phone")
q = np.zeros((1, 9 + hand.num_joints))
for mistaken in (
    lambda: dn.Sampler("shadow_lite"),
    lambda: dn.Sampler(hand).sample("phone"),
    lambda: dn.verify(hand, scene, q),
    lambda: dn.verify(scene, hand, q, Left()),
    lambda: dn.Sampler(hand, terms=Left()),
    lambda: dn.Sampler(hand, terms=[Left]),
    lambda: dn.HandBatch(hand, q[0]),
):
    try:
        mistaken()
    except dn.InputError as error:
        print(error)
"""


def test_arguments_of_another_class_are_refused_by_name():
    """In a process of its own: here, where the tests run, annotations are checked before the functions are called."""
    done = subprocess.run([sys.executable, "-c", MISTAKEN], capture_output=True, text=True, check=True)
    assert [line.partition(",")[0] for line in done.stdout.splitlines()] == [
        "`hand` is 'shadow_lite'; expected a Hand",
        "`scene` is 'phone'; expected a Scene",
        "`scene` is a Hand; expected a Scene",
        "`criteria` is a Left; expected a sequence: [*default_criteria()",
        "`terms` is a Left; expected a sequence of terms",
        "entry 0 of `terms` is the class Left; expected an object",
        "`q` is torch.float64 of shape (25",
    ]
