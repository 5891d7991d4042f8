"""The nearest training pose, checked against the rows of a dataset by hand."""

import numpy as np
import pytest
import torch
import trimesh

from dexnudge.dataset.manifest import Manifest, write_manifest
from dexnudge.dataset.schema import NUM_DIRECTIONS, BehaviourCounts, ConfigurationRow, round_cloud
from dexnudge.dataset.shards import write_shard
from dexnudge.errors import DatasetError, InputError
from dexnudge.geometry.surface_points import object_cloud
from dexnudge.sampling.sampler import Sampler
from dexnudge.sampling.starts import TrainingPoses, nearest_pose_start

SIZES = {"long": (0.18, 0.05, 0.02), "short": (0.12, 0.07, 0.01), "thick": (0.15, 0.06, 0.04)}
DIRECTION = 3  # in which some hands can move their object: 67.5 degrees
ROWS = 10


def stored(hand, rng, behaviour, directions):
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    margin = np.full(NUM_DIRECTIONS, -1.0)
    margin[directions] = 2.0
    angles = rng.uniform(hand.lower, hand.upper)
    return ConfigurationRow(
        behaviour=behaviour,
        q=np.concatenate([rng.normal(0.0, 0.1, 3), rotation[:, 0], rotation[:, 1], angles]),
        direction_margin=margin,
        contact_links=("ffdistal",),
        contact_points=np.zeros((1, 3)),
        digits=("FF",),
        penetration_object=0.0,
        penetration_environment=0.0,
        penetration_self=0.0,
        seed=0,
    )


@pytest.fixture(scope="module")
def rows(hand):
    """By object: two grasps, four pushes along `DIRECTION` and the next one, four along the opposite."""
    rng = np.random.default_rng(0)
    return {
        name: [stored(hand, rng, "grasp", []) for _ in range(2)]
        + [stored(hand, rng, "push", [DIRECTION, DIRECTION + 1]) for _ in range(4)]
        + [stored(hand, rng, "push", [DIRECTION + 8]) for _ in range(4)]
        for name in SIZES
    }


@pytest.fixture(scope="module")
def clouds():
    """As they are stored."""
    return {name: round_cloud(object_cloud(trimesh.creation.box(size)).numpy()) for name, size in SIZES.items()}


def write(folder, hand, rows, clouds, *, hand_name=None):
    manifest = Manifest(
        hand=hand_name or hand.name,
        joint_names=hand.joint_names,
        joint_groups={"FF": (0, 1, 2, 3)},
        objects={name: f"{index:064x}" for index, name in enumerate(rows)},
    )
    write_manifest(folder, manifest)
    for name, kept in rows.items():
        counts = {
            behaviour: BehaviourCounts(attempted=number, kept=number)
            for behaviour in ("grasp", "push")
            if (number := sum(row.behaviour == behaviour for row in kept))
        }
        write_shard(folder, manifest, name, kept, clouds[name], counts)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory, hand, rows, clouds):
    return write(tmp_path_factory.mktemp("data"), hand, rows, clouds)


@pytest.fixture(scope="module")
def poses(folder, hand):
    return TrainingPoses.load(folder, hand)


def turned(vectors, angle):
    """R_z(angle) v, written out."""
    x, y, z = vectors.T
    return np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z], axis=1)


def in_frame_C(cloud):
    """The training object as it lies where its motion along `DIRECTION` is +x."""
    yaw = -DIRECTION * np.pi / 8
    moved = np.concatenate([turned(cloud[:, :3], yaw), turned(cloud[:, 3:], yaw)], axis=1)
    return torch.as_tensor(moved, dtype=torch.float32)


def start(poses, cloud, count, seed=0):
    return nearest_pose_start(poses, cloud, count=count, generator=torch.Generator().manual_seed(seed)).numpy()


def by_hand(kept):
    """The four pushes along `DIRECTION` in frame C."""
    q = np.array([row.q for row in kept[2:6]])
    yaw = -DIRECTION * np.pi / 8
    moved = [turned(q[:, first : first + 3], yaw) for first in (0, 3, 6)]
    return np.concatenate([*moved, q[:, 9:]], axis=1)


def sorted_rows(q):
    return q[np.argsort(q[:, 0])]


@pytest.mark.parametrize("name", list(SIZES))
def test_an_object_of_the_dataset_gets_its_own_feasible_hands(poses, rows, clouds, name):
    cloud = in_frame_C(clouds[name])
    assert poses.nearest(cloud[:, :3]) == (sorted(SIZES).index(name), DIRECTION)
    found = start(poses, cloud, 4)
    np.testing.assert_allclose(sorted_rows(found), sorted_rows(by_hand(rows[name])), atol=1e-5)


def test_positions_are_stretched_axis_by_axis_and_nothing_else(poses, rows, clouds):
    factor = torch.tensor([1.04, 0.97, 1.1])
    cloud = in_frame_C(clouds["long"])
    cloud[:, :3] *= factor
    found, expected = sorted_rows(start(poses, cloud, 4)), by_hand(rows["long"])
    expected[:, :3] *= factor.numpy()
    np.testing.assert_allclose(found, sorted_rows(expected), atol=1e-5)


def test_none_is_taken_twice_before_all_were_taken_once(poses, clouds):
    found = start(poses, in_frame_C(clouds["short"]), 10)
    counts = np.unique(found.round(5), axis=0, return_counts=True)[1]
    assert sorted(counts) == [2, 2, 3, 3]
    np.testing.assert_array_equal(start(poses, in_frame_C(clouds["short"]), 10), found)
    assert not np.array_equal(start(poses, in_frame_C(clouds["short"]), 10, seed=1), found)


def test_an_object_without_a_feasible_hand_is_passed_over(tmp_path, hand, rows, clouds):
    """The thick one has only hands that push it the other way; turned by 180 degrees it is its own likeness."""
    fewer = {"thick": rows["thick"][6:], "long": rows["long"]}
    poses = TrainingPoses.load(write(tmp_path, hand, fewer, clouds), hand)
    assert poses.nearest(in_frame_C(clouds["thick"])[:, :3]) == (1, DIRECTION + 8)


def test_the_sampler_projects_them(hand, problem, folder):
    result = Sampler(hand, weights="nowhere", poses=folder).draw(problem, num=3, seed=0, method="nearest_pose")
    assert result.q.shape == (3, 9 + hand.num_joints)
    assert np.isfinite(result.q).all()
    assert result.report["projection_iterations"] > 0


def test_without_a_dataset(hand, tmp_path):
    with pytest.raises(InputError) as caught:
        Sampler(hand).load("random_start_projection", "nearest_pose")
    assert str(caught.value) == (
        "the method starts from stored poses; expected a dataset folder, got none; pass one as `poses` "
        "(on the command line as `data`)"
    )
    with pytest.raises(DatasetError, match=r"manifest\.json: no such file; expected a dataset folder"):
        Sampler(hand, poses=tmp_path).load("nearest_pose")


def test_a_dataset_of_another_hand(hand, tmp_path, rows, clouds):
    write(tmp_path, hand, rows, clouds, hand_name="claw")
    with pytest.raises(DatasetError, match="holds poses of hand 'claw' with 16 joints; expected 'shadow_lite' with 16"):
        TrainingPoses.load(tmp_path, hand)


def test_a_dataset_of_grasps_alone(hand, tmp_path, rows, clouds):
    write(tmp_path, hand, {name: kept[:2] for name, kept in rows.items()}, clouds)
    with pytest.raises(DatasetError, match="holds no push, press or hook that can move its object"):
        TrainingPoses.load(tmp_path, hand)
