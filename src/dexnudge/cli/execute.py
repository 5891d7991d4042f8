"""`dexnudge execute`: verified configurations played out in MuJoCo."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
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
    refuse_beside,
    refuse_without,
    say,
    stdout,
    table,
)
from dexnudge.errors import InputError

if TYPE_CHECKING:
    from dexnudge.trajectories.plan import Plan
    from dexnudge.trajectories.plan_episode import PlanEpisode

LEAST_SHORTENED = 5e-4  # [m] less is nothing in a sentence


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
    """With --then-grasp: most attempts; each goes on from where the one before left hand and object. Slides that stop short
    go on as pushes do, and spend none."""
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
        if not self.then_grasp:
            refuse_without("then_grasp", self, "attempts", "seed", "weights")
        else:
            refuse_beside("`then_grasp`, which is one simulation", self, "workers")
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
        refuse_beside("a plan, which is played as it is", self, "workers", "open_loop")
        from dexnudge.execution.folder import PUSH_FOLDER
        from dexnudge.trajectories.plan_episode import execute_plan
        from dexnudge.trajectories.plan_folder import load_plan

        folder = Path(self.folder) if Path(self.folder).is_dir() else Path(self.folder).parent
        out = out_folder(self.out, folder / PUSH_FOLDER, overwrite=self.overwrite)
        with counted("executing"):
            plan = load_plan(folder)
            lifts = plan.phases[-1].name == "lift"
            if lifts:
                refuse_beside("a plan that lifts the object itself", self, "attempts", "seed", "weights")
            if self.then_grasp and not lifts:
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
                on_progress=lambda done, total, row: show(done, total, line=_line(done, total, row)),
            )
        _print_pushes(summary, Path(self.folder))
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
        f"{summary['sentence']}: moved {1e3 * summary['length_reached']:.1f} mm, {1e3 * summary['length_asked']:.0f} asked, "
        f"orientation off by {summary['turned_deg']:.1f} deg, "
        f"{1e3 * summary['hand_environment']:.2f} mm into the surroundings"
    )
    if "lift" in summary:
        lift = summary["lift"]
        say(f"lifted by {1e3 * lift['raised']:.0f} mm, held at {1e3 * lift['least_held']:.0f} mm or above")


def _line(done: int, total: int, row: dict[str, Any] | None) -> str:
    """Return what stands in a log of a push that is done."""
    if row is None:
        return ""
    return f"executed {done} of {total}: configuration {row['configuration']}: {_named(row)}"


def _print_pushes(summary: dict[str, Any], folder: Path) -> None:
    from dexnudge.planning.outcomes import Outcome
    from dexnudge.simulation.success import MOST_ASIDE, MOST_PENETRATION, MOST_TURNED

    rows = summary["configurations"]
    played = [row for row in rows if "length_reached" in row]
    columns: dict[str, Callable[[dict[str, Any]], str]] = {}
    for name, unit, key, factor in (("turned", "deg", "angle", math.degrees(1.0)), ("moved", "mm", "length", 1e3)):
        if asked := max((factor * row[f"{key}_asked"] for row in played), default=0.0):
            columns[f"{name}\n[{unit}]\nof {asked:.0f}"] = partial(_figure, f"{key}_reached", factor)
    if played:
        columns[f"off\n[deg]\n< {MOST_TURNED:.0f}"] = partial(_figure, "turned_deg", 1.0)
        if any(row["angle_asked"] for row in played):
            columns[f"aside\n[mm]\n≤ {1e3 * MOST_ASIDE:.0f}"] = partial(_figure, "aside", 1e3)
        columns[f"depth\n[mm]\n≤ {1e3 * MOST_PENETRATION:.0f}"] = lambda row: f"{1e3 * row['hand_environment']:.2f}"
        limit = played[0]["limits"]["link_force"]
        columns[f"force\n[N]\n≤ {limit:g}"] = lambda row: f"{max(row['link_force'].values(), default=0.0):.1f}"
    shown = table("no.", "outcome", *columns)
    shown.columns[1].justify = "left"
    for row in rows:
        figures = [figure(row) if row in played else "" for figure in columns.values()]
        shown.add_row(_number(row), _named(row), *figures)
    stdout().print(shown)
    if played:
        say(
            "off: of the orientation from its motion; depth: of the hand in the surroundings; force: a link's greatest on "
            "the object, mean over 0.1 s"
        )
    said = {_named(row): Outcome(row["outcome"]).sentence for row in rows if not row["success"]}
    say(*(f"{name}: {sentence}" for name, sentence in said.items() if sentence != name))
    say(*(f"configuration {row['configuration']}: {row['detail']}" for row in rows if row["detail"]))
    whole, asked = summary["motion_length"], max((row["length_asked"] for row in played), default=0.0)
    if 0 < asked < whole - LEAST_SHORTENED:
        say(
            f"pushed by {1e3 * asked:.0f} of the motion's {1e3 * whole:.0f} mm: there enough of the object hangs over the "
            "edge to be grasped"
        )
    repeated = [_number(row) for row in rows if not row["counted"]]
    if repeated:
        say(f"not counted, as their push is counted already: {', '.join(repeated)}")
    say(f"{summary['succeeded']} of {summary['succeeded'] + summary['failed']} pushes succeed")
    left = summary["verified"] - summary["attempted"]
    if summary["succeeded"] == 0 and left > 0:
        tried = "the best alone was" if summary["attempted"] == 1 else f"the best {summary['attempted']} were"
        others = "1 other is" if left == 1 else f"{left} others are"
        top = min(summary["verified"], max(4, 2 * summary["attempted"]))
        say(f"{tried} played; {others} verified: `dexnudge execute {folder} --top {top}`")


def _figure(key: str, factor: float, row: dict[str, Any]) -> str:
    return f"{round(factor * row[key], 1) + 0.0:.1f}"


def _number(row: dict[str, Any]) -> str:
    """Return the number of a configuration, and of that with which its push began instead."""
    number, first = row["configuration"], row.get("began_with", row["configuration"])
    return str(number) if first == number else f"{number} → {first}"


def _named(row: dict[str, Any]) -> str:
    return str(row["outcome"]).replace("_", " ")


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
    say(
        "slid by: number of the configuration that slides it, none where it is grasped as it lies; overhang: free share "
        "of its length after the slide; grasps: those that hold, of all drawn so far"
    )
    first = "yes" if summary["success_first_attempt"] else "no"
    say(f"success: {'yes' if summary['success'] else 'no'}; at the first attempt: {first}")
    if summary["ended"]:
        from dexnudge.planning.outcomes import Outcome

        say(f"no further attempt: {Outcome(summary['ended']).sentence}")


def _outcome(row: dict[str, Any]) -> str:
    from dexnudge.planning.outcomes import Outcome

    detail = f" ({row['detail']})" if row["detail"] else ""
    return Outcome(row["outcome"]).sentence + detail
