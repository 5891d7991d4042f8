"""A small made-up dataset for a hand with the Shadow Lite's joint names."""

from pathlib import Path

import numpy as np

from dexnudge.dataset.manifest import Manifest, write_manifest
from dexnudge.dataset.schema import CLOUD_POINTS, NUM_DIRECTIONS, BehaviourCounts, ConfigurationRow
from dexnudge.dataset.shards import write_shard

FINGERS = ("FF", "MF", "RF")
JOINT_NAMES = (*(f"{digit}J{k}" for digit in FINGERS for k in (4, 3, 2, 1)), "THJ5", "THJ4", "THJ2", "THJ1")
DIGIT_JOINTS = {"FF": (0, 1, 2, 3), "MF": (4, 5, 6, 7), "RF": (8, 9, 10, 11), "TH": (12, 13, 14, 15)}
DIMENSION = 9 + len(JOINT_NAMES)


def toy_manifest(num_objects: int = 3) -> Manifest:
    return Manifest(
        hand="toy",
        joint_names=JOINT_NAMES,
        joint_groups=DIGIT_JOINTS,
        objects={f"object-{k}": f"{k:064x}" for k in range(num_objects)},
        seed=7,
    )


def toy_cloud(rng: np.random.Generator) -> np.ndarray:
    """Points on an ellipsoid with its normals."""
    axes = rng.uniform([0.05, 0.03, 0.005], [0.09, 0.05, 0.02])
    unit = rng.normal(size=(CLOUD_POINTS, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    normals = unit / axes
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.concatenate([unit * axes, normals], axis=1)


def toy_row(rng: np.random.Generator, behaviour: str) -> ConfigurationRow:
    """A random configuration; pushes are feasible along four neighbouring directions."""
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    margin = np.full(NUM_DIRECTIONS, -1.0)
    if behaviour != "grasp":
        margin[(rng.integers(NUM_DIRECTIONS) + np.arange(4)) % NUM_DIRECTIONS] = rng.uniform(1.0, 3.0, size=4)
    q = np.concatenate(
        [rng.normal(0.0, 0.1, 3), rotation[:, 0], rotation[:, 1], rng.uniform(0.0, 1.5, len(JOINT_NAMES))]
    )
    digits = ("FF", "TH")[: rng.integers(1, 3)]
    return ConfigurationRow(
        behaviour=behaviour,
        q=q,
        direction_margin=margin,
        contact_links=tuple(f"{digit.lower()}distal" for digit in digits),
        contact_points=rng.normal(0.0, 0.05, (len(digits), 3)),
        digits=digits,
        penetration_object=1e-4,
        penetration_environment=0.0,
        penetration_self=2e-4,
        seed=int(rng.integers(2**62)),
        hold_translation=0.004 if behaviour == "grasp" else None,
        hold_rotation=0.02 if behaviour == "grasp" else None,
    )


def write_toy_dataset(
    folder: Path, *, num_objects: int = 3, rows: int = 12, seed: int = 0, manifest: Manifest | None = None
) -> Manifest:
    """Half grasps, half pushes; every attempt counted."""
    rng = np.random.default_rng(seed)
    manifest = manifest or toy_manifest(num_objects)
    write_manifest(folder, manifest)
    for name in manifest.objects:
        kept = [toy_row(rng, "grasp" if k % 2 else "push") for k in range(rows)]
        grasps = rows // 2
        counts = {
            "grasp": BehaviourCounts(attempted=grasps + 5, kept=grasps, failed=2, rejected={"penetration": 3}),
            "push": BehaviourCounts(attempted=rows - grasps + 1, kept=rows - grasps, rejected={"force": 1}),
        }
        write_shard(folder, manifest, name, kept, toy_cloud(rng), counts)
    return manifest
