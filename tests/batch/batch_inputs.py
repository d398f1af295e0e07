"""Small motions, and a verb that is killed while it runs."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from jaxcap.cli.batch.jobs import Job
from jaxcap.cli.console.console import print_table, say, warn
from jaxcap.cli.console.record import give_figures
from jaxcap.errors import InputError

SKELETON = """HIERARCHY
ROOT hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT leg
  {
    OFFSET 0 -40 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -40 0
    }
  }
}
MOTION
Frames: 8
Frame Time: 0.033333
"""


def write_take(path: Path, start: int) -> Path:
    """A motion of eight frames of two joints, .bvh."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(SKELETON + "".join(f"0 {90 + start} {k} {k} 0 0 0 {2 * k} 0\n" for k in range(8)))
    return path


def write_takes(folder: Path) -> Path:
    """Two takes of each of two people: `takes/anna/t1.bvh` and so on."""
    for person in ("anna", "ben"):
        for take in (1, 10):
            write_take(folder / "takes" / person / f"t{take}.bvh", take)
    return folder


@dataclass
class Count:
    """A verb that writes the numbers that it has counted, with a checkpoint; it stops once, as a killed process does."""

    source: Path
    out: Path
    report: Path | None = None
    stop: bool = False
    resume: bool = False
    overwrite: bool = False

    def run(self) -> None:
        if not self.source.is_file():
            raise InputError(f"{self.source}: there is no such file; check the path.")
        checkpoint = self.out.with_name(f"{self.out.name}.partial")
        if self.resume and not checkpoint.is_file():
            raise InputError(f"{checkpoint}: there is no checkpoint.")
        counted = int(checkpoint.read_text()) if self.resume else 0
        checkpoint.write_text("3")
        if self.stop and not self.resume:
            raise KeyboardInterrupt
        say(f"{self.out}: counted on from {counted}")
        warn("a warning")
        print_table(["place", "error"], [["top", "1 mm"], ["bottom", "2 mm"]])
        give_figures({"counted": 7})
        self.out.write_text(f"{counted} {self.source.read_text()}")
        if self.report is not None:
            self.report.mkdir()
            (self.report / "report.json").write_text(json.dumps({"rms": 0.5, "frames": [1], "a": {"b": 2}}))
        checkpoint.unlink()


def count_job(folder: Path, *, stop: bool = False, report: bool = False, name: str = "a.txt") -> Job:
    """A job of `Count` in a folder."""
    source = folder / "source.txt"
    if not source.exists():
        source.write_text("seven")
    command = Count(source, folder / "out" / name, folder / "out" / "report" if report else None, stop)
    return Job("0123", os.fspath(source), {}, ("count", name), "count", command, {})
