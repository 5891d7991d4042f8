"""Shape and type checks on every call into dexnudge, and settings and a hand that all tests share."""

import importlib.util
import os
import re
import shlex
import shutil
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh
from hypothesis import settings
from jaxtyping import install_import_hook

SOURCE = Path(__file__).parents[1] / "src"
# Warp compiles the source of a kernel as it stands, so nothing may be wrapped around it, and its structs are no types
# that could be checked; a name that is imported for the type checker alone cannot be looked up when the program runs.
UNCHECKABLE = re.compile(r"^@wp\.(kernel|func|struct)|^from \S+_kernel import|^if TYPE_CHECKING:", re.MULTILINE)


def checkable_modules() -> list[str]:
    """Names of the modules whose annotations can be checked while they run."""
    files = sorted(file for file in (SOURCE / "dexnudge").rglob("*.py") if file.name != "__init__.py")
    checkable = [file for file in files if not UNCHECKABLE.search(file.read_text(encoding="utf-8"))]
    return [".".join(file.relative_to(SOURCE).with_suffix("").parts) for file in checkable]


# Benchmarks are scripts: what they import, and what tests take from them, lies beside them.
sys.path.append(str(SOURCE.parent / "benchmarks"))

# Tests neither read nor write what the developer's own runs have cached; `one_cache_per_run` gives them a folder.
os.environ["DEXNUDGE_CACHE"] = "off"

# A run in the background may ignore Ctrl-C; processes that tests start and interrupt must not inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine is no failure: benchmarks time, tests do not.
settings.register_profile("dexnudge", deadline=None)
settings.load_profile("dexnudge")

# Before any test module imports dexnudge.
install_import_hook(checkable_modules(), "beartype.beartype")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests come first, so that no worker ends minutes after the others."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


@pytest.fixture(scope="session", autouse=True)
def one_torch_thread_per_worker(request: pytest.FixtureRequest) -> None:
    """Workers share the cores; more threads than cores would only wait for each other."""
    if hasattr(request.config, "workerinput"):
        import torch

        torch.set_num_threads(1)


