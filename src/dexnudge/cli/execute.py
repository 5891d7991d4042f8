"""`dexnudge execute`: verified configurations played out in MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dexnudge.cli.arguments import (
    NOTHING_SUCCEEDED,
    Count,
    Flag,
    OptionalFolder,
    ResultFolder,
    check_at_least,
    counted,
    out_folder,
    say,
    stdout,
    table,
)
from dexnudge.errors import InputError

if TYPE_CHECKING:
    from dexnudge.trajectories.plan import Plan
    from dexnudge.trajectories.plan_episode import PlanEpisode


@dataclass(frozen=True)
class Execute:
    """Play the best verified configurations, or a plan, out in MuJoCo: close in, squeeze, push.

    A push is as long as the motion, or ends where the object can be grasped. It succeeds if the object makes 80 % of its
    turn and of its slide, its orientation stays within 15 degrees of those of its motion, its centre goes no more than 20 mm
    below its path and, where it turns, no more than 20 mm beside it, the hand enters the surroundings by no more than 2 mm,
    and no link presses harder than allowed. With --then-grasp the object is pushed until it can be grasped, grasped, lifted
    by 10 cm and held for 2 s, in one continuous simulation. Of a plan, arm and hand move by their own motors alone, and what
    holds for the hand holds for the arm; with --then-grasp the plan goes on from where the object then lies. Exit code 3:
    nothing succeeds.
    """

    folder: ResultFolder
    """Folder that `sample` wrote, or that of a plan."""
    top: Count = 1
    """Execute this many, best first."""
    workers: Count = 2
    """Processes; one core each."""
    open_loop: Flag = False
    """Play what was planned, whatever comes of it; else the hand answers what it feels and sees."""
    then_grasp: Flag = False
    """Slide, grasp and lift."""
    attempts: Count = 3
    """With --then-grasp: most attempts; each goes on from where the one before left hand and object."""
    seed: Count = 0
    """With --then-grasp: seed of the grasps."""
    weights: OptionalFolder = None
    """With --then-grasp: folder of the model; the shipped one unless given."""
    out: OptionalFolder = None
    """Folder to write; unless given DIR/execution, with --then-grasp DIR/slide_grasp_lift, numbered where taken."""
    overwrite: Flag = False
    """Replace an existing folder of an earlier execution; other files in it stay."""
    films: Count = 1
    """Draw film.png and film.gif of the first N, which takes some seconds each; the page film.html is of each."""

    def run(self) -> int:
        """Execute, write, print."""
        check_at_least(1, top=self.top, workers=self.workers, attempts=self.attempts)
        check_at_least(0, seed=self.seed, films=self.films)
        if self.then_grasp and self.top != 1:
            raise InputError(
                f"`top` is {self.top} with `then_grasp`, which goes through the configurations by itself, best first; "
                "expected no `top`; use `attempts`"
            )
        given = Path(self.folder)
        is_plan = given.name == "plan.json" or (given / "plan.json").is_file()
        play = self._plan if is_plan else self._then_grasp if self.then_grasp else self._push
        succeeded, out = play()
        say(f"written: {out}")
        from dexnudge.execution.film import PAGE_FILE

        for film in sorted(out.rglob(PAGE_FILE))[:1]:
            say(f"watch it: {film}")
        say(f"open the model: python -m mujoco.viewer --mjcf={out / 'scene.xml'}")
        return 0 if succeeded else NOTHING_SUCCEEDED

    def _plan(self) -> tuple[bool, Path]:
        """Play the plan of the folder in a model made anew of its robot and scene; world.xml is for other simulators."""
        if self.top != 1:
            raise InputError("`top` was given with a plan, which is one way of one configuration; leave it out")
        from dexnudge.execution.folder import PUSH_FOLDER
        from dexnudge.trajectories.plan_episode import execute_plan
        from dexnudge.trajectories.plan_folder import load_plan

        folder = Path(self.folder) if Path(self.folder).is_dir() else Path(self.folder).parent
        out = out_folder(self.out, folder / PUSH_FOLDER, overwrite=self.overwrite)
        with counted("executing"):
            plan = load_plan(folder)
            if self.then_grasp and plan.phases[-1].name != "lift":
                episode, why = self._going_on(plan)
            else:
                episode, why = execute_plan(plan), ""
            episode.save(out, overwrite=self.overwrite, pictures=self.films > 0)
        _print_phases(episode.summary())
        if why:
            say(f"it was not grasped and lifted: {why}")
        return episode.success and not why, out

    def _going_on(self, plan: Plan) -> tuple[PlanEpisode, str]:
        """Play a plan that ends with its push, then grasp and lift the object where it lies; return why not, too."""
        from dexnudge.planning.outcomes import Outcome
        from dexnudge.sampling.sampler import Sampler
        from dexnudge.trajectories.regrasp import with_grasp

        sampler = Sampler.from_pretrained(plan.robot.hand, weights=self.weights)
        lifted = with_grasp(plan, sampler, attempts=self.attempts, seed=self.seed)
        if lifted.outcome is Outcome.SUCCESS:
            return lifted.episode, ""
        return lifted.episode, f"{lifted.outcome.sentence} {lifted.detail}".strip()

    def _push(self) -> tuple[bool, Path]:
        from dexnudge.execution.folder import PUSH_FOLDER, push_folder

        out = out_folder(self.out, Path(self.folder) / PUSH_FOLDER, overwrite=self.overwrite)
        with counted("executing") as show:
            summary = push_folder(
                Path(self.folder),
                top=self.top,
                feedback=not self.open_loop,
                workers=self.workers,
                out=out,
                overwrite=self.overwrite,
                films=self.films,
                on_done=lambda *_: show(advance=1),
            )
        _print_pushes(summary)
        return summary["succeeded"] > 0, out

    def _then_grasp(self) -> tuple[bool, Path]:
        from dexnudge.execution.folder import LIFT_FOLDER, lift_folder

        out = out_folder(self.out, Path(self.folder) / LIFT_FOLDER, overwrite=self.overwrite)
        with counted("slide, grasp, lift"):
            summary = lift_folder(
                Path(self.folder),
                feedback=not self.open_loop,
                attempts=self.attempts,
                seed=self.seed,
                weights=self.weights,
                out=out,
                overwrite=self.overwrite,
                films=self.films > 0,
            )
        _print_attempts(summary)
        return summary["success"], out


def _print_phases(summary: dict[str, Any]) -> None:
    shown = table(
        "phase", "palm off [mm]", "[deg]", "arm off [mrad]", "fingers off [mrad]", "torque [% of limit]", "presses [N]"
    )
    for row in summary["phases"]:
        shown.add_row(
            row["name"],
            f"{1e3 * row['palm_error']:.2f}",
            f"{row['palm_error_deg']:.2f}",
            f"{1e3 * row['arm_error']:.1f}",
            f"{1e3 * row['hand_error']:.1f}",
            f"{100 * max(row['arm_torque_share'], row['hand_torque_share']):.0f}",
            f"{row['hand_object_force']:.1f}",
        )
    stdout().print(shown)
    say(
        f"{summary['sentence']}: moved {1e3 * summary['length_reached']:.1f} of {1e3 * summary['length_asked']:.0f} mm, "
        f"orientation off by {summary['turned_deg']:.1f} deg, "
        f"{1e3 * summary['hand_environment']:.2f} mm into the surroundings"
    )
    if "lift" in summary:
        lift = summary["lift"]
        say(f"lifted by {1e3 * lift['raised']:.0f} mm, held at {1e3 * lift['least_held']:.0f} mm or above")


def _print_pushes(summary: dict[str, Any]) -> None:
    from dexnudge.simulation.success import MOST_ASIDE

    rows = summary["configurations"]
    made = {  # heading: keys of what was asked and reached, factor; a scene's object turns, slides, or does both
        heading: keys
        for heading, keys in {
            "turned [deg]": ("angle_asked", "angle_reached", math.degrees(1.0)),
            "moved [mm]": ("length_asked", "length_reached", 1e3),
        }.items()
        if any(row.get(keys[0]) for row in rows)
    }
    turns = any(row.get("angle_asked") for row in rows)
    beside = [f"aside [mm], limit {1e3 * MOST_ASIDE:.0f}"] * turns
    headings = (*made, "orientation off [deg]", *beside, "hand in surroundings [mm]")
    shown = table("configuration", "outcome", *headings)
    for row in rows:
        figures = [""] * len(headings)
        if "length_reached" in row:
            figures = [
                *(
                    f"{round(factor * row[reached], 1) + 0.0:.1f} of {factor * row[asked]:.0f}"
                    for asked, reached, factor in made.values()
                ),
                f"{row['turned_deg']:.1f}",
                *[f"{1e3 * row['aside']:.1f}"] * turns,
                f"{1e3 * row['hand_environment']:.2f}",
            ]
        shown.add_row(str(row["configuration"]), _outcome(row), *figures)
    stdout().print(shown)
    say(f"{summary['succeeded']} of {summary['attempted']} succeed")


def _print_attempts(summary: dict[str, Any]) -> None:
    shown = table("attempt", "slid by", "moved [mm]", "overhang", "grasps", "raised [mm]", "outcome")
    for row in summary["attempts"]:
        moved = row["length_reached"]
        shown.add_row(
            str(row["number"]),
            "" if row["configuration"] < 0 else str(row["configuration"]),
            "" if moved is None else f"{round(1e3 * moved)} of {1e3 * row['length_asked']:.0f}",
            "" if row["overhang"] is None else f"{row['overhang']:.0%}",
            "" if row["grasps"] < 0 else f"{row['grasps']} of {row['drawn']}",
            "" if row["raised"] is None else f"{1e3 * row['raised']:.0f}",
            f"{row['phase']}: {_outcome(row)}" if row["phase"] else "lifted and held",
        )
    stdout().print(shown)
    first = "yes" if summary["success_first_attempt"] else "no"
    say(f"success: {'yes' if summary['success'] else 'no'}; at the first attempt: {first}")
    if summary["ended"]:
        from dexnudge.planning.outcomes import Outcome

        say(f"no further attempt: {Outcome(summary['ended']).sentence}")


def _outcome(row: dict[str, Any]) -> str:
    from dexnudge.planning.outcomes import Outcome

    detail = f" ({row['detail']})" if row["detail"] else ""
    return Outcome(row["outcome"]).sentence + detail
