"""How long our trajectories take against what no trajectory can beat, and how long it takes to compute one.

The floor of a polyline is the least time that toppra finds on the same rounded way without limits of jerk; that of a
straight motion is ruckig's, with them.
"""

import time
from dataclasses import dataclass

import numpy as np
import tyro
from jaxtyping import Float
from ruckig import InputParameter, Ruckig, Trajectory
from scipy.interpolate import PPoly
from toppra import algorithm, constraint
from toppra.interpolator import AbstractGeometricPath

from dexnudge.arms.arm import JointLimits
from dexnudge.arms.registry import load_arm
from dexnudge.cli.arguments import stdout, table
from dexnudge.jobs.provenance import machine, versions
from dexnudge.trajectories.interpolation import limits_used
from dexnudge.trajectories.timing import CORNER, rounded_polyline, time_optimal

GRID = 500  # places along a way at which toppra keeps the limits
FINGERS = JointLimits(*(np.full(4, value) for value in (-0.2, 1.5, 2.0, 20.0, 400.0, 1.0)))


@dataclass(frozen=True)
class Benchmark:
    """Time random polylines in joint space, after one that is not counted."""

    arms: tuple[str, ...] = ("panda", "ur5e", "xarm7")
    """Arms, each alone and with four fingers that move along."""
    waypoints: tuple[int, ...] = (2, 3, 5, 10)
    """Waypoints of a polyline; two make a straight motion."""
    num: int = 10
    """Polylines of each kind."""
    seed: int = 0
    """Seed of the waypoints."""

    def run(self) -> None:
        """Print machine, versions, and a line for each arm and number of waypoints."""
        console = stdout()
        console.print("; ".join(f"{key} {value}" for key, value in {**machine(), **versions()}.items()), soft_wrap=True)
        shown = table(
            "joints", "waypoints", "ours s", "floor s", "ratio", "stops s", "median ms", "greatest ms", "limit used"
        )
        for arm in self.arms:
            limits = load_arm(arm).limits
            for name, own in ((arm, limits), (f"{arm} + fingers", limits + FINGERS)):
                for waypoints in self.waypoints:
                    shown.add_row(name, str(waypoints), *self._line(own, waypoints))
        console.print(shown)
        console.print("floor: toppra's without limits of jerk; of two waypoints ruckig's with them")
        console.print("stops: at each waypoint; ms: of the processor, for one trajectory")

    def _line(self, limits: JointLimits, waypoints: int) -> list[str]:
        rng = np.random.default_rng(self.seed)
        ours, floors, stops, costs, used = [], [], [], [], []
        for _ in range(self.num + 1):
            start = rng.uniform(limits.lower, limits.upper) * 0.5
            moves = rng.normal(scale=0.4, size=(waypoints - 1, len(start)))
            path = np.vstack([start, start + np.cumsum(moves, axis=0)]).clip(limits.lower, limits.upper)
            began = time.process_time()
            found = time_optimal(path, limits, share=1.0)
            costs.append((time.process_time() - began) * 1e3)
            ours.append(found.duration)
            stops.append(time_optimal(path, limits, share=1.0, corner=0.0).duration)
            floors.append(_straight(path, limits) if waypoints == 2 else _without_jerk(path, limits))
            shares = limits_used(found, limits)
            used.append(max(share.max() for share in (shares.velocity, shares.acceleration, shares.jerk)))
        totals = [float(np.sum(times[1:])) for times in (ours, floors, stops)]
        return [
            f"{totals[0]:.2f}",
            f"{totals[1]:.2f}",
            f"{totals[0] / totals[1]:.3f}",
            f"{totals[2]:.2f}",
            f"{np.median(costs[1:]):.1f}",
            f"{np.max(costs[1:]):.1f}",
            f"{max(used):.4f}",
        ]


def _straight(path: Float[np.ndarray, "2 n"], limits: JointLimits) -> float:
    """Return ruckig's time [s] along a straight line with all limits."""
    size = np.abs(path[1] - path[0])
    wanted, found = InputParameter(1), Trajectory(1)
    wanted.target_position = [1.0]
    wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = (
        [float((bound / size).min())] for bound in (limits.velocity, limits.acceleration, limits.jerk)
    )
    Ruckig(1).calculate(wanted, found)
    return float(found.duration)


class _Path(AbstractGeometricPath):
    waypoints = dof = path_interval = None

    def __init__(self, way: PPoly) -> None:
        self.way, self.dof, self.path_interval = way, way.c.shape[-1], way.x[[0, -1]]

    def __call__(self, path_positions: np.ndarray, order: int = 0) -> np.ndarray:
        return self.way(path_positions, order)


def _without_jerk(path: Float[np.ndarray, "waypoint n"], limits: JointLimits) -> float:
    """Return toppra's time [s] along the rounded polyline with limits of velocity and acceleration only."""
    way = rounded_polyline(path, limits.velocity, CORNER / 2)
    bounds = [np.stack([-bound, bound], axis=1) for bound in (limits.velocity, limits.acceleration)]
    constraints = [constraint.JointVelocityConstraint(bounds[0]), constraint.JointAccelerationConstraint(bounds[1])]
    grid = np.unique(np.r_[np.linspace(*way.x[[0, -1]], GRID), way.x])
    speed = algorithm.TOPPRA(constraints, _Path(way), gridpoints=grid).compute_parameterization(0.0, 0.0)[1]
    return float((2 * np.diff(grid) / (speed[1:] + speed[:-1])).sum())


if __name__ == "__main__":
    tyro.cli(Benchmark).run()
