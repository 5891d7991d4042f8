"""NumPy files of dicts: what is plain is read as numpy reads it, and nothing in a file can run."""

import os
import pickle
import resource
from collections import OrderedDict
from fractions import Fraction

import numpy as np
import pytest

from dexnudge.errors import InputError
from dexnudge.formats.object_arrays import read_object_array, write_object_array

PLAIN = {
    "numbers": [1, 2.5, True, None, -(2**70)],
    "nested": {"array": np.arange(12.0).reshape(3, 4), "fortran": np.asfortranarray(np.eye(3)), "text": ("a", "ä")},
    "scalar": np.float32(0.5),
    "texts": np.array(["FFJ3", "FFJ2"]),
    "objects": np.array([{"a": np.int64(1)}, [2]], dtype=object),
}


def equal(one, two):
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(equal(one[key], two[key]) for key in one)
    if isinstance(one, list | tuple) or (isinstance(one, np.ndarray) and one.dtype.hasobject):
        return len(one) == len(two) and all(equal(a, b) for a, b in zip(one, two, strict=True))
    return np.array_equal(one, two) and type(one) is type(two)


@pytest.mark.parametrize("content", [PLAIN, [PLAIN, {"qpos": {"WRJTx": 0.1}, "scale": 0.08}]])
def test_what_is_plain_is_read_as_numpy_reads_it(content, tmp_path):
    write_object_array(tmp_path / "a.npy", content)
    loaded = np.load(tmp_path / "a.npy", allow_pickle=True)
    loaded = loaded.item() if loaded.shape == () else list(loaded)
    assert equal(loaded, content)
    assert equal(read_object_array(tmp_path / "a.npy"), content)


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
def test_files_of_every_protocol_are_read(protocol, tmp_path):
    content = {"q": np.arange(6.0).reshape(2, 3), "scale": np.float64(0.08)}
    write_object_array(tmp_path / "a.npy", {})
    header = (tmp_path / "a.npy").read_bytes().split(b"\n", 1)[0] + b"\n"
    array = np.empty((), dtype=object)
    array[()] = content
    (tmp_path / "a.npy").write_bytes(header + pickle.dumps(array, protocol=protocol))
    if protocol == 2:  # arrays as texts that Python 2 wrote, through _codecs.encode
        with pytest.raises(InputError, match=r"_codecs.encode, which may run code"):
            read_object_array(tmp_path / "a.npy")
    else:
        assert equal(read_object_array(tmp_path / "a.npy"), content)


class Runs:
    def __reduce__(self):
        return os.mkdir, (os.environ["RUNS_HERE"],)


class Evaluates:
    def __reduce__(self):
        return eval, ("__import__('os').mkdir(__import__('os').environ['RUNS_HERE'])",)


class Large:
    def __reduce__(self):
        return np.ndarray, ((10**13,),)


@pytest.mark.parametrize("value", [Runs(), Evaluates(), Large(), OrderedDict(a=1), Fraction(1, 2), np.sum, {1, 2}])
def test_anything_else_is_refused_before_it_is_made(value, tmp_path, monkeypatch):
    monkeypatch.setenv("RUNS_HERE", str(tmp_path / "ran"))
    write_object_array(tmp_path / "a.npy", [{"qpos": value}])
    with pytest.raises(InputError, match=r"a\.npy"):
        read_object_array(tmp_path / "a.npy")
    assert not (tmp_path / "ran").exists()


def test_damaged_files_are_refused(tmp_path):
    write_object_array(tmp_path / "a.npy", PLAIN)
    whole = (tmp_path / "a.npy").read_bytes()
    for size in range(0, len(whole) - 1, 37):
        (tmp_path / "cut.npy").write_bytes(whole[:size])
        with pytest.raises(InputError):
            read_object_array(tmp_path / "cut.npy")
    generator = np.random.default_rng(0)
    for _ in range(3000):  # whatever is read, is plain; the rest is refused
        poisoned = bytearray(whole)
        poisoned[generator.integers(len(whole))] = generator.integers(256)
        (tmp_path / "poisoned.npy").write_bytes(poisoned)
        try:
            read_object_array(tmp_path / "poisoned.npy")
        except InputError:
            continue
    with pytest.raises(InputError, match="no such file"):
        read_object_array(tmp_path / "none.npy")


def test_what_holds_itself_or_grows_is_refused(tmp_path):
    itself, wide = [], [0.0]
    itself.append(itself)
    for _ in range(60):
        wide = [wide] * 10  # 10**60 numbers, in a file of kilobytes
    few = [0.0] * 1000
    for _ in range(2):
        few = [few] * 1000  # 10**9
    for content in (itself, wide, few):
        write_object_array(tmp_path / "a.npy", [{"qpos": content}])
        with pytest.raises(InputError, match=r"nested|holds"):
            read_object_array(tmp_path / "a.npy")


def raw_file(path, body):
    write_object_array(path, {})
    path.write_bytes(path.read_bytes().split(b"\n", 1)[0] + b"\n" + body)
    return path


DOUBLED = b"K\x01" + b"2\x86" * 40  # a tuple of twice itself, 40 times: 2**40 numbers


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"\x80\x02}" + DOUBLED + b"K\x01s.", "tuple as a key"),
        (b"\x80\x02}(" + DOUBLED + b"K\x01u.", "tuple as a key"),
        (b"\x80\x02(" + DOUBLED + b"K\x01d.", "tuple as a key"),
        (b"\x80\x04\x8f(" + DOUBLED + b"\x90.", "a set"),
        (b"\x80\x04(" + DOUBLED + b"\x91.", "a set"),
        (b"\x80\x02cnumpy\ndtype\n(" + DOUBLED + b"tR.", "none of numbers and texts"),
        (b"\x80\x05\x96" + b"\xff" * 6 + b"\x00\x00N.", r"a\.npy"),  # room for 2**48 bytes
    ],
)
def test_a_small_file_takes_no_time_and_memory(body, message, tmp_path):
    with pytest.raises(InputError, match=message):
        read_object_array(raw_file(tmp_path / "a.npy", body))


def test_a_memo_takes_as_much_as_is_in_it(tmp_path):
    path = raw_file(tmp_path / "a.npy", b"\x80\x02Nr" + (2**31).to_bytes(4, "little") + b".")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="damaged"):
        read_object_array(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**20  # [KiB]


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.npy")
    with pytest.raises(InputError, match="is no file"):
        read_object_array(tmp_path / "a.npy")


def test_objects_that_are_arrays_stay_apart(tmp_path):
    content = np.empty(2, dtype=object)
    content[0], content[1] = np.zeros(3), np.ones(3)
    write_object_array(tmp_path / "a.npy", {"arrays": content})
    found = read_object_array(tmp_path / "a.npy")["arrays"]
    assert found.shape == (2,)
    assert equal(found, content)
