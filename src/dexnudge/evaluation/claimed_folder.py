"""A folder that belongs to one run: the run's options stand in it, and another run is refused."""

import json
from pathlib import Path
from typing import Any

from dexnudge.errors import InputError, OutputError
from dexnudge.evaluation.provenance import machine, versions


def claim_folder(out: Path, file: str, config: dict[str, Any], *, format_version: int, device: str) -> None:
    """Make `out` the folder of a run with these options, or see that it already is.

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
            raise InputError(
                f"{out} holds another experiment: {key} is {theirs.get(key)!r} there and {ours[key]!r} here; "
                "expected equal options to go on with it; choose another --out"
            )
        return
    unfinished = path.with_suffix(".partial")  # a killed run may have left it
    if out.exists() and (not out.is_dir() or any(entry != unfinished for entry in out.iterdir())):
        raise OutputError(f"{out} exists and holds no experiment; expected a new folder; choose another --out")
    content = {"format_version": format_version, "config": ours, "versions": versions(), "machine": machine(device)}
    try:
        out.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        unfinished.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error.strerror or error}; choose another --out") from error


def read_claim(folder: Path, file: str, *, format_version: int) -> dict[str, Any]:
    """What `claim_folder` wrote: format_version, config, versions, machine.

    Raises:
        InputError: the file is missing, damaged or of another format.
    """
    path = folder / file
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path} cannot be read ({error}); expected the file that `dexnudge evaluate` or `dexnudge reproduce` wrote"
        ) from error
    if not isinstance(content, dict) or content.get("format_version") != format_version:
        raise InputError(f"{path} is of another format; expected format_version {format_version}; choose another --out")
    return content
