"""A sampler for given methods, with weights only where a method needs them."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.errors import CheckpointError, InputError
from dexnudge.hands.hand import Hand
from dexnudge.sampling.denoise import denoise
from dexnudge.sampling.methods import Method, find_method
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.projection import ProjectionReport, project
from dexnudge.sampling.starts import TrainingPoses, nearest_pose_start, random_start
from dexnudge.scenes.scene import Scene

SHIPPED_WEIGHTS = Path(__file__).parent.parent / "weights"


@dataclass(frozen=True)
class SampleResult:
    """Draws for one scene; nothing is judged here.

    q: world frame, in the order in which the sampler would try them (its own measure: converged, then least residual).
    timings: seconds per stage. report: what guidance and projection did, means over the draws.
    """

    q: Float[np.ndarray, "n coordinates"]
    timings: dict[str, float]
    report: dict[str, Any]


class Sampler:
    """A hand with its learned prior, and the stored poses that a method may start from.

    Example:
        sampler = Sampler.from_pretrained(load_hand("shadow_lite"))
        result = sampler.sample(scene, num=32, seed=0)
    """

    def __init__(
        self, hand: Hand, prior: DiffusionPrior | None, *, device: str = "cpu", poses: TrainingPoses | None = None
    ) -> None:
        self.hand, self.prior, self.device, self.poses = hand, prior, device, poses

    @classmethod
    def from_pretrained(
        cls,
        hand: Hand,
        *,
        weights: Path | str | None = None,
        device: str = "cpu",
        poses: TrainingPoses | None = None,
    ) -> "Sampler":
        """A sampler with the weights that ship for this hand, or those in the folder `weights`.

        Raises:
            CheckpointError: no weights for this hand, or weights that are broken or made for another.
            InputError: another device than the CPU.
        """
        if device != "cpu":
            raise InputError(f"cannot sample on '{device}'; expected cpu, the only device that this version supports")
        folder = Path(weights) if weights is not None else SHIPPED_WEIGHTS / hand.name
        if not folder.is_dir():
            raise CheckpointError(
                f"no weights for hand '{hand.name}': expected a model folder, got {folder}, which does not exist; "
                "train some with `dexnudge train` and pass them with --weights"
            )
        return cls(hand, DiffusionPrior.from_folder(folder, hand, device=device), device=device, poses=poses)

    def sample(self, scene: Scene, *, num: int = 32, seed: int = 0, method: str = "steered_noise") -> SampleResult:
        """`num` draws for a scene; the same seed gives the same draws on the same machine.

        Raises:
            UnknownNameError: no such method. InputError: num below 1.
        """
        found = find_method(method)
        if num < 1:
            raise InputError(f"cannot draw {num} configurations; expected at least 1; mend --num")
        begin = time.perf_counter()
        problem = prepare(scene, device=self.device)
        prepared = time.perf_counter()
        result = self.draw(problem, num=num, seed=seed, method=found)
        result.timings["prepare"] = prepared - begin
        return result

    def draw(self, problem: SamplingProblem, *, num: int, seed: int, method: Method) -> SampleResult:
        """`num` draws for a scene whose fields are already built."""
        generator = torch.Generator().manual_seed(seed)
        begin = time.perf_counter()
        q = self._start(problem, num, method, generator)
        drawn = time.perf_counter()
        report: dict[str, Any] = {}
        if method.projection is not None:
            q, projection = project(self.hand, problem, q, config=method.projection)
            order = torch.argsort(projection.residual_after + 10.0 * (~projection.converged), stable=True)
            q, report = q[order], _summary(projection)
        timings = {"draw": drawn - begin, "project": time.perf_counter() - drawn}
        return SampleResult(problem.to_world(q), timings, report)

    def _start(
        self, problem: SamplingProblem, num: int, method: Method, generator: torch.Generator
    ) -> Float[Tensor, "num coordinates"]:
        if method.start == "random":
            return random_start(self.hand, problem.cloud, count=num, generator=generator)
        if method.start == "nearest":
            if self.poses is None:
                raise InputError("this sampler has no stored poses; expected a dataset; use `load_sampler` with `data`")
            return nearest_pose_start(self.poses, problem.cloud, count=num, generator=generator)
        if self.prior is None:
            raise CheckpointError("this sampler has no prior; expected weights; use Sampler.from_pretrained")
        return denoise(
            self.hand,
            problem,
            self.prior,
            num=num,
            rule=method.make_rule(),
            behaviour=method.behaviour,
            config=method.denoising,
            generator=generator,
        )


def _summary(report: ProjectionReport) -> dict[str, float]:
    """Means over the draws."""
    return {
        "projection_converged": float(report.converged.float().mean()),
        "projection_iterations": float(report.iterations.float().mean()),
        "projection_moved_mm": float(report.moved.mean()) * 1e3,
        "contacts_before": float(report.contacts_before.float().mean()),
        "contacts_after": float(report.contacts_after.float().mean()),
        "force_residual_before": float(report.residual_before.mean()),
        "force_residual_after": float(report.residual_after.mean()),
        "depth_before_mm": float(report.depth_before.mean()) * 1e3,
    }


def load_sampler(
    hand: Hand,
    methods: Sequence[str],
    *,
    weights: Path | str | None = None,
    data: Path | str | None = None,
    device: str = "cpu",
) -> Sampler:
    """A sampler that can run all of `methods`; a hand without weights can still run those that need none.

    Args:
        hand: what is sampled.
        methods: names in `METHODS`.
        weights: folder of the model, None for the shipped one.
        data: dataset folder, for methods that start from stored poses.
        device: where sampling runs.

    Raises:
        UnknownNameError: no such method; the message lists those that exist.
        CheckpointError: weights that are missing, broken or made for another hand.
        InputError: a method starts from stored poses, and there is no `data`.
        DatasetError: `data` is damaged or made for another hand.
    """
    starts = {method: find_method(method).start for method in methods}
    poses = None
    for method, start in starts.items():
        if start == "nearest":
            if data is None:
                raise InputError(
                    f"method '{method}' starts from stored poses; expected a dataset folder, got none; pass one with "
                    "--data DIR to `dexnudge evaluate` or `dexnudge reproduce`"
                )
            poses = TrainingPoses.load(data, hand)
    if "prior" not in starts.values():
        return Sampler(hand, None, device=device, poses=poses)
    return Sampler.from_pretrained(hand, weights=weights, device=device, poses=poses)
