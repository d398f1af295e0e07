"""C3D: what several programs write, byte by byte, is read; what is written is read again by ezc3d."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import ezc3d
import jax.numpy as jnp
import numpy as np
import pytest
from alone import ALONE
from c3d_bytes import c3d_bytes
from hypothesis import given
from hypothesis import strategies as st

import jaxcap as jc
from jaxcap.errors import InputError
from jaxcap.io.markers import c3d_child, c3d_process
from jaxcap.io.markers.c3d import read_c3d_file, write_c3d
from jaxcap.io.markers.up_axis import find_up_axis
from jaxcap.io.registry import read_marker_file
from jaxcap.io.system import process_limits

#: limits as the program sets them for itself, with a second of CPU
LIMITED = f"""
import runpy
runpy.run_path({process_limits.__file__!r})["limit"](1, {c3d_process.MEMORY})
"""
NAMES = ["LKNE", "RKNE", "LANK", "RANK"]


def walked(frames=6, markers=4, seed=0):
    """Places in millimetres that fit a body."""
    rng = np.random.default_rng(seed)
    return 300 + 1200 * rng.random((1, markers, 3)) + 30 * rng.random((frames, markers, 3))


def walked_with_gap():
    """The same places; the residuals of one marker mark a gap in two frames."""
    places = walked()
    residuals = np.zeros(places.shape[:2])
    residuals[2:4, 1] = -1
    return places, residuals


def check_positions(file, places, residuals, integers):
    np.testing.assert_array_equal(file.frames.visible, residuals == 0)
    expected = np.where(residuals[..., None] < 0, 0, places / 1000)
    np.testing.assert_allclose(file.frames.positions, expected, atol=6e-5 if integers else 1e-6)


def written(folder, *arguments, name="trial.c3d", **options):
    (folder / name).write_bytes(c3d_bytes(*arguments, **options))
    return folder / name


@pytest.mark.parametrize("processor", ["intel", "dec"])
@pytest.mark.parametrize("integers", [False, True])
def test_number_formats(tmp_path, processor, integers):
    places, residuals = walked_with_gap()
    options = dict(processor=processor, integers=integers, rate=120.0, first=37)
    path = written(tmp_path, places, NAMES, residuals=residuals, **options)
    file = read_c3d_file(path)
    assert (file.frames.labels, file.frames.rate, file.first_frame) == (tuple(NAMES), 120.0, 37)
    check_positions(file, places, residuals, integers)


@pytest.mark.parametrize("processor", ["intel", "dec"])
@pytest.mark.parametrize("integers", [False, True])
def test_analogue_values_that_only_the_header_counts(tmp_path, processor, integers):
    """A reader that believes the parameters finds each frame at a wrong place."""
    places, residuals = walked_with_gap()
    options = dict(processor=processor, integers=integers, unannounced=6)
    path = written(tmp_path, places, NAMES, residuals=residuals, **options)
    file = read_c3d_file(path)
    check_positions(file, places, residuals, integers)
    assert any("its header 6" in sentence for sentence in file.warnings)


def test_copies_of_points_are_left_out(tmp_path):
    """Programs that store a trial several times repeat its points; a second marker with the same label is another one."""
    places = walked(markers=3)
    whole = np.concatenate([places, places[:, :2], places[:, 2:] + 50.0], axis=1)
    file = read_c3d_file(written(tmp_path, whole, ["A", "B", "C", "A", "B", "C"]))
    assert file.frames.labels == ("A", "B", "C", "C_2")
    assert [sentence for sentence in file.warnings if "2 points are copies of earlier ones" in sentence]


SIDES = np.array([0.5, 0.6, 1.7])


@pytest.mark.parametrize(
    ("screen", "axes", "shift", "found"),
    [
        # a header that agrees with the positions, one with the wrong sign, one that the positions do not decide
        ("+Z", [0, 1, 2], 0.0, ("z", True)),
        ("-Z", [0, 1, 2], 0.0, ("z", True)),
        ("-Z", [0, 1, 2], -0.8, ("-z", True)),
        ("+Y", [0, 1, 2], 0.0, ("y", True)),
        # without a header: the long side above or below the origin; none if it is on both sides, or not long
        ("", [0, 1, 2], 0.0, ("z", False)),
        ("up", [2, 0, 1], 0.0, ("x", False)),
        ("", [0, 2, 1], -1.7, ("-y", False)),
        ("", [0, 1, 2], -0.8, None),
        ("", [2, 2, 1], 0.0, None),
    ],
)
def test_up_axis(tmp_path, rng, screen, axes, shift, found):
    places = 1000 * (rng.random((20, 30, 3)) * SIDES + [0.0, 0.0, shift])[..., axes]
    more = [("POINT", "Y_SCREEN", "char", (len(screen),), [screen])] if screen else []
    file = read_c3d_file(written(tmp_path, places, [f"M{i}" for i in range(30)], more=more))
    assert find_up_axis(file) == found


def test_nan_and_zeros_are_gaps_as_well(tmp_path):
    places = walked()
    places[1, 0] = np.nan
    places[2, 1, 2] = np.nan
    places[3, 2] = 0
    frames = jc.read_markers(written(tmp_path, places, NAMES))
    assert np.argwhere(~np.asarray(frames.visible)).tolist() == [[1, 0], [2, 1], [3, 2]]
    assert jnp.all(frames.positions[~frames.visible] == 0)


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("mm", 1e-3), ("m", 1.0), ("cm", 1e-2), ("Meters", 1.0), ("INCHES", 0.0254), ("mm  ", 1e-3), ("", 1e-3)],
)
def test_units_of_the_file(tmp_path, unit, metres):
    places = walked() * 1e-3 / metres
    file = read_c3d_file(written(tmp_path, places, NAMES, unit=unit))
    np.testing.assert_allclose(file.frames.positions, walked() * 1e-3, rtol=1e-5)
    assert any("unit" in sentence for sentence in file.warnings) == (not unit)


def test_a_unit_that_is_given_counts_more(tmp_path):
    path = written(tmp_path, walked() / 10, NAMES, unit="mm")
    with pytest.raises(InputError, match="looks like centimetres: pass unit='cm'"):
        jc.read_markers(path)
    np.testing.assert_allclose(jc.read_markers(path, "cm").positions, walked() * 1e-3, rtol=1e-5)
    assert jc.read_markers(path, size=(0.01, 5.0)).positions.max() < 0.2


@pytest.mark.parametrize(("metres", "name"), [(1.0, "metres"), (0.01, "centimetres"), (0.0254, "inches")])
def test_a_wrong_unit_is_named(tmp_path, metres, name):
    path = written(tmp_path, walked() * 1e-3 / metres, NAMES, unit="mm" if name != "inches" else "m")
    if name == "inches":
        name = "(inches|centimetres)"
    with pytest.raises(InputError, match=f"looks like {name}: pass unit="):
        jc.read_markers(path)


def test_angles_forces_and_the_rest_are_no_markers(tmp_path):
    """By the lists of POINT, by groups that TYPE_GROUPS names, by Plug-in Gait's names, and by four axes."""
    names = ["A:LKNE", "A:KneeThing", "A:LKneeAngles", "A:Grip", "A:LPower", "A:PELO", "A:PELP", "A:PELA", "A:PELL", "A:RKNE"]  # fmt: skip
    names += ["A:Strain", "A:RHEO", "A:LongName"]
    lists = [
        ("POINT", "ANGLES", "char", (11, 1), ["KneeThing  "]),
        ("POINT", "FORCES", "char", (6, 1), ["A:Grip"]),
        ("POINT", "TYPE_GROUPS", "char", (7, 3), ["ANGLES ", "STRAINS", "FORCES "]),
        ("POINT", "STRAINS", "char", (6, 1), ["Strain"]),
        ("POINT", "STRAINS2", "char", (8, 1), ["LongName"]),
    ]
    places = walked(markers=len(names))
    file = read_c3d_file(written(tmp_path, places, names, more=lists))
    assert file.frames.labels == ("A:LKNE", "A:RKNE", "A:RHEO")
    assert file.other_points == {
        "angles": ("A:KneeThing", "A:LKneeAngles"),
        "forces": ("A:Grip",),
        "powers": ("A:LPower",),
        "segment axes": ("A:PELO", "A:PELP", "A:PELA", "A:PELL"),
        "strains": ("A:Strain", "A:LongName"),
    }
    np.testing.assert_allclose(file.frames.positions, places[:, [0, 9, 11]] / 1000, rtol=1e-6)
    assert jc.read_markers(tmp_path / "trial.c3d").labels == ("LKNE", "RKNE", "RHEO")


