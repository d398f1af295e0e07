"""A small share of `benchmarks.fuzz`, and what readers of archives, of trees and of scenes promise."""

import io
import zipfile

import numpy as np
import pytest
from command_line import fails

from benchmarks.files._fuzz_damage import damage
from benchmarks.files._fuzz_nasty import bomb, nasty_files
from benchmarks.files._fuzz_read import FAULTS, outcome
from benchmarks.files._fuzz_scenes import gltf, gltf_bytes
from benchmarks.files._fuzz_seeds import FORMATS, make_seeds
from jaxcap.cli.console.errors import report_errors
from jaxcap.errors import InputError, is_user_error
from jaxcap.geometry.camera import look_at
from jaxcap.io.archives.archive import load_arrays
from jaxcap.io.gltf.gltf_reader import read_gltf
from jaxcap.io.system.reader_errors import reader_of

#: bytes of files that are read in a moment
SMALL = 50_000


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    return make_seeds(tmp_path_factory.mktemp("seeds"))


def test_whole_files_of_every_format_are_read(seeds, tmp_path):
    assert {seed.format for seed in seeds} == set(FORMATS)
    for seed in seeds:
        path = tmp_path / seed.name.split("-", 1)[1]
        path.write_bytes(seed.data)
        # a motion may do without its skeleton, which then cannot be read
        wanted = "refused" if seed.name == "motion-bare.npz" else "data"
        assert outcome(seed.format, path)[0] == wanted, seed.name


def test_damaged_files_are_read_or_refused(seeds, tmp_path):
    rng, wrong = np.random.default_rng(5), []
    for number, seed in enumerate(seeds):
        for variant in range(2):
            path = tmp_path / f"{number}_{variant}" / seed.name.split("-", 1)[1]
            path.parent.mkdir()
            other = seeds[rng.integers(len(seeds))]
            path.write_bytes(damage(seed.name, seed.data, other.data, rng))
            found, detail = outcome(seed.format, path)
            wrong += [(seed.name, variant, found, detail)] if found in FAULTS else []
    assert not wrong


def test_files_made_by_hand_are_read_or_refused(tmp_path):
    """Of those that are small: the others take seconds and are left to the benchmark."""
    wrong, count = [], 0
    small = [file for file in nasty_files() if len(file[2]) < SMALL and "chain" not in file[1]]
    for number, (format, name, data) in enumerate(small):
        # a part of each kind
        if number % 4:
            continue
        path = tmp_path / format / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        found, detail = outcome(format, path)
        wrong += [(format, name, found, detail)] if found in FAULTS else []
        count += 1
    assert count > 100
    assert not wrong


def _ours() -> None:
    raise ValueError("There is no such joint; name another.")


def _reshaped() -> None:
    np.zeros(3).reshape(2)


def test_only_what_the_package_says_is_a_sentence(capsys):
    """NumPy's functions leave no frame, so a file of the package is the last one of its errors as well."""
    with pytest.raises(ValueError, match="broadcast") as theirs:
        look_at([0, 0], [0, 0, 0], 64, 48, 50)
    assert not is_user_error(theirs.value)
    with pytest.raises(InputError) as ours:
        look_at([0, 0, 0], [0, 0, 0], 64, 48, 50)
    assert is_user_error(ours.value)
    # neither is raised by the package
    for function, words in ((_ours, "no such joint"), (_reshaped, "cannot reshape")):
        with pytest.raises(ValueError, match=words) as raised, report_errors():
            function()
        assert not is_user_error(raised.value)
    assert not capsys.readouterr().err


