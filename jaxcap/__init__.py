"""Fit articulated bodies to sensor data: poses, motions and their energies in JAX."""

import functools
import importlib
import importlib.util
from pathlib import Path


def __getattr__(name: str) -> object:
    """Import a public name on first use (PEP 562), so that `import jaxcap` alone loads nothing.

    The command line's help does not need JAX. `__init__.pyi` lists the origins of names, also for type
    checkers.
    """
    if name == "__all__":
        return list(_origins())
    if name.startswith("__"):
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module, attribute = _origins().get(name, (name, None))
    if attribute is None and importlib.util.find_spec(f"{__name__}.{module}") is None:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    found = importlib.import_module(f"{__name__}.{module}")
    globals()[name] = found = found if attribute is None else getattr(found, attribute)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_origins()})


@functools.cache
def _origins() -> dict[str, tuple[str, str | None]]:
    """Read the module of each public name and its name there; None for a module itself."""
    import ast

    found: dict[str, tuple[str, str | None]] = {}
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                name = alias.asname or alias.name
                found[name] = (node.module, alias.name) if node.module else (alias.name, None)
    return found
