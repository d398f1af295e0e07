"""Arrays are read from pickles of every protocol and of Python 2, and nothing in a pickle is run."""

import collections
import contextlib
import io
import os
import pickle
import struct
import sys
import types
from typing import ClassVar

import numpy as np
import pytest
import scipy.sparse as sparse
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxcap.errors import InputError
from jaxcap.io.archives.pickle_arrays import read_pickled_arrays

PROTOCOLS = range(6)
#: module and name of the fakes of chumpy
CHUMPY = [("chumpy.ch", "Ch"), ("chumpy.reordering", "Select"), ("chumpy.ch_ops", "add")]


class Python2Pickler(pickle._Pickler):
    """Write bytes and text as the strings of Python 2, and NumPy's modules by their names of that time."""

    dispatch: ClassVar = dict(pickle._Pickler.dispatch)

    def save_string(self, value):
        raw = value if isinstance(value, bytes) else value.encode("latin-1")
        if self.proto == 0:
            self.write(b"S" + repr(raw)[1:].encode() + b"\n")
        elif len(raw) < 256:
            self.write(b"U" + bytes([len(raw)]) + raw)
        else:
            self.write(b"T" + struct.pack("<i", len(raw)) + raw)
        self.memoize(value)

    dispatch[bytes] = dispatch[str] = save_string


def python2(content, protocol):
    stream = io.BytesIO()
    Python2Pickler(stream, protocol).dump(content)
    data = stream.getvalue()
    assert b"_codecs" not in data
    return data.replace(b"cnumpy._core.", b"cnumpy.core.").replace(b"cscipy.sparse._", b"cscipy.sparse.")


@pytest.fixture
def read(tmp_path):
    def read_bytes(data, names=None):
        path = tmp_path / "model.pkl"
        path.write_bytes(data)
        return read_pickled_arrays(path, names)

    return read_bytes


@pytest.fixture
def refused(read):
    def message(data, names=None):
        with pytest.raises(InputError) as caught:
            read(data, names)
        assert caught.value.__cause__ is None, "an unforeseen error"
        text = caught.value.message
        assert "model.pkl: " in text and text.endswith(".") and "\n" not in text
        return text

    return message


@pytest.fixture
def chumpy(monkeypatch):
    """Return fakes of chumpy's classes, which are importable only until their pickles are written."""
    classes = []
    for module, name in CHUMPY:
        classes.append(type(name, (), {"__module__": module}))
        fake = types.ModuleType(module)
        setattr(fake, name, classes[-1])
        monkeypatch.setitem(sys.modules, module, fake)
    monkeypatch.setitem(sys.modules, "chumpy", types.ModuleType("chumpy"))
    return classes


def instance(cls, **state):
    made = cls()
    made.__dict__.update(state)
    return made


def same(found, expected):
    assert list(found) == list(expected)
    for name, value in expected.items():
        assert type(found[name]) is type(value)
        if isinstance(value, np.ndarray):
            assert found[name].dtype == value.dtype.newbyteorder("=")
            assert found[name].flags.c_contiguous and found[name].flags.writeable
        np.testing.assert_array_equal(found[name], value)


def model(rng):
    return {
        "v_template": rng.normal(size=(7, 3)),
        "weights": rng.normal(size=(7, 2)).astype(np.float32),
        "kintree_table": np.array([[2**32 - 1, 0], [0, 1]], np.uint32),
        "f": np.arange(-6, 6).reshape(4, 3),
        "shapedirs": np.asfortranarray(rng.normal(size=(7, 3, 2))),
        "posedirs": rng.normal(size=(7, 3, 2)).transpose(1, 0, 2),
        "big": rng.normal(size=(3, 2)).astype(">f4"),
        "many": np.arange(300, dtype=np.uint8),
        "mask": np.array([True, False]),
        "empty": np.zeros((0, 3)),
        "point": np.array(2.5),
        "joints": np.array(["hüfte", "knee"]),
        "bs_style": "lbs",
        "bs_type": "größe",
        "nothing": None,
        "count": -3,
        "large": 2**40,
        "ratio": 0.1,
        "yes": True,
    }


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_arrays_numbers_and_text_are_read_from_every_protocol(read, rng, protocol):
    content = model(rng)
    same(read(pickle.dumps(content, protocol)), content)


@pytest.mark.parametrize("protocol", [0, 1, 2])
def test_files_of_python_2_are_read(read, rng, protocol):
    content = model(rng)
    content["regressor"] = sparse.csc_matrix(np.eye(3)[:2])
    expected = content | {"regressor": np.eye(3)[:2]}
    same(read(python2(content, protocol)), expected)


