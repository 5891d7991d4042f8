"""What browsers send, before viser acts on it: what is malformed is dropped, and numbers stay within their control."""

import math
from collections.abc import Callable
from typing import Any

import msgspec
from viser.infra import Message

from dexnudge.errors import LONGEST_NAME

UPDATE = "GuiUpdateMessage"
MALFORMED = (msgspec.MsgspecError, AttributeError, KeyError, TypeError, ValueError, ArithmeticError, RecursionError)
"""What reading a message that no page of ours sent may raise."""


def admitted(raw: bytes | str, control: Callable[[str], Any]) -> bytes | None:
    """Return a browser's message as viser may read it; None for one that is malformed or sets what is no value.

    control: the control of an identifier, or None; with `value`, and `min` and `max` where it has them.
    """
    if isinstance(raw, str):
        return None
    try:
        message = Message.deserialize(raw)
        if any(isinstance(value, list) for value in vars(message).values()):  # a tuple of another length
            return None
        fields = msgspec.msgpack.decode(raw)
        if fields["type"] != UPDATE:
            return raw
        handle, updates = control(fields["uuid"]), fields["updates"]
        if handle is None or set(updates) != {"value"}:
            return None
        fields["updates"] = {"value": within(handle, updates["value"])}
        return msgspec.msgpack.encode(fields)
    except MALFORMED:
        return None


def within(handle: Any, value: Any) -> Any:
    """Return a value that a control can have, the nearest where a number is beyond its ends.

    Raises:
        ValueError: of another kind, too long, or not finite.
    """
    now = handle.value
    if isinstance(now, bool | str):
        if not isinstance(value, type(now)) or (isinstance(value, str) and len(value) > LONGEST_NAME):
            raise ValueError
        return value
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError
    least, most = getattr(handle, "min", None), getattr(handle, "max", None)
    value = value if least is None else max(value, least)
    return type(now)(value if most is None else min(value, most))
