"""Draw configurations, judge every one of them, and put the verified ones first."""

import dataclasses
import itertools
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Int

from dexnudge.errors import InputError
from dexnudge.hands.hand import Hand
from dexnudge.results.samples import Samples
from dexnudge.sampling.methods import Method, find_method
from dexnudge.sampling.problem import SamplingProblem, prepare
from dexnudge.sampling.ranking import lead, mean_help, pressing_margins
from dexnudge.sampling.sampler import Sampler
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import ROBUST_MARGIN, SUCCESS_MARGIN, Verdicts, verify

MAX_DRAWS_FACTOR = 32  # a search for K verified ones gives up after this many draws each, unless told otherwise
SMALLEST_CALL = 4  # draws: fewer take as long, since a call's own steps cost more than their arithmetic


def draw_and_judge(
    sampler: Sampler,
    hand: Hand,
    scene: Scene,
    *,
    num: int = 32,
    seed: int = 0,
    method: str | Method = "steered_noise",
    verified: int | None = None,
    max_draws: int | None = None,
    problem: SamplingProblem | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Samples:
    """Draw `num` configurations, or as many as it takes to verify some.

    Args:
        sampler: where draws come from.
        hand: judges; need not be the object that the sampler holds.
        scene: the problem.
        num: draws of one call of the sampler, or the most of one call where some are to be verified: such a call draws
            twice as many as are still missing, so that the first one comes soon.
        seed: of the first call; later calls use seeds derived from it.
        method: name in `sampling.METHODS`, or one made from such a one.
        verified: go on drawing until this many succeed.
        max_draws: stop after this many draws; the default is 32 for each one asked for in `verified`.
        problem: the scene made ready, where a caller draws from it more than once; then no time is spent on it here.
        on_progress: called after each batch with (drawn, verified).

    Raises:
        UnknownNameError: no such method.
        InputError: a count below 1, or `max_draws` without `verified`.
    """
    check_counts(num, verified, max_draws)
    found = find_method(method) if isinstance(method, str) else method
    limit = num if verified is None else max_draws or max(num, MAX_DRAWS_FACTOR * verified)
    q: list[np.ndarray] = []
    verdicts: list[Verdicts] = []
    own_rank: list[np.ndarray] = []
    seconds: Counter[str] = Counter()
    reports = []
    if problem is None:
        start = time.perf_counter()
        problem = prepare(scene, device=sampler.device)
        seconds.update({"prepare": time.perf_counter() - start})
    drawn = succeeded = 0
    while drawn < limit and (verified is None or succeeded < verified):
        wanted = num if verified is None else max(SMALLEST_CALL, 2 * (verified - succeeded))
        size = min(wanted, num, limit - drawn)
        batch = sampler.draw(problem, num=size, seed=_batch_seed(seed, len(q)), method=found)
        start = time.perf_counter()
        verdicts.append(verify(hand, scene, batch.q.astype(np.float64)))
        seconds.update({**batch.timings, "verify": time.perf_counter() - start})
        q.append(batch.q)
        own_rank.append(np.arange(len(batch.q)))
        reports.append(batch.report)
        drawn += len(batch.q)
        succeeded += int(verdicts[-1].success.sum())
        if on_progress:
            on_progress(drawn, succeeded)
    together, drawn_q = _concatenate(verdicts), np.concatenate(q)
    start = time.perf_counter()
    order = best_first(scene, together)
    seconds.update({"rank": time.perf_counter() - start})
    return Samples(
        drawn_q[order], take(together, order), np.concatenate(own_rank)[order], dict(seconds), tuple(reports)
    )


def best_first(scene: Scene, verdicts: Verdicts) -> Int[np.ndarray, " n"]:
    """Order of the draws: verified ones first; among them those that push best.

    That is: by the force margin where the way begins, up to 1.5 (robust); by the least one on the way of those contacts
    alone that press or push, up to 1; by how near to the object's centre of mass or behind it they are on average; by how
    far they press or push; by the least penetration. Larger margins are those of hands that squeeze, and slip.
    """
    margin, verified = np.asarray(verdicts.force_margin), np.flatnonzero(verdicts.success)
    pressing, ahead, helping = np.zeros((3, len(margin)))
    if len(verified) > 1:
        contacts = [verdicts.contacts[row] for row in verified]
        pressing[verified] = pressing_margins(scene, contacts)
        ahead[verified], helping[verified] = lead(scene, contacts), mean_help(scene, contacts)
    deepest = np.maximum.reduce(
        [verdicts.penetration_object, verdicts.penetration_environment, verdicts.penetration_self]
    )
    order = (-np.minimum(margin, ROBUST_MARGIN), -np.minimum(pressing, SUCCESS_MARGIN), ahead, -helping, deepest)
    return np.lexsort((*reversed(order), ~verdicts.success))


def take(verdicts: Verdicts, order: Int[np.ndarray, " m"]) -> Verdicts:
    """The verdicts at the given places, in that order."""
    picked: dict[str, Any] = {}
    for field in dataclasses.fields(verdicts):
        value = getattr(verdicts, field.name)
        picked[field.name] = value[order] if isinstance(value, np.ndarray) else [value[i] for i in order]
    return dataclasses.replace(verdicts, **picked)


def _concatenate(parts: list[Verdicts]) -> Verdicts:
    joined: dict[str, Any] = {}
    for field in dataclasses.fields(parts[0]):
        values = [getattr(part, field.name) for part in parts]
        arrays = isinstance(values[0], np.ndarray)
        joined[field.name] = np.concatenate(values) if arrays else list(itertools.chain.from_iterable(values))
    return dataclasses.replace(parts[0], **joined)


def _batch_seed(seed: int, batch: int) -> int:
    """The user's own seed for the first batch, and one derived from it for each later one."""
    if batch == 0:
        return seed
    return int(np.random.SeedSequence([seed, batch]).generate_state(1)[0])


def check_counts(num: int, verified: int | None, max_draws: int | None) -> None:
    """Refuse counts that `draw_and_judge` could not serve, before anything slow has begun; InputError."""
    for name, value in (("num", num), ("verified", verified), ("max_draws", max_draws)):
        if value is not None and value < 1:
            raise InputError(f"--{name.replace('_', '-')} is {value}; expected at least 1")
    if max_draws is not None and verified is None:
        raise InputError("--max-draws limits the search of --verified K; expected both or neither; use --num instead")
