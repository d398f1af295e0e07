"""Rivals in virtual environments of their own: made where they are not there, and run in processes of their own."""

import argparse
import os
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.report import progress


class Rival(NamedTuple):
    """The Python versions and packages of another program, and libraries to preload."""

    #: the first of these interpreters that is found
    pythons: tuple[str, ...]
    packages: tuple[str, ...]
    #: libraries of the system that have to be loaded first
    preload: tuple[str, ...] = ()


RIVALS = {
    "momentum": Rival(("3.12", "3.13"), ("torch==2.8.*", "pymomentum-cpu==0.1.114.post0", "numpy", "scipy"), ("libstdc++.so.6",)),
    "opensim": Rival(("3.11",), ("opensim==4.6", "numpy")),
    "nimblephysics": Rival(("3.10", "3.9"), ("nimblephysics==0.10.52.1", "numpy==1.26.*")),
}  # fmt: skip


def find_python(versions: tuple[str, ...]) -> str | None:
    """Find a Python of one of these versions on the path or in pyenv."""
    roots = sorted(
        Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/*"), reverse=True
    )
    for version in versions:
        for root in roots:
            if root.name.startswith(f"{version}."):
                return str(root / "bin" / "python")
        if found := shutil.which(f"python{version}"):
            return found
    return None


def opensim_parser(description: str | None) -> argparse.ArgumentParser:
    """Make the parser of a benchmark against OpenSim, with its models and its Python."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", type=Path, required=True, help="a checkout of opensim-org/opensim-models")
    parser.add_argument("--venvs", type=Path, default=Path.home() / ".cache" / "jaxcap" / "rivals")
    parser.add_argument("--python", type=Path, help="a Python that has opensim, in place of an environment")
    return parser


def opensim_python(options: argparse.Namespace) -> Path:
    """Find the Python of `opensim_parser`'s options, or make its environment."""
    python = options.python or environment("opensim", options.venvs)
    if python is None:
        raise SystemExit("The package opensim could not be installed.")
    return python


def environment(name: str, folder: Path) -> Path | None:
    """Find or install the Python of a rival's environment; None as in `install`."""
    return install(name, RIVALS[name], folder)


def install(name: str, rival: Rival, folder: Path) -> Path | None:
    """Find or install the Python of an environment under a folder; print a message and return None if this fails."""
    home = folder / name
    python, done = home / "bin" / "python", home / "complete"
    if done.exists():
        return python
    base = find_python(rival.pythons)
    if base is None:
        progress(f"{name} is skipped: Python {' or '.join(rival.pythons)} was not found")
        return None
    progress(f"{name}: installing {', '.join(rival.packages)} with {base}")
    for command in (
        [base, "-m", "venv", str(home)],
        [str(python), "-m", "pip", "install", "-q", *rival.packages],
    ):
        outcome = subprocess.run(command, capture_output=True, text=True)
        if outcome.returncode:
            said = (outcome.stderr.strip() or "no output").splitlines()[-1]
            progress(f"{name} is skipped: the installation failed: {said}")
            return None
    done.touch()
    return python


def library(name: str) -> str | None:
    folders = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib")
    return next((str(Path(folder) / name) for folder in folders if (Path(folder) / name).exists()), None)


def clean_surroundings() -> dict[str, str]:
    """Return the variables of this process without those of its own Python."""
    return {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}


def run_script(python: Path, script: Path, *paths: Path) -> None:
    """Run a script in the environment of another Python, and report the end of its error output if it fails."""
    command = [str(python), str(script), *map(str, paths)]
    outcome = subprocess.run(command, env=clean_surroundings(), capture_output=True, text=True)
    if outcome.returncode:
        progress(outcome.stderr[-500:])
        outcome.check_returncode()


def run_rival(name: str, python: Path, scene_path: Path, limit: float) -> dict[str, np.ndarray] | None:
    result = scene_path.with_name(f"{name}.npz")
    script = Path(__file__).with_name(f"run_{name}.py")
    preload = ":".join(found for one in RIVALS[name].preload if (found := library(one)))
    surroundings = clean_surroundings()
    surroundings |= {"LD_PRELOAD": preload} if preload else {}
    try:
        command = [str(python), str(script), str(scene_path), str(result)]
        outcome = subprocess.run(command, env=surroundings, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        progress(f"{name} is skipped: it did not finish within {limit:.0f} s")
        return None
    # they say much, and draw bars; what the script itself says begins with the rival's name
    for line in outcome.stderr.splitlines():
        if line.startswith(f"{name} "):
            progress(line)
    if outcome.returncode or not result.exists():
        said = ([line for line in outcome.stderr.splitlines() if line.strip()] or ["no output"])[-1][-200:]
        progress(f"{name} is skipped: exit code {outcome.returncode}: {said}")
        return None
    with np.load(result, allow_pickle=False) as file:
        return dict(file)
