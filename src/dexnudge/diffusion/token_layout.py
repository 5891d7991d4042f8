"""How the entries of x are grouped into tokens of the transformer: a choice of the architecture.

    digits    one token for the translation, one for the rotation, one for the joints of each digit
    single    one token for everything: attention has nothing to mix, the blocks are an MLP
    scalars   one token for each entry

A new layout is one function and one line in the table. Tokens at keypoints of the hand are no layout in this sense: q is
what is diffused, so they would be derived from x_t by forward kinematics, and a pose of pure noise has no meaningful ones.
"""

from collections.abc import Callable
from typing import Literal

from dexnudge.errors import UnknownNameError

TokenLayout = Literal["digits", "single", "scalars"]
Digits = tuple[tuple[int, ...], ...]  # joint indices of each digit
Parts = tuple[tuple[int, ...], ...]  # indices into x of each token

TRANSLATION, ROTATION = (0, 1, 2), (3, 4, 5, 6, 7, 8)
FIRST_JOINT = 9


def _digits(digit_joints: Digits) -> Parts:
    return (TRANSLATION, ROTATION, *(tuple(FIRST_JOINT + joint for joint in digit) for digit in digit_joints))


def _single(digit_joints: Digits) -> Parts:
    return (tuple(index for part in _digits(digit_joints) for index in part),)


def _scalars(digit_joints: Digits) -> Parts:
    return tuple((index,) for part in _digits(digit_joints) for index in part)


LAYOUTS: dict[str, Callable[[Digits], Parts]] = {"digits": _digits, "single": _single, "scalars": _scalars}


def token_parts(layout: str, digit_joints: Digits) -> Parts:
    """Indices into x of each token; together they hold each of the 9 + d entries exactly once.

    Raises UnknownNameError for a layout that is not in the table.
    """
    if layout not in LAYOUTS:
        raise UnknownNameError(f"unknown token layout {layout!r}; expected one of {', '.join(LAYOUTS)}.")
    return LAYOUTS[layout](digit_joints)
