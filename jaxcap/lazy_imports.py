"""Import public names on first use (PEP 562): the names of a package are those of its `.pyi`.

`import jaxcap` alone loads nothing, so that the command line's help does not need JAX. Type checkers read
the same `.pyi`.
"""

import ast
import functools
import importlib
import importlib.util
from collections.abc import Callable
from pathlib import Path


def attach(
    package: str, file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], tuple[str, ...]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package, from its `__name__` and `__file__`.

    A name that the stub lists is imported from its module; any other name is a submodule.
    """
    origins = read_stub(Path(file).with_suffix(".pyi"))

    def __getattr__(name: str) -> object:
        module, attribute = origins.get(name, (f".{name}", None))
        if name.startswith("__") or (name not in origins and _is_missing(f"{package}.{name}")):
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        found = importlib.import_module(module, package)
        found = found if attribute is None else getattr(found, attribute)
        setattr(importlib.import_module(package), name, found)
        return found

    def __dir__() -> list[str]:
        return sorted({*vars(importlib.import_module(package)), *origins})

    return __getattr__, __dir__, tuple(origins)


@functools.cache
def read_stub(stub: Path) -> dict[str, tuple[str, str | None]]:
    """Read the relative module of each public name and its name there; None for a module itself."""
    origins: dict[str, tuple[str, str | None]] = {}
    for node in ast.parse(stub.read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                module = "." * node.level + (node.module or alias.name)
                origins[alias.asname or alias.name] = (module, alias.name if node.module else None)
    return origins


def _is_missing(module: str) -> bool:
    return importlib.util.find_spec(module) is None
