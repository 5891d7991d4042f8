"""Folders of runs that a later one goes on with: a file in each says with which options, versions and machine."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError, OutputError, quote, writing
from dexnudge.jobs.digests import is_as_signed, signed
from dexnudge.jobs.json_files import MAX_TABLE_BYTES, read_json_object
from dexnudge.jobs.locks import LOCK_NAME
from dexnudge.jobs.provenance import machine, versions

AGAIN = (
    "the records beside it are not lost: the same command with another `out` writes an equal {file} at once; stop it, and "
    "copy that file here"
)


def claim_folder(
    out: Path,
    file: str,
    config: dict[str, Any],
    *,
    format_version: int,
    device: str,
    changed: Mapping[str, str] | None = None,
) -> None:
    """Make `out` the folder of a run with these options, or see that it already is.

    changed: messages for options that differ, by their names, in place of the usual one with both values.

    Raises:
        InputError: it holds a run with other options; the message names the first that differs.
        OutputError: it holds something else, or cannot be written.
    """
    path = out / file
    ours = json.loads(json.dumps(config))
    if path.is_file():
        theirs = read_claim(out, file, format_version=format_version)["config"]
        differing = [key for key in ours if theirs.get(key) != ours[key]]
        if differing:
            key = differing[0]
            usual = (
                f"{out} holds another experiment: {key} is {theirs.get(key)!r} there and {ours[key]!r} here; "
                "expected equal options to go on with it; choose another `out`"
            )
            raise InputError((changed or {}).get(key, usual))
        return
    unfinished = path.with_suffix(".partial")  # a killed run may have left it
    ignored = (unfinished.name, LOCK_NAME)
    if out.exists() and (not out.is_dir() or any(entry.name not in ignored for entry in out.iterdir())):
        records = out.is_dir() and any(out.rglob("*.jsonl"))
        kept = f"; its {file} is lost, {AGAIN.format(file=file)}" if records else ""
        raise OutputError(f"{out} exists and holds no experiment; expected a new folder; choose another `out`{kept}")
    said = {"format_version": format_version, "config": ours, "versions": versions(), "machine": machine(device)}
    with writing(out, "choose another `out`"):
        out.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(json.dumps(signed(said), indent=2) + "\n", encoding="utf-8")
        unfinished.replace(path)


def read_claim(folder: Path, file: str, *, format_version: int) -> dict[str, Any]:
    """What `claim_folder` wrote: format_version, config, versions, machine.

    Raises:
        InputError: the file is missing, damaged or of another format.
    """
    path = folder / file
    expected = "the file that `dexnudge evaluate` or `dexnudge reproduce` wrote"
    again = AGAIN.format(file=file)
    content = read_json_object(path, error=InputError, expected=expected, again=again, largest=MAX_TABLE_BYTES)
    if content.get("format_version") != format_version:
        raise InputError(f"{path} is of another format; expected format_version {format_version}; choose another `out`")
    for part in ("config", "versions", "machine"):
        if not isinstance(content.get(part), dict):
            raise InputError(f"{path}: {part} is {quote(content.get(part))}; expected an object; {again}")
    if not is_as_signed(content):
        raise InputError(f"{path} has changed since it was written: its checksum is another; {again}")
    return content
