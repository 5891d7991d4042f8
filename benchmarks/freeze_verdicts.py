"""Write down what this version draws and how it judges, so that a later one can be held to it.

verdicts.npz: configurations in scenes of every family, with their verdicts. samples.npz: what the default method draws.
`tests/test_frozen_verdicts.py` compares; run this again, with `--out tests/frozen`, only where a change is meant.
"""

from collections import Counter
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
import tyro

import dexnudge as dn
from dexnudge.jobs.provenance import machine

HAND = "shadow_lite"
PLAIN_OBJECTS = ("phone", "remote", "tablet", "book", "box")
DRAWS = {"steered_noise": 40, "random_start_projection": 30, "guidance_only": 30}
"""Draws in each scene by method; the last ones of all are replaced by `spoiled` ones."""
SAMPLES = 8
"""Draws of each seed in samples.npz."""
SURE = {"book": "tablet"}
"""Object for a family, where of most fewer draws are verified."""
MEASURED = ("penetration_object", "penetration_environment", "penetration_self", "force_margin", "joint_limits")


def main(out: Path) -> None:
    """Write verdicts.npz and samples.npz into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    hand = dn.load_hand(HAND)
    sampler = dn.Sampler(hand)
    _save(out / "verdicts.npz", freeze_verdicts(hand, sampler))
    _save(out / "samples.npz", freeze_samples(sampler))


def scene_table() -> list[tuple[str, str, int, bool]]:
    """Family, object, seed of each scene, and whether its motion is reversed.

    Three objects for each family, one of them with a plain name; and one more scene whose object would have to move
    through its support, which no family draws by itself.
    """
    test, rows = dn.builtin_names("test"), []
    for k, family in enumerate(dn.scene_families()):
        for name in (PLAIN_OBJECTS[k % 5], test[17 * 2 * k % len(test)], test[17 * (2 * k + 1) % len(test)]):
            rows.append((family, name, len(rows), False))
    return [*rows, ("corner", "phone", len(rows), True)]


def frozen_scene(family: str, name: str, seed: int, *, reverse: bool) -> dn.Scene:
    """The scene of one row of the table."""
    scene = dn.build_scene(family, name, seed=seed)
    return replace(scene, motion=-scene.motion) if reverse else scene


def freeze_verdicts(hand: dn.Hand, sampler: dn.Sampler) -> dict[str, np.ndarray]:
    """Configurations and verdicts, one row each; `scene` is the place of its scene in the table."""
    table = scene_table()
    parts = []
    for place, (family, name, seed, reverse) in enumerate(table):
        scene = frozen_scene(family, name, seed, reverse=reverse)
        drawn = [sampler.sample(scene, num=n, seed=seed, method=m).q for m, n in DRAWS.items()]
        q = np.concatenate(drawn).astype(np.float32)
        made = spoiled(hand, q[0], np.random.default_rng(seed))
        q[-len(made) :] = made
        source = np.repeat(list(DRAWS), list(DRAWS.values())).astype("U32")
        source[-len(made) :] = "spoiled"
        anew = frozen_scene(family, name, seed, reverse=reverse)
        verdicts = dn.verify(anew, hand, q)
        parts.append({"q": q, "source": source, "scene": np.full(len(q), place), **columns(verdicts)})
        print(family, name, dict(Counter(verdicts.reasons)), flush=True)
    families, names, seeds, reversed_ = zip(*table, strict=True)
    scenes = {"family": families, "object": names, "seed": seeds, "reverse": reversed_}
    rows = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    return {"hand": np.array(HAND), **{key: np.array(value) for key, value in scenes.items()}, **rows}


def spoiled(hand: dn.Hand, q: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """A good configuration, spoiled in every way that the sampler itself hardly ever does."""
    made = np.repeat(q[None], 8, axis=0)
    follower, leader = 9 + hand.coupled_indices[0]
    made[0, 0] = np.nan
    made[1, 12] = np.inf
    made[2, 3:6] *= 1.01  # no rotation
    made[3, 9] = hand.upper[0] + 1e-3
    made[4, leader], made[4, follower] = 0.2, 0.25
    made[5, 2] += 0.5  # nothing in reach
    made[6, 2] += 0.5  # nor here, but the fingers may cross
    made[6, 9:] = generator.uniform(hand.lower, hand.upper)
    for behind, ahead in 9 + hand.coupled_indices:
        made[6, behind] = min(made[6, behind], made[6, ahead])
    made[7, 2] -= 1e-3  # pressed
    return made


def columns(verdicts: dn.Verdicts) -> dict[str, np.ndarray]:
    """Verdicts as arrays with one row for each configuration."""
    return {
        "success": verdicts.success,
        "robust": verdicts.robust,
        "reason": np.array(verdicts.reasons, dtype="U32"),
        **{name: verdicts.values[name] for name in MEASURED},
        "num_contacts": np.array([len(each.points) for each in verdicts.contacts]),
        "contact_links": np.array([" ".join(links) for links in verdicts.contact_links], dtype="U256"),
    }


def freeze_samples(sampler: dn.Sampler) -> dict[str, np.ndarray]:
    """Draws of ten seeds, each in a scene of another family, and which of them succeed."""
    test = dn.builtin_names("test")
    table = [
        (family, SURE.get(family, test[(11 * seed + 3) % len(test)]), seed)
        for seed, family in enumerate(dn.scene_families())
    ]
    draws = [
        sampler.sample(dn.build_scene(family, name, seed=seed), num=SAMPLES, seed=seed) for family, name, seed in table
    ]
    families, names, seeds = zip(*table, strict=True)
    return {
        "hand": np.array(HAND),
        "platform": platform_lines(),
        "family": np.array(families),
        "object": np.array(names),
        "seed": np.array(seeds),
        "q": np.stack([each.q for each in draws]),
        "own_rank": np.stack([each.own_rank for each in draws]),
        "success": np.stack([each.verdicts.success for each in draws]),
    }


def platform_lines() -> np.ndarray:
    """What decides the last bits of a draw: processor, and the versions of what computes on it."""
    processor = {"processor": machine()["processor"], "instructions": torch.backends.cpu.get_cpu_capability()}
    packages = {name: version(name) for name in ("torch", "warp-lang", "numpy")}
    return np.array([f"{key} {value}" for key, value in {**processor, **packages}.items()])


def _save(path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez_compressed(path, **arrays)
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    tyro.cli(main)
