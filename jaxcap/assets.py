"""Where the package keeps the files it brings along."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def asset_path(name: str) -> Path:
    """The path of a file that comes with jaxcap, in an installed wheel (`jaxcap/_assets`) or in
    a checkout (`assets` beside the package).

    **Raises:** `FileNotFoundError` with one sentence when it lies in neither.
    """
    places = (PACKAGE / "_assets" / name, PACKAGE.parent / "assets" / name)
    for path in places:
        if path.is_file():
            return path
    raise FileNotFoundError(
        f"The file '{name}' that comes with jaxcap is neither at {places[0]} nor at {places[1]}; "
        f"install jaxcap anew, or build the file with scripts/build_human.py."
    )