def test_more_labels_than_a_byte_counts(tmp_path):
    names = [f"marker{i}" for i in range(300)]
    places = walked(frames=2, markers=300)
    frames = jc.read_markers(written(tmp_path, places, names))
    assert frames.labels == tuple(names)
    write_c3d(tmp_path / "again.c3d", frames)
    again = jc.read_markers(tmp_path / "again.c3d")
    assert again.labels == tuple(names)
    np.testing.assert_array_equal(again.positions, frames.positions)


def test_labels_missing_empty_twice_starred_and_too_many(tmp_path):
    places = walked(markers=6)
    file = read_c3d_file(written(tmp_path, places, ["A  ", "", "A", "*32", "A_2"]))
    assert file.frames.labels == ("A", "*2", "A_3", "*32", "A_2", "*6")
    assert any("'A'" in sentence for sentence in file.warnings)
    few = read_c3d_file(written(tmp_path, places[:, :2], ["A", "B", "C"]))
    assert few.frames.labels == ("A", "B")
    assert any("3 labels for 2 points" in sentence for sentence in few.warnings)
    assert read_c3d_file(written(tmp_path, places, NAMES, without=("LABELS",))).frames.labels[-1] == "*6"


def test_subjects_are_parted_by_their_prefix(tmp_path):
    places = walked(markers=4)
    one = written(tmp_path, places, ["Anna:A", "Anna:B", "*32", "C"])
    assert jc.read_markers(one).labels == ("A", "B", "*32", "C")
    assert jc.read_markers(one, subject="Anna").labels == ("A", "B")
    two = written(tmp_path, places, ["Anna:A", "Ben:A", "Ben:B", "*32"])
    with pytest.raises(InputError, match=r"2 subjects, 'Anna' \(1 markers\) and 'Ben' \(2 markers\)"):
        jc.read_markers(two)
    with pytest.raises(InputError, match="no subject 'Carl'; it has 'Anna'"):
        jc.read_markers(two, subject="Carl")
    ben = jc.read_markers(two, subject="Ben")
    assert ben.labels == ("A", "B")
    np.testing.assert_allclose(ben.positions, places[:, 1:3] / 1000, rtol=1e-6)


