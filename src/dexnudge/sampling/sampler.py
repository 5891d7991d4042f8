"""The sampler: draws hand configurations for a scene, verifies every one of them, and ranks them."""

from __future__ import annotations

import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Float

from dexnudge.diffusion.checkpoint import CONFIG_NAME, SHIPPED_WEIGHTS
from dexnudge.diffusion.prior import DiffusionPrior
from dexnudge.energies.terms import EnergyTerm, check_terms
from dexnudge.errors import CheckpointError, InputError, check_integer, check_kind, check_path, check_seed, quote
from dexnudge.geometry.devices import check_device, free_memory, own_modes, ran_out_of_memory, torch_stream
from dexnudge.hands.hand import Hand
from dexnudge.results.path_margins import find_stations
from dexnudge.results.samples import Samples
from dexnudge.sampling.denoise import denoise
from dexnudge.sampling.methods import Method, find_method
from dexnudge.sampling.problem import PreparedScene, SamplingProblem
from dexnudge.sampling.projection import project
from dexnudge.sampling.random_start import random_start
from dexnudge.scenes.scene import Scene
from dexnudge.scenes.uncertainty import Uncertainty
from dexnudge.verification.criteria import Criterion, check_criteria, missing_criteria
from dexnudge.verification.penetration import hand_solids
from dexnudge.verification.verdicts import Verdicts, verify

if TYPE_CHECKING:
    from dexnudge.sampling.starts import TrainingPoses

WEIGHTS_FOLDER = "weights"  # beside a hand's description: the model that was learned for it
DEFAULT_METHOD = "steered_noise"
WITHOUT_WEIGHTS = "random_start_projection"
MAX_DRAWS_FACTOR = 32  # a search for K verified draws gives up after this many draws each, unless told otherwise
LARGEST_CALL = 10_000  # draws that are in memory, and in one batch, at once
MOST_DRAWS = MAX_DRAWS_FACTOR * LARGEST_CALL  # of a search; all of them are kept, judged and written
SMALLEST_CALL = 4  # draws: fewer take as long, since a call's own steps cost more than their arithmetic
MEMORY_PER_HAND = 2.0e5  # bytes for each hand of a batch: three times what drawing and verifying 2,048 took
MEMORY_SHARE = 0.8  # of what is free that a batch may take
NOT_CONVERGED = 10.0  # added to the residual of a draw that the projection could not finish, so that it comes last


@dataclass(frozen=True)
class Draws:
    """Draws for one scene, not verified.

    Attributes:
        q: world frame, in the sampler's own order: converged ones first, then least force residual.
        unprojected: the same draws before the projection, world frame; `q` where the method has none.
        seconds: by stage. report: what the projection did, see `project`; means over the draws.
    """

    q: Float[np.ndarray, "n coordinates"]
    unprojected: Float[np.ndarray, "n coordinates"]
    seconds: dict[str, float]
    report: dict[str, float]