@given(
    hnp.arrays(
        st.sampled_from(["<f8", ">f8", "f4", "i8", "u4", "i2", "?"]), hnp.array_shapes(min_dims=0, min_side=0)
    ),
    st.sampled_from(PROTOCOLS),
    st.booleans(),
)
def test_any_array_comes_back(tmp_path_factory, array, protocol, by_columns):
    path = tmp_path_factory.getbasetemp() / "any.pkl"
    array = np.asfortranarray(array) if by_columns and array.ndim else array
    path.write_bytes(pickle.dumps({"a": array}, protocol))
    same(read_pickled_arrays(str(path)), {"a": array})


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_scalars_of_numpy_become_numbers(read, protocol):
    content = {
        "a": np.float32(0.5),
        "b": np.int64(-7),
        "c": np.bool_(True),
        "d": np.str_("é"),
        "e": b"female",
    }
    assert read(pickle.dumps(content, protocol)) == {"a": 0.5, "b": -7, "c": True, "d": "é", "e": "female"}


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("kind", ["csc", "csr", "coo"])
@pytest.mark.parametrize("form", ["matrix", "array"])
def test_sparse_matrices_become_dense(read, rng, protocol, kind, form):
    dense = rng.normal(size=(4, 6)) * (rng.random((4, 6)) < 0.4)
    matrix = getattr(sparse, f"{kind}_{form}")(dense)
    same(read(pickle.dumps({"J_regressor": matrix}, protocol)), {"J_regressor": dense})


def test_sparse_matrices_of_old_scipy_become_dense(read):
    matrix = sparse.coo_matrix(np.eye(2))
    del matrix.__dict__["coords"]
    matrix.__dict__.update(row=np.array([0, 0, 1]), col=np.array([1, 1, 0]), data=np.array([1.0, 2, 3]))
    same(read(python2({"a": matrix}, 2)), {"a": np.array([[0, 3.0], [3, 0]])})


@pytest.mark.parametrize(
    "damage",
    [
        {"indices": np.array([0, 9])},
        {"indices": np.array([0, -1])},
        {"indices": np.array([0.0, 1.0])},
        {"indptr": np.array([0, 5, 2])},
        {"indptr": np.array([0, 2])},
        {"data": np.ones(9)},
        {"data": "text"},
        {"_shape": (2, 2**39)},
        {"_shape": (2,)},
    ],
)
def test_damaged_sparse_matrices_are_refused(refused, damage):
    matrix = sparse.csr_matrix(np.eye(2))
    matrix.__dict__.update(damage)
    assert "the entry 'a'" in refused(pickle.dumps({"a": matrix}, 2))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_wrappers_of_chumpy_become_their_arrays(read, rng, chumpy, monkeypatch, protocol):
    ch, select, _ = chumpy
    array = rng.normal(size=(4, 3, 5))
    inner = instance(ch, x=array, _dirty_vars=set(), _depends_on_deps={"r": {"deps": {"x"}}}, _itr=None)
    places = np.arange(array.size).reshape(array.shape)[..., :2]
    selected = instance(select, a=inner, idxs=places.ravel(), preferred_shape=places.shape)
    flat = instance(select, a=instance(ch, x=selected), idxs=[3, 0])
    content = {"posedirs": inner, "shapedirs": selected, "flat": flat, "number": instance(ch, x=0.5)}
    data = pickle.dumps(content, protocol)
    for name in [name for name in sys.modules if name.startswith("chumpy")]:
        monkeypatch.delitem(sys.modules, name)
    shapedirs = array[..., :2].copy()
    same(
        read(data),
        {
            "posedirs": array,
            "shapedirs": shapedirs,
            "flat": shapedirs.ravel()[[3, 0]],
            "number": np.array(0.5),
        },
    )
    assert not any(name.startswith("chumpy") for name in sys.modules)


def test_an_expression_of_chumpy_is_refused_only_where_it_is_requested(read, refused, chumpy):
    data = pickle.dumps({"sum": instance(chumpy[2], a=1, b=2), "f": np.arange(3)}, 2)
    same(read(data, ["f", "absent"]), {"f": np.arange(3)})
    for names in (None, ["sum"]):
        assert "'sum' is an object of the type chumpy.ch_ops.add" in refused(data, names)


@pytest.mark.parametrize(
    "state",
    [{"idxs": np.array([6])}, {"idxs": np.array([0.5])}, {"preferred_shape": (2, 2)}, {"a": "x"}],
)
def test_damaged_selections_are_refused(refused, chumpy, state):
    whole = {"a": np.zeros((2, 3)), "idxs": np.array([1]), "preferred_shape": (1,)} | state
    assert "'s' " in refused(pickle.dumps({"s": instance(chumpy[1], **whole)}, 4))


def test_deep_and_circular_wrappers_are_refused(refused, chumpy):
    deep = np.zeros(2)
    for _ in range(20):
        deep = instance(chumpy[0], x=deep)
    circle = instance(chumpy[0])
    circle.x = circle
    for wrapper in (deep, circle):
        assert "chumpy.ch.Ch" in refused(pickle.dumps({"w": wrapper}, 2))


