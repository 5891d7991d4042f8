"""An episode from a real push with the pads: what it says, writes and shows; and a model file that MuJoCo loads."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from PIL import Image

from dexnudge.errors import CheckpointError, InputError, OutputError, quote
from dexnudge.execution.episode import Episode, execute, write_model
from dexnudge.execution.executor import chosen_policy
from dexnudge.execution.slide_grasp_lift import Attempt, SlideGraspLiftResult
from dexnudge.hands.motors import POSITION_GAIN
from dexnudge.planning.outcomes import Outcome
from dexnudge.results.samples import Sample
from dexnudge.simulation.hand_path import waiting
from dexnudge.simulation.model import scene_model
from dexnudge.simulation.open_loop import OpenLoop
from dexnudge.simulation.rollout import Rollout


@pytest.fixture(scope="module")
def sample(pad_hand, pad_grasp, block_scene):
    q, contacts = pad_grasp
    scene = replace(block_scene, motion_length=0.04)
    return Sample(scene, pad_hand, q, True, "", {"force_margin": 1.5}, contacts, ("pad0", "pad1"))


@pytest.fixture(scope="module")
def episode(sample) -> Episode:
    return execute(sample)


def test_a_push_says_what_was_asked_and_what_was_reached(episode, sample):
    assert (episode.success, episode.outcome, episode.detail) == (True, Outcome.SUCCESS, "")
    centres = episode.trace.object_pose[:, :3]
    untouched = np.flatnonzero(episode.trace.phase == "settle")[-1]
    assert episode.length_asked == 0.04
    assert episode.length_reached == pytest.approx((centres[-1] - centres[untouched])[0])
    assert episode.length_reached > 0.8 * 0.04
    reached = f"{1e3 * episode.length_reached:.1f}"
    assert repr(episode) == f"Push of pads in '{sample.scene.name}': success; {reached} mm, 40 asked"


def test_a_push_says_how_far_its_object_drifted_and_how_often_the_hand_took_hold_again(episode):
    trace, verdict = episode.trace, replace(episode.result.verdict, outcome=Outcome.DRIFTED, aside=0.0234)
    attempt = np.where(np.arange(len(trace.time)) < np.flatnonzero(trace.phase == "push")[3], 1, 2)
    played = replace(episode.result, verdict=verdict, trace=replace(trace, attempt=attempt))
    assert replace(episode, result=played).detail == "23.4 mm, took hold again 1 time"
    released = replace(trace, attempt=np.where(trace.phase == "stop", 2, 1))  # and pushed no more
    assert replace(episode, result=replace(episode.result, trace=released)).detail == ""


def test_what_is_saved_is_what_was_played(episode, tmp_path):
    out = episode.save(tmp_path / "out", pictures=False)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["outcome"] == "success"
    assert summary["policy"] == "Feedback"
    assert (summary["length_asked"], summary["length_reached"]) == (episode.length_asked, episode.length_reached)
    with np.load(out / summary["trace"], allow_pickle=False) as trace:
        np.testing.assert_array_equal(trace["qpos"], episode.trace.qpos)
        assert trace["planned_force"].shape[1:] == (len(episode.result.forces.force[0]), 3)
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    np.testing.assert_allclose(model.key_qpos[-1], episode.trace.qpos[-1], atol=1e-8)
    with pytest.raises(OutputError, match="exists"):
        episode.save(out)


def test_an_episode_is_written_in_the_hands_terms(episode, sample, tmp_path):
    out, hand = episode.save(tmp_path / "out", pictures=False), sample.hand
    figures = json.loads((out / "episode.json").read_text(encoding="utf-8"))
    assert Outcome[figures["outcome"]] is episode.outcome
    assert figures["sentence"] == episode.outcome.sentence
    with np.load(out / "episode.npz", allow_pickle=False) as saved:
        arrays = dict(saved)
    count, simulation = len(episode.trace.time), episode.simulation
    assert arrays["joint_names"].tolist() == list(hand.joint_names)
    assert arrays["link_names"].tolist() == list(hand.link_names)
    for record in (0, count // 2, count - 1):
        simulation.data.qpos[:] = arrays["qpos"][record]
        mujoco.mj_kinematics(simulation.model, simulation.data)
        for name, body in (("palm", simulation.link_body[0]), ("object", simulation.object_body)):
            pose = arrays[f"T_world_{name}"][record]
            np.testing.assert_allclose(pose[:3, 3], simulation.data.xpos[body], atol=1e-9)
            np.testing.assert_allclose(pose[:3, :3].ravel(), simulation.data.xmat[body], atol=1e-9)
        for joint, name in enumerate(hand.joint_names):
            angle = simulation.data.joint(name).qpos[0]
            assert arrays["joint_angles"][record, joint] == pytest.approx(angle)
            assert arrays["commanded_joint_angles"][record, joint] == arrays["ctrl"][record, joint]
    assert arrays["link_force"].shape == (count, len(hand.link_names))
    assert arrays["base_wrench"].shape == (count, 6)
    # The pads press as hard as their motors turn them on the block, at their levers.
    pressing = arrays["phase"] == "push"
    lacking = (arrays["commanded_joint_angles"] - arrays["joint_angles"])[pressing].mean(axis=0)
    force = arrays["link_force"][pressing][:, 1:].mean(axis=0)
    np.testing.assert_allclose(force, POSITION_GAIN * lacking / 0.5, rtol=0.1)
    greatest = arrays["link_force"].max(axis=0)
    assert figures["link_force_peak"] == pytest.approx(
        dict(zip(hand.link_names[1:], greatest[1:], strict=True)), abs=1e-3
    )
    assert figures["limits"] == {"link_force": 5.0, "base_force": 30.0, "base_torque": 9.0}
    lasting = max(figures["link_force"].values())
    assert figures["limits_used"]["link_force"] == pytest.approx(lasting / 5.0, abs=1e-3)
    assert 0.0 < figures["limits_used"]["base_force"] < 1.0


def test_a_film_is_written_by_its_suffix(episode, tmp_path):
    with Image.open(episode.film(tmp_path / "push.gif")) as film:
        assert film.n_frames > 5
    with pytest.raises(InputError, match=r"expected a name that ends in .gif, .png, .html"):
        episode.film(tmp_path / "push.mp4")


@pytest.mark.parametrize("steps", [126, 251, 250])  # ends at 0.252 s, at 0.502 s right after a record, and at 0.5 s
def test_keys_have_names_of_their_own(sample, tmp_path, steps):
    simulation = scene_model(sample.hand, sample.scene)
    rollout = Rollout(simulation, sample.q)
    rollout.follow(waiting(sample.q, seconds=0.002 * steps), "hold")
    write_model({1: rollout.trace}, tmp_path, xml=simulation.xml)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.key_time[-1] == pytest.approx(0.002 * steps)
    assert (np.diff(model.key_time) > 0).all()
    np.testing.assert_allclose(model.key_qpos[-1], rollout.trace.qpos[-1], atol=1e-8)


class Spoilt(OpenLoop):
    """The plan, at whose first step the base shall go nowhere."""

    def command(self, seen):
        """Return the command with NaN."""
        told = super().command(seen)
        return told._replace(q=np.nan * told.q)


def test_a_command_with_nan_ends_the_push(sample):
    with pytest.raises(
        InputError, match=r"^the policy Spoilt commanded a `q` beyond 1e\+06, or NaN; expected 11 finite "
    ):
        execute(sample, feedback=Spoilt())
    with pytest.raises(InputError, match=r"`feedback` is <class '.*Spoilt'>; expected True, False or a policy"):
        execute(sample, feedback=Spoilt)


class Brief(OpenLoop):
    """Ends each push after 20 steps of the plan, and counts them."""

    begun = 0

    def start(self, plan):
        """Count."""
        super().start(plan)
        self.begun, self.steps = self.begun + 1, 0

    def command(self, seen):
        """Return the plan's command, or that the push is over."""
        self.steps += 1
        return super().command(seen) if self.steps <= 20 else None


