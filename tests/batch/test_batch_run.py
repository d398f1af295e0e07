"""One job on a worker, and whole batches on workers in threads of this process."""

import contextlib
import dataclasses
import json
import os
from pathlib import Path

import pytest
from batch_inputs import count_job, write_take, write_takes
from command_line import fails, runs

from jaxcap.batch import map_jobs, open_cluster
from jaxcap.batch.cluster import check_version
from jaxcap.batch.size import GIB, Computer, count_workers
from jaxcap.batch.versions import Version, installed_version
from jaxcap.cli import main
from jaxcap.cli.batch import batch
from jaxcap.cli.batch.finished import check_absent_outputs, index_owners, is_finished, owned_outputs
from jaxcap.cli.batch.inputs import describe_inputs
from jaxcap.cli.batch.jobs import Job
from jaxcap.cli.batch.results import ResultTable, read_rows
from jaxcap.cli.batch.run_job import Assignment, run_job
from jaxcap.cli.batch.staging import open_staging, publish
from jaxcap.errors import InputError

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def client():
    with open_cluster(2, processes=False) as client:
        yield client


def assigned(folder, job, replace=False):
    (folder / "receipts").mkdir(exist_ok=True)
    return Assignment(job, os.getcwd(), str(folder / "receipts"), replace)


def files_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


def test_a_job_gives_its_outputs_and_its_row(tmp_path):
    row = run_job(assigned(tmp_path, count_job(tmp_path, report=True)))
    assert (row["status"], row["message"], row["attempts"]) == ("done", "", 1)
    out = tmp_path / "out"
    assert files_in(out) == ["a.txt", "report", "report.json"]
    assert sorted(row["outputs"]) == [str(out / "a.txt"), str(out / "report" / "report.json")]
    # the folder in which the job wrote is nowhere in its messages
    assert row["messages"] == [f"{out / 'a.txt'}: counted on from 0"]
    assert row["warnings"] == ["a warning"]
    assert row["rows"] == [{"place": "top", "error": "1 mm"}, {"place": "bottom", "error": "2 mm"}]
    assert row["figures"] == {"counted": 7, "rms": 0.5, "a.b": 2}
    assert row["inputs"][str(tmp_path / "source.txt")]["files"] == 1
    # a worker that finished the job and died before its row arrived does not do it again
    (out / "a.txt").unlink()
    assert run_job(assigned(tmp_path, count_job(tmp_path, report=True))) == json.loads(json.dumps(row))
    assert files_in(out) == ["report", "report.json"]


def test_a_killed_job_goes_on_from_its_checkpoint(tmp_path):
    stopped = count_job(tmp_path, stop=True)
    with pytest.raises(KeyboardInterrupt):
        run_job(assigned(tmp_path, stopped))
    # nothing is to be seen of it
    assert [path.name for path in (tmp_path / "out").iterdir() if not path.name.startswith(".")] == []
    row = run_job(assigned(tmp_path, stopped))
    assert (row["status"], row["attempts"]) == ("done", 2)
    assert (tmp_path / "out" / "a.txt").read_text() == "3 seven"
    assert files_in(tmp_path / "out") == ["a.txt"]


def test_a_checkpoint_that_is_of_no_use_is_left(tmp_path):
    stopped = count_job(tmp_path, stop=True)
    with pytest.raises(KeyboardInterrupt):
        run_job(assigned(tmp_path, stopped))
    next((tmp_path / "out").rglob("*.partial")).unlink()
    again = dataclasses.replace(stopped.command, stop=False)
    row = run_job(assigned(tmp_path, stopped._replace(command=again)))
    assert row["status"] == "done"
    assert "begun anew" in row["warnings"][0]
    assert (tmp_path / "out" / "a.txt").read_text() == "0 seven"


def test_a_failed_job_leaves_its_sentence_only(tmp_path):
    job = count_job(tmp_path)
    (tmp_path / "source.txt").unlink()
    row = run_job(assigned(tmp_path, job))
    assert (row["status"], row["outputs"]) == ("failed", [])
    assert row["message"] == f"{tmp_path / 'source.txt'}: there is no such file; check the path."
    assert files_in(tmp_path / "out") == []


