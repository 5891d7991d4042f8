"""A sampler for given methods, with weights only where a method needs them."""

from collections.abc import Sequence
from pathlib import Path

from dexnudge.errors import InputError
from dexnudge.hands.hand import Hand
from dexnudge.sampling.methods import find_method
from dexnudge.sampling.nearest_pose import TrainingPoses
from dexnudge.sampling.sampler import Sampler


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