@pytest.fixture(scope="session", autouse=True)
def one_cache_per_run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A folder of this run's own, where workers and the commands that tests start find each other's grids and pieces."""
    folder = tmp_path_factory.getbasetemp()
    if hasattr(request.config, "workerinput"):
        folder = folder.parent
    os.environ["DEXNUDGE_CACHE"] = str(folder / "cache")


@pytest.fixture(scope="session", autouse=True)
def size_of_films() -> Iterator[tuple[int, int]]:
    """Films and pictures of draws whose pixels are not looked at are drawn small: a film takes longer than its push."""
    from dexnudge.viewer import picture, recording

    with pytest.MonkeyPatch.context() as patch:
        size = recording.TILE
        patch.setattr(recording, "TILE", (240, 160))
        patch.setattr(picture, "SIZE", (320, 240))
        yield size


@pytest.fixture(scope="session")
def shadow_hand():
    """The default hand, once for all tests: what is derived from it, such as its convex pieces, is made once too."""
    from dexnudge.hands.registry import load_hand

    return load_hand("shadow_lite")


def two_jaw_urdf() -> str:
    """A gripper as they are sold: two jaws that slide apart by up to 40 mm each, the second by <mimic>, on a flange."""

    def box(x: float, y: float, z: float, size: str) -> str:
        origin = f'<origin xyz="{x} {y} {z}"/>'
        return f'<collision>{origin}<geometry><box size="{size}"/></geometry></collision>'

    def joint(name: str, kind: str, child: str, inside: str) -> str:
        ends = f'<parent link="hand"/><child link="{child}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'

    limit, mimic = '<limit lower="0" upper="0.04"/>', '<mimic joint="left_slide" multiplier="1"/>'
    return (
        '<robot name="two_jaws">'
        f'<link name="hand">{box(0, 0, 0.03, "0.06 0.20 0.06")}</link>'
        f'<link name="left">{box(0, 0.006, 0.022, "0.02 0.012 0.055")}</link>'
        f'<link name="right">{box(0, -0.006, 0.022, "0.02 0.012 0.055")}</link>'
        f'<link name="flange">{box(0, 0, -0.02, "0.07 0.07 0.04")}</link>'
        + joint("left_slide", "prismatic", "left", f'<origin xyz="0 0 0.066"/><axis xyz="0 1 0"/>{limit}')
        + joint("right_slide", "prismatic", "right", f'<origin xyz="0 0 0.066"/><axis xyz="0 -1 0"/>{limit}{mimic}')
        + joint("mount", "fixed", "flange", "")
        + "</robot>"
    )


@pytest.fixture(scope="session")
def two_jaws(tmp_path_factory: pytest.TempPathFactory):
    """The hand of `two_jaw_urdf`."""
    from dexnudge.hands.registry import load_hand

    folder = tmp_path_factory.mktemp("two_jaws")
    yaml = "palm: hand\nfingertips: {left: left, right: right}\npalm_normal: [0, 0, 1]\nbase_link: flange\n"
    (folder / "hand.yaml").write_text(yaml)
    (folder / "hand.urdf").write_text(two_jaw_urdf())
    return load_hand(folder / "hand.urdf")


@pytest.fixture(scope="session")
def browser() -> ModuleType:
    """The driver of Chromium that the benchmarks use."""
    pytest.importorskip("playwright", reason="needs playwright, which drives the browser")
    spec = importlib.util.spec_from_file_location("browser", Path(__file__).parents[1] / "benchmarks" / "browser.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if module.chromium() is None or shutil.which(module.chromium()) is None:
        pytest.skip("no Chromium on the PATH or in CHROMIUM: apt-get install chromium")
    return module


@pytest.fixture(scope="session")
def toy() -> ModuleType:
    """Module that writes made-up datasets."""
    spec = importlib.util.spec_from_file_location("toy", Path(__file__).parent / "dataset" / "toy.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def toy_folder(toy: ModuleType, tmp_path: Path) -> Path:
    """A dataset of three objects with twelve rows each."""
    toy.write_toy_dataset(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def boxy_hand():
    """A palm and two fingers of two segments, side by side in x, pointing along -z; joints turn about y.

    Every depth of it is easily known by hand. Each segment hangs 30 mm down from its joint, fingers stand 30 mm apart,
    and at zero joint angles the fingertips are 73 mm below the palm's centre.
    """
    from dexnudge.hands.hand import Hand, Joint

    def joint(name, origin, index):
        pose = np.eye(4)
        pose[:3, 3] = origin
        return Joint(name, pose, np.array([0.0, 1.0, 0.0]), index)

    segment = trimesh.creation.box((0.01, 0.01, 0.03))
    segment.apply_translation([0, 0, -0.015])
    return Hand(
        name="boxy",
        joint_names=("one", "two", "three", "four"),
        lower=np.full(4, -1.0),
        upper=np.full(4, 1.0),
        link_names=("palm", "near_a", "tip_a", "near_b", "tip_b"),
        link_parent=np.array([-1, 0, 1, 0, 3]),
        joints=(
            None,
            joint("one", (-0.015, 0, -0.011), 0),
            joint("two", (0, 0, -0.032), 1),
            joint("three", (0.015, 0, -0.011), 2),
            joint("four", (0, 0, -0.032), 3),
        ),
        link_meshes=(trimesh.creation.box((0.06, 0.06, 0.02)), segment, segment, segment, segment),
        fingertips={"a": "tip_a", "b": "tip_b"},
        couplings=(("two", "one"),),
        palm_normal=np.array([0.0, 0.0, -1.0]),
    )


@pytest.fixture(scope="session")
def scara():
    """An arm that lifts by up to 0.5 m either way and turns three links of 0.4, 0.3 and 0.1 m about z.

    Its wrist, 0.1 m behind the flange along x, reaches the annulus from 0.1 to 0.7 m about the base and nothing else."""
    from dexnudge.arms.arm import Arm, JointLimits
    from dexnudge.hands.tree import Tree, TreeJoint

    def joint(number: int, length: float, *, fixed: bool = False, slides: bool = False) -> TreeJoint:
        origin, ends = np.eye(4), (f"link{number}", f"link{number + 1}")
        origin[0, 3] = length
        range_ = 0.5 if slides else 3.1
        return TreeJoint(
            f"joint{number}", *ends, origin, np.array([0.0, 0.0, 1.0]), fixed, -range_, range_, slides=slides
        )

    joints = (joint(0, 0.0, slides=True), joint(1, 0.0), joint(2, 0.4), joint(3, 0.3), joint(4, 0.1, fixed=True))
    links = {f"link{number}": trimesh.Trimesh() for number in range(6)}
    upper, ones = np.array([0.5, 3.1, 3.1, 3.1]), np.ones(4)
    limits = JointLimits(-upper, upper, 2 * ones, 10 * ones, 100 * ones, 50 * ones)
    names, home = tuple(each.name for each in joints[:4]), np.array([0.0, 0.5, 0.8, 0.5])
    return Arm("scara", Tree("scara", links, joints), names, limits, home, "link5")


LEVER = 0.5  # [m] so long that a pad moves straight for the millimetres that matter
HALF_WIDTH = 0.02  # [m] of the block between the pads
PAD = (0.016, 0.01, 0.016)  # [m]


@pytest.fixture(scope="session")
def pad_hand():
    """Two fingers whose long levers press two flat pads on a block from both sides, as good as straight on.

    The palm is far below; joints about +x and -x at (0, 0, -LEVER) bring the pads at y = -+HALF_WIDTH together."""
    from dexnudge.hands.hand import Hand, Joint

    links, joints = [trimesh.creation.box((0.02, 0.02, 0.02))], [None]
    for index, side in enumerate((-1.0, 1.0)):
        pad = trimesh.creation.box(PAD)
        pad.apply_translation((0.0, side * (HALF_WIDTH + PAD[1] / 2), LEVER))
        links.append(pad)
        # A turn about +x moves the top toward -y: the pad at -y needs the opposite turn.
        joints.append(Joint(f"slide{index}", np.eye(4), np.array([side, 0.0, 0.0]), index))
    links[0].apply_translation((0.0, 0.0, -0.1))
    return Hand(
        name="pads",
        joint_names=("slide0", "slide1"),
        lower=np.full(2, -0.5),
        upper=np.full(2, 0.5),
        link_names=("palm", "pad0", "pad1"),
        link_parent=np.array([-1, 0, 0]),
        joints=tuple(joints),
        link_meshes=tuple(links),
        fingertips={"A": "pad0", "B": "pad1"},
        couplings=(),
        palm_normal=np.array([0.0, 0.0, 1.0]),
    )


@pytest.fixture(scope="session")
def pad_grasp():
    """q with the pads just at the block around the origin, and its contacts: four corners on each side."""
    from dexnudge.mechanics.contacts import HandContacts

    q = np.array([0.0, 0.0, -LEVER, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    corners = [(x, side * HALF_WIDTH, z) for side in (-1.0, 1.0) for x in (-0.007, 0.007) for z in (-0.007, 0.007)]
    normals = np.repeat([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]], 4, axis=0)
    return q, HandContacts(points=np.array(corners), normals=normals, link=np.repeat([1, 2], 4))


@pytest.fixture(scope="session")
def block():
    return trimesh.creation.box((0.06, 2 * HALF_WIDTH, 0.04))


@pytest.fixture(scope="session")
def block_scene(block):
    """The block on a slab, to be moved along x."""
    from dexnudge.scenes.boxes import box
    from dexnudge.scenes.scene import Scene

    slab = box((-0.3, -0.3, -0.06), (0.3, 0.3, float(block.bounds[0, 2])))
    return Scene(block, slab, np.eye(4), np.array([1.0, 0.0, 0.0]))


@pytest.fixture(scope="session")
def gripper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The URDF of a thumb before two fingers, all of boxes: nothing of it needs to be cut, so runs start at once."""
    folder = tmp_path_factory.mktemp("gripper")
    parts = [_box_link("palm", (0.06, 0.075, 0.02), (0.0, -0.0275, -0.012))]
    for digit, x, y, bends in (("a", 0.012, 0.0, 1), ("b", -0.012, 0.0, 1), ("t", 0.0, -0.055, -1)):
        parts.append(_box_link(f"{digit}near", (0.014, 0.014, 0.04), (0.0, 0.0, 0.022)))
        parts.append(_box_link(f"{digit}tip", (0.014, 0.014, 0.03), (0.0, 0.0, 0.017)))
        parts.append(_joint(f"{digit}2", "palm", f"{digit}near", (x, y, 0.0), bends))
        parts.append(_joint(f"{digit}1", f"{digit}near", f"{digit}tip", (0.0, 0.0, 0.044), bends))
    (folder / "gripper.urdf").write_text(f'<robot name="gripper">{"".join(parts)}</robot>')
    (folder / "gripper.yaml").write_text(
        "palm: palm\nfingertips: {A: atip, B: btip, T: ttip}\npalm_normal: [0, -1, 0]\ncouplings: [[a1, a2], [b1, b2]]\n"
    )
    return folder / "gripper.urdf"


