"""Open a USD file and look at all that is in it, as a program of its own: `python -I -S usd_process.py FILE FOLDERS...`.

OpenUSD is C++ and ends its process on some damaged files. So `usd_child.py` starts this file, which imports nothing of
jaxcap, and reads a file itself only where this comes to its end. What OpenUSD says of an error is left to the reader.
`FOLDERS` are those of OpenUSD.
"""

# pxr fills its modules as it is imported and has no stubs
# pyright: reportAttributeAccessIssue=false

import os
import runpy
import sys
from typing import Any

#: bytes, and seconds of CPU, for a file of no bytes, and more for each byte
MEMORY, MEMORY_PER_BYTE = 3 << 30, 200
SECONDS, SECONDS_PER_BYTE = 15, 4e-6


def main(path: str, folders: list[str]) -> None:
    sys.path[:0] = folders
    from pxr import Sdf, Tf, Usd, UsdSkel

    limits = runpy.run_path(os.path.join(os.path.dirname(__file__), "process_limits.py"))
    size = os.path.getsize(path)
    limits["limit"](int(SECONDS + SECONDS_PER_BYTE * size), MEMORY + MEMORY_PER_BYTE * size)
    try:
        layer = Sdf.Layer.FindOrOpen(path)
        # the reader refuses what lies elsewhere, and it is not opened here either
        folder = os.path.dirname(os.path.realpath(path)) + os.sep
        names = layer.GetCompositionAssetDependencies() if layer else ()
        files = [layer.ComputeAbsolutePath(name).partition("[")[0] for name in names]
        if layer and all((os.path.realpath(file) + os.sep).startswith(folder) for file in files):
            _touch(Usd, UsdSkel, Usd.Stage.Open(layer))
    except (Tf.ErrorException, UnicodeDecodeError):
        pass


def _touch(Usd: Any, UsdSkel: Any, stage: Any) -> None:
    """Get the value of every attribute at every time, and what moves surfaces."""
    predicate, cache = Usd.TraverseInstanceProxies(), UsdSkel.Cache()
    for prim in Usd.PrimRange.Stage(stage, predicate):
        for attribute in prim.GetAttributes():
            attribute.Get()
            for time in attribute.GetTimeSamples():
                attribute.Get(time)
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, predicate)
            for found in cache.ComputeSkelBindings(root, predicate):
                cache.GetSkelQuery(found.GetSkeleton()).GetJointOrder()
                found.GetSkinningTargets()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