@given(
    st.integers(0, 10**6),
    st.integers(1, 8),
    st.integers(1, 6),
    st.sampled_from(["mm", "m", "cm", "in"]),
    st.sampled_from([50.0, 100.0, 120.0, 59.94, 29.97]),
)
def test_written_and_read_by_ezc3d(tmp_path_factory, seed, count, markers, unit, rate):
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.mktemp("c3d") / "trial.C3D"
    places = rng.normal(size=(count, markers, 3))
    places[rng.random((count, markers)) < 0.3] = np.nan
    places[0, 0] = 0.0, 0.0, 0.0
    frames = jc.make_markers(places, [f"M{i}" for i in range(markers)], rate)
    jc.write_markers(path, frames, unit)
    theirs = ezc3d.c3d(str(path))
    metres = {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 0.0254}[unit]
    points = np.transpose(theirs["data"]["points"][:3], (2, 1, 0)) * metres
    np.testing.assert_allclose(points, places, rtol=1e-6, atol=2e-9)
    assert theirs["parameters"]["POINT"]["LABELS"]["value"] == list(frames.labels)
    np.testing.assert_array_equal(theirs["data"]["meta_points"]["residuals"][0].T < 0, ~frames.visible)
    again = read_marker_file(path).frames
    assert (again.labels, again.rate) == (frames.labels, rate)
    np.testing.assert_array_equal(again.visible, frames.visible)
    np.testing.assert_allclose(again.positions, frames.positions, rtol=1e-6, atol=2e-9)


