"""Files that appear whole, whoever else writes them, and one run at a time for an output."""

import errno
import os
import stat
import subprocess
import sys
import threading

import pytest
from alone import ALONE

from jaxcap.errors import InputError
from jaxcap.io.archives.journal import create_journal
from jaxcap.io.system.atomic import atomic_path, write_text
from jaxcap.io.system.run_lock import run_lock

HOLD = f"""{ALONE}
import time
from jaxcap.io.system.run_lock import run_lock
with run_lock(*sys.argv[1:]):
    print("locked", flush=True)
    time.sleep(60)
"""
WRITE = f"""{ALONE}
from jaxcap.io.system.atomic import write_text
for _ in range(150):
    write_text(sys.argv[1], sys.argv[2] * 50_000)
"""


@pytest.fixture
def holder():
    """Starts a process that holds the lock of outputs until it is killed."""
    started = []

    def hold(*outputs):
        process = subprocess.Popen(
            [sys.executable, "-c", HOLD, *map(str, outputs)], stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "locked\n"
        return process

    yield hold
    for process in started:
        process.kill()
        process.communicate()


def test_threads_on_one_path(tmp_path):
    """Every call ends well, and the file is one of the texts, whole."""
    path, texts, failures = tmp_path / "a.txt", [letter * 50_000 for letter in "abcdef"], []

    def write(text):
        try:
            for _ in range(40):
                write_text(path, text)
                assert path.read_text() in texts
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert os.listdir(tmp_path) == ["a.txt"]


def test_processes_on_one_path(tmp_path):
    path = tmp_path / "a.txt"
    writers = [subprocess.Popen([sys.executable, "-c", WRITE, str(path), letter]) for letter in "ab"]
    assert [writer.wait() for writer in writers] == [0, 0]
    assert path.read_text() in ("a" * 50_000, "b" * 50_000)
    assert os.listdir(tmp_path) == ["a.txt"]


def test_temporary_names_cannot_be_guessed(tmp_path):
    with atomic_path(tmp_path / "a.txt") as first, atomic_path(tmp_path / "a.txt") as second:
        assert first != second
        assert (first.suffix, stat.S_IMODE(first.parent.stat().st_mode)) == (".txt", 0o700)
        first.write_text("1")
        second.write_text("2")
    # the inner block ends first, so the outer one is the last to write
    assert (tmp_path / "a.txt").read_text() == "1"


def test_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "victim").write_text("mine")
    (tmp_path / "a.txt").symlink_to(tmp_path / "victim")
    write_text(tmp_path / "a.txt", "new")
    assert (tmp_path / "victim").read_text() == "mine"
    assert not (tmp_path / "a.txt").is_symlink()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no umask")
@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_permissions_are_those_of_any_new_file(tmp_path, mask):
    before = os.umask(mask)
    try:
        write_text(tmp_path / "a.txt", "text")
        create_journal(tmp_path / "journal", {}, 1).close()
    finally:
        os.umask(before)
    for name in ("a.txt", "journal"):
        assert stat.S_IMODE((tmp_path / name).stat().st_mode) == 0o666 & ~mask


def test_longest_names_and_failures_leave_nothing(tmp_path):
    path = tmp_path / ("n" * 251 + ".txt")
    write_text(path, "text")

    def fail():
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "text"
    assert os.listdir(tmp_path) == [path.name]
    with pytest.raises(InputError, match="cannot be written"):
        write_text(tmp_path / "no folder" / "a.txt", "text")


def test_second_run_is_refused_until_the_first_dies(tmp_path, holder):
    """The number in the sentence is that of the process; SIGKILL frees the lock, and what it left is removed."""
    first = holder(tmp_path)
    with (
        pytest.raises(InputError, match=f"another run \\(process {first.pid}\\) writes to this output"),
        run_lock(tmp_path),
    ):
        pass
    (tmp_path / ".a.npz.abcdefgh.unfinished").mkdir()
    first.kill()
    first.wait()
    assert len(os.listdir(tmp_path)) == 2
    with run_lock(tmp_path):
        assert os.listdir(tmp_path) == [".jaxcap.lock"]
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.name == "nt", reason="Windows removes no temporary folders")
def test_what_another_program_is_writing_stays(tmp_path):
    """A run in a folder begins while a file is written there, without a lock of the folder."""
    (tmp_path / ".b.npz.abcdefgh.unfinished").mkdir()
    with atomic_path(tmp_path / "a.npz") as temporary:
        with run_lock(tmp_path):
            assert set(os.listdir(tmp_path)) == {".jaxcap.lock", temporary.parent.name}
        temporary.write_text("whole")
    assert (os.listdir(tmp_path), (tmp_path / "a.npz").read_text()) == (["a.npz"], "whole")


@pytest.mark.skipif(os.name == "nt", reason="Windows has other locks")
def test_a_file_system_without_locks(tmp_path, monkeypatch):
    """The run goes on with a word, and removes nothing."""
    import fcntl

    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    left = tmp_path / ".b.npz.abcdefgh.unfinished"
    left.mkdir()
    with pytest.warns(UserWarning, match="has no locks; do not start another run"), run_lock(tmp_path):
        write_text(tmp_path / "a.txt", "text")
    assert sorted(os.listdir(tmp_path)) == [left.name, "a.txt"]


def test_locks_of_files(tmp_path, holder):
    """Runs that share one file of several exclude each other, others in the folder do not."""
    first = holder(tmp_path / "a.npz", tmp_path / "motion.npz")
    with (
        pytest.raises(InputError, match=f"process {first.pid}"),
        run_lock(tmp_path / "b.npz", tmp_path / "motion.npz"),
    ):
        pass
    with run_lock(tmp_path / "b.npz", tmp_path / "c.npz"):
        pass
    assert sorted(os.listdir(tmp_path)) == [".a.npz.lock", ".motion.npz.lock"]


def test_threads_exclude_each_other(tmp_path):
    """However fast a lock is taken and given back, one thread at a time has it."""
    inside, most, ended = [0], [0], []

    def run():
        taken = 0
        while taken < 60:
            try:
                with run_lock(tmp_path):
                    inside[0] += 1
                    most[0] = max(most[0], inside[0])
                    inside[0] -= 1
                    taken += 1
            except InputError:
                pass
        ended.append(taken)

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (most, ended) == ([1], [60] * 4)


@pytest.mark.skipif(os.name == "nt", reason="Windows follows no such links")
def test_lock_does_not_follow_links(tmp_path):
    (tmp_path / "victim").write_text("mine")
    (tmp_path / ".jaxcap.lock").symlink_to(tmp_path / "victim")
    with pytest.raises(InputError, match="lock of this run cannot be created"), run_lock(tmp_path):
        pass
    assert (tmp_path / "victim").read_text() == "mine"