class Sampler:
    """Draws configurations of one hand. Weights and stored poses are loaded when a method first needs them.

    The scene of the last call stays prepared: another call with it begins to draw at once.

    Args:
        hand: what is sampled.
        terms: energy terms of your own, felt by guidance and projection beside the built-in ones.
        weights: model folder, or a prior in memory; None for those beside the hand's description, in its folder
            `weights`, else those that ship for a hand of this name.
        device: where hands are drawn, projected and verified: "cpu", "cuda" or "cuda:1".
        poses: dataset folder, or poses in memory, for methods that start from stored poses.

    Raises:
        InputError: a device that is not there, or a term without a usable name or weight.

    Example:
        samples = Sampler(load_hand("shadow_lite")).sample(scene, num=32, seed=0)
    """

    def __init__(
        self,
        hand: Hand,
        *,
        terms: Sequence[EnergyTerm] = (),
        weights: Path | str | DiffusionPrior | None = None,
        device: str = "cpu",
        poses: Path | str | TrainingPoses | None = None,
    ) -> None:
        check_kind("hand", hand, Hand, 'load_hand("shadow_lite")')
        self.hand, self.device, self.terms = hand, check_device(device), check_terms(terms)
        self._weights, self._poses = weights, poses
        self._prepared = PreparedScene(self.device)

    @classmethod
    def from_pretrained(cls, hand: Hand, **options: Any) -> Sampler:
        """Return a sampler whose weights are loaded at once; `options` as above.

        Raises:
            CheckpointError: no weights for this hand, or weights that are broken or made for another.
        """
        sampler = cls(hand, **options)
        sampler.load(DEFAULT_METHOD)
        return sampler

    @own_modes()
    def load(self, *methods: str | Method) -> None:
        """Load what these methods start from, so that what is missing is said before anything slow begins.

        Raises:
            UnknownNameError: no such method.
            CheckpointError: weights that are missing, broken or made for another hand.
            InputError: a method starts from stored poses, and the sampler has none.
            DatasetError: a dataset that is damaged or made for another hand.
        """
        starts = {_method(method).start for method in methods}
        if "prior" in starts:
            _ = self.prior
        if "nearest" in starts:
            _ = self.poses

    @property
    def weights_folder(self) -> Path:
        """The model folder that the prior is read from: the given one, that beside the hand's file, or the shipped one."""
        if self._weights is not None and not isinstance(self._weights, DiffusionPrior):
            check_path("weights", self._weights, CheckpointError)
            return Path(self._weights)
        beside = self.hand.source.parent / WEIGHTS_FOLDER if self.hand.source else None
        return beside if beside and (beside / CONFIG_NAME).is_file() else SHIPPED_WEIGHTS / self.hand.name

    @property
    def weights_name(self) -> str:
        """Where the prior comes from: "shipped", a folder, "in memory", or "none"."""
        if isinstance(self._weights, DiffusionPrior):
            return "in memory"
        folder = self.weights_folder
        if folder.parent != SHIPPED_WEIGHTS:
            return str(folder)
        return "shipped" if folder.is_dir() else "none"

    def __repr__(self) -> str:
        return f"Sampler of {self.hand.name} on {self.device}, weights: {self.weights_name}"

    @cached_property
    def prior(self) -> DiffusionPrior:
        """The learned prior; CheckpointError where there are no usable weights for this hand."""
        if isinstance(self._weights, DiffusionPrior):
            if str(self._weights.device) != self.device:
                raise CheckpointError(
                    f"the prior that `weights` holds lies on {self._weights.device}; expected {self.device}, where this "
                    "sampler draws; load it there"
                )
            return self._weights
        folder = self.weights_folder
        if not folder.is_dir():
            got = (
                "none beside it and none that ship"
                if folder.parent == SHIPPED_WEIGHTS
                else f"{folder}, which does not exist"
            )
            raise CheckpointError(
                f"no weights for hand '{self.hand.name}': expected a model folder, got {got}; learn some with "
                "`dexnudge hand HAND --learn`, pass a model folder as `weights`, or draw without any, with `method` "
                f"{WITHOUT_WEIGHTS}"
            )
        return DiffusionPrior.from_folder(folder, self.hand, device=self.device)

    @cached_property
    def poses(self) -> TrainingPoses:
        """The stored poses; InputError where the sampler was given none."""
        if self._poses is None:
            raise InputError(
                "the method starts from stored poses; expected a dataset folder, got none; pass one as `poses` "
                "(on the command line as `data`)"
            )
        from dexnudge.sampling.starts import TrainingPoses

        return TrainingPoses.load(self._poses, self.hand) if isinstance(self._poses, str | Path) else self._poses

    @own_modes()
    def sample(
        self,
        scene: Scene,
        *,
        num: int = 32,
        seed: int = 0,
        method: str | Method = DEFAULT_METHOD,
        criteria: Sequence[Criterion] | None = None,
        verified: int | None = None,
        max_draws: int | None = None,
        problem: SamplingProblem | None = None,
        hand: Hand | None = None,
        uncertain: Uncertainty | None = None,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> Samples:
        """Draw `num` configurations, or as many as it takes to verify some; verify and rank all of them.

        The same seed gives the same samples on the same machine, and on another device the same up to rounding. What does
        not fit into the device's memory is drawn in parts; a warning says so.

        Args:
            scene: the problem.
            num: number of draws. With `verified`, draws come in calls of at most `num`, each twice as many as are still
                missing.
            seed: seed of the first call; later calls use seeds derived from it.
            method: name of a method, built in or of a package (`dexnudge plugins` lists them), or a method made from one;
                `steered_noise` unless given.
            criteria: what a draw must meet to succeed: `default_criteria()`, and your own after them.
            verified: go on drawing until this many succeed; in a scene whose motion is blocked, `num` draws end the search.
            max_draws: stop after this many draws; the default is 32 for each one asked for in `verified`.
            problem: the scene made ready, where a caller draws from it more than once; then no time is spent on it here.
            hand: the hand that is verified and that the samples carry, such as one read back from the files of a
                result; the sampler's own unless given.
            uncertain: how far the scene's numbers and the object's pose may be off, in place of the scene's `uncertainty`:
                guidance aims at where the motion is hardest to make, and draws are ranked by the share of sampled worlds
                in which they hold. A `problem` has to be of a scene that has it already.
            on_progress: called after each call with (drawn, verified).

        Raises:
            UnknownNameError: no such method.
            InputError: a seed or count out of range, `max_draws` without `verified`, a criterion that does not fit, or a
                problem or hand that is another one.
            CheckpointError: no usable weights.
        """
        check_kind("scene", scene, Scene, 'build_scene("table", "phone")')
        if uncertain is not None:
            check_kind("uncertain", uncertain, Uncertainty, "Uncertainty(friction=(0.5, 1), pose_mm=2)")
            scene = replace(scene, uncertainty=uncertain)
        check_seed(seed)
        check_counts(num, verified, max_draws)
        criteria = check_criteria(criteria)
        if missing := missing_criteria(criterion.name for criterion in criteria):
            raise InputError(
                f"`criteria` leave out {', '.join(missing)}; expected all of default_criteria(), and your own after them"
            )
        if problem is not None:
            check_kind("problem", problem, SamplingProblem, "sampling.problem.prepare(scene)")
            if not problem.scene.lies_as(scene):
                raise InputError("`problem` was prepared for another scene; expected that of `scene`; prepare it again")
        if hand is not None and hand.joint_names != self.hand.joint_names:
            raise InputError(
                f"`hand` is '{hand.name}', whose joints are not those of the sampler's '{self.hand.name}'; expected the "
                "same hand; make a sampler of it"
            )
        method, hand = _method(method), hand or self.hand
        self.load(method)
        calls: list[Draws] = []
        verdicts: list[Verdicts] = []
        seconds: Counter[str] = Counter()
        start = time.perf_counter()
        hand_solids(hand, device=self.device)  # for `verify`: what making them takes is free again for what follows
        ahead = time.perf_counter() - start
        if problem is None:
            start = time.perf_counter()
            problem = self._prepared(scene)
            if problem.balances:
                find_stations(scene)
            seconds.update({"prepare": time.perf_counter() - start})
        limit = num if verified is None else max_draws or max(num, MAX_DRAWS_FACTOR * verified)
        limit = limit if problem.balances else min(limit, num)  # without, nothing can be verified
        drawn = succeeded = 0
        most = self._most_at_once(method, min(num, limit))
        while drawn < limit and (verified is None or succeeded < verified):
            wanted = num if verified is None else max(SMALLEST_CALL, 2 * (verified - succeeded))
            size = min(wanted, num, limit - drawn, most)
            try:
                draws = self.draw(problem, num=size, seed=call_seed(seed, len(calls)), method=method)
                start = time.perf_counter()
                found = verify(scene, hand, draws.q, criteria, device=self.device)
            except (MemoryError, RuntimeError) as error:
                if not ran_out_of_memory(error):
                    raise
                most = self._smaller(size, error)
                continue
            seconds.update({**draws.seconds, "verify": time.perf_counter() - start + ahead})
            ahead = 0.0
            calls.append(draws)
            verdicts.append(found)
            drawn += size
            succeeded += int(found.success.sum())
            if on_progress:
                on_progress(drawn, succeeded)
        samples = Samples(
            scene=scene,
            hand=hand,
            q=np.concatenate([call.q for call in calls]),
            verdicts=Verdicts.concatenate(verdicts),
            own_rank=np.concatenate([np.arange(len(call.q)) for call in calls]),
            reports=tuple(call.report for call in calls),
        )
        start = time.perf_counter()
        ranked = samples.best_first()
        ranked.seconds.update(seconds, rank=time.perf_counter() - start)
        return ranked

    def _most_at_once(self, method: Method, wanted: int) -> int:
        """How many draws the memory that is free has room for; a warning where they are fewer than wanted."""
        fit = MEMORY_SHARE * free_memory(self.device) / (MEMORY_PER_HAND * method.hands_per_draw)
        if fit >= wanted:
            return wanted
        most = max(1, int(fit))
        _warn_of_split(most, f"{wanted} at once would not fit into the memory that is free on {self.device}")
        return most

    def _smaller(self, size: int, error: Exception) -> int:
        """Half of a call that ran out of memory; InputError where there is no half."""
        if size == 1:
            raise InputError(
                f"not even one draw fits into the memory of {self.device} ({error}); expected about "
                f"{MEMORY_PER_HAND / 1e6:.1f} MB beside what the scene takes; free some, or choose another `device`"
            ) from error
        _warn_of_split(size // 2, f"{size} at once ran out of the memory of {self.device}")
        return size // 2

    @own_modes()
    def draw(self, problem: SamplingProblem, *, num: int, seed: int, method: str | Method = DEFAULT_METHOD) -> Draws:
        """Return `num` draws for a prepared scene, not verified.

        Raises:
            UnknownNameError: no such method.
            CheckpointError, InputError, DatasetError: what the method starts from is missing or broken; see `load`.
            InputError: a problem that was prepared on another device.
            InputError: naming a term that fails or whose energy or gradient is of no use.
        """
        if problem.device != self.device:
            raise InputError(
                f"`problem` was prepared on {problem.device}; expected {self.device}, where this sampler draws; give the "
                "same `device` to both"
            )
        with torch_stream(self.device):
            return self._draw(replace(problem, terms=self.terms), num=num, seed=seed, method=_method(method))

    def _draw(self, problem: SamplingProblem, *, num: int, seed: int, method: Method) -> Draws:
        generator = torch.Generator(device="cpu").manual_seed(seed)
        begin = time.perf_counter()
        if method.start == "random":
            q = random_start(self.hand, problem.cloud, count=num, generator=generator).to(self.device)
        elif method.start == "nearest":
            from dexnudge.sampling.starts import nearest_pose_start

            q = nearest_pose_start(self.poses, problem.cloud, count=num, generator=generator).to(self.device)
        else:
            q = denoise(
                self.hand,
                problem,
                self.prior,
                num=num,
                rule=method.make_rule(),
                behaviour=method.behaviour,
                config=method.denoising,
                generator=generator,
            )
        drawn = time.perf_counter()
        report: dict[str, float] = {}
        unprojected = q
        if method.projection is not None:
            q, projection = project(self.hand, problem, q, config=method.projection)
            failed = ~projection["projection_converged"]
            order = torch.argsort(projection["force_residual_after"] + NOT_CONVERGED * failed, stable=True)
            q, unprojected = q[order], unprojected[order]
            report = {name: float(values.float().mean()) for name, values in projection.items()}
        seconds = {"draw": drawn - begin, "project": time.perf_counter() - drawn}
        return Draws(problem.to_world(q), problem.to_world(unprojected), seconds, report)


def _warn_of_split(most: int, why: str) -> None:
    what = f"drawn in parts of at most {most}: {why}; with the same seed, draws differ from those of larger parts"
    warnings.warn(what, stacklevel=4)


def check_counts(num: int, verified: int | None, max_draws: int | None) -> None:
    """Refuse counts that `Sampler.sample` could not serve, before anything slow has begun; InputError."""
    hints = {
        "num": (LARGEST_CALL, "the draws of one call; ask for `verified` draws, or sample again with another seed"),
        "verified": (LARGEST_CALL, "all of which are kept; sample again with another seed for more"),
        "max_draws": (MOST_DRAWS, f"{MAX_DRAWS_FACTOR} for each of {LARGEST_CALL} verified ones"),
    }
    for name, value in (("num", num), ("verified", verified), ("max_draws", max_draws)):
        if value is not None or name == "num":
            check_integer(name, value, least=1)
            most, hint = hints[name]
            if int(value) > most:  # type: ignore[arg-type]  # None is refused
                raise InputError(f"`{name}` is {quote(value)}; expected at most {most}, {hint}")
    if max_draws is not None and verified is None:
        raise InputError(
            "`max_draws` limits the search for `verified` draws; expected both or neither; use `num` instead"
        )


def _method(method: str | Method) -> Method:
    if isinstance(method, str):
        return find_method(method)
    check_kind("method", method, Method, repr(DEFAULT_METHOD))
    return method


def call_seed(seed: int, call: int) -> int:
    """Return the user's own seed for the first call, and one derived from it for each later one."""
    if call == 0:
        return seed
    return int(np.random.SeedSequence([seed, call]).generate_state(1)[0])
