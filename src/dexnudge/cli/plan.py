"""`dexnudge plan`: from verified configurations to a trajectory of arm and hand."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from dexnudge.cli.arguments import (
    NOTHING_SUCCEEDED,
    Count,
    Flag,
    Meshes,
    OptionalFolder,
    ResultFolder,
    check_at_least,
    counted,
    metavar,
    out_folder,
    refuse_without,
    say,
    stdout,
    table,
)
from dexnudge.cli.arm_options import MountOptions, Pose, standing_arm, typed_pose
from dexnudge.errors import PlanningError

if TYPE_CHECKING:
    from dexnudge.trajectories.plan import Plan as PlanResult

PLAN_FOLDER = "plan"
FAILURES = "failures.json"
WORTH_SAYING = 0.01  # [m] below the plane of the arm's base


@dataclass(frozen=True, kw_only=True)
class Plan(MountOptions):
    """Plan one trajectory of arm and hand: home, pre-contact, contact, squeeze, push, retreat.

    The verified configurations of DIR are tried, best first, until one has a way that is free of collisions, and as fast
    as the limits of velocity, acceleration and jerk allow. Exit code 3: none has one; the reasons are printed and written.
    """

    folder: ResultFolder
    """Folder that `sample` wrote."""
    arm: Annotated[str, metavar("NAME_OR_FILE")] = "panda"
    """Built-in arm, or a URDF or MJCF file; an unknown name lists them."""
    arm_base: Pose = ()
    """Where it stands: a JSON file with T_world_base, or metres and degrees; a sensible place unless given."""
    floor: Annotated[float | None, metavar("Z")] = None
    """What the arm stands on, height of its top [m, world]: arm and hand stay above it. Unless given, they know no floor."""
    top: Count = 8
    """Try at most this many configurations."""
    seed: Count = 0
    """Seed of the planner."""
    speed: Annotated[float, metavar("X")] = 1.0
    """Share of the joints' velocities that is used, at most 1; small for a first run on a robot."""
    then_grasp: Flag = False
    """Push until the object can be grasped, grasp it, lift it by 10 cm and hold it for 2 s."""
    weights: OptionalFolder = None
    """With --then-grasp: folder of the model that draws grasps; the shipped one unless given."""
    out: OptionalFolder = None
    """Folder to write; unless given DIR/plan, numbered where taken."""
    overwrite: Flag = False
    """Replace an existing plan."""
    meshes: Meshes = "visual"
    """What pictures and pages show of the arm: visual meshes where its description has them, or what is judged."""
    films: Count = 1
    """0: without plan.gif and plan.png, which take some seconds; the page plan.html is always written."""

    def run(self) -> int:
        """Plan, write, print."""
        check_at_least(1, top=self.top)
        check_at_least(0, seed=self.seed, films=self.films)
        if not self.then_grasp:
            refuse_without("then_grasp", self, "weights")
        from dexnudge.jobs.folders import new_folder
        from dexnudge.trajectories.plan_folder import PLAN, PLAN_FILES, write_plan

        start = time.perf_counter()
        out = out_folder(self.out, Path(self.folder) / PLAN_FOLDER, overwrite=self.overwrite)
        marker = FAILURES if (out / FAILURES).is_file() and not (out / PLAN).is_file() else PLAN
        with new_folder(out, overwrite=self.overwrite, marker=marker, ours=(PLAN, *PLAN_FILES, FAILURES)) as folder:
            seconds = {"load": 0.0}
            found = self._planned(seconds)
            if isinstance(found, PlanningError):
                _write_failures(found, folder)
            else:
                planned = time.perf_counter()
                write_plan(found, folder, pictures=self.films > 0)
                seconds |= {**found.seconds, "files and pictures": time.perf_counter() - planned}
        if isinstance(found, PlanningError):
            say("no configuration has a plan; move --arm-base (find-base shows where), turn --mount, or draw more")
            say(f"written: {out}")
            return NOTHING_SUCCEEDED
        if self.floor is None:
            _say_below(found)
        _print(found, seconds, total=time.perf_counter() - start)
        say(f"written: {out}", f"watch it: {out / 'plan.html'}", f"play it: dexnudge execute {out}")
        return 0

    def _planned(self, seconds: dict[str, float]) -> PlanResult | PlanningError:
        """Return the plan, or why there is none; add what loading took to `seconds`."""
        from dexnudge.results.folder import load_samples
        from dexnudge.trajectories.planner import plan

        start = time.perf_counter()
        arm, mount = self.loaded(self.arm), self.T_flange_mount()  # what is wrong with them is said before samples load
        typed_pose("arm_base", self.arm_base, "T_world_base")
        if self.meshes == "collision":
            arm = replace(arm, source=None)
        samples = load_samples(self.folder)
        arm = standing_arm(arm, self.arm_base, samples.scene)
        seconds["load"] = time.perf_counter() - start
        with counted("planning", total=min(self.top, samples.num_verified)) as show:
            try:
                return plan(
                    samples,
                    arm,
                    mount=mount,
                    floor=self.floor,
                    top=self.top,
                    seed=self.seed,
                    then_grasp=self.then_grasp,
                    speed=self.speed,
                    weights=self.weights,
                    on_failure=lambda _: show(advance=1),
                )
            except PlanningError as error:
                return error


def _write_failures(error: PlanningError, folder: Path) -> None:
    """Print and write why there is no plan."""
    shown = table("configuration", "phase", "reason")
    for one in error.failures:
        shown.add_row(str(one.configuration), one.phase, one.reason)
    stdout().print(shown)
    if not error.failures:
        say("none of the samples is verified")
    content = {"failures": [asdict(one) for one in error.failures]}
    (folder / FAILURES).write_text(json.dumps(content, indent=1), encoding="utf-8")


def _say_below(plan: PlanResult) -> None:
    from dexnudge.trajectories.plan import below_base

    if (below := below_base(plan)) > WORTH_SAYING:
        plane = plan.robot.arm.T_world_base[2, 3]
        say(
            f"warning: the arm comes {100 * below:.0f} cm below the plane that it stands on; --floor {plane:.3g} keeps it "
            "above, where base and object lie no lower"
        )


def _print(plan: PlanResult, seconds: dict[str, float], *, total: float) -> None:
    from dexnudge.trajectories.interpolation import limits_used

    used = limits_used(plan.trajectory, plan.robot.limits)
    shown = table("phase", "start [s]", "end [s]", "force [N]")
    for phase in plan.phases:
        force = f"{sum(phase.link_force.values()):.1f}" if phase.link_force else ""
        shown.add_row(phase.name, f"{phase.start:.2f}", f"{phase.end:.2f}", force)
    stdout().print(shown)
    arm = plan.robot.arm.num_joints
    shares = [f"position {used.position[:arm].max():.0%} of the arm, {used.position[arm:].max():.0%} of the hand"]
    shares += [f"{name} {getattr(used, name).max():.0%}" for name in ("velocity", "acceleration", "jerk")]
    say(f"configuration {plan.phases[0].configuration}; greatest share of the limits: {', '.join(shares)}")
    say(f"seconds: {', '.join(f'{stage} {value:.1f}' for stage, value in seconds.items())}; total {total:.1f}")
