"""CoACD in a process of its own, which can be ended: how long it searches cannot be told from a mesh.

Run as a script it imports nothing of dexnudge, reads a .npz (vertices, faces, settings as JSON) and writes another one
(vertices 0, vertices 1, ...).
"""

import io
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

BUSY = 5  # times longer than on a machine with nothing else to do may a search take
DELAY = 5  # [s] after which a process whose parent has gone ends by itself


def coacd_pieces(
    vertices: np.ndarray, faces: np.ndarray, settings: dict[str, Any], *, limit: float
) -> list[np.ndarray]:
    """Return the vertices (n, 3) of CoACD's pieces for a mesh (v, 3), (f, 3), in its unit; `settings` are CoACD's own.

    Kept on disk, see `geometry/disk_cache.py`: a hand's palm takes seconds, and is the same every time.

    Raises:
        TimeoutError: it took more than `limit` [s] of all cores, or five times that on a machine that is busy.
        ValueError: CoACD refuses the mesh, or dies of it.
    """
    from importlib.metadata import version

    from dexnudge.geometry.disk_cache import cached_array

    def make() -> np.ndarray:
        pieces = _search(vertices, faces, settings, limit=limit)
        return np.concatenate(
            [np.zeros((0, 4)), *(np.insert(one, 0, index, axis=1) for index, one in enumerate(pieces))]
        )

    kind = f"CoACD {version('coacd')} {json.dumps(settings, sort_keys=True)}"
    rows = cached_array(kind, [vertices, faces], make)
    return [rows[rows[:, 0] == index, 1:] for index in np.unique(rows[:, 0])]


def _search(vertices: np.ndarray, faces: np.ndarray, settings: dict[str, Any], *, limit: float) -> list[np.ndarray]:
    from dexnudge.jobs.processes import available_cores

    problem = io.BytesIO()
    limits = {"computing": limit * available_cores(), "waiting": BUSY * limit}
    np.savez(problem, vertices=vertices, faces=faces, settings=json.dumps({**settings, **limits}))
    command = [sys.executable, str(Path(__file__).resolve())]
    late = f"CoACD has not finished after {limit:g} s"
    try:
        done = subprocess.run(  # noqa: S603 - this file
            command, input=problem.getvalue(), capture_output=True, timeout=BUSY * limit, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise TimeoutError(late) from error
    if hasattr(signal, "SIGPROF") and done.returncode == -signal.SIGPROF:
        raise TimeoutError(late)
    if done.returncode != 0:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise ValueError(lines[-1] if lines else f"CoACD died with code {done.returncode}")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as found:
        return [found[f"vertices {index}"] for index in range(len(found))]


def _answer() -> None:
    import coacd

    with np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False) as problem:
        vertices, faces, settings = problem["vertices"], problem["faces"], json.loads(str(problem["settings"]))
    computing, waiting = settings.pop("computing"), settings.pop("waiting")
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, computing)
        signal.alarm(int(waiting) + DELAY)
    coacd.set_log_level("off")
    pieces = coacd.run_coacd(coacd.Mesh(vertices, faces), **settings)
    answer = io.BytesIO()
    np.savez(answer, **{f"vertices {index}": piece for index, (piece, _) in enumerate(pieces)})
    sys.stdout.buffer.write(answer.getvalue())


if __name__ == "__main__":
    _answer()