def test_the_last_door_names_the_file(tmp_path):
    @reader_of("a list of cats")
    def read(path, error):
        raise error

    path = tmp_path / "cats.txt"
    for error in (
        KeyError("a"),
        ValueError("cannot reshape"),
        MemoryError(),
        RecursionError(),
        OSError(5, "I/O"),
        IndexError(),
    ):
        with pytest.raises(InputError, match=r"cats\.txt: .*\.$") as raised:
            read(path, error)
        assert raised.value.__cause__ is error
        assert "reshape" not in str(raised.value)
    with pytest.raises(InputError, match="^as it is$"):
        read(path, InputError("as it is"))
    path.write_text("Tom")
    with pytest.raises(InputError, match=r"cats\.txt: a cat lacks its tail$"):
        read(path, InputError("a cat lacks its tail"))
    with pytest.raises(KeyboardInterrupt):
        read(path, KeyboardInterrupt())


ARRAYS = {
    "plain": np.arange(6.0).reshape(2, 3),
    "columns": np.asfortranarray(np.arange(6, dtype="i2").reshape(2, 3)),
    "swapped": np.arange(4, dtype=">f4"),
    "words": np.array(["a", "Hüfte", ""]),
    "swapped_words": np.array(["ab", "c"], dtype=">U2"),
    "bytes": np.array([b"a", b"bc"]),
    "none": np.zeros((0, 3), "u1"),
    "one": np.array(7),
    "nothing": np.array("", dtype=str),
    "half": np.ones(2, "f2"),
    "true": np.array([True, False]),
    "long": np.ones(3, np.longdouble),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_are_those_that_numpy_reads(tmp_path, save):
    path = tmp_path / "arrays.npz"
    save(path, **ARRAYS)
    found = load_arrays(path)
    with np.load(path) as file:
        assert list(found) == file.files
        for name in file.files:
            theirs = file[name].astype(str) if file[name].dtype.kind == "S" else file[name]
            np.testing.assert_array_equal(found[name], theirs)
            assert found[name].dtype.isnative
    assert list(load_arrays(path, lambda name: name in ("one", "absent"))) == ["one"]


def test_an_archive_that_fills_the_memory_is_not_inflated(tmp_path):
    path = tmp_path / "bomb.npz"
    path.write_bytes(bomb("points", "(44739242, 3)"))
    assert path.stat().st_size < 2e6
    with pytest.raises(InputError, match=r"the arrays need 1074 MB"):
        load_arrays(path)
    assert load_arrays(path, lambda name: name == "faces") == {}


def test_members_that_lie_are_told(tmp_path):
    path = tmp_path / "lies.npz"
    with zipfile.ZipFile(path, "w") as file:
        content = io.BytesIO()
        np.save(content, np.zeros((2, 3)))
        file.writestr("a.npy", content.getvalue().replace(b"(2, 3)", b"(4, 3)"))
    with pytest.raises(
        InputError, match=r"'a' has the shape \(4, 3\) and needs 96 bytes, but the file has 48"
    ):
        load_arrays(path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"nodes": [{"children": [1]}, {"children": [0]}, {"mesh": 0, "skin": 0}]}, r"nodes\[0\] descends from itself"),
        ({"nodes": [{"children": [1]}, {"rotation": [0, 0, 0, 0]}, {"mesh": 0, "skin": 0}]}, r"nodes\[1\]\.rotation has"),
        ({"nodes": [{"children": [1, 7]}, {}, {}]}, r"nodes\[0\]: 'children' is \[1, 7\]"),
        ({"skins": [{"joints": [0, "a"]}]}, r"skins\[0\]: 'joints' is"),
    ],
)  # fmt: skip
def test_a_scene_that_is_no_tree_is_told(tmp_path, changes, said):
    path = tmp_path / "scene.glb"
    path.write_bytes(gltf_bytes(gltf(**changes)))
    with pytest.raises(InputError, match=said):
        read_gltf(path)


def test_pictures_of_any_size_are_not_made(tmp_path, capsys):
    line = fails(
        capsys, "scan", "human", tmp_path / "none.npz", "-o", tmp_path / "out", "--resolution", 10**6, 10**6
    )
    assert "1000000 x 1000000 pixels are too large" in line