def _with(raw, behind, instead):
    """A file with one byte changed, that behind some others."""
    at = raw.index(behind) + len(behind)
    return raw[:at] + instead + raw[at + 1 :]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "the file is empty"),
        (b"hello world\n" * 100, "not a C3D file"),
        (c3d_bytes(walked(), NAMES)[:300], "cut short within its header"),
        (c3d_bytes(walked(), NAMES)[:600], "cut short or damaged within its parameters"),
        (c3d_bytes(walked(100), NAMES)[:4000], "cut short: .* of the 100 frames"),
        (bytes([2, 0x50]) + bytes(range(256)) * 8, "not a C3D file, or its header is damaged"),
        # ezc3d looks for the end of these for ever, and dies of the next
        (
            _with(c3d_bytes(walked(), NAMES), b"ANALOG\x03\x00", b"\xb7"),
            "cut short or damaged within its parameters",
        ),
        (_with(c3d_bytes(walked(), NAMES), b"UNITS\x08\x00\xff", b"\x9e"), "damaged within its parameters"),
        # a list of words without dimensions: a segmentation fault within ezc3d 1.7
        (
            _with(c3d_bytes(walked(), NAMES), b"LABELS\x17\x00\xff", b"\x00"),
            r"this C3D file is incomplete or damaged \(ezc3d crashes with this file, SIG\w+\); copy or export it again",
        ),
        (c3d_bytes(np.full((5, 4, 3), np.inf), NAMES), "infinite, first that of 'LKNE' in frame 1"),
        (c3d_bytes(walked(), NAMES, processor="mips"), "numbers are in the MIPS format"),
        (
            c3d_bytes(walked(), NAMES, more=[("ANALOG", "OFFSET", "float", (1,), [0.0])]),
            "ANALOG:OFFSET has real numbers where the format has integers",
        ),
        (c3d_bytes(np.zeros((5, 0, 3)), []), "the file has no markers"),
        (c3d_bytes(walked(0), NAMES), "the file has no frames"),
        (
            c3d_bytes(walked(markers=2), ["LKneeAngles", "RKneeAngles"]),
            "no markers; it contains only 2 angles",
        ),
        (c3d_bytes(np.zeros((5, 4, 3)), NAMES), "none of its 4 markers is visible in any of 5 frames"),
    ],
)
def test_what_is_refused(tmp_path, content, sentence):
    path = tmp_path / "trial.c3d"
    path.write_bytes(content)
    with pytest.raises(InputError, match=sentence) as error:
        jc.read_markers(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_paths_that_are_wrong(tmp_path):
    frames = jc.make_markers(walked() / 1000, NAMES, 100.0)
    with pytest.raises(InputError, match="no such file"):
        jc.read_markers(tmp_path / "none.c3d")
    (tmp_path / "some.what").touch()
    with pytest.raises(InputError, match=r"'\.what' is unknown; expected a marker file: \.c3d, \.trc, \.csv"):
        jc.read_markers(tmp_path / "some.what")
    (tmp_path / "folder.c3d").mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        jc.read_markers(tmp_path / "folder.c3d")
    with pytest.raises(InputError, match="writable folder"):
        jc.write_markers(tmp_path / "nowhere" / "trial.c3d", frames)
    long = jc.MarkerFrames(jnp.ones((65536, 1, 3)), jnp.ones((65536, 1), bool), ("A",), 100.0)
    with pytest.raises(InputError, match="65536 frames; a C3D file can contain at most 65535"):
        jc.write_markers(tmp_path / "long.c3d", long)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder.c3d", "some.what"]


@pytest.mark.shared
def test_real_files(shared):
    folder = shared / "data" / "markers"
    for name, count, markers in [("static", 875, 73), ("right_hip", 1690, 73), ("right_knee", 922, 73)]:
        frames = jc.read_markers(folder / f"biobuddy_{name}.c3d")
        assert (frames.visible.shape, frames.rate) == ((count, markers), 100.0)
        assert frames.visible.all()
    epicondyles = [frames.labels.index(label) for label in ("RLFE", "RMFE")]
    knee = frames.positions[:, epicondyles]
    assert 0.09 < float(jnp.linalg.norm(knee[:, 0] - knee[:, 1], axis=1).mean()) < 0.12
    cmu = jc.read_markers(folder / "cmu_02_05.c3d")
    assert (cmu.visible.shape, cmu.rate, cmu.labels[0]) == ((1854, 41), 120.0, "RBWT")
    # three frames of one marker have a negative residual
    assert np.unique(np.argwhere(~np.asarray(cmu.visible))[:, 1]).tolist() == [cmu.labels.index("RSHN")]
    assert int((~cmu.visible).sum()) == 3
    with pytest.raises(InputError, match="'boite' .* and 'Daphnee'"):
        jc.read_markers(folder / "pyomeca_upper_limb.c3d")
    arm = jc.read_markers(folder / "pyomeca_upper_limb.c3d", subject="Daphnee")
    assert (arm.visible.shape, arm.labels[0]) == ((580, 43), "ASISr")
    with pytest.raises(InputError, match="looks like millimetres: pass unit='mm'"):
        jc.read_markers(folder / "cmu_02_05.c3d", unit="m")


#: programs in place of ezc3d's, and what is told of them
_PROGRAMS = {
    "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)": "crashes with this file, SIGSEGV",
    "import time; time.sleep(60)": "does not end within 3 s",
    "import sys; sys.exit('bad')": "fails with this file, bad",
    "print('{')": "ended before the whole file was read",
    "pass": "ended before the whole file was read",
    LIMITED + "while True: pass": "does not end with this file",
    LIMITED + "bytearray(4 << 30)": "fails with this file, MemoryError",
}


@pytest.mark.parametrize("program", _PROGRAMS)
def test_process_that_fails(tmp_path, monkeypatch, program):
    """However the process ends, its caller is told by a sentence."""
    path = written(tmp_path, walked(), NAMES)
    (tmp_path / "program.py").write_text(program)
    monkeypatch.setattr(c3d_child, "_PROGRAM", tmp_path / "program.py")
    monkeypatch.setattr(c3d_child, "_WAIT", 3 if "sleep" in program else 60)
    with pytest.raises(InputError, match=_PROGRAMS[program]):
        read_c3d_file(path)


def test_threads_read_at_once(tmp_path):
    path = written(tmp_path, walked(), NAMES)
    with ThreadPoolExecutor(4) as threads:
        files = list(threads.map(read_c3d_file, [path] * 4))
    for file in files:
        np.testing.assert_allclose(file.frames.positions, walked() / 1000, atol=1e-6)


def test_script_without_a_main_guard(tmp_path):
    """Such as `multiprocessing` would run again and again: it reads once, from any folder, and nothing else is printed."""
    path = written(tmp_path, walked(), NAMES)
    script = tmp_path / "script.py"
    script.write_text(
        f"{ALONE}\nfrom pathlib import Path\nfrom jaxcap.io.markers.c3d_child import load_c3d\nprint(load_c3d(Path({str(path)!r})).points.shape)"
    )
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("(3, 4, 6)\n", "")


def test_no_python_to_start(tmp_path, monkeypatch):
    path = written(tmp_path, walked(), NAMES)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    with pytest.raises(InputError, match="no Python program was found to start it; convert it to .trc"):
        read_c3d_file(path)


@pytest.mark.shared
def test_real_file_that_kills_ezc3d(shared, tmp_path):
    """One flipped byte of a real take, the count of its analog channels, ends the process that reads it and no other."""
    raw = bytearray((shared / "data" / "markers" / "cmu_02_05.c3d").read_bytes())
    at = raw.index(b"USED\x07\x00\x02\x00", raw.index(b"GEN_SCALE")) + 8
    raw[at] = 0x80
    (tmp_path / "flipped.c3d").write_bytes(raw)
    with pytest.raises(
        InputError,
        match=r"flipped.c3d: this C3D file is incomplete or damaged \(ezc3d crashes with this file, SIGSEGV\)",
    ):
        jc.read_markers(tmp_path / "flipped.c3d")


@pytest.mark.shared
@pytest.mark.parametrize("kept", [0.1, 0.5, 0.99])
def test_a_real_file_cut_short(shared, tmp_path, kept):
    raw = (shared / "data" / "markers" / "cmu_02_05.c3d").read_bytes()
    (tmp_path / "cut.c3d").write_bytes(raw[: int(kept * len(raw))])
    with pytest.raises(InputError, match="cut short"):
        jc.read_markers(tmp_path / "cut.c3d")
