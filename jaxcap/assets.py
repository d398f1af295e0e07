"""Paths of the data files of the package."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def asset_path(name: str) -> Path:
    """Return the path of a data file of jaxcap, in an installed wheel (`jaxcap/_assets`) or in a checkout
    (`assets` next to the package).

    **Raises:** `FileNotFoundError` with one sentence when it is in neither.
    """
    candidates = (PACKAGE / "_assets" / name, PACKAGE.parent / "assets" / name)
    for path in candidates:
        if path.is_file():
            return path
    raise FileNotFoundError(
        f"The data file '{name}' of jaxcap is neither at {candidates[0]} nor at {candidates[1]}; "
        f"reinstall jaxcap, or build the file with scripts/build_human.py."
    )