def test_lists_of_numbers_become_arrays_and_other_containers_are_left_out(read, refused):
    content = {
        "a": [[1, 2], (3, 4)],
        "b": [1.5, np.float64(2)],
        "c": ["x"],
        "d": {"y": 1},
        "e": [[1], [2, 3]],
        "f": {1},
    }
    data = pickle.dumps(content | {"g": [2**70], "h": frozenset("k"), 5: 1.0}, 4)
    same(read(data), {"a": np.array([[1, 2], [3, 4]]), "b": np.array([1.5, 2]), "f": np.array([1])})
    for name in "cdeg":
        assert f"the entry '{name}' is" in refused(data, [name])


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_ordered_dict_is_a_dict(read, protocol):
    same(read(pickle.dumps(collections.OrderedDict(a=np.ones(2)), protocol)), {"a": np.ones(2)})


def test_an_ordered_dict_of_python_2_is_a_dict(read):
    same(read(b"ccollections\nOrderedDict\n((lp0\n(lp1\nS'a'\naI3\naatR."), {"a": 3})


class Reduced:
    def __init__(self, function, *arguments):
        self.reduced = function, arguments

    def __reduce__(self):
        return self.reduced


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("names", [None, ["f"]])
def test_code_is_named_and_never_run(refused, tmp_path, protocol, names):
    made = tmp_path / "made"
    name = f"{os.system.__module__}.system"
    command = Reduced(os.system, f"touch {made}")
    for content in (command, {"x": command}, {"x": [{"y": Reduced(collections.OrderedDict, command)}]}):
        assert f"holds code: the global {name} at byte" in refused(pickle.dumps(content, protocol), names)
    assert "eval at byte" in refused(
        pickle.dumps({"x": Reduced(eval, f"open({str(made)!r}, 'w')")}, protocol), names
    )
    assert not made.exists()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"cos\nsystem\n(S'true'\ntR.", "the global os.system"),
        (b"\x80\x04\x8c\x02os\x8c\x06system\x93.", "the global os.system"),
        (b"(S'true'\nios\nsystem\n.", "the opcode INST os system"),
        (b"(cos\nsystem\nU\x04trueo.", "the global os.system"),
        (b"\x80\x02}c__builtin__\ngetattr\n.", "the global __builtin__.getattr"),
        (b"\x80\x04\x8c\x09chumpy.ch\x8c\x09os.system\x93.", "the global chumpy.ch.os.system"),
        (b"\x80\x02cnumpy\nload\n.", "the global numpy.load"),
        (b"\x80\x02cnumpy.core.multiarray\n_reconstruct\n)R)R.", "a call of an object"),
        (b"\x80\x02}\x82\x01.", "the opcode EXT1 1"),
        (b"\x80\x02}Pname\n.", "the opcode PERSID name"),
        (b"\x80\x05}\x97.", "the opcode NEXT_BUFFER"),
        (b"\x80\x04cnumpy\ndtype\n)}\x92.", "the opcode NEWOBJ_EX"),
        (b"\x80\x02c" + b"x" * 9999 + b"\ny\n.", "the global xxxx"),
    ],
)
def test_opcodes_and_globals_out_of_the_list_are_named(refused, data, what):
    message = refused(data)
    assert f"holds code: {what}" in message
    assert len(message) < 400


@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_a_file_cut_anywhere_is_refused(refused, rng, chumpy, protocol):
    content = {name: value for name, value in model(rng).items() if name not in ("many", "posedirs")}
    content |= {"J": sparse.csc_matrix(np.eye(2)), "c": instance(chumpy[0], x=np.ones(2))}
    files = [pickle.dumps(content, protocol)] + ([python2(content, protocol)] if protocol < 3 else [])
    for data in files:
        for end in range(0, len(data), 37):
            assert "not a pickle" in (message := refused(data[:end])) or "incomplete" in message


