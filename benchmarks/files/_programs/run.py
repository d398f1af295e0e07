"""Other programs in environments of their own: Blender, Khronos's validator, three.js in a browser, and OpenUSD."""

import functools
import http.server
import json
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from benchmarks.markers._rivals.environments import Rival, install
from benchmarks.report import progress
from benchmarks.view._browser import launch_browser

HERE = Path(__file__).parent
BLENDER = Rival(("3.11",), ("bpy==5.0.1",))
NODE = ("gltf-validator@2.0.0-dev.3.10", "three@0.187.0")
#: of the pictures, pixels
WIDTH, HEIGHT = 480, 480


def node_modules(folder: Path) -> Path | None:
    """Find or install the folder whose `node_modules` has the validator and three.js; print a message and return None if this
    fails."""
    home = folder / "node"
    if (home / "complete").exists():
        return home
    if shutil.which("node") is None or shutil.which("npm") is None:
        progress("gltf-validator and three.js are skipped: node and npm are not installed")
        return None
    home.mkdir(parents=True, exist_ok=True)
    progress(f"node: installing {', '.join(NODE)}")
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(home), *NODE]
    outcome = subprocess.run(command, capture_output=True, text=True, cwd=home)
    if outcome.returncode:
        said = (outcome.stderr.strip() or "no output").splitlines()[-1]
        progress(f"gltf-validator and three.js are skipped: the installation failed: {said}")
        return None
    (home / "complete").touch()
    return home


def blender(folder: Path) -> Path | None:
    """Find or install the Python with Blender; None as in `install`."""
    return install("blender", BLENDER, folder)


def in_blender(
    python: Path, file: Path, rate: float, frames: list[int], again: Path | None = None
) -> dict[str, np.ndarray]:
    """Read a file in Blender (`blender.py`), and write it as `again`, a `.glb`. Raises `RuntimeError` with its last output
    if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "found.npz"
        chosen = ",".join(map(str, frames))
        command = [str(python), str(HERE / "blender.py"), str(file), str(rate), chosen, str(result)]
        command += [] if again is None else [str(again)]
        outcome = subprocess.run(command, capture_output=True, text=True, timeout=1800)
        if outcome.returncode or not result.exists():
            raise RuntimeError(f"Blender failed on {file.name}: {(outcome.stdout + outcome.stderr)[-2000:]}")
        with np.load(result, allow_pickle=False) as found:
            return dict(found)


def validate(home: Path, files: list[Path]) -> dict[str, dict[str, Any]]:
    """Validate files; return the validator's results by file name."""
    command = ["node", str(HERE / "validate.mjs"), *map(str, files)]
    outcome = subprocess.run(command, capture_output=True, text=True, cwd=home, timeout=600, check=True)
    return {Path(path).name: found for path, found in json.loads(outcome.stdout)["files"].items()}


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format, *args):
        pass


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Serve a folder on the local machine, and yield its address."""
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(_Quiet, directory=str(folder))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


def in_three(
    home: Path, file: Path, times: list[float], centre: Float[np.ndarray, "3"], radius: float
) -> dict[str, Any]:
    """Load the body of a `.glb` in three.js at some times, seconds: `vertices (T, V, 3)`, `pictures` (PNG), `errors`."""
    with tempfile.TemporaryDirectory() as folder:
        site = Path(folder)
        (site / "node_modules").symlink_to(home / "node_modules")
        shutil.copy(HERE / "page.html", site)
        shutil.copy(file, site / "body.glb")
        with serve(site) as address, launch_browser() as browser:
            page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            said: list[str] = []
            page.on("pageerror", lambda error: said.append(str(error)))
            page.on("console", lambda line: said.append(line.text) if line.type == "error" else None)
            page.goto(f"{address}/page.html?file=body.glb")
            page.wait_for_function("window.loaded", timeout=120_000)
            said += page.evaluate("window.errors")
            found: dict[str, Any] = {"errors": said, "revision": page.evaluate("window.revision")}
            if not said:
                page.evaluate("([c, r]) => look(c, r)", [centre.tolist(), radius])
                vertices, pictures = [], []
                for time in times:
                    page.evaluate("t => show(t)", time)
                    vertices.append(np.array(page.evaluate("vertices()")).reshape(-1, 3))
                    pictures.append(page.screenshot())
                found |= {"vertices": np.array(vertices), "pictures": pictures}
    return found


def in_usd(file: Path, frames: list[int]) -> dict[str, Any]:
    """Skin the body of a USD file by UsdSkel: `vertices (F, V, 3)`, `joints (F, J, 3)`, `names`, `messages` of all of
    OpenUSD's validators."""
    from pxr import Usd, UsdGeom, UsdSkel, UsdValidation, Vt

    stage = Usd.Stage.Open(str(file))
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    (target,) = binding.GetSkinningTargets()
    query = cache.GetSkelQuery(binding.GetSkeleton())
    rest = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get()
    vertices, joints = [], []
    for frame in frames:
        points = Vt.Vec3fArray(rest)
        if not target.ComputeSkinnedPoints(query.ComputeSkinningTransforms(frame), points, frame):
            raise RuntimeError(f"OpenUSD does not skin {file.name}.")
        # points come in the skeleton's space, and the file's scale is of the root
        placed = UsdGeom.XformCache(frame).GetLocalToWorldTransform(binding.GetSkeleton().GetPrim())
        matrix = np.array(placed)
        vertices.append(np.array(points) @ matrix[:3, :3] + matrix[3, :3])
        joints.append((np.array(query.ComputeJointSkelTransforms(frame)) @ matrix)[:, 3, :3])
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    messages = [
        f"{error.GetName()}: {error.GetMessage()}"
        for error in UsdValidation.ValidationContext(validators).Validate(stage)
    ]
    names = list(binding.GetSkeleton().GetJointNamesAttr().Get())
    return {"vertices": np.array(vertices), "joints": np.array(joints), "names": names, "messages": messages}