def _box_link(name: str, size: tuple[float, float, float], centre: tuple[float, float, float]) -> str:
    shape = f'<origin xyz="{centre[0]} {centre[1]} {centre[2]}"/><geometry><box size="{size[0]} {size[1]} {size[2]}"/>'
    return f'<link name="{name}"><collision>{shape}</geometry></collision></link>'


def _joint(name: str, parent: str, child: str, origin: tuple[float, float, float], bends: int) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{origin[0]} {origin[1]} {origin[2]}"/><axis xyz="{bends} 0 0"/>'
        '<limit lower="-0.3" upper="1.3"/></joint>'
    )


@pytest.fixture(scope="session")
def crane():
    """An arm of boxes that turns about z, lifts, and bends about y; a link and a joint are called as the gripper's are."""
    from dexnudge.arms.arm import Arm, JointLimits
    from dexnudge.hands.tree import Tree, TreeJoint

    def joint(name, parent, child, origin, axis, ends, *, slides=False):
        pose = trimesh.transformations.euler_matrix(0.1, 0.0, 0.0)
        pose[:3, 3] = origin
        lower, upper = ends or (0.0, 0.0)
        return TreeJoint(name, parent, child, pose, np.array(axis), ends is None, lower, upper, slides=slides)

    joints = (
        joint("a1", "stand", "column", (0, 0, 0.3), (0.0, 0.0, 1.0), (-3.0, 3.0)),
        joint("lift", "column", "palm", (0.1, 0, 0.1), (0.0, 0.0, 1.0), (-0.2, 0.3), slides=True),
        joint("bend", "palm", "beam", (0.2, 0, 0), (0.0, 1.0, 0.0), (-2.0, 2.0)),
        joint("plate", "beam", "flange", (0.2, 0, 0), (0.0, 0.0, 1.0), None),
    )
    links = {name: trimesh.creation.box((0.06, 0.05, 0.04)) for name in ("stand", "column", "palm", "beam")}
    limits = JointLimits(
        lower=np.array([-3.0, -0.2, -2.0]),
        upper=np.array([3.0, 0.3, 2.0]),
        velocity=np.array([2.0, 0.5, 3.0]),
        acceleration=np.array([10.0, 5.0, 15.0]),
        jerk=np.array([500.0, 200.0, 700.0]),
        effort=np.array([50.0, 200.0, 20.0]),
    )
    stand = trimesh.transformations.euler_matrix(0.0, 0.0, 0.5)
    stand[:3, 3] = (-0.5, -0.2, 0.1)
    tree = Tree("crane", links | {"flange": trimesh.Trimesh()}, joints)
    return Arm("crane", tree, ("a1", "lift", "bend"), limits, np.array([0.2, 0.0, 0.4]), "flange", T_world_base=stand)


