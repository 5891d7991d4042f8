"""configurations.npz: what is written is what is read, and nothing else is read."""

import tracemalloc
import zipfile

import numpy as np
import pytest

from dexnudge.errors import InputError
from dexnudge.results.folder import CONFIGURATIONS, read_configurations, write_configurations
from dexnudge.verification.criteria import default_criteria
from dexnudge.verification.verdicts import Verdicts

N, JOINTS = 5, ("J4", "J3")


@pytest.fixture
def written(tmp_path):
    """(q, verdicts) of the file in `tmp_path`."""
    generator = np.random.default_rng(0)
    q = generator.normal(size=(N, 9 + len(JOINTS))).astype(np.float32)
    verdicts = Verdicts(
        success=np.array([True, True, False, False, False]),
        reasons=["", "", "force_margin", "mine", "contact"],
        values={criterion.name: generator.uniform(0, 3, N) for criterion in default_criteria()},
        contacts=[],
        contact_links=[["a", "b"], ["a, right", "b"], [], ["c\\", "\\,a", '["b"]', " "], ["two\nlines,", "b"]],
    )
    write_configurations(tmp_path, q, JOINTS, verdicts)
    return q, verdicts


def rewrite(folder, **changes):
    with np.load(folder / CONFIGURATIONS) as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays.update(changes)
    np.savez(folder / CONFIGURATIONS, **{key: value for key, value in arrays.items() if value is not None})


def test_round_trip(written, tmp_path):
    (q, verdicts), (read_q, joint_names, read) = written, read_configurations(tmp_path)
    assert (joint_names, read.reasons, read.contact_links) == (JOINTS, verdicts.reasons, verdicts.contact_links)
    np.testing.assert_array_equal(read_q, q)
    for key in ("success", "robust"):
        np.testing.assert_array_equal(getattr(read, key), getattr(verdicts, key))
    assert list(read.values) == list(verdicts.values)
    for name, value in verdicts.values.items():
        np.testing.assert_array_equal(read.values[name], value)


@pytest.mark.usefixtures("written")
def test_keys_and_types_are_those_that_other_tools_rely_on(tmp_path):
    with np.load(tmp_path / CONFIGURATIONS, allow_pickle=False) as archive:
        kinds = {key: archive[key].dtype.kind for key in archive.files}
        assert archive["q"].dtype == np.float32
        assert archive["contact_links"].tolist() == [
            "a,b",
            r"a\, right,b",
            "",
            r'c\\,\\\,a,["b"], ',
            "two\nlines\\,,b",
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
        read_configurations(tmp_path)


@pytest.mark.parametrize("keep", [0, 10, 300, -30])
@pytest.mark.usefixtures("written")
def test_a_truncated_file_is_damaged(tmp_path, keep):
    content = (tmp_path / CONFIGURATIONS).read_bytes()
    (tmp_path / CONFIGURATIONS).write_bytes(content[:keep])
    with pytest.raises(InputError, match="is damaged"):
        read_configurations(tmp_path)


@pytest.mark.usefixtures("written")
def test_flipped_bytes_inside_an_array_are_found(tmp_path):
    with zipfile.ZipFile(tmp_path / CONFIGURATIONS) as archive:
        info = archive.getinfo("q.npy")
    content = bytearray((tmp_path / CONFIGURATIONS).read_bytes())
    middle = info.header_offset + 60 + info.compress_size // 2
    content[middle] ^= 0xFF
    (tmp_path / CONFIGURATIONS).write_bytes(content)
    with pytest.raises(InputError, match="is damaged"):
        read_configurations(tmp_path)


@pytest.mark.usefixtures("written")
def test_pickles_are_refused(tmp_path):
    rewrite(tmp_path, contact_links=np.array([["a"], [], [], [], ["b"]], dtype=object))
    with pytest.raises(InputError, match="expected an npz archive without pickles"):
        read_configurations(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"force_margin": None, "success": None}, "lacks success, force_margin"),
        (
            {"reasons": None, "contact": None},
            "lacks reasons, contact; expected .* which dexnudge 0.6 and before did not",
        ),
        ({"success": np.ones(N)}, r"success is float64 of shape \(5,\); expected bool of shape \(5\)"),
        ({"success": np.ones(4, dtype=bool)}, r"success is bool of shape \(4,\); expected bool of shape \(5\)"),
        ({"q": np.ones(11, dtype=np.float32)}, r"q is float32 of shape \(11,\)"),
        ({"q": np.full((N, 11), np.nan)}, "q holds NaN"),
        ({"q": np.full((N, 11), 1e300)}, "q holds NaN, infinity or a number above 1000; expected metres and radians"),
        ({"joint_names": np.array(["a"])}, r"joint_names is <U1 of shape \(1,\); expected text of shape \(2\)"),
    ],
)
@pytest.mark.usefixtures("written")
def test_arrays_that_do_not_fit_together_are_named(tmp_path, changes, message):
    rewrite(tmp_path, **changes)
    with pytest.raises(InputError, match=message):
        read_configurations(tmp_path)


