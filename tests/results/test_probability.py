"""The probability that a configuration holds in physics: what it is computed from, and how the fit is measured."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dexnudge.finding import probability_text
from dexnudge.mechanics.contacts import HandContacts
from dexnudge.results import probability
from dexnudge.results.probability import calibrated, features, probabilities
from dexnudge.results.samples import Samples
from dexnudge.scenes.boxes import box
from dexnudge.scenes.motion import Turn
from dexnudge.scenes.scene import Scene
from dexnudge.verification.verdicts import verify

FIT = Path(__file__).parents[2] / "benchmarks" / "execution_probability.py"
SIZE = 0.16, 0.08, 0.02  # [m] of the block


@pytest.fixture
def scene():
    """A block on a floor, to be moved along x."""
    pose = np.eye(4)
    pose[2, 3] = SIZE[2] / 2
    floor = box((-0.4, -0.4, -0.02), (0.4, 0.4, 0.0))
    return Scene(trimesh.creation.box(SIZE), floor, pose, np.array([1.0, 0.0, 0.0]))


@pytest.fixture
def fitted(monkeypatch, tmp_path):
    """A model of two features."""
    of = {"mean": 0.5, "scale": 2.0, "least": 0.0, "greatest": 1.5}
    model = {"calibrated": {"hand": "boxy"}, "bias": 0.3}
    model |= {"features": {"links": of | {"weight": 0.7}, "ahead": of | {"weight": -4.0, "least": -1.0}}}
    path = tmp_path / "model.json"
    path.write_text(json.dumps(model))
    monkeypatch.setattr(probability, "MODEL", path)
    return model


def touching(*points):
    """Contacts on top of the block, each by a link of its own."""
    at = np.array(points, dtype=np.float64)
    return HandContacts(points=at, normals=np.tile([0.0, 0.0, 1.0], (len(at), 1)), link=np.arange(len(at)))


def test_features_are_those_of_two_fingertips_on_a_block(scene):
    contacts = touching((0.02, 0.03, SIZE[2]), (-0.04, 0.01, SIZE[2]))
    found = {name: float(value[0]) for name, value in features(scene, [contacts]).items()}
    assert found["links"] == found["pressing_links"] == 2
    assert (found["help"], found["least_help"], found["on_top"]) == (1.0, 1.0, 1.0)
    np.testing.assert_allclose(found["ahead"], -0.01 / 0.08)
    np.testing.assert_allclose(found["aside"], 0.02 / 0.08)
    np.testing.assert_allclose((found["spread_ahead"], found["spread_aside"]), (0.06 / 0.08, 0.02 / 0.08))
    np.testing.assert_allclose(found["height"], 0.01 / 0.08)
    np.testing.assert_allclose((found["thickness"], found["width"], found["half_length"]), (0.25, 1.0, 0.08))
    np.testing.assert_allclose(found["press_slack"], 0.4)
    assert found["margin"] == found["margin_at_end"] == found["pressing_margin"] > 1.0


def test_the_probability_is_the_logistic_sum_of_the_file(scene, fitted):
    several = [touching((0.0, 0.0, SIZE[2])), touching((0.02, 0.03, SIZE[2]), (-0.04, 0.01, SIZE[2]))]
    found = features(scene, several)
    for row, shown in enumerate(probabilities(scene, several)):
        score = fitted["bias"]
        for name, of in fitted["features"].items():
            inside = min(max(found[name][row], of["least"]), of["greatest"])
            score += of["weight"] * (inside - of["mean"]) / of["scale"]
        assert shown == pytest.approx(1 / (1 + np.exp(-score)))
    assert probabilities(scene, []).shape == (0,)


@pytest.mark.parametrize(
    ("probability", "text"),
    [
        (0.0, "<5%"),
        (0.024, "<5%"),
        (0.03, "5%"),
        (0.62, "60%"),
        (0.63, "65%"),
        (0.96, "95%"),
        (0.976, ">95%"),
        (1.0, ">95%"),
    ],
)
def test_a_probability_is_told_to_five_percent_and_never_as_certain(probability, text):
    assert probability_text(probability) == text


@pytest.mark.usefixtures("fitted")
def test_only_slides_of_the_hand_of_the_fit_have_a_probability(scene, boxy_hand):
    """Its fit knows nothing else: elsewhere it is an order, which nothing shows as a probability."""
    figures = {"probability": 0.9, "share_of_worlds": 0.5}
    assert calibrated(figures, scene, boxy_hand) == figures
    assert calibrated(figures, scene, replace(boxy_hand, name="other")) == {"share_of_worlds": 0.5}
    turning = replace(scene, turn=Turn(1.0, np.array([0.0, 0.0, 1.0]), np.zeros(3)))
    assert calibrated(figures, turning, boxy_hand) == {"share_of_worlds": 0.5}


@pytest.mark.usefixtures("fitted")
def test_check_finds_a_probability_that_is_not_true(scene, boxy_hand, tmp_path):
    from dexnudge.results.checking import check

    q = np.zeros((2, 13), dtype=np.float32)
    q[:, 3] = q[:, 7] = 1.0
    q[:, :3] = [[0.01, 0.0, SIZE[2] + 0.074], [0.3, 0.3, 0.3]]
    saved = Samples(scene, boxy_hand, q, verify(scene, boxy_hand, q)).save(tmp_path / "out")
    assert 0 < saved[0].probability < 1
    assert np.isnan(saved[1].probability)
    assert check(tmp_path / "out").agrees
    with np.load(tmp_path / "out" / "configurations.npz") as archive:
        arrays = dict(archive)
    np.savez(tmp_path / "out" / "configurations.npz", **(arrays | {"probability": np.array([0.0, np.nan])}))
    (difference,) = check(tmp_path / "out").differences
    expected = f"configuration 0: probability is 0.000 in the file, {saved[0].probability:.3f} found"
    assert difference == expected
    del arrays["probability"]
    np.savez(tmp_path / "out" / "configurations.npz", **arrays)
    assert check(tmp_path / "out").agrees  # as dexnudge 0.10 wrote it


@pytest.fixture(scope="module")
def fit():
    """The benchmark that fits, as a module."""
    spec = importlib.util.spec_from_file_location("execution_probability", FIT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_area_under_the_curve_is_the_share_of_pairs_in_order(fit):
    p, y = np.array([0.1, 0.4, 0.4, 0.9]), np.array([0.0, 1.0, 0.0, 1.0])
    pairs = [1.0 if a > b else 0.5 if a == b else 0.0 for a in p[y == 1] for b in p[y == 0]]
    assert fit.auc(p, y) == np.mean(pairs)
    assert np.isnan(fit.auc(p, np.ones(4)))


def test_the_fit_finds_the_weights_that_made_the_data_and_tells_nothing_from_noise(fit):
    rng = np.random.default_rng(0)
    X = rng.normal(size=(4000, 3)) * [1.0, 5.0, 0.2] + [0.0, 3.0, 1.0]
    truth = np.array([1.5, -0.2, 0.0])
    y = (rng.random(4000) < 1 / (1 + np.exp(-(X - [0.0, 3.0, 1.0]) @ truth))).astype(float)
    _, weight, _, scale = fit.logistic(X, y)
    np.testing.assert_allclose(weight / scale, truth, atol=0.3)
    objects = np.array([f"object {k % 40}" for k in range(4000)])
    assert fit.auc(fit.left_out(X, y, objects), y) > 0.75
    assert fit.auc(fit.left_out(rng.normal(size=(4000, 3)), y, objects), y) == pytest.approx(0.5, abs=0.05)


def test_the_interval_of_a_share_is_wilsons(fit):
    np.testing.assert_allclose(fit.wilson(8, 10), (0.4902, 0.9433), atol=1e-3)  # statsmodels proportion_confint