@given(st.data())
def test_a_damaged_file_is_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "damaged.pkl"
    content = model(np.random.default_rng(0)) | {"J": sparse.csc_matrix(np.eye(3))}
    raw = bytearray(pickle.dumps(content, data.draw(st.sampled_from(PROTOCOLS))))
    for _ in range(6):
        damaged = raw.copy()
        damaged[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
        path.write_bytes(damaged)
        with contextlib.suppress(InputError):
            assert isinstance(read_pickled_arrays(path), dict)


def test_arrays_of_objects_are_refused_only_where_they_are_requested(read, refused):
    for protocol in PROTOCOLS:
        data = pickle.dumps({"o": np.array([{}, None]), "r": np.zeros(2, "f4,i4"), "n": 1}, protocol)
        assert read(data, ["n"]) == {"n": 1}
        assert "'o' has the type object" in refused(data)
        assert "'r' has the type V8" in refused(data, {"r"})


def array_with(shape, dtype=b"U\x02f8", data=b"U\x08" + bytes(8)):
    """Write a pickle of Python 2 with one array."""
    return (
        b"\x80\x02}U\x01acnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01"
        + pickle.dumps(shape, 2)[2:-1]
        + b"cnumpy\ndtype\n"
        + dtype
        + b"K\x00K\x01\x87R\x89"
        + data
        + b"tbs."
    )


def test_the_hand_written_array_is_one(read):
    same(read(array_with((1,))), {"a": np.zeros(1)})


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        ((2,), "has the shape (2,) and the type float64, but 8 bytes"),
        ((2**39,), "has the shape"),
        ((2**70,), "has the shape"),
        ((0, 2**39), "no valid shape"),
        ((-1,), "no valid shape"),
        ((1,) * 40, "no valid shape"),
        (("x",), "no valid shape"),
        (7, "no valid shape"),
    ],
)
def test_wrong_and_huge_shapes_are_refused(refused, shape, said):
    assert said in refused(array_with(shape))


@pytest.mark.parametrize(
    "dtype", [b"U\x02V8", b"U\x02O8", b"U\x03c16", b"U\x02M8", b"U\x02f9", b"U\x00", b"K\x01"]
)
def test_other_types_are_refused(refused, dtype):
    assert "type" in refused(array_with((1,), dtype))


def test_invalid_text_is_refused(refused):
    assert "letters" in refused(array_with((2,), b"U\x02U1", b"U\x08" + b"\xff" * 8))


def test_files_that_grow_are_refused(read, refused, monkeypatch):
    sheet = sparse.csc_matrix((200_000, 2_000))
    assert "too much memory" in refused(pickle.dumps({"a": sheet}, 2))
    nested = [1.0]
    for _ in range(12):
        nested = [nested] * 10
    assert "too much memory" in refused(pickle.dumps({"a": nested}, 2), ["a"])
    array = np.zeros(2000)
    monkeypatch.setattr("jaxcap.io.archives.pickle_arrays.MIN_MEMORY_LIMIT", 2**16)
    # the same bytes in many arrays
    assert len(read(pickle.dumps(dict.fromkeys("ab", array), 2))) == 2
    assert "too much memory" in refused(pickle.dumps(dict.fromkeys("abcdefghij", array), 2))
    entries = {f"entry {number}": 0 for number in range(5000)}
    assert "5000 entries" in refused(pickle.dumps(entries, 2))


def test_long_and_deep_programs_are_refused_or_read(read, refused, monkeypatch):
    monkeypatch.setattr("jaxcap.io.archives.pickle_machine.MAX_OPCODES", 1000)
    assert "more than 1000 opcodes" in refused(b"\x80\x02" + b"]" * 2000)
    assert "damaged" in refused(b"\x80\x02}r\xff\xff\xff\x7f.")
    monkeypatch.undo()
    deep = b"\x80\x02}U\x01d" + b"]" * 30_000 + b"a" * 29_999 + b"s."
    assert read(deep) == {}
    circle = []
    circle.append(circle)
    assert read(pickle.dumps({"a": circle, "b": 1}, 2)) == {"b": 1}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "not a pickle"),
        (b"v 0 0 0\n", "not a pickle"),
        (b"hello world\n", "not a pickle"),
        (b'{"a": 1}', "not a pickle"),
        (b"\x93NUMPY\x01\x00", "not a pickle"),
        (b"\x1f\x8b\x08\x00", "not a pickle"),
        (b"\x80\x02.", "incomplete"),
        (b"\x80\x02K\x01R.", "damaged"),
        (b"\x80\x02U\x01a}s.", "damaged"),
        (b"\x80\x02h\x05.", "damaged"),
        (b"\x80\x02t.", "damaged"),
        (b"\x80\x02(]e.", "damaged"),
        (b"\x80\x02(U\x01ad.", "damaged"),
        (b"\x80\x02]}b.", "damaged"),
        (b"S'\\xq'\n.x", "not a pickle"),
        (b"(S'a\n.x", "damaged"),
        (pickle.dumps([np.ones(2)], 2), "holds an object of the type list and no dict"),
        (pickle.dumps(np.ones(2), 5), "_frombuffer and no dict"),
        (pickle.dumps("text", 0), "holds an object of the type str and no dict"),
    ],
)
def test_other_files_are_refused(refused, data, said):
    assert said in refused(data)


def test_an_npz_is_refused_by_name(refused):
    stream = io.BytesIO()
    np.savez(stream, a=np.ones(2))
    assert "such as an .npz file" in refused(stream.getvalue())


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path, said in ((tmp_path / "absent.pkl", "no such file"), (tmp_path, "cannot be read")):
        with pytest.raises(InputError, match=said):
            read_pickled_arrays(path)
