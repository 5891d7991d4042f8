"""`dexnudge hand HAND --learn`: learning in a prepared folder, and what is printed."""

from __future__ import annotations

from pathlib import Path

from dexnudge.cli.arguments import NOTHING_SUCCEEDED, check_at_least, say


def learn(folder: Path, *, minutes: float | None, workers: int | None, seed: int | None) -> int:
    """Learn the hand of a prepared folder in that folder, and print what came of it."""
    check_at_least(1, workers=workers)
    check_at_least(0, seed=seed)
    from dexnudge.experiments.learning.learn import learn_hand

    learned = learn_hand(folder, minutes=minutes, workers=workers, seed=seed, say=say)
    say(learned.report, f"written: {folder}")
    return 0 if learned.succeeded else NOTHING_SUCCEEDED
