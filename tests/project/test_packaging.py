"""The package as others get it: the wheel with its assets, and the rules of the source tree."""

import contextlib
import importlib.metadata
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest


def committed(checkout: Path) -> list[Path]:
    """The files git knows, where this is a git checkout."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=checkout, capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("needs a git checkout")
    return [checkout / name for name in listed.stdout.split("\0") if name and (checkout / name).is_file()]


def test_nothing_committed_names_one_machine(checkout):
    """Home folders, and indices of packages other than the public one, work in one place only."""
    # in pieces, so that this file does not find itself
    folders = ["/ho" + "me/", "/ro" + "ot/", "/wo" + "rk/", "/Use" + "rs/"]
    indices = ["--index" + "-url", "--extra-index" + "-url", "--find" + "-links"]
    found = []
    for path in committed(checkout):
        try:
            text = path.read_text("utf-8")
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.splitlines(), 1):
            if any(word in line for word in folders + indices):
                found.append(f"{path.relative_to(checkout)}:{number}: {line.strip()[:80]}")
    assert found == []


def test_version_is_told_in_one_way(checkout):
    project = tomllib.loads((checkout / "pyproject.toml").read_text("utf-8"))["project"]
    changelog = (checkout / "CHANGELOG.md").read_text("utf-8")
    assert f"## [{project['version']}]" in changelog
    # run from the source tree alone there is no installed version to compare
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        assert importlib.metadata.version("jaxcap") == project["version"]


@pytest.mark.slow
def test_wheel_brings_its_human(checkout, tmp_path):
    """A wheel, unpacked far from the checkout, finds the embedded human in itself."""
    pip = [sys.executable, "-m", "pip", "--quiet"]
    wheels, site = tmp_path / "wheels", tmp_path / "site"
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", wheels, checkout], check=True, timeout=300)
    (wheel,) = wheels.glob("jaxcap-*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", site, wheel], check=True, timeout=300)
    assert (site / "jaxcap" / "py.typed").is_file()

    script = (
        "import jaxcap, numpy as np\n"
        "body = jaxcap.human()\n"
        "assert np.isfinite(body.vertices).all() and len(body.vertices) > 1000\n"
        "print(jaxcap.__file__)"
    )
    environment = {**os.environ, "PYTHONPATH": str(site)}
    told = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert told.returncode == 0, told.stderr
    assert Path(told.stdout.strip()).is_relative_to(site)
