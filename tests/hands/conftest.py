"""Hands that the tests share, and MuJoCo's forward kinematics to compare with."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from dexnudge.hands.hand import Hand
from dexnudge.hands.registry import load_hand

SMALL_URDF = """<?xml version="1.0"?>
<robot name="small">
  <link name="forearm">
    <collision><origin xyz="0 0 0.02" rpy="0.1 0 0"/><geometry><box size="0.04 0.05 0.06"/></geometry></collision>
  </link>
  <joint name="wrist" type="revolute">
    <parent link="forearm"/><child link="palm"/>
    <origin xyz="0.01 0.02 0.06" rpy="0.3 -0.2 0.5"/><axis xyz="0 3 4"/><limit lower="-0.5" upper="0.7"/>
  </joint>
  <link name="thumb"/>
  <link name="palm">
    <collision><geometry><box size="0.06 0.02 0.08"/></geometry></collision>
    <collision><origin xyz="0 0.01 0.03"/><geometry><cylinder radius="0.01" length="0.03"/></geometry></collision>
    <visual><geometry><sphere radius="0.3"/></geometry></visual>
  </link>
  <joint name="near" type="revolute">
    <parent link="palm"/><child link="finger"/>
    <origin xyz="0.02 0 0.05" rpy="0 1.5707963267948966 0.4"/><axis xyz="1 0 0"/><limit lower="0" upper="1.2"/>
  </joint>
  <joint name="far" type="revolute">
    <parent link="finger"/><child link="tip"/><origin xyz="0 0 0.05"/><axis xyz="1 0 0"/>
    <mimic joint="middle" multiplier="-0.5" offset="0.1"/>
  </joint>
  <joint name="middle" type="revolute">
    <parent link="palm"/><child link="thumb"/><origin xyz="-0.02 0 0.05" rpy="-1 0 2"/><axis xyz="0 0 -2"/>
    <mimic joint="near" multiplier="0.8" offset="-0.2"/>
  </joint>
  <joint name="spin" type="continuous">
    <parent link="thumb"/><child link="thumbtip"/><origin xyz="0 0.01 0.04"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="mount" type="fixed"><parent link="tip"/><child link="pad"/><origin xyz="0 0 0.02" rpy="0 0 1"/></joint>
  <link name="finger">
    <collision><origin xyz="0 0 0.025"/><geometry><cylinder radius="0.008" length="0.05"/></geometry></collision>
  </link>
  <link name="tip"><collision><geometry><sphere radius="0.009"/></geometry></collision></link>
  <link name="thumbtip">
    <collision>
      <origin xyz="0 0 0.01"/>
      <geometry><mesh filename="package://small/wedge.stl" scale="0.001 0.002 0.001"/></geometry>
    </collision>
  </link>
  <link name="pad"><collision><geometry><box size="0.01 0.01 0.004"/></geometry></collision></link>
</robot>
"""
SMALL_YAML = """palm: palm
fingertips: {F: pad, T: thumbtip}
palm_normal: [0, -2, 0]
couplings: [[spin, near]]
base_link: forearm
"""


def write_small_hand(folder: Path, urdf: str = SMALL_URDF, config: str | None = SMALL_YAML) -> Path:
    trimesh.creation.cone(radius=10, height=20).export(folder / "wedge.stl")
    if config is not None:
        (folder / "hand.yaml").write_text(config)
    path = folder / "small.urdf"
    path.write_text(urdf)
    return path


@pytest.fixture(scope="session")
def small_urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_hand(tmp_path_factory.mktemp("small"))


@pytest.fixture
def write_hand(tmp_path: Path) -> Callable[..., Path]:
    """Write the small hand, its URDF or YAML changed, and return the URDF's path."""

    def write(urdf: str = SMALL_URDF, config: str | None = SMALL_YAML) -> Path:
        return write_small_hand(tmp_path, urdf, config)

    return write


@pytest.fixture(scope="session")
def small(small_urdf: Path) -> Hand:
    return load_hand(small_urdf)


@pytest.fixture(scope="session")
def lite(shadow_hand: Hand) -> Hand:
    return shadow_hand


@pytest.fixture(scope="session")
def full() -> Hand:
    return load_hand("shadow_full")


@pytest.fixture(scope="session")
def random_q() -> Callable[..., np.ndarray]:
    """Configurations with any root pose and joint angles within limits, couplings not heeded."""

    def draw(hand: Hand, count: int, seed: int = 0) -> np.ndarray:
        rng = np.random.default_rng(seed)
        rotation = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
        six = np.concatenate([rotation[:, :, 0], rotation[:, :, 1]], axis=1)
        angles = rng.uniform(hand.lower, hand.upper, size=(count, hand.num_joints))
        return np.concatenate([rng.normal(size=(count, 3)), six, angles], axis=1)

    return draw


@pytest.fixture(scope="session")
def mujoco_transforms() -> Callable[..., np.ndarray]:
    """T_palm_body of named bodies, by mj_kinematics, for joint angles given by name."""

    def transforms(model: mujoco.MjModel, angles: dict[str, float], bodies: list[str], palm: str) -> np.ndarray:
        data = mujoco.MjData(model)
        for name, angle in angles.items():
            data.qpos[model.joint(name).qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        worlds = []
        for body in [palm, *bodies]:
            world = np.eye(4)
            world[:3, :3], world[:3, 3] = data.body(body).xmat.reshape(3, 3), data.body(body).xpos
            worlds.append(world)
        return np.linalg.inv(worlds[0]) @ np.stack(worlds[1:])

    return transforms
