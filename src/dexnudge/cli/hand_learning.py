"""`dexnudge hand HAND --learn`: the folder that is learned in, and what is printed."""

from __future__ import annotations

from pathlib import Path

from dexnudge.cli.arguments import NOTHING_SUCCEEDED, check_at_least, say
from dexnudge.errors import InputError


def learn(
    hand: str, *, out: str | None, base: bool, minutes: float | None, workers: int | None, seed: int | None
) -> int:
    """Learn a hand in its prepared folder, or in `out`, where a named hand or a description is prepared first.

    Raises:
        InputError: no folder to learn in, or one with another hand.
    """
    check_at_least(1, workers=workers)
    check_at_least(0, seed=seed)
    from dexnudge.experiments.hand_learning import learn_hand

    folder = _prepared_folder(hand, out, base=base)
    learned = learn_hand(folder, minutes=minutes, workers=workers, seed=seed, say=say)
    say(learned.report, f"written: {folder}")
    return 0 if learned.succeeded else NOTHING_SUCCEEDED


def _prepared_folder(hand: str, out: str | None, *, base: bool) -> Path:
    from dexnudge.hands.export import HAND_FILES, export_hand
    from dexnudge.hands.registry import PREPARED_NAME, load_hand
    from dexnudge.jobs.folders import new_folder

    loaded = load_hand(hand, base=base)
    if loaded.source and loaded.source.name == PREPARED_NAME and loaded.source.parent == Path(hand) and out is None:
        return Path(hand)
    if out is None:
        raise InputError(f"{hand} is no prepared folder to learn in; expected one, or `out`, the folder to make")
    folder = Path(out)
    if (folder / PREPARED_NAME).is_file():
        there = load_hand(folder)
        if (there.name, there.joint_names) != (loaded.name, loaded.joint_names):
            raise InputError(f"{folder} holds the hand '{there.name}', not '{loaded.name}'; choose another `out`")
        return folder
    with new_folder(folder, overwrite=False, marker=PREPARED_NAME, ours=HAND_FILES) as made:
        export_hand(loaded, made)
    return folder
