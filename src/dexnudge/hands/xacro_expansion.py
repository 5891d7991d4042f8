"""xacro files expanded to URDF in memory, by the `xacro` package in a process of its own.

xacro evaluates expressions with Python's `eval`, opens whatever file an include names and has no limit of time or memory.
Here expressions may compute, and call xacro's functions, and nothing else; files must lie in the hand's folder or a given
package; the process ends after some seconds. What descriptions use is left: properties, macros, arguments with defaults,
conditions, includes, `$(find PACKAGE)` and `load_yaml`.
"""

import ast
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from dexnudge.errors import HandError

MAX_SECONDS = 4  # a hand takes half of one
MAX_MEMORY = 1 << 30  # [bytes]
SAFE_NODES = (
    *(ast.Expression, ast.Constant, ast.Name, ast.Load, ast.Attribute, ast.Subscript, ast.Slice, ast.Call, ast.keyword),
    *(ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.List, ast.Tuple, ast.Dict),
    *(ast.operator, ast.unaryop, ast.boolop, ast.cmpop),
)
NAMESPACES = ("math", "python", "xacro")
UNSAFE_CALLS = ("map", "type", "vars", "filter", "isinstance", "issubclass", "hash", "dotify")


def expand_xacro(path: Path, packages: Mapping[str, Path | str] | None = None) -> str | None:
    """Return the URDF text of a xacro file; None where the `xacro` package is not installed.

    Args:
        path: the file.
        packages: folders of the packages that `$(find NAME)` may name; the package around the file is known.

    Raises:
        HandError: an error in the file, an expression or a file that is not allowed, or too much time or memory.
    """
    from dexnudge.hands.link_meshes import description_folders  # the process that expands needs no meshes

    if find_spec("xacro") is None:
        return None
    home = path.parent.resolve()
    roots = description_folders(home)
    known = {root.name: str(root) for root in reversed(roots)}
    known |= {name: str(Path(place).resolve()) for name, place in (packages or {}).items()}
    task = {"path": str(path.resolve()), "packages": known, "roots": [*map(str, roots), *known.values()]}
    command = [sys.executable, __file__]  # not as a module of its package, which imports torch
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(  # noqa: S603 - this module, no shell
            command,
            input=json.dumps(task),
            capture_output=True,
            text=True,
            timeout=MAX_SECONDS,
            env=environment,
            check=False,
        )
        failed, text, said = done.returncode, done.stdout, done.stderr.strip().splitlines()
    except subprocess.TimeoutExpired:
        failed, text, said = -1, "", []
    if failed:
        got = (
            f"more than {MAX_SECONDS} s or {MAX_MEMORY >> 20} MiB" if failed < 0 or not said else f"'{said[-1][:300]}'"
        )
        raise HandError(
            f"{path}: xacro cannot expand it: expected properties, macros and files below the description's folder, got "
            f"{got}; mend it, or expand it yourself with: xacro {path.name} -o hand.urdf"
        )
    return text


def checked_expression(expression: str) -> str:
    """Return a xacro expression that computes with numbers, names and the listed functions; ValueError for others."""
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
        allowed = isinstance(node, SAFE_NODES) and not name.startswith("_")
        if isinstance(node, ast.Attribute):
            chain: ast.expr = node
            while isinstance(chain, ast.Attribute | ast.Subscript):
                chain = chain.value
            allowed &= isinstance(chain, ast.Name | ast.Call)
        if isinstance(node, ast.Call):
            called = node.func
            allowed &= isinstance(called, ast.Name) or (
                isinstance(called, ast.Attribute)
                and isinstance(called.value, ast.Name)
                and called.value.id in NAMESPACES
            )
        if not allowed or name in UNSAFE_CALLS:
            raise ValueError(f"the expression ${{{expression[:100]}}} does more than compute")
    return expression


def _expand(task: dict[str, Any]) -> str:
    """Expand one file, in a process of its own."""
    sys.path.pop(0)  # this folder, as the script's
    import xacro
    from xacro import substitution_args

    evaluate, absolute, parse = xacro.safe_eval, xacro.abs_filename_spec, xacro.parse
    roots = [Path(root) for root in task["roots"]]

    def inside(name: str) -> str:
        place = Path(absolute(name)).resolve()
        if not any(place.is_relative_to(root) for root in roots):
            raise xacro.XacroException(f"the file '{name}' lies outside the description's folder")
        return str(place)

    def package(name: str) -> str:
        if name not in task["packages"]:
            raise xacro.XacroException(f"the package '{name}' is unknown: name its folder in `packages`")
        return str(task["packages"][name])

    def nothing(*names: str, **_: str) -> str:
        raise xacro.XacroException(f"environment variables are not read: {names[0]}")

    def forbidden(text: str, _: object) -> str:
        raise xacro.XacroException(f"$(eval ...) is not read: write ${{...}} in its place: {text[:100]}")

    xacro.safe_eval = lambda text, *symbols: evaluate(checked_expression(text), *symbols)
    xacro.abs_filename_spec = inside
    xacro.parse = lambda text, name: parse(text, inside(name))  # what a pattern found, too
    substitution_args._eval_find, substitution_args._eval_env = package, nothing  # noqa: SLF001 - no other way in
    substitution_args._eval_optenv, substitution_args._eval = nothing, forbidden  # noqa: SLF001
    return str(xacro.process_file(inside(task["path"])).toxml())


def _main() -> int:
    with suppress(ImportError, ValueError):  # Windows has no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
    try:
        sys.stdout.write(_expand(json.load(sys.stdin)))
    except Exception as error:  # noqa: BLE001 - whatever xacro raises ends as one line for the caller
        cause = getattr(error, "exc", None) or error
        sys.stderr.write(" ".join((str(cause) or type(cause).__name__).split()) + "\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main())
