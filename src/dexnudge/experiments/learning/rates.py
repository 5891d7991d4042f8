"""How fast this machine learns a hand: one object's data, some steps of training and one trial, each timed once warm."""

import time
from collections import Counter

import numpy as np
import torch

from dexnudge.dataset.loading import Dataset
from dexnudge.dataset.manifest import Manifest, joint_groups
from dexnudge.dataset.schema import BEHAVIOURS
from dexnudge.diffusion.config import TrainingConfig
from dexnudge.diffusion.network import ConditionalDenoiser
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.diffusion.training_run import TrainingRun
from dexnudge.errors import DatasetError
from dexnudge.experiments.learning.plan import BATCH, DRAWS, GRASPS, METHODS, LearningRates
from dexnudge.hands.hand import Hand
from dexnudge.objects.builtin import builtin_object
from dexnudge.sampling.problem import prepare
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.families import build_scene
from dexnudge.synthesis.object_data import GeneratedObject, generate_object

OBJECT = "remote"  # neither in builtin:train nor in builtin:test
WARM_UP_ATTEMPTS, WARM_UP_STEPS = 32, 3  # the first ones load kernels and allocate memory
MEASURED_STEPS = 12
TOP_REASONS = 3


def measure_rates(hand: Hand, training: TrainingConfig, *, seed: int, grasps: bool) -> LearningRates:
    """Return the rates of this machine for a hand. training: as it will run; grasps: whether to time these, too.

    Raises:
        DatasetError: no attempt is kept, so that there is nothing to learn from.
    """
    torch.set_num_threads(1)
    mesh, generator = builtin_object(OBJECT), np.random.default_rng(seed)

    def generate(*, non_prehensile: int = 0, grasps: int = 0) -> tuple[GeneratedObject, float]:
        begun = time.perf_counter()
        made = generate_object(hand, mesh, non_prehensile=non_prehensile, grasps=grasps, generator=generator, seed=seed)
        return made, time.perf_counter() - begun

    generate(non_prehensile=WARM_UP_ATTEMPTS)
    made, seconds = generate(non_prehensile=BATCH)
    if not made.rows:
        rejected: Counter[str] = Counter()
        for count in made.counts.values():
            rejected.update(count.rejected)
        reasons = ", ".join(f"{reason} {number}" for reason, number in rejected.most_common(TOP_REASONS))
        raise DatasetError(
            f"none of {BATCH} attempts at a push, press or hook with hand '{hand.name}' is kept (rejected: {reasons}); "
            "expected some to learn from; look at the palm's direction and the fingertips in the hand's YAML"
        )
    per_grasp = generate(grasps=GRASPS[0])[-1] / GRASPS[0] if grasps else None
    step, prior = _time_steps(hand, made, training)
    return LearningRates(
        attempt=seconds / BATCH,
        kept=len(made.rows) / BATCH,
        grasp=per_grasp,
        step=step,
        trial=_time_trial(hand, prior, seed),
    )


def _time_steps(hand: Hand, made: GeneratedObject, config: TrainingConfig) -> tuple[float, DiffusionPrior]:
    """Return seconds of a step on one object's rows, and the prior that these few steps made."""
    rows = made.rows
    manifest = Manifest(hand=hand.name, joint_names=hand.joint_names, joint_groups=joint_groups(hand), objects={})
    dataset = Dataset(
        manifest=manifest,
        object_names=(OBJECT,),
        q=np.array([row.q for row in rows], dtype=np.float32),
        object_index=np.zeros(len(rows), dtype=np.int64),
        behaviour=np.array([BEHAVIOURS.index(row.behaviour) for row in rows], dtype=np.int64),
        direction_margin=np.array([row.direction_margin for row in rows], dtype=np.float32),
        clouds=made.cloud[None].astype(np.float32),
        turn_margin=np.array([row.turn_margin for row in rows], dtype=np.float32),
        turns=made.turns[None].astype(np.float32),
    )
    torch.set_num_threads(config.num_threads or 1)
    try:
        run = TrainingRun(dataset, config)
        for _ in range(WARM_UP_STEPS):
            run.advance()
        begun = time.perf_counter()
        for _ in range(MEASURED_STEPS):
            run.advance()
        seconds = (time.perf_counter() - begun) / MEASURED_STEPS
    finally:
        torch.set_num_threads(1)
    network = ConditionalDenoiser(run.model_config)
    network.load_state_dict(run.average)
    return seconds, DiffusionPrior(
        network.train(mode=False).requires_grad_(requires_grad=False), run.normaliser.to("cpu")
    )


def _time_trial(hand: Hand, prior: DiffusionPrior, seed: int) -> float:
    sampler = Sampler(hand, weights=prior)
    scene = build_scene("table", OBJECT, seed=seed)
    for method in METHODS:
        sampler.sample(scene, num=1, seed=seed, method=method)
    begun = time.perf_counter()
    problem = prepare(scene)
    for method in METHODS:
        sampler.sample(scene, num=DRAWS, seed=seed, method=method, problem=problem)
    return time.perf_counter() - begun
