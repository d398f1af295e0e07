"""A batch on worker processes, of which one is killed."""

import contextlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import jax
import pytest
from batch_inputs import write_takes
from command_line import runs

psutil = pytest.importorskip("psutil")
pytest.importorskip("distributed")
CHECKOUT = Path(__file__).resolve().parents[2]


def workers(batch: subprocess.Popen) -> list:
    found = []
    with contextlib.suppress(psutil.Error):
        for process in psutil.Process(batch.pid).children(recursive=True):
            with contextlib.suppress(psutil.Error):
                found += [process] if "spawn_main" in " ".join(process.cmdline()) else []
    return found


@pytest.mark.slow
def test_killed_workers_lose_nothing(tmp_path, monkeypatch, capsys):
    """All workers die during a job; every job is done, with the outputs of one process."""
    monkeypatch.chdir(write_takes(tmp_path))
    words = ["edit", "resample", "{input}", "-o", "out/{person}-{stem}.bvh", "--rate", "60"]
    batch = subprocess.Popen(
        [sys.executable, "-m", "jaxcap", "batch", "takes/{person}/*.bvh", "--workers", "2", "--", *words],
        env=os.environ | {"PYTHONPATH": str(CHECKOUT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    interrupted = False
    while batch.poll() is None and not interrupted:
        # a folder of an attempt: a job runs now
        begun = list(Path("out").glob(".jaxcap-batch-*"))
        found = workers(batch) if begun else []
        for worker in found:
            worker.kill()
        if found:
            time.sleep(0.2)
            # the folder of a job that was done in the last moment is gone
            interrupted = any(folder.exists() for folder in begun)
        time.sleep(0.005)
    said, wrong = batch.communicate(timeout=300)
    assert interrupted
    assert batch.returncode == 0, wrong
    assert "4 of 4 jobs are done" in said
    rows = [json.loads(line) for line in Path("out/batch.jsonl").read_text().splitlines()]
    assert {row["status"] for row in rows} == {"done"}
    assert any(row["attempts"] > 1 for row in rows)
    for person in ("anna", "ben"):
        for stem in ("t1", "t10"):
            words = ("edit", "resample", f"takes/{person}/{stem}.bvh", "-o", "alone.bvh", "--rate", "60")
            # workers are in single precision, as the command line is
            with jax.enable_x64(False):
                runs(capsys, *words, "--overwrite")
            assert Path("alone.bvh").read_bytes() == Path(f"out/{person}-{stem}.bvh").read_bytes()
    # nothing else is left
    left = {path.name for path in Path("out").iterdir()} - {"batch.parquet"}
    assert left == {"batch.jsonl", "anna-t1.bvh", "anna-t10.bvh", "ben-t1.bvh", "ben-t10.bvh"}