def test_existing_outputs_are_replaced_only_if_they_may_be(tmp_path):
    job = count_job(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.txt").write_text("mine")
    row = run_job(assigned(tmp_path, job))
    assert row["status"] == "failed"
    assert "a.txt: this file already exists; give --overwrite to the batch" in row["message"]
    assert (tmp_path / "out" / "a.txt").read_text() == "mine"
    assert run_job(assigned(tmp_path, job, replace=True))["status"] == "done"
    assert (tmp_path / "out" / "a.txt").read_text() == "0 seven"


def test_outputs_of_others_are_never_replaced(tmp_path):
    """Neither after a row of a failed job, nor after an attempt that was killed before it moved its outputs."""
    job = count_job(tmp_path, stop=True)
    failed = {"key": job.key, "status": "failed", "outputs": []}
    with pytest.raises(KeyboardInterrupt):
        run_job(assigned(tmp_path, job))
    (tmp_path / "out" / "a.txt").write_text("mine")
    with pytest.raises(InputError, match="not an output of an earlier run"):
        check_absent_outputs([job], {job.key: failed})
    assert owned_outputs(job, {job.key: failed}, index_owners({job.key: failed})) == ()
    row = run_job(assigned(tmp_path, job))
    assert "this file already exists" in row["message"]
    assert (tmp_path / "out" / "a.txt").read_text() == "mine"
    # those of a done job are, and so are those that a killed attempt had begun to move
    done = {
        "other": {**failed, "status": "done", "outputs": [str(tmp_path / "out" / ".." / "out" / "a.txt")]}
    }
    check_absent_outputs([job], done)
    owned = owned_outputs(job, done, index_owners(done))
    job = count_job(tmp_path)
    assert run_job(assigned(tmp_path, job)._replace(owned=owned))["status"] == "done"
    (tmp_path / "receipts" / f"{job.key}.json").unlink()
    with open_staging(job) as staging:
        (tmp_path / "out" / "a.txt").unlink()
        (next(iter(staging.folders.values())) / "a.txt").write_text("new")
        publish(staging, replace=False)
        check_absent_outputs([job], {})
        (next(iter(staging.folders.values())) / "a.txt").write_text("newer")
        publish(staging, replace=False)
    assert (tmp_path / "out" / "a.txt").read_text() == "newer"


def test_urls_are_fetched_and_sent(tmp_path):
    """fsspec's store in memory stands for one on a network."""
    store = pytest.importorskip("fsspec").filesystem("memory")
    job = count_job(tmp_path)
    store.pipe("/in/source.txt", b"nine")
    urls = {"memory://in/source.txt": "memory://in/source.txt", "memory:/out/a.txt": "memory://out/a.txt"}
    urls["memory:/in/source.txt"] = "memory://in/source.txt"
    command = dataclasses.replace(
        job.command, source=Path("memory:/in/source.txt"), out=Path("memory:/out/a.txt")
    )
    row = run_job(assigned(tmp_path, job._replace(command=command, urls=urls)))
    assert row["message"] == ""
    assert row["outputs"] == ["memory://out/a.txt"]
    assert store.cat("/out/a.txt") == b"0 nine"
    gone = {name: url.replace("source", "gone") for name, url in urls.items()}
    row = run_job(assigned(tmp_path, job._replace(key="4", command=command, urls=gone), replace=True))
    assert "cannot be reached" in row["message"] or "there is no such file" in row["message"]
    # nor is anything left of a job with outputs on this computer
    local = dataclasses.replace(job.command, source=Path("memory:/in/source.txt"))
    row = run_job(assigned(tmp_path, job._replace(key="5", command=local, urls=gone)))
    assert row["status"] == "failed"
    assert files_in(tmp_path / "out") == []


def test_files_that_are_not_written_again_are_removed(tmp_path):
    job = count_job(tmp_path, report=True)
    first = run_job(assigned(tmp_path, job))
    (tmp_path / "out" / "report" / "old.json").write_text("{}")
    (tmp_path / "out" / "report" / "mine.json").write_text("{}")
    earlier = (*first["outputs"], str(tmp_path / "out" / "report" / "old.json"))
    (tmp_path / "receipts" / f"{job.key}.json").unlink()
    row = run_job(assigned(tmp_path, job)._replace(earlier=earlier))
    assert (row["status"], row["outputs"]) == ("done", first["outputs"])
    assert files_in(tmp_path / "out") == ["a.txt", "mine.json", "report", "report.json"]


@dataclasses.dataclass
class List:
    """A verb that reads a folder or a pattern."""

    source: str
    out: Path
    report: Path


@pytest.mark.parametrize("source", [".", "*", "**/*", "scans"])
def test_outputs_in_an_input_folder_are_no_inputs(tmp_path, monkeypatch, source):
    monkeypatch.chdir(tmp_path)
    write_take(Path("scans/a.bvh"), 0)
    write_take(Path("b.bvh"), 0)
    command = List(source, Path("scans/found"), Path("scans/c.json"))
    job = Job("0", "", {}, (), "list", command, {})
    row = {"key": job.key, "status": "done", "inputs": describe_inputs(job, ("batch.jsonl",)), "outputs": []}
    row["version"] = str(installed_version())
    assert row["inputs"][source]["files"] == {".": 2, "*": 1, "**/*": 2, "scans": 1}[source]
    for name in ("scans/found/d.bvh", "scans/found/e/d.bvh", "scans/c.json", "scans/c.mtl"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
        row["outputs"].append(name)
    for name in ("batch.jsonl", "batch.parquet", "scans/.hidden"):
        Path(name).touch()
    assert is_finished(job, row, Path("batch.jsonl"))
    # other sources with the same number are another version
    other = Version(installed_version().number, "0" * 64)
    assert not is_finished(job, {**row, "version": str(other)}, Path("batch.jsonl"))
    Path("scans/f.bvh" if source != "*" else "f.bvh").touch()
    assert not is_finished(job, row, Path("batch.jsonl"))


def test_a_torn_row_is_left_out(tmp_path):
    path = tmp_path / "batch.jsonl"
    rows = [{"key": "a", "status": "failed"}, {"key": "b", "status": "done"}, {"key": "a", "status": "done"}]
    text = "".join(f"{json.dumps(row)}\n" for row in rows)
    path.write_text(text + '{"key": "c", "sta')
    assert read_rows(path) == {"a": rows[2], "b": rows[1]}
    ResultTable(path).append({"key": "d", "status": "done"})
    assert list(read_rows(path)) == ["a", "b", "d"]
    path.write_text('{"key": "c", "sta\n' + text)
    with pytest.raises(InputError, match=r"batch.jsonl:1: this line is no row"):
        read_rows(path)


def test_workers_by_cores_memory_and_jobs():
    computer = Computer(8, 16 * GIB)
    assert count_workers(computer, GIB, 100) == 8
    assert count_workers(computer, 4 * GIB, 100) == 3
    assert count_workers(computer, 100 * GIB, 100) == 1
    assert count_workers(computer, GIB, 2) == 2
    assert count_workers(computer, 4 * GIB, 100, 12) == 12
    with pytest.raises(InputError, match="is 0; it must be at least 1"):
        count_workers(computer, GIB, 2, 0)


def invert(number: int) -> float:
    return 1 / number


def test_map_jobs(client):
    found = sorted(map_jobs(invert, [1, 0, 4], client))
    assert [result.value for result in found] == [1.0, None, 0.25]
    assert [type(result.error) for result in found] == [type(None), ZeroDivisionError, type(None)]
    with pytest.raises(InputError, match="cannot be pickled"):
        list(map_jobs(invert, [(each for each in "abc")], client))


def test_another_version_on_a_worker():
    own = installed_version()
    check_version(own, Version(*own), "tcp://there")
    with pytest.raises(InputError, match="tcp://there: this worker has version 9.9"):
        check_version(own, Version("9.9", own.source), "tcp://there")
    with pytest.raises(InputError, match="install the same version"):
        check_version(own, Version(own.number, "0" * 64), "tcp://there")


def test_no_scheduler(monkeypatch):
    monkeypatch.setattr("jaxcap.batch.cluster.ANSWER_SECONDS", 0.3)
    with (
        pytest.raises(InputError, match="tcp://127.0.0.1:9: no scheduler answers at this address"),
        open_cluster(scheduler="tcp://127.0.0.1:9"),
    ):
        pass


def test_without_dask(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    assert "install it with pip install 'jaxcap[cluster]'." in fails(
        capsys, "batch", "*.bvh", "--", "info", "{input}"
    )


CUT = ("--", "edit", "cut", "{input}", "-o", "out/{person}/{take}.bvh", "--frames", "2", "5")
PATTERN = "takes/{person}/{take}.bvh"


@pytest.fixture
def takes(tmp_path, monkeypatch, client):
    monkeypatch.chdir(write_takes(tmp_path))
    monkeypatch.setattr(batch, "open_cluster", lambda *_, **__: contextlib.nullcontext(client))
    return tmp_path


def table() -> dict[str, dict]:
    return {row["job"]: row for row in read_rows(Path("out/batch.jsonl")).values()}


def test_a_batch_goes_on_where_it_was(takes, capsys):
    (takes / "takes" / "ben" / "t2.bvh").write_text("no motion")
    with pytest.raises(SystemExit) as stop:
        main(["batch", PATTERN, *CUT])
    assert stop.value.code == 2
    said = capsys.readouterr()
    assert "4 of 5 jobs are done: out/batch.jsonl" in said.out
    sentence = said.err.strip().splitlines()[-1]
    assert sentence.startswith(
        "jaxcap: 1 job of 5 failed; correct the inputs and run the same command again."
    )
    assert "takes/ben/t2.bvh: " in sentence
    first = table()
    assert {job: row["status"] for job, row in first.items()} == {
        "takes/anna/t1.bvh": "done",
        "takes/anna/t10.bvh": "done",
        "takes/ben/t1.bvh": "done",
        "takes/ben/t2.bvh": "failed",
        "takes/ben/t10.bvh": "done",
    }
    assert not Path("out/ben/t2.bvh").exists()
    # as the verb alone
    runs(capsys, "edit", "cut", "takes/ben/t10.bvh", "-o", "alone.bvh", "--frames", "2", "5")
    assert Path("alone.bvh").read_bytes() == Path("out/ben/t10.bvh").read_bytes()

    # one input is mended, one changes, one has another time only, and one output is lost
    write_take(Path("takes/ben/t2.bvh"), 2)
    write_take(Path("takes/anna/t1.bvh"), 30)
    os.utime("takes/anna/t10.bvh")
    Path("out/ben/t1.bvh").unlink()
    assert "5 of 5 jobs are done, 2 of them before" in runs(capsys, "batch", PATTERN, *CUT)
    again = table()
    new = {job for job, row in again.items() if row != first[job]}
    assert new == {"takes/ben/t2.bvh", "takes/anna/t1.bvh", "takes/ben/t1.bvh"}
    assert list(again) == list(first)
    assert sorted(path.name for path in Path("out").iterdir() if path.suffix != ".parquet") == [
        "anna",
        "batch.jsonl",
        "ben",
    ]
    parquet = pytest.importorskip("pyarrow.parquet").read_table("out/batch.parquet")
    assert parquet.column("values.take").to_pylist() == ["t1", "t10", "t1", "t2", "t10"]

    # outputs of this batch are replaced if options change; those of others are not
    assert "5 of 5 jobs are done" in runs(capsys, "batch", PATTERN, *CUT[:-1], "6")
    Path("other.bvh").write_text("mine")
    words = ("-o", "out/batch.jsonl", "--", "edit", "mirror", "{input}", "-o", "other.bvh")
    sentence = fails(capsys, "batch", "takes/anna/{take}0.bvh", *words)
    assert "other.bvh: this already exists, and it is not an output of an earlier run" in sentence
    assert Path("other.bvh").read_text() == "mine"


def test_refused_with_one_sentence(takes, capsys):
    (takes / "locked").mkdir(mode=0o500)
    if not os.access(takes / "locked", os.W_OK):
        words = ("--", "edit", "mirror", "{input}", "-o", "locked/{person}{take}.bvh")
        assert "locked: this folder cannot be written to" in fails(capsys, "batch", PATTERN, *words)
    assert "--slurm has 'cpu'" in fails(capsys, "batch", PATTERN, "--slurm", "cpu", *CUT)
    assert "--memory is -1" in fails(capsys, "batch", PATTERN, "--memory", "-1", *CUT)
    assert "written as .jsonl" in fails(capsys, "batch", PATTERN, "-o", "a.csv", *CUT)
    assert not (takes / "out" / "anna" / "t1.bvh").exists()
    shown = runs(capsys, "batch", PATTERN, "--list", *CUT).splitlines()
    assert shown[0].startswith("takes/anna/t1.bvh: jaxcap edit cut takes/anna/t1.bvh -o out/anna/t1.bvh")