@pytest.fixture(scope="session")
def crane_plan(crane, gripper: Path, block_scene):
    """The crane swings the gripper to a posture and back within 4 s; nothing of it is planned.

    Two joints go as far as they can, where a digit lost by rounding would lie beyond their limits."""
    from dexnudge.arms.robot import Robot
    from dexnudge.hands.registry import load_hand
    from dexnudge.trajectories.interpolation import at
    from dexnudge.trajectories.plan import JointTrajectory, Phase, Plan

    mount = trimesh.transformations.euler_matrix(0.0, np.pi / 2, 0.0)
    mount[:3, 3] = (0.0, 0.01, 0.03)
    robot = Robot(crane, load_hand(gripper), mount)
    start = np.concatenate([crane.home, np.full(6, 0.1)])
    away = start + np.array([0.7, 0.1, -0.5, 0.3, 0.3, 0.3, 0.3, 0.0, 0.0])
    away[-1], away[-2] = robot.limits.upper[-1], robot.limits.lower[-2]
    stages = JointTrajectory(
        np.array([0.0, 1.5, 2.5, 4.0]), np.array([start, away, away, start]), *(np.zeros((4, 9)) for _ in range(3))
    )
    time = np.arange(81) / 20
    whole = at(stages, time)
    effort = np.where((time >= 1.5) & (time <= 2.5), 0.1234567, 0.0)[:, None] * np.ones(9)
    trajectory = JointTrajectory(time, whole.position, whole.velocity, whole.acceleration, effort)
    moved = block_scene.T_world_object.copy()
    moved[0, 3] += 0.05
    phases = (
        Phase("pre-contact", 0.0, 1.0, 3, block_scene.T_world_object),
        Phase("contact", 1.0, 1.25, 3, block_scene.T_world_object),
        Phase("squeeze", 1.25, 1.5, 3, block_scene.T_world_object),
        Phase("push", 1.5, 2.5, 3, moved, {"atip": 1.5, "ttip": 0.25}),
        Phase("retreat", 2.5, 4.0, 3, moved),
    )
    return Plan(robot, block_scene, trajectory, phases, length=0.05, seconds={"search": 1.25})


BLOCK = re.compile(r"^```(python|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
RunPage = Callable[[str, Path], dict[str, tuple[int, str]]]


@pytest.fixture(scope="session")
def run_page() -> RunPage:
    """Run a page of the documentation from top to bottom in a folder; return exit code and output of its commands."""
    from dexnudge.cli.main import main

    def run(page: str, folder: Path) -> dict[str, tuple[int, str]]:
        namespace: dict[str, object] = {"__name__": page}
        outcomes: dict[str, tuple[int, str]] = {}
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            for language, text in BLOCK.findall((SOURCE.parent / page).read_text(encoding="utf-8")):
                if language == "python":
                    exec(compile(text, page, "exec"), namespace)  # noqa: S102 - our own page
                    continue
                for line in text.splitlines():
                    assert line.startswith("$ dexnudge "), line
                    with redirect_stdout(StringIO()) as out:
                        code = main(shlex.split(line)[2:])
                    outcomes[line.removeprefix("$ ")] = code, out.getvalue()
        return outcomes

    return run
