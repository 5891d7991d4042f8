"""Ways in which valid bytes, numbers, JSON and XML are damaged at random."""

from __future__ import annotations

import copy
import gzip
import io
import json
import random
import re
import struct
import xml.etree.ElementTree as ElementTree
import zipfile
from typing import Any

from hostile.case import CONTROL, MARKUP

NUMBERS = ("nan", "inf", "-inf", "1e400", "1e300", "-1e300", "1e-320", "0", "-0", "-1", "1", "1e12", "9" * 400,
           "4294967295", "99999999999999999999", "0x10", "1_000", "1,5", "abc", "", "1e", "٣")  # fmt: skip
NAMES = (MARKUP, CONTROL, "", " ", "a" * 300, "a" * 100_000, "../../etc/passwd", "/etc/passwd", "/dev/zero", "a\x00b", "é",
         "\u200b", "a,b", 'a"b', "a'b&c", "%s{0}${x}$(pwd)", "C:\\x", "package://a/../../b", "file:///etc/passwd",
         "http://127.0.0.1:9/x", "nan", "null", "[bold]x[/bold]", "\ud800")  # fmt: skip
NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")


def damaged_bytes(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Return what was done, and the result: the damage that any file can take on its way."""
    place, length = rng.randrange(len(data) + 1), rng.choice((1, 4, 50, 1000))
    other = rng.randrange(len(data) + 1)
    ways = {
        "cut off": lambda: data[:place],
        "without its beginning": lambda: data[place:],
        "a hole": lambda: data[:place] + data[place + length :],
        "zeros inside": lambda: data[:place] + bytes(length) + data[place + length :],
        "a part twice": lambda: data[:place] + data[max(0, place - length) :],
        "noise inside": lambda: data[:place] + rng.randbytes(length) + data[place + length :],
        "bits flipped": lambda: _flipped(data, rng),
        "parts swapped": lambda: data[other:] + data[:other],
        "a tail": lambda: data + rng.choice((bytes(17), b"\n\n\n", rng.randbytes(100), data)),
        "a mark before it": lambda: b"\xef\xbb\xbf" + data,
        "empty": lambda: b"",
        "only whitespace": lambda: b" \r\n\t" * 20,
        "UTF-16": lambda: data.decode("latin-1").encode("utf-16"),
        "CR line ends": lambda: data.replace(b"\n", b"\r"),
        "CRLF line ends": lambda: data.replace(b"\n", b"\r\n"),
        "zipped": lambda: _zipped(data),
        "gzipped": lambda: gzip.compress(data),
        "noise": lambda: rng.randbytes(rng.choice((1, 100, 5000))),
        "one long line": lambda: data.replace(b"\n", b" "),
        "another number": lambda: changed_number(data, rng),
        "other numbers": lambda: changed_number(changed_number(data, rng), rng),
        "a large 32-bit number": lambda: data[:place] + struct.pack("<I", rng.choice((2**32 - 1, 2**31, 10**9))) + data[place + 4 :],
        "a float that is none": lambda: data[:place] + struct.pack("<f", rng.choice((float("nan"), float("inf"), 3e38))) + data[place + 4 :],
    }  # fmt: skip
    way = rng.choice(list(ways))
    return way, ways[way]()


def changed_number(data: bytes, rng: random.Random) -> bytes:
    """Return text with one number replaced; unchanged without any."""
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    start, end = rng.choice(found).span()
    return data[:start] + rng.choice(NUMBERS).encode() + data[end:]


def _flipped(data: bytes, rng: random.Random) -> bytes:
    flipped = bytearray(data)
    for _ in range(rng.choice((1, 1, 8, 64)) if data else 0):
        flipped[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(flipped)


def _zipped(data: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("file", data)
    return packed.getvalue()


def odd_values(rng: random.Random) -> Any:
    """Return a value of JSON or YAML that hardly any key expects."""
    deep: Any = []
    for _ in range(500):
        deep = [deep]
    return rng.choice((None, True, False, 0, -1, 1.5, 1e300, -1e300, 1e12, float("nan"), float("inf"), 10**400, 2**64, "",
                       [], {}, [[]], [1], {"a": 1}, [None] * 4, [1] * 10_000, deep, "1", *NAMES))  # fmt: skip


def changed_value(value: Any, rng: random.Random) -> tuple[str, Any]:
    """Return where and how one thing of a JSON value was changed, and the changed value."""
    value = copy.deepcopy(value)
    holder: Any = {"": value}
    inside, path = holder, []
    key: Any = ""
    while True:  # go down at random
        path.append(str(key))
        below = inside[key]
        if not isinstance(below, dict | list) or not below or rng.random() < 0.15:
            break
        inside, key = below, rng.choice(list(below) if isinstance(below, dict) else range(len(below)))
    way = rng.choice(("another value", "another value", "another value", "left out", "twice", "nested"))
    if way == "left out":
        del inside[key]
    elif way == "twice" and isinstance(inside, list):
        inside.insert(key, copy.deepcopy(inside[key]))
    elif way == "nested":
        inside[key] = [inside[key]]
    else:
        inside[key] = odd_values(rng)
    return f"{way}: {'/'.join(path)}", holder.get("")


def damaged_json(value: Any, rng: random.Random) -> tuple[str, bytes]:
    """Return what was done, and JSON with a value, a key or bytes damaged."""
    if rng.random() < 0.25:
        return damaged_bytes(json.dumps(value).encode(), rng)
    what, changed = changed_value(value, rng)
    text = json.dumps(changed)
    if rng.random() < 0.1 and text.startswith("{"):
        what, text = "a key twice", "{" + text[1:-1] + ", " + text[1:]
    return what, text.encode()


def damaged_xml(text: bytes, rng: random.Random, values: tuple[str, ...] = ()) -> tuple[str, bytes]:
    """Return what was done, and XML with elements, attributes or bytes damaged."""
    if rng.random() < 0.2:
        return damaged_bytes(text, rng)
    root = ElementTree.fromstring(text)  # noqa: S314 - our own
    words = (*NUMBERS, *NAMES, *values)
    done = [_changed_element(root, rng, words) for _ in range(rng.choice((1, 1, 1, 2, 3)))]
    return ", ".join(done), ElementTree.tostring(root, encoding="unicode").encode("utf-8", "surrogatepass")


def _changed_element(root: ElementTree.Element, rng: random.Random, values: tuple[str, ...]) -> str:
    elements = list(root.iter())
    above = {child: parent for parent in elements for child in parent}
    element, other, change = rng.choice(elements), rng.choice(elements), rng.randrange(8)
    key = rng.choice([*element.attrib, "extra"])
    if change == 0 and element in above:
        above[element].remove(element)
        return f"<{element.tag}> left out"
    if change == 1 and element in above:
        above[element].append(copy.deepcopy(element))
        return f"<{element.tag}> twice"
    if change == 2 and element in above and other not in element.iter():
        other.append(copy.deepcopy(element))
        return f"<{element.tag}> in <{other.tag}>"
    if change == 3:
        element.attrib.pop(key, None)
        return f"<{element.tag} {key}> left out"
    if change == 4 and other.attrib:
        element.attrib[key] = rng.choice(list(other.attrib.values()))
        return f"<{element.tag} {key}> as elsewhere"
    if change == 5 and element.attrib.get(key):
        words = element.attrib[key].split()
        words[rng.randrange(len(words)) if words else 0 :][:1] = [rng.choice(NUMBERS)]
        element.attrib[key] = " ".join([*words[:-1], rng.choice(NUMBERS)])
        return f"<{element.tag} {key}> another number"
    if element.text and element.text.strip() and rng.random() < 0.5:
        element.text = rng.choice(values)
        return f"<{element.tag}> another text"
    element.attrib[key] = rng.choice(values)
    return f"<{element.tag} {key}> another value"
