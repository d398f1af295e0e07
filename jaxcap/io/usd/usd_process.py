"""Open a USD file and read all of its contents, as a separate program.

It is run as `python -I -S usd_process.py FILE FOLDERS...`. OpenUSD is C++ and crashes on some damaged files.
So `usd_child.py` starts this file, which imports nothing of jaxcap, and the reader continues only if this
program succeeds. The reader reports the errors of OpenUSD. `FOLDERS` are those of OpenUSD.
"""

# pxr fills its modules as it is imported and has no stubs
# pyright: reportAttributeAccessIssue=false

import os
import runpy
import sys
from typing import Any

#: limits of bytes and of seconds of CPU: a constant and a part for each byte
MEMORY, MEMORY_PER_BYTE = 3 << 30, 200
SECONDS, SECONDS_PER_BYTE = 15, 4e-6


def main(path: str, folders: list[str]) -> None:
    sys.path[:0] = folders
    from pxr import Sdf, Tf, Usd, UsdSkel

    limits = runpy.run_path(os.path.join(os.path.dirname(__file__), "..", "system", "process_limits.py"))
    size = os.path.getsize(path)
    limits["limit"](int(SECONDS + SECONDS_PER_BYTE * size), MEMORY + MEMORY_PER_BYTE * size)
    try:
        layer = Sdf.Layer.FindOrOpen(path)
        if layer and _layers_in_folder(Sdf, path, layer):
            _read_everything(Usd, UsdSkel, Tf, Usd.Stage.Open(layer))
    except (Tf.ErrorException, UnicodeDecodeError):
        pass


def _layers_in_folder(Sdf: Any, path: str, first: Any) -> bool:
    """Check that all layers are in the folder of the file or of its link target.

    The reader rejects layers in other folders, so they are not opened here either.
    """
    folders = {
        os.path.realpath(os.path.dirname(found)) for found in (os.path.abspath(path), os.path.realpath(path))
    }
    layers, seen = [first], set()
    while layers:
        layer = layers.pop()
        for name in layer.GetCompositionAssetDependencies() if layer else ():
            found = layer.ComputeAbsolutePath(name)
            real = os.path.realpath(found.partition("[")[0])
            if not any(os.path.commonpath([real, folder]) == folder for folder in folders):
                return False
            if found not in seen:
                seen.add(found)
                layers.append(Sdf.Layer.FindOrOpen(found))
    return True


def _read_everything(Usd: Any, UsdSkel: Any, Tf: Any, stage: Any) -> None:
    """Read every attribute at every time, and the skinning of surfaces.

    An error of one does not stop the rest.
    """
    predicate, cache = Usd.TraverseInstanceProxies(), UsdSkel.Cache()
    for prim in Usd.PrimRange.Stage(stage, predicate):
        for attribute in prim.GetAttributes():
            try:
                attribute.Get()
                for time in attribute.GetTimeSamples():
                    attribute.Get(time)
            except (Tf.ErrorException, UnicodeDecodeError):
                continue
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, predicate)
            for found in cache.ComputeSkelBindings(root, predicate):
                cache.GetSkelQuery(found.GetSkeleton()).GetJointOrder()
                found.GetSkinningTargets()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
