"""The public names of `jaxcap` and of its namespaces, as `public_names.txt` lists them."""

import inspect
from pathlib import Path
from types import ModuleType

import pytest

import jaxcap

NAMES = Path(__file__).with_name("public_names.txt")
NAMESPACES = {
    name: getattr(jaxcap, name) for name in jaxcap.__all__ if hasattr(getattr(jaxcap, name), "__path__")
}


def listed() -> dict[str, list[str]]:
    """The names of each namespace in the snapshot, a line each: `jaxcap.limits: Cone JointRanges ...`."""
    rows = (line.partition(":") for line in NAMES.read_text("utf-8").splitlines())
    return {space: names.split() for space, _, names in rows}


def public_names() -> dict[str, list[str]]:
    """The names as the package has them now."""
    spaces = {"jaxcap": jaxcap} | {f"jaxcap.{name}": space for name, space in NAMESPACES.items()}
    return {name: sorted(space.__all__) for name, space in spaces.items()}


def test_public_names_change_on_purpose_only():
    """After a change on purpose: `python -m tests.project.test_public_names` writes the snapshot."""
    assert public_names() == listed()


def test_the_face_is_small():
    own = [name for name in jaxcap.__all__ if not isinstance(getattr(jaxcap, name), ModuleType)]
    assert len(own) <= 60


@pytest.mark.parametrize("space", [jaxcap, *NAMESPACES.values()], ids=lambda space: space.__name__)
def test_a_name_is_that_of_its_definition_and_hides_no_module(space):
    for name in space.__all__:
        found = getattr(space, name)
        if isinstance(found, ModuleType):
            assert found.__name__ == f"{space.__name__}.{name}"
        elif inspect.isroutine(found) or inspect.isclass(found):
            assert found.__name__ == name
            folder = Path(space.__file__).parent
            assert not (folder / f"{name}.py").exists() and not (folder / name).exists(), name
    assert set(space.__all__) <= set(dir(space))


def test_a_name_has_one_place():
    places = {}
    for space, names in public_names().items():
        for name in names:
            places.setdefault(name, []).append(space)
    assert {name: spaces for name, spaces in places.items() if len(spaces) > 1} == {}


def test_what_is_missing_raises():
    with pytest.raises(AttributeError, match="module 'jaxcap' has no attribute 'trak'"):
        _ = jaxcap.trak
    with pytest.raises(AttributeError, match=r"module 'jaxcap\.limits' has no attribute 'kone'"):
        _ = jaxcap.limits.kone
    assert jaxcap.io.registry.read_skinned is jaxcap.io.read_skinned


if __name__ == "__main__":
    rows = (f"{space}: {' '.join(names)}\n" for space, names in public_names().items())
    NAMES.write_text("".join(rows), "utf-8")
