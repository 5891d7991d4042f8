"""A result folder of Python's: what is saved is what `check` finds and what is read back."""

import json
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh

import dexnudge as dn

TIP = 0.011 + 0.032 + 0.03  # [m] of the palm's centre over the fingertips of the boxy hand


@pytest.fixture(scope="module")
def block():
    floor = trimesh.creation.box(bounds=[[-0.4, -0.4, -0.02], [0.4, 0.4, 0.0]])
    pose = np.eye(4)
    pose[2, 3] = 0.01
    return dn.Scene(trimesh.creation.box((0.16, 0.08, 0.02)), floor, pose, np.array([1.0, 0.0, 0.0]))


@dataclass
class Low:
    """The palm is lower than the limit."""

    limit: float = 0.094
    name: str = "low"

    def __call__(self, hands, scene):  # noqa: ARG002 - as the protocol has it
        height = hands.T_world_link[:, 0, 2, 3]
        return dn.CriterionResult(height, height < self.limit, "the palm is too high")


def samples(hand, scene, criteria=None):
    """Three that press on the block, from far to near, and one out of reach."""
    q = np.zeros((4, 13), dtype=np.float32)
    q[:, 3] = q[:, 7] = 1.0
    q[:, 2] = 0.02 + TIP + np.array([0.0015, 0.001, 0.0005, 0.05])
    return dn.Samples(scene, hand, q, dn.verify(scene, hand, q, criteria), reports=({"n": 1},))