def add_entry(folder, name, content):
    with (
        zipfile.ZipFile(folder / CONFIGURATIONS, "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open(name, "w") as file,
    ):
        for part in content:
            file.write(part)


def npy(header, data=b"", version=1):
    text = header.encode()
    length = len(text).to_bytes(2 if version == 1 else 4, "little")
    return [b"\x93NUMPY" + bytes([version, 0]) + length + text + data]


def header(shape, descr="'<f8'"):
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("q.npy", npy(header("(0,)")), "holds 'q.npy' twice"),
        ("notes.txt", [b"hello"], "holds 'notes.txt', which is no array"),
        ("x.npy", [b"hello"], "is damaged"),
        ("x.npy", [], "is damaged"),
        ("x.npy", npy(header(f"({2**50},)"), bytes(80)), rf"announces {2**53} bytes, and 80 follow"),
        ("x.npy", npy(header(f"({2**50},)", "'<U0'")), "is damaged"),
        ("x.npy", npy(header("(-1,)"), bytes(80)), "is damaged"),
        ("x.npy", npy("[" * 9000), "is damaged"),
        ("x.npy", npy("(" * 9000), "is damaged"),
        ("x.npy", npy(header("(1,)", "'|O'"), bytes(8)), "without pickles"),
        ("x.npy", npy(header("(1,)", "'<U1'"), b"\xff" * 4), "is damaged"),
        ("x.npy", npy(header("(5,)"), bytes(40), version=7), "is damaged"),
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.usefixtures("written")
def test_an_entry_that_is_no_array_of_a_result_is_one_clear_error(tmp_path, name, content, message):
    add_entry(tmp_path, name, content)
    with pytest.raises(InputError, match=message):
        read_configurations(tmp_path)


@pytest.mark.usefixtures("written")
def test_a_file_that_unpacks_to_gigabytes_is_refused_before_it_is_read(tmp_path):
    add_entry(tmp_path, "x.npy", [bytes(2**26)] * 17)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"unpacks to 1088 MiB; expected at most 1024 MiB"):
            read_configurations(tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()


@pytest.mark.usefixtures("written")
def test_a_file_without_configurations_is_refused(tmp_path):
    with np.load(tmp_path / CONFIGURATIONS) as archive:
        rewrite(tmp_path, **{key: archive[key][:0] for key in archive.files if key != "joint_names"})
    with pytest.raises(InputError, match="holds no configurations; expected at least one"):
        read_configurations(tmp_path)


@pytest.mark.usefixtures("written")
def test_contact_links_of_brackets_alone_are_one_name(tmp_path):
    rewrite(tmp_path, contact_links=np.array(["[" * 100_000, "", "", "", ""]))
    assert read_configurations(tmp_path)[2].contact_links[0] == ["[" * 100_000]
