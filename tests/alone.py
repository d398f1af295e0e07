"""Scripts for other processes that need a module of `jaxcap.io` and not all that `jaxcap` imports, which takes seconds."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "jaxcap"
#: what such a script begins with
ALONE = f"""
import sys, types
for name, folder in (("jaxcap", {str(PACKAGE)!r}), ("jaxcap.io", {str(PACKAGE / "io")!r})):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = [folder]
"""