def test_what_is_saved_is_found_again_and_read_back(boxy_hand, block, tmp_path):
    written = samples(boxy_hand, block).save(tmp_path / "out", title="a block")
    assert dn.check(tmp_path / "out").differences == ()
    read = dn.load_samples(tmp_path / "out")
    assert (len(read), read.num_verified, read.reasons) == (4, 3, ["", "", "", "contact"])
    np.testing.assert_array_equal(read.q, written.q)
    for name, value in written.verdicts.values.items():
        np.testing.assert_array_equal(read.verdicts.values[name], value)
    assert [each.link.tolist() for each in read.verdicts.contacts] == [
        each.link.tolist() for each in written.verdicts.contacts
    ]
    assert read[0].contact_links == ("tip_a", "tip_b")
    assert repr(read).startswith(
        "4 samples of boxy in 'user': 3 verified\n  1 rejected, first reason: contact\n  best: Sample of boxy"
    )
    for name in ("view.html", "view.png"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    read.save(tmp_path / "again")
    assert dn.check(tmp_path / "again").agrees


def test_an_existing_folder_is_replaced_only_when_told_to(boxy_hand, block, tmp_path):
    found = samples(boxy_hand, block)
    found.save(tmp_path / "out")
    with pytest.raises(dn.OutputError, match="exists"):
        found.save(tmp_path / "out")
    written = {path.relative_to(tmp_path / "out") for path in (tmp_path / "out").rglob("*") if path.is_file()}
    kept = [tmp_path / "out" / name for name in ("my_notes.txt", "execution/summary.json", "hand/licence.txt")]
    for path in kept:
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
    (tmp_path / "out" / "hand" / "meshes" / "of_another_hand.obj").write_text("o")
    found[:2].save(tmp_path / "out", overwrite=True)
    assert len(dn.load_samples(tmp_path / "out")) == 2
    assert [path.read_text() for path in kept] == ["mine"] * 3
    files = {path for path in (tmp_path / "out").rglob("*") if path.is_file()} - {*kept}
    assert {path.relative_to(tmp_path / "out") for path in files} == written
    with pytest.raises(dn.InputError, match="there are no samples to save"):
        found[:0].save(tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_comma_in_the_name_of_a_link_is_no_difference(boxy_hand, block, tmp_path):
    names = ("palm", "near_a", "tip, a", "near_b", "tip_b")
    hand = replace(boxy_hand, link_names=names, fingertips={"a": "tip, a", "b": "tip_b"})
    samples(hand, block).save(tmp_path / "out")
    assert dn.check(tmp_path / "out").differences == ()
    assert dn.load_samples(tmp_path / "out")[0].contact_links == ("tip, a", "tip_b")


def test_a_criterion_of_ones_own_is_written_shown_and_named_where_it_is_not_installed(boxy_hand, block, tmp_path):
    found = samples(boxy_hand, block, [*dn.default_criteria(), Low()])
    assert found.reasons == ["low", "", "", "contact"]
    written = found.save(tmp_path / "out")
    assert written.reasons == ["", "", "low", "contact"]
    with np.load(tmp_path / "out" / "configurations.npz", allow_pickle=False) as arrays:
        np.testing.assert_allclose(arrays["low"], written.q[:, 2])
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["rejected"] == {"low": 1, "contact": 1}
    assert summary["reasons"]["low"] == "the palm is too high"
    assert "<th>low</th>" in (tmp_path / "out" / "view.html").read_text()
    result = dn.check(tmp_path / "out")
    assert result.agrees, result.differences
    assert list(result.not_recomputed) == ["low"]
    assert "unknown criterion 'low'" in result.not_recomputed["low"]
    with pytest.raises(dn.InputError, match="cannot be verified again by low; expected all built-in criteria"):
        dn.load_samples(tmp_path / "out").save(tmp_path / "again")


@pytest.mark.parametrize(
    ("changes", "difference"),
    [
        ({"reasons": ["", "", "contact", "contact"]}, "configuration 2: the reason is contact in the file, none found"),
        ({"success": [True, False, False, False]}, "configuration 1: success is False in the file, True found"),
        ({"reasons": ["", "", "low", "low"]}, "configuration 3: the reason is low in the file, contact found"),
        ({"contact": [2.0, 1.0, 2.0, 0.0]}, "configuration 1: contact is 1.000 in the file, 2.000 found"),
    ],
)
def test_a_lie_is_found_though_a_criterion_is_not_installed(boxy_hand, block, tmp_path, changes, difference):
    samples(boxy_hand, block, [*dn.default_criteria(), Low()]).save(tmp_path / "out")
    path = tmp_path / "out" / "configurations.npz"
    with np.load(path) as archive:
        arrays = {**archive, **{name: np.array(value) for name, value in changes.items()}}
    np.savez(path, **arrays)
    assert any(line.startswith(difference) for line in dn.check(tmp_path / "out").differences)


def test_built_in_criteria_cannot_be_left_out_of_what_is_saved_or_sampled(boxy_hand, block, tmp_path):
    with pytest.raises(dn.InputError, match="cannot be verified again by joint_limits, penetration_environment"):
        samples(boxy_hand, block, [Low()]).save(tmp_path / "out")
    with pytest.raises(dn.InputError, match="`criteria` leave out joint_limits, penetration_environment"):
        dn.Sampler(boxy_hand).sample(block, criteria=[Low()])


def test_a_summary_that_names_other_criteria_is_refused(boxy_hand, block, tmp_path):
    samples(boxy_hand, block).save(tmp_path / "out")
    path = tmp_path / "out" / "summary.json"
    summary = json.loads(path.read_text())
    summary["criteria"] = ["force_margin"]
    path.write_text(json.dumps(summary))
    for read in (dn.check, dn.load_samples):
        with pytest.raises(dn.InputError, match=r"summary.json lists the criteria \['force_margin'\]"):
            read(tmp_path / "out")


@pytest.fixture(scope="module")
def saved(boxy_hand, block, tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "out"
    found = samples(boxy_hand, block)
    q = found.q.copy()
    q[:, 0] += np.array([0.01, 0.0, 0.02, 0.0])  # the further ahead of the centre, the worse
    replace(found, q=q).save(folder)
    return folder


@pytest.fixture
def copy(saved, tmp_path):
    return shutil.copytree(saved, tmp_path / "copy")


def change_arrays(folder, change):
    with np.load(folder / "configurations.npz") as archive:
        arrays = dict(archive)
    np.savez(folder / "configurations.npz", **change(arrays))


def add(name, amount, row=1):
    def change(arrays):
        arrays[name][row] += amount
        return arrays

    return change


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (add("force_margin", 0.02), "configuration 1: force_margin is"),
        (add("force_margin", -0.02), "configuration 1: force_margin is"),
        (add("penetration_object", 1e-4), "configuration 1: penetration_object is"),
        (add("penetration_self", -1e-4), "configuration 1: penetration_self is"),
        (add("valid_pose", 5e-5), "configuration 1: valid_pose is 0.000050"),
        (add("force_margin", np.inf), "configuration 1: force_margin is inf"),
        (
            lambda arrays: {  # the verified ones from worst to best, the rejected one last
                name: array if name == "joint_names" else array[[2, 1, 0, 3]] for name, array in arrays.items()
            },
            "is better than the one before it; expected the best first",
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_changed_figure_or_order_is_found(copy, change, difference):
    change_arrays(copy, change)
    differences = dn.check(copy).differences
    assert any(difference in line for line in differences), differences


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("best_force_margin", 2.5),
        ("best_force_margin", None),
        ("verified_rate", 1.0),
        ("robust_rate", "all"),
        ("hand", "shadow"),
        ("scene", "shelf"),
        ("robust", 3.5),
    ],
)
def test_a_changed_summary_is_found(copy, key, value):
    summary = json.loads((copy / "summary.json").read_text())
    assert summary[key] != value
    (copy / "summary.json").write_text(json.dumps(summary | {key: value}))
    (difference,) = dn.check(copy).differences
    assert difference.startswith(f"summary.json: {key} is {value} in the file")


def test_a_page_of_more_than_it_can_show_says_so(boxy_hand, block, tmp_path):
    page = samples(boxy_hand, block)[[0, 1] * 251].page(tmp_path / "page.html")
    assert "The first 500 of 502 are shown." in page.read_text(encoding="utf-8")
