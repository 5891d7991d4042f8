"""The order of the acts, and when a story ends; hand, object and physics are stand-ins that do what each test says."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from dexnudge.execution import slide_grasp_lift
from dexnudge.execution.grasp_and_lift import NoGrasp
from dexnudge.execution.slide_grasp_lift import SlideGraspLift
from dexnudge.simulation.lift_verdict import LiftVerdict

LIFTED = LiftVerdict("", "", 0.1, 0.1, 1.0, 0.0)
SLIPPED = LiftVerdict("lift", "slipped on lift: raised 3 of 100 mm", 0.003, 0.0, 1.0, 0.0)


@dataclass
class Acts:
    """What happens in turn, and what was done."""

    overhangs: list[float | None]
    slides: list[str] = field(default_factory=list)
    verdicts: list[LiftVerdict] = field(default_factory=list)
    fallen_after: int = 99
    grasps: bool = True
    done: list[str] = field(default_factory=list)

    def slide(self, _scene: object) -> tuple[int, str]:
        self.done.append("slide")
        return len(self.done), self.slides.pop(0)

    def lift(self, _scene: object, _chosen: object) -> None:
        self.done.append("lift")

    def why_over(self) -> str:
        return "the object fell" if self.done.count("lift") >= self.fallen_after else ""

    def choose(self, _scene: object) -> object:
        if not self.grasps:
            return NoGrasp("grasp search", "no grasp found in 96 draws")
        return SimpleNamespace(grasp=SimpleNamespace(drift=0.25))


@pytest.fixture
def story(monkeypatch):
    """Runs a story of these acts."""

    def run(acts: Acts, *, tries: int = 3):
        episode = SimpleNamespace(attempt=1, diverged=False, trace=None, last_state=np.zeros(1))
        stage = SimpleNamespace(episode=episode, scene_now=lambda: None, why_over=acts.why_over)
        monkeypatch.setattr(slide_grasp_lift, "overhang", lambda scene: acts.overhangs.pop(0))
        monkeypatch.setattr(slide_grasp_lift, "why_not_graspable", lambda scene: "stopped 9 mm short of 20% overhang")
        monkeypatch.setattr(slide_grasp_lift, "judge_lift", lambda trace, *, attempt, height: acts.verdicts.pop(0))
        runner = SlideGraspLift.__new__(SlideGraspLift)
        runner._stage = stage
        runner._slide = acts.slide
        runner._grasp = SimpleNamespace(
            choose=acts.choose,
            lift=acts.lift,
            put_back=lambda chosen: acts.done.append("put back"),
            found=[1],
            drawn=32,
        )
        return runner.run(tries)

    return run


def test_all_goes_well(story):
    acts = Acts(overhangs=[None, 0.4], slides=[""], verdicts=[LIFTED])
    told = story(acts)
    assert acts.done == ["slide", "lift"]
    (only,) = told.tries
    assert only.success
    assert (only.configuration, only.overhang, only.grasps, only.drawn, only.drift) == (1, 0.4, 1, 32, 0.25)
    assert told.ended == ""


def test_a_graspable_object_is_not_pushed(story):
    acts = Acts(overhangs=[0.35], verdicts=[LIFTED])
    assert story(acts).tries[0].configuration == -1
    assert acts.done == ["lift"]


def test_a_slip_is_put_back_and_the_next_try_goes_on_from_there(story):
    acts = Acts(overhangs=[None, 0.4, 0.4], slides=[""], verdicts=[SLIPPED, LIFTED])
    told = story(acts)
    assert acts.done == ["slide", "lift", "put back", "lift"]
    assert [(one.number, one.phase, one.success) for one in told.tries] == [(1, "lift", False), (2, "", True)]


def test_a_short_slide_and_a_failed_one_cost_a_try_each(story):
    acts = Acts(
        overhangs=[None, None, None, None, 0.3], slides=["", "the object tipped by 20 deg", ""], verdicts=[LIFTED]
    )
    told = story(acts)
    assert [(one.phase, one.reason) for one in told.tries] == [
        ("slide", "stopped 9 mm short of 20% overhang"),
        ("slide", "the object tipped by 20 deg"),
        ("", ""),
    ]


def test_a_fall_ends_the_story(story):
    acts = Acts(overhangs=[0.4, 0.4], verdicts=[SLIPPED], fallen_after=1)
    told = story(acts)
    assert acts.done == ["lift"]  # nothing is put back, nothing tried again
    assert (len(told.tries), told.ended) == (1, "the object fell")


def test_tries_are_counted(story):
    acts = Acts(overhangs=[0.4, 0.4], grasps=False)
    told = story(acts, tries=2)
    assert [(one.phase, one.reason) for one in told.tries] == [("grasp search", "no grasp found in 96 draws")] * 2
    assert told.ended == ""
