"""Force margins in batches, equal to the reference in `balance`, by a Warp kernel on the CPU or on CUDA."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from dexnudge.geometry.warp_runtime import THREADS, WarpStruct, wp
from dexnudge.mechanics.balance import balance_problem, problem_margin, solve_balance
from dexnudge.mechanics.contacts import ContactBatch, HandContacts
from dexnudge.mechanics.friction_cone import EDGE_COUNT
from dexnudge.mechanics.margin_kernel import FAILED_MARGIN, MEMORY_TYPES, Memory, margin_kernel
from dexnudge.mechanics.sliding_task import SlidingTask
from dexnudge.scenes.motion import Twist
from dexnudge.scenes.support_contacts import SupportContacts

WORKERS_CUDA = 4096
"""Problems solved at once on CUDA; each worker holds about 25 kB of scratch memory."""
PROBLEMS_PER_THREAD = 32
"""Problems below which a second CPU thread costs more than it saves."""


class Margins(NamedTuple):
    """Force margins and whether the forces balance at factor 1, per configuration and twist."""

    factor: Float[np.ndarray, "configuration twist"]
    balanced: Bool[np.ndarray, "configuration twist"]


def force_margins(
    contacts: Sequence[HandContacts],
    supports: SupportContacts,
    task: SlidingTask,
    *,
    twists: Sequence[Twist] | None = None,
    device: str = "cpu",
    threads: int = THREADS,
) -> Margins:
    """Return the force margin of every configuration's contacts for every twist.

    The factor is that of `balance.problem_margin`, found by the same scan and bisection; a problem that the kernel
    gives up on is passed to that reference. twists: the task's own by default.
    device: "cpu" or "cuda:0". threads: CPU threads, each running its share of the problems.
    """
    twists, contacts = [task.twist] if twists is None else twists, ContactBatch.of(contacts)
    count, shape = len(contacts) * len(twists), (len(contacts), len(twists))
    if count == 0:
        return Margins(np.zeros(shape), np.zeros(shape, dtype=bool))
    on_cpu = wp.get_device(device).is_cpu
    shares = min(threads, max(1, count // PROBLEMS_PER_THREAD)) if on_cpu else 1
    workers = shares if on_cpu else min(count, WORKERS_CUDA)
    factor = wp.zeros(count, dtype=wp.float64, device=device)
    balanced = wp.zeros(count, dtype=wp.int32, device=device)
    inputs = [*_inputs(contacts, supports, task, twists, device)]
    turns = any(twist.angular.any() for twist in twists)
    inputs.append(_memory(contacts, supports, workers, device, edges=EDGE_COUNT if turns else 1))

    def run(share: int) -> None:
        bounds = [count * share // shares, count * (share + 1) // shares]
        wp.launch(
            margin_kernel,
            dim=workers // shares,
            inputs=[*bounds, share, workers // shares, *inputs],
            outputs=[factor, balanced],
            device=device,
        )

    if shares == 1:
        run(0)
    else:
        wp.load_module(margin_kernel.module, device=device)
        with ThreadPoolExecutor(shares) as pool:
            list(pool.map(run, range(shares)))
    margins = Margins(factor.numpy().reshape(shape).copy(), balanced.numpy().reshape(shape).astype(bool))
    for row, twist in np.argwhere(margins.factor == FAILED_MARGIN).tolist():
        problem = balance_problem(contacts[row], supports, task.moving(twists[twist]))
        margins.factor[row, twist] = problem_margin(problem)
        margins.balanced[row, twist] = solve_balance(problem, factor=1.0) is not None
    return margins


def _inputs(
    contacts: ContactBatch,
    supports: SupportContacts,
    task: SlidingTask,
    twists: Sequence[Twist],
    device: str,
) -> list[Any]:
    """Return the kernel's inputs: points relative to the centre of mass in half-lengths, ragged by offsets."""
    centred = np.eye(4)
    centred[:3, 3] = -task.centre
    about_centre = [twist.moved(centred) if twist.angular.any() else twist for twist in twists]

    def vectors(rows: Float[np.ndarray, "row 3"]) -> Any:
        return wp.array(np.ascontiguousarray(rows), dtype=wp.vec3d, device=device)

    def integers(values: Any) -> Any:
        return wp.array(np.asarray(values, dtype=np.int32), dtype=wp.int32, device=device)

    def scaled(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point 3"]:
        return (points - task.centre) / task.half_length

    link, count = contacts.link_places()
    return [
        vectors(scaled(contacts.every.points)),
        vectors(contacts.every.normals),
        integers(link),
        integers(contacts.begins),
        integers(count),
        vectors(scaled(supports.points)),
        vectors(supports.normals),
        vectors(np.stack([twist.linear for twist in about_centre])),
        vectors(task.half_length * np.stack([twist.angular for twist in about_centre])),
        task.friction_hand,
        task.friction_environment,
        task.max_normal_force / task.weight,
    ]


def _memory(contacts: ContactBatch, supports: SupportContacts, workers: int, device: str, *, edges: int) -> WarpStruct:
    """Return what the workers write on: wrench columns, up to `edges` a support, keys per link, and the working basis."""
    most, memory, carrying = int(np.diff(contacts.begins).max()), Memory(), edges * len(supports.points)
    columns = {"edges": EDGE_COUNT * most, "normal": carrying, "friction": carrying}
    columns |= dict.fromkeys(("key", "key_value", "key_price"), most)
    for name, dtype in MEMORY_TYPES.items():
        shape = (workers, max(1, columns.get(name, 6)))
        setattr(memory, name, wp.empty(shape, dtype=dtype, device=device))
    return memory
