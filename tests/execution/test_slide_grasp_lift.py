"""The order of the acts, and when they end; hand, object and physics are stand-ins that do what each test says."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from dexnudge.execution import slide_grasp_lift
from dexnudge.execution.grasp_and_lift import NoGrasp
from dexnudge.execution.slide_grasp_lift import Attempt, Slide, SlideGraspLift
from dexnudge.planning.outcomes import Outcome
from dexnudge.scenes.boxes import box
from dexnudge.scenes.scene import Scene
from dexnudge.simulation.success import LiftVerdict

LIFTED = LiftVerdict("", Outcome.SUCCESS, 0.1, 0.1, 1.0, 0.0, 3.0)
SLIPPED = LiftVerdict("lift", Outcome.SLIPPED, 0.003, 0.0, 1.0, 0.0, 3.0)


@dataclass
class Acts:
    """What happens in turn, and what was done."""

    overhangs: list[float | None]
    slides: list[Outcome] = field(default_factory=list)
    verdicts: list[LiftVerdict] = field(default_factory=list)
    fallen_after: int = 99
    grasps: bool = True
    may_go_on: bool = False
    reachable_after: int = 0  # grasps that are asked for before one can be reached
    done: list[str] = field(default_factory=list)

    def slide(self, _scene: object, attempt: Attempt) -> Attempt:
        self.done.append("slide")
        outcome = self.slides.pop(0)
        if outcome is Outcome.NO_LONGER_FITS:
            return replace(attempt, outcome=outcome)
        slid = replace(attempt, configuration=len(self.done), length_asked=0.08, length_reached=0.07)
        return replace(slid, outcome=outcome)

    def lift(self, _scene: object, _chosen: object) -> None:
        self.done.append("lift")

    def why_over(self) -> Outcome | None:
        return Outcome.FELL if self.done.count("lift") >= self.fallen_after else None

    def choose(self, _scene: object) -> object:
        if not self.grasps:
            self.grasps = self.may_go_on  # farther on there are some
            return NoGrasp("grasp search", Outcome.NO_GRASP, "in 96 draws")
        if self.reachable_after > 0:
            self.reachable_after -= 1
            return NoGrasp("approach", Outcome.APPROACH_BLOCKED, "for 6 grasps")
        return SimpleNamespace(grasp=SimpleNamespace(drift=0.25))


@pytest.fixture
def play(monkeypatch):
    """Runs these acts."""

    def overhang(free: float | None):
        return free or (Outcome.STOPPED_SHORT, "9 mm short of 20% overhang")

    def run(acts: Acts, *, attempts: int = 3):
        rollout = SimpleNamespace(attempt=1, divergence=None, trace=None)
        stage = SimpleNamespace(
            begun=True,
            rollout=rollout,
            scene_now=lambda: SimpleNamespace(turn=None),
            why_over=acts.why_over,
            go_out=lambda: acts.done.append("go out"),
        )
        monkeypatch.setattr(slide_grasp_lift, "_may_go_on", lambda scene: acts.may_go_on)
        monkeypatch.setattr(slide_grasp_lift, "overhang", lambda scene: overhang(acts.overhangs.pop(0)))
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
        return runner.run(attempts)

    return run


def test_all_goes_well(play):
    acts = Acts(overhangs=[None, 0.4], slides=[Outcome.SUCCESS], verdicts=[LIFTED])
    result = play(acts)
    assert acts.done == ["slide", "lift"]
    (only,) = result.attempts
    assert only.success
    assert (only.configuration, only.overhang, only.grasps, only.drawn, only.drift) == (1, 0.4, 1, 32, 0.25)
    assert (only.length_asked, only.length_reached) == (0.08, 0.07)
    assert result.ended is None


def test_a_graspable_object_is_not_pushed(play):
    acts = Acts(overhangs=[0.35], verdicts=[LIFTED])
    assert play(acts).attempts[0].configuration == -1
    assert acts.done == ["lift"]


def test_a_slip_is_put_back_and_the_next_attempt_goes_on_from_there(play):
    acts = Acts(overhangs=[None, 0.4, 0.4], slides=[Outcome.SUCCESS], verdicts=[SLIPPED, LIFTED])
    result = play(acts)
    assert acts.done == ["slide", "lift", "put back", "lift"]
    assert [(one.number, one.phase, one.success) for one in result.attempts] == [(1, "lift", False), (2, "", True)]


def test_a_short_slide_and_a_failed_one_cost_an_attempt_each(play):
    slides = [Outcome.SUCCESS, Outcome.TIPPED, Outcome.SUCCESS]
    acts = Acts(overhangs=[None, None, None, None, 0.3], slides=slides, verdicts=[LIFTED])
    assert [(one.phase, one.outcome, one.detail) for one in play(acts).attempts] == [
        ("slide", Outcome.STOPPED_SHORT, "9 mm short of 20% overhang"),
        ("slide", Outcome.TIPPED, ""),
        ("", Outcome.SUCCESS, ""),
    ]


def test_slides_that_stop_short_go_on_as_a_push_does_and_spend_no_attempt(play):
    acts = Acts(overhangs=[None] * 16 + [0.3], slides=[Outcome.SUCCESS] * 8, verdicts=[LIFTED])
    acts.overhangs.insert(15, 0.3)  # after the eighth
    result = play(acts, attempts=1)
    assert [one.outcome for one in result.attempts] == [Outcome.STOPPED_SHORT] * 7 + [Outcome.SUCCESS]
    ever_short = Acts(overhangs=[None] * 99, slides=[Outcome.SUCCESS] * 99)
    assert len(play(ever_short, attempts=2).attempts) == 7 + 2


def test_an_attempt_that_could_only_be_repeated_is_the_last(play):
    acts = Acts(overhangs=[None] * 9, slides=[Outcome.NO_LONGER_FITS] * 9)
    result = play(acts)
    assert acts.done == ["slide"]
    assert result.ended is Outcome.NO_LONGER_FITS


def test_an_object_without_grasps_is_slid_farther_where_it_may_go(play):
    acts = Acts(overhangs=[0.21] * 3, slides=[Outcome.SUCCESS], verdicts=[LIFTED], grasps=False, may_go_on=True)
    result = play(acts)
    assert acts.done == ["slide", "lift"]
    assert [one.outcome for one in result.attempts] == [Outcome.NO_GRASP, Outcome.SUCCESS]


def test_a_farther_slide_with_nothing_to_slide_with_fails_no_attempt(play):
    acts = Acts(overhangs=[0.21] * 3, slides=[Outcome.NO_LONGER_FITS], verdicts=[LIFTED], grasps=False, may_go_on=True)
    assert [one.outcome for one in play(acts).attempts] == [Outcome.NO_GRASP, Outcome.SUCCESS]


def test_a_hand_with_no_way_to_a_grasp_goes_out_first(play):
    acts = Acts(overhangs=[0.4, 0.4], verdicts=[LIFTED], reachable_after=1)
    assert play(acts).attempts[-1].success
    assert acts.done == ["go out", "lift"]


def test_what_comes_free_by_more_at_once_is_slid_that_far(block_scene, monkeypatch):
    def plan(_scene, limits):
        return SimpleNamespace(length=0.07) if limits.overhang[1] == 0.9 else Outcome.WOULD_OVERHANG

    monkeypatch.setattr(slide_grasp_lift, "plan_object_motion", plan)
    assert slide_grasp_lift.to_be_graspable(block_scene) == 0.07


def test_an_object_that_lies_close_to_its_balance_can_be_grasped_there():
    pose = np.eye(4)
    pose[:3, 3] = -0.002, 0.0, 0.01  # 2 mm from where it would tip
    table = box((-0.3, -0.2, -0.04), (0.0, 0.2, 0.0))
    scene = Scene(trimesh.creation.box((0.1, 0.06, 0.02)), table, pose, np.array([1.0, 0.0, 0.0]))
    assert slide_grasp_lift.overhang(scene) == pytest.approx(0.48, abs=0.03)


def test_a_fall_ends_it(play):
    acts = Acts(overhangs=[0.4, 0.4], verdicts=[SLIPPED], fallen_after=1)
    result = play(acts)
    assert acts.done == ["lift"]  # nothing is put back, nothing tried again
    assert (len(result.attempts), result.ended) == (1, Outcome.FELL)


def test_attempts_are_counted(play):
    acts = Acts(overhangs=[0.4, 0.4], grasps=False)
    result = play(acts, attempts=2)
    assert [(one.phase, one.outcome) for one in result.attempts] == [("grasp search", Outcome.NO_GRASP)] * 2
    assert result.ended is None


@pytest.mark.parametrize(
    ("force", "seconds", "outcome", "lasting"),
    [
        (5.05, 0.2, Outcome.SUCCESS, 5.05),
        (5.2, 0.2, Outcome.PRESSED_TOO_HARD, 5.2),
        (9.0, 0.06, Outcome.PRESSED_TOO_HARD, 5.8),  # 9 N for 60 ms and 1 N for 40 ms
        (9.0, 0.04, Outcome.SUCCESS, 4.2),
    ],
)
def test_a_slide_is_judged_by_what_its_links_press_with_for_a_tenth_of_a_second(
    block_scene, force, seconds, outcome, lasting
):
    time = np.arange(100) * 0.02
    attempt = np.where(time < 1.0, 1, 2)
    link_force = np.ones((100, 2))
    link_force[time < 0.5] = 20.0  # of the attempt before
    link_force[(time > 1.5) & (time < 1.5 + seconds + 1e-9), 1] = force
    trace = SimpleNamespace(time=time, attempt=attempt, link_force=link_force, hand_environment_depth=np.zeros(100))
    rollout = SimpleNamespace(trace=trace, attempt=2, T_world_object=block_scene.T_world_object)
    slide = Slide.__new__(Slide)
    slide._stage = SimpleNamespace(rollout=rollout, why_over=lambda: None)
    found = slide._judged(replace(block_scene, max_normal_force=5.0))
    assert found[0] is outcome
    assert found[2] == pytest.approx(lasting)
