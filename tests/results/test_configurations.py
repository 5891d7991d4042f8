"""configurations.npz: what is written is what is read, and nothing else is read."""

import zipfile

import numpy as np
import pytest

from dexnudge.errors import InputError
from dexnudge.results.configurations import FILE, Configurations, load_configurations
from dexnudge.verification.criteria import default_criteria

N, JOINTS = 5, ("J4", "J3")


def configurations() -> Configurations:
    generator = np.random.default_rng(0)
    return Configurations(
        q=generator.normal(size=(N, 9 + len(JOINTS))).astype(np.float32),
        joint_names=JOINTS,
        success=np.array([True, True, False, False, False]),
        reasons=("", "", "force_margin", "mine", "contact"),
        values={criterion.name: generator.uniform(0, 3, N) for criterion in default_criteria()},
        contact_links=(("a", "b"), ("a, right",), (), ("c", "a", '["b"]'), ()),
    )


def rewrite(folder, **changes):
    with np.load(folder / FILE) as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays.update(changes)
    np.savez(folder / FILE, **{key: value for key, value in arrays.items() if value is not None})


def test_round_trip(tmp_path):
    written = configurations()
    written.save(tmp_path)
    read = load_configurations(tmp_path)
    for key in ("joint_names", "reasons", "contact_links"):
        assert getattr(read, key) == getattr(written, key)
    for key in ("q", "success", "robust"):
        np.testing.assert_array_equal(getattr(read, key), getattr(written, key))
    assert list(read.values) == list(written.values)
    for name, value in written.values.items():
        np.testing.assert_array_equal(read.values[name], value)


def test_keys_and_types_are_those_that_other_tools_rely_on(tmp_path):
    configurations().save(tmp_path)
    with np.load(tmp_path / FILE, allow_pickle=False) as archive:
        kinds = {key: archive[key].dtype.kind for key in archive.files}
        assert archive["q"].dtype == np.float32
        assert archive["contact_links"].tolist() == [
            '["a", "b"]',
            '["a, right"]',
            "[]",
            '["c", "a", "[\\"b\\"]"]',
            "[]",
        ]
    assert kinds == {
        "q": "f",
        "joint_names": "U",
        "success": "b",
        "reasons": "U",
        **{criterion.name: "f" for criterion in default_criteria()},
        "contact_links": "U",
    }


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"configurations.npz is missing; expected the folder"):
        load_configurations(tmp_path)


@pytest.mark.parametrize("keep", [0, 10, 300, -30])
def test_a_truncated_file_is_damaged(tmp_path, keep):
    configurations().save(tmp_path)
    content = (tmp_path / FILE).read_bytes()
    (tmp_path / FILE).write_bytes(content[:keep])
    with pytest.raises(InputError, match="is damaged"):
        load_configurations(tmp_path)


def test_flipped_bytes_inside_an_array_are_found(tmp_path):
    configurations().save(tmp_path)
    with zipfile.ZipFile(tmp_path / FILE) as archive:
        info = archive.getinfo("q.npy")
    content = bytearray((tmp_path / FILE).read_bytes())
    middle = info.header_offset + 60 + info.compress_size // 2
    content[middle] ^= 0xFF
    (tmp_path / FILE).write_bytes(content)
    with pytest.raises(InputError, match="is damaged"):
        load_configurations(tmp_path)


def test_pickles_are_refused(tmp_path):
    configurations().save(tmp_path)
    rewrite(tmp_path, contact_links=np.array([["a"], [], [], [], ["b"]], dtype=object))
    with pytest.raises(InputError, match="expected an npz archive without pickles"):
        load_configurations(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"force_margin": None, "success": None}, "lacks success, force_margin"),
        ({"contact_links": np.array(["a,b"] * N)}, "contact_links holds 'a,b'; expected a JSON list"),
        ({"success": np.ones(N)}, r"success is float64 of shape \(5,\); expected bool of shape \(5\)"),
        ({"success": np.ones(4, dtype=bool)}, r"success is bool of shape \(4,\); expected bool of shape \(5\)"),
        ({"q": np.ones(11, dtype=np.float32)}, r"q is float32 of shape \(11,\)"),
        ({"q": np.full((N, 11), np.nan)}, "q holds NaN"),
        ({"joint_names": np.array(["a"])}, r"joint_names is <U1 of shape \(1,\); expected text of shape \(2\)"),
    ],
)
def test_arrays_that_do_not_fit_together_are_named(tmp_path, changes, message):
    configurations().save(tmp_path)
    rewrite(tmp_path, **changes)
    with pytest.raises(InputError, match=message):
        load_configurations(tmp_path)
