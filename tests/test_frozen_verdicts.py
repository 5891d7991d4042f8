"""Verdicts and draws are those that `benchmarks/freeze_verdicts.py` wrote down."""

from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import torch

import dexnudge as dn
from dexnudge.jobs.provenance import machine

FOLDER = Path(__file__).parent / "frozen"
SCENES, SEEDS = range(31), range(13)
TOLERANCE = 1e-9
MEASURED = {
    "penetration_object": "penetration_object",
    "penetration_environment": "penetration_environment",
    "penetration_self": "penetration_self",
    "force_margin": "force_margin",
    "limits_violation": "joint_limits",
}
"""Name in a file of version 0.6 -> name of the criterion, which later files have."""
REASONS = {
    "": "",
    "invalid": "valid_pose",
    "joint limits": "joint_limits",
    "penetration environment": "penetration_environment",
    "penetration object": "penetration_object",
    "penetration self": "penetration_self",
    "no contact": "contact",
    "motion blocked": "motion_not_blocked",
    "force": "force_margin",
}
"""The same for reasons."""

hand = cache(dn.load_hand)


@cache
def frozen(name: str) -> dict[str, np.ndarray]:
    with np.load(FOLDER / name, allow_pickle=False) as arrays:
        return dict(arrays)


@cache
def sampler(hand_name: str) -> dn.Sampler:
    return dn.Sampler(hand(hand_name))


def here() -> list[str]:
    processor = {"processor": machine()["processor"], "instructions": torch.backends.cpu.get_cpu_capability()}
    packages = {name: version(name) for name in ("torch", "warp-lang", "numpy")}
    return [f"{key} {value}" for key, value in {**processor, **packages}.items()]


def test_every_frozen_scene_and_seed_is_compared() -> None:
    assert len(frozen("verdicts.npz")["family"]) == len(SCENES)
    assert len(frozen("samples.npz")["family"]) == len(SEEDS)


@pytest.mark.parametrize("place", SCENES)
def test_verdicts_are_the_frozen_ones(place: int) -> None:
    stored = frozen("verdicts.npz")
    scene = dn.build_scene(str(stored["family"][place]), str(stored["object"][place]), seed=int(stored["seed"][place]))
    if stored["reverse"][place]:
        scene = replace(scene, motion=-scene.motion)
    rows = stored["scene"] == place
    found = dn.verify(scene, hand(str(stored["hand"])), stored["q"][rows])
    assert found.reasons == [REASONS.get(reason, reason) for reason in stored["reason"][rows].tolist()]
    np.testing.assert_array_equal(found.success, stored["success"][rows])
    np.testing.assert_array_equal(found.robust, stored["robust"][rows])
    for name, criterion in MEASURED.items():
        np.testing.assert_allclose(
            found.values[criterion],
            stored[name if name in stored else criterion][rows],
            rtol=0,
            atol=TOLERANCE,
            err_msg=name,
        )
    assert [" ".join(links) for links in found.contact_links] == stored["contact_links"][rows].tolist()
    assert [len(each.points) for each in found.contacts] == stored["num_contacts"][rows].tolist()


@pytest.mark.slow
def test_draws_are_the_frozen_ones() -> None:
    """Bit for bit on the kind of machine that froze them; elsewhere they are others, and as many are verified."""
    stored = frozen("samples.npz")
    name, same, verified = str(stored["hand"]), here() == stored["platform"].tolist(), 0
    for place in SEEDS:
        seed, q = int(stored["seed"][place]), stored["q"][place]
        scene = dn.build_scene(str(stored["family"][place]), str(stored["object"][place]), seed=seed)
        found = sampler(name).sample(scene, num=len(q), seed=seed)
        verified += found.num_verified
        if same:
            assert found.q.dtype == q.dtype
            assert found.q.tobytes() == q.tobytes()
            np.testing.assert_array_equal(found.own_rank, stored["own_rank"][place])
            np.testing.assert_array_equal(found.success, stored["success"][place])
    assert abs(verified - stored["success"].sum()) <= 0.1 * stored["success"].size  # chance alone: 4 of 104
