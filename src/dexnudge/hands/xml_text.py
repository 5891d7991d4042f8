"""Robot descriptions read as text: small, and without entities, which could expand or fetch without limit."""

import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable
from pathlib import Path

from dexnudge.errors import HandError


def numbers(values: Iterable[float]) -> str:
    """Return the shortest text of each value that reads back exactly, separated by spaces."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # + 0.0 turns -0.0 into 0.0


DECLARED = re.compile(rb"""\s*<\?xml[^>]*encoding=["']([\w.-]+)["']""")
ONE_BYTE = ("iso-8859-1", "iso-8859-15", "latin-1", "latin1", "windows-1252", "us-ascii")
"""Encodings in which letters of XML are those of ASCII, so that nothing hides in them."""
MAX_DESCRIPTION_BYTES = 10_000_000  # a hand's description has some ten kilobytes


def read_xml(
    path: Path, *, root_tag: str | None, expand: Callable[[Path], str | None] | None = None
) -> ElementTree.Element:
    """Return the root element of an XML file.

    Args:
        path: the file.
        root_tag: the tag that the root must have; None: any.
        expand: gives the plain text of a file with macros of xacro, or None where that cannot be had.

    Raises:
        HandError: missing, too large, in another encoding, with a DOCTYPE or entities, not well-formed, or another root.
    """
    if not os.path.isfile(path):  # noqa: PTH113 - a name of 300 letters is no file, and no error
        raise HandError(f"the description is missing: expected a file at {path}, found none; mend the path")
    size = path.stat().st_size
    if size > MAX_DESCRIPTION_BYTES:
        raise HandError(
            f"{path}: the file is too large: expected at most {MAX_DESCRIPTION_BYTES} bytes of XML, got {size}; "
            "keep meshes in files of their own"
        )
    text = _decoded(path.read_bytes(), path)
    root = _parsed(text, root_tag, path)
    if _first_macro(root) is not None and expand is not None and (plain := expand(path)) is not None:
        root = _parsed(plain, root_tag, path)
    _refuse_xacro(root, path)
    if root_tag is not None and root.tag != root_tag:
        raise HandError(
            f"{path}: wrong kind of file: expected a root element <{root_tag}>, got <{root.tag}>; mend the path"
        )
    return root


def _decoded(content: bytes, path: Path) -> str:
    """Return the text of a file in UTF-8, or in one of `ONE_BYTE` that it declares."""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        declared = DECLARED.match(content)
        if declared is None or declared[1].decode().lower() not in ONE_BYTE:
            raise HandError(
                f"{path}: not a text file: expected XML in UTF-8, got {error.reason}; save it as UTF-8"
            ) from error
        return content.decode(declared[1].decode(), errors="replace")


def _parsed(text: str, root_tag: str | None, path: Path) -> ElementTree.Element:
    refuse_entities(text, path)
    try:
        # From a str the parser takes no encoding that the file may declare, so nothing hides from the check above.
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise HandError(
            f"{path}: not well-formed XML: expected a complete <{root_tag or 'mujocoinclude'}> element, "
            f"got an error at '{error}'; mend or re-export the file"
        ) from error


def _first_macro(root: ElementTree.Element) -> ElementTree.Element | None:
    """Return the first element that xacro would expand."""
    for element in root.iter():
        if "xacro" in str(element.tag) or any("${" in value or "$(" in value for value in element.attrib.values()):
            return element
    return None


def _refuse_xacro(root: ElementTree.Element, path: Path) -> None:
    """Raise HandError where macros of xacro are left in a description."""
    element = _first_macro(root)
    if element is not None:
        plain = path.name.removesuffix(".xacro").removesuffix(".urdf") + ".urdf"
        raise HandError(
            f"{path}: the file is xacro, not yet URDF: expected plain XML, got <{str(element.tag).rpartition('}')[2]}> "
            "with a macro; install xacro, which expands it here (pip install xacro), or expand it with: "
            f"xacro {path.name} -o {'expanded.urdf' if plain == path.name else plain}"
        )


def refuse_entities(text: str, path: Path) -> None:
    """Raise HandError where an XML text declares a document type or entities."""
    for word in ("<!DOCTYPE", "<!ENTITY"):
        if word in text.upper():
            raise HandError(
                f"{path}: document types and entities are not read: expected plain XML, got '{word}'; "
                "remove it (for xacro: expand the file first)"
            )