def test_a_policy_of_ones_own_ends_the_push_unless_there_are_alternatives(sample):
    ends = Brief()
    assert not execute(sample, feedback=ends).success
    assert ends.begun == 1
    goes_on = Brief()
    execute(sample, feedback=goes_on, alternatives=[sample])
    assert goes_on.begun > 1


class Halfway:
    """A policy that cannot begin."""

    def command(self, seen):
        """Return that the push is over."""


@pytest.mark.parametrize("feedback", ["off", 1, None, Halfway(), OpenLoop])
def test_what_is_no_policy_is_refused(feedback):
    with pytest.raises(InputError) as refused:
        chosen_policy(feedback)
    expected = "expected True, False or a policy with `start` and `command`"
    call = "; call the class" if feedback is OpenLoop else ""
    assert str(refused.value) == f"`feedback` is {quote(feedback)}; {expected}{call}"


def test_where_nothing_was_played_there_is_no_film(sample):
    attempt = Attempt(1, "slide", Outcome.APPROACH_BLOCKED, "the palm meets the surroundings")
    result = SlideGraspLiftResult([attempt], None, Outcome.NOTHING_PLAYED, None)
    episode = Episode(sample.scene, scene_model(sample.hand, sample.scene), result, "Feedback")
    assert (episode.success, episode.length_asked, episode.length_reached) == (False, 0.0, 0.0)
    assert "the hand has no free way to contact (the palm meets the surroundings)" in repr(episode)
    with pytest.raises(InputError, match="no film where nothing was played"):
        episode.film("none.gif")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"attempts": 0}, "`attempts` is 0; expected at least 1"),
        ({"draws": 10**9}, "`draws` is 1000000000; expected at most 10000"),
        ({"seed": -1}, "`seed` is -1; expected a whole number"),
    ],
)
def test_bad_numbers_are_refused(sample, options, message):
    with pytest.raises(InputError, match=message):
        execute(sample, then_grasp=True, **options)


def test_an_alternative_of_another_scene_is_refused(sample):
    other = replace(sample, scene=replace(sample.scene, motion=np.array([0.0, 1.0, 0.0])))
    with pytest.raises(InputError, match="of another scene or hand than `sample`"):
        execute(sample, alternatives=[other])


def test_every_outcome_has_its_sentence_and_its_name_in_lower_case():
    assert len({outcome.sentence for outcome in Outcome}) == len(Outcome)
    assert all(Outcome(outcome.value) is outcome for outcome in Outcome)
    assert all(outcome.value == name.lower() for name, outcome in Outcome.__members__.items())


def test_a_rejected_configuration_is_executed_with_a_warning(sample, tmp_path):
    rejected = replace(sample, success=False, reason="contact")
    with (
        pytest.warns(UserWarning, match="the configuration was rejected for 'contact'"),
        pytest.raises(CheckpointError),
    ):
        execute(rejected, then_grasp=True, weights=tmp_path / "nowhere")
