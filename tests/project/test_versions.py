"""The lowest and the newest versions of libraries that `pyproject.toml` allows, on every Python that it allows.

`JAXCAP_VERSIONS="3.12 lowest"` runs one of them alone.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

#: ends of the ranges, and what `uv` calls them
ENDS = {"lowest": "lowest-direct", "newest": "highest"}
PYTHONS = ("3.11", "3.12", "3.13")
#: quick tests of what calls libraries most: arrays, solvers, readers and writers, meshes, the command line
TESTS = (
    "test_rotation", "test_retraction", "test_solve", "test_arguments", "test_io_lock", "test_io_inside", "test_io_c3d",
    "test_io_npz", "test_mesh", "test_gltf", "test_io_usd", "test_bad_input",
)  # fmt: skip


def uv() -> str:
    """The program `uv`, of this environment or any other. Skips where there is none."""
    found = shutil.which("uv", path=sysconfig.get_path("scripts")) or shutil.which("uv")
    if found is None:
        pytest.skip("needs uv, such as pip install uv brings it")
    return found


def interpreter(version: str) -> str:
    """A Python of this version that `uv` knows of or pyenv has. Skips where there is none: none is downloaded."""
    if version == f"{sys.version_info[0]}.{sys.version_info[1]}":
        return sys.executable
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = sorted(kept.glob(f"{version}.*/bin/python"))
    if found:
        return str(found[-1])
    words = [uv(), "python", "find", "--no-python-downloads", version]
    asked = subprocess.run(words, capture_output=True, text=True)
    if asked.returncode:
        pytest.skip(f"needs Python {version}")
    return asked.stdout.strip()


def run(*words, **options) -> None:
    """Run a program; what it says is the message of a failure."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, **options)
    assert done.returncode == 0, (
        f"{' '.join(map(str, words[:6]))}\n{done.stdout[-6000:]}\n{done.stderr[-3000:]}"
    )


@pytest.mark.slow
@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("version", PYTHONS)
def test_both_ends_of_the_ranges(checkout, tmp_path, version, end):
    """Only wheels, as a user without compilers has it: the lowest version is then the lowest that this Python has one of."""
    only = os.environ.get("JAXCAP_VERSIONS")
    if only and only.split() != [version, end]:
        pytest.skip(f"JAXCAP_VERSIONS asks for {only}")
    python = tmp_path / "venv" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    run(uv(), "venv", "--python", interpreter(version), tmp_path / "venv")
    install = (uv(), "pip", "install", "--python", python)
    run(
        *install,
        "--no-build",
        "--resolution",
        ENDS[end],
        "-r",
        checkout / "pyproject.toml",
        "--extra",
        "test",
    )
    run(*install, "--no-deps", "-e", checkout)
    files = [checkout / "tests" / f"{name}.py" for name in TESTS]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    # compiled functions of other versions of JAX are of no use
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    run(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files, cwd=checkout, env=environment)
