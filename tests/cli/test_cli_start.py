"""What the command line does before and around a verb: help without JAX, its folder of compiled functions, words in silence."""

import io
import logging
import os
import signal
import subprocess
import sys
import time
from importlib.metadata import version

import pytest
from command_line import PYTHON, fails

from jaxcap.cli.console import compiled, heartbeat
from jaxcap.cli.console.groups import JAXCAP
from jaxcap.cli.console.verbs import VerbGroup

MAIN = "import sys; from jaxcap.cli import main; main(sys.argv[1:])"


def leaves(group: VerbGroup):
    for name, verb in group.verbs.items():
        if isinstance(verb, VerbGroup):
            yield from ((f"{name} {inner}", found) for inner, found in leaves(verb))
        else:
            yield name, verb


@pytest.mark.parametrize(
    "words", [[], ["--help"], ["edit", "--help"], ["limits"], ["--version"], ["trak"], ["edit", "x"]]
)
def test_help_needs_neither_jax_nor_numpy(words):
    """Nothing slow is imported: of a processor's time it takes less than half a second, however busy the machine is."""
    code = (
        "import contextlib, sys, time\nfrom jaxcap.cli import main\n"
        f"with contextlib.suppress(SystemExit): main({words})\n"
        "heavy = {'jax', 'numpy', 'scipy', 'equinox', 'tyro', 'rich'} & set(sys.modules)\n"
        "assert not heavy, heavy\nassert time.process_time() < 0.5"
    )
    done = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr


def test_the_program_is_a_module_too():
    """Where the folder of installed programs is not on the path, `python -m jaxcap` is the same program."""
    done = subprocess.run(
        [PYTHON, "-m", "jaxcap", "--version"], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout) == (0, f"jaxcap {version('jaxcap')}\n"), done.stderr


def test_every_verb_is_where_the_table_has_it():
    for name, verb in leaves(JAXCAP):
        found = verb.load()
        assert callable(found.run), name
        assert found.__doc__ and len(verb.summary) < 70 and not verb.summary.endswith(".")


def prepared(**environment: str) -> str:
    """What `prepare_jax` says of the environment, in a process in which JAX is not imported."""
    code = (
        "import os\nfrom jaxcap.cli.console.compiled import prepare_jax\n"
        "prepare_jax(os.environ.get('KEEP') != '0')\n"
        "print({n: v for n, v in os.environ.items() if n.startswith(('JAX_', 'TF_CPP'))})"
    )
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("JAX", "TF_CPP"))}
    done = subprocess.run(
        [PYTHON, "-c", code], env=clean | environment, capture_output=True, text=True, check=False
    )
    return done.stdout if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


def test_compiled_functions_are_kept_in_a_folder_of_the_user(tmp_path):
    told = eval(prepared(XDG_CACHE_HOME=str(tmp_path)))
    folder = tmp_path / "jaxcap"
    assert told["JAX_COMPILATION_CACHE_DIR"].startswith(f"{folder}{os.sep}")
    assert told["TF_CPP_MIN_LOG_LEVEL"] == "3"
    assert folder.stat().st_mode & 0o777 == 0o700
    named = eval(prepared(JAXCAP_CACHE=str(tmp_path / "other")))
    assert named["JAX_COMPILATION_CACHE_DIR"].startswith(str(tmp_path / "other"))


def test_what_the_user_says_of_the_folder_counts(tmp_path):
    own = eval(prepared(JAX_COMPILATION_CACHE_DIR="/somewhere", XDG_CACHE_HOME=str(tmp_path)))
    assert own["JAX_COMPILATION_CACHE_DIR"] == "/somewhere"
    none = eval(prepared(KEEP="0", XDG_CACHE_HOME=str(tmp_path)))
    assert "JAX_COMPILATION_CACHE_DIR" not in none and none["JAX_ENABLE_COMPILATION_CACHE"] == "false"
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_others_write_to_is_refused(tmp_path):
    """A compiled function is a program: whoever puts one there runs it as this user."""
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    assert "others can write to it" in prepared(JAXCAP_CACHE=str(tmp_path / "open"))
    (tmp_path / "file").write_text("")
    assert "cannot be used" in prepared(JAXCAP_CACHE=str(tmp_path / "file" / "cache"))
    # the usual one is done without
    assert "JAX_COMPILATION_CACHE_DIR" not in eval(prepared(XDG_CACHE_HOME=str(tmp_path / "file")))


def test_the_oldest_compiled_functions_go_first(tmp_path):
    for number in range(5):
        (tmp_path / f"f{number}").write_bytes(bytes(100))
        os.utime(tmp_path / f"f{number}", (number, number))
    compiled.trim(tmp_path, 250)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f3", "f4"]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def quick(monkeypatch):
    """Words after a tenth of a second of silence."""
    monkeypatch.setattr(heartbeat, "SILENCE_SECONDS", 0.1)
    monkeypatch.setattr(heartbeat, "CHECK_SECONDS", 0.02)


def test_silence_is_broken_by_what_is_done(quick, capsys):
    with heartbeat.periodic_status():
        heartbeat.set_activity("adding up")
        time.sleep(0.4)
        logging.getLogger("jaxcap.tracking.track").info("searching for frame %d", 7)
        time.sleep(0.4)
        with heartbeat.pause_status():
            time.sleep(0.4)
    told = capsys.readouterr().err.splitlines()
    assert {line.rsplit(":", 1)[0] for line in told} == {"jaxcap: adding up", "jaxcap: searching for frame 7"}
    # none while a window was open, and none after the end
    assert 4 <= len(told) <= 9
    assert not logging.getLogger("jaxcap").handlers


def test_compiling_is_named(quick, capsys):
    """A function that is being traced, which takes as long as it sleeps."""
    import jax

    with heartbeat.periodic_status():
        heartbeat.set_activity("tracking")
        jax.jit(lambda x: (time.sleep(0.5), x)[1])(1.0)
    assert "jaxcap: tracking, compiling, which is done once: 0 s" in capsys.readouterr().err


def test_on_a_terminal_words_pass(quick, monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    with heartbeat.periodic_status():
        heartbeat.set_activity("adding up")
        time.sleep(0.4)
        heartbeat.write_line(screen, "a result")
    text = screen.getvalue()
    # what passes is wiped out before the line that stays
    assert text.count("adding up") >= 2
    assert text.endswith("\r\x1b[2Ka result\n")
    assert text.count("\n") == 1


def heeding_ctrl_c() -> None:
    """Tests that run in the background of a shell are deaf to it, and so would what they start be."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_ctrl_c_while_it_imports():
    """In the middle of the imports of JAX there is one line, no traceback, and the exit code of Ctrl-C."""
    program = [PYTHON, "-X", "importtime", "-c", MAIN, "track", "human", "none", "-o", "none"]
    # of so small a pipe that the program waits to be read, and cannot end before it is stopped
    with subprocess.Popen(
        program, stderr=subprocess.PIPE, text=True, pipesize=4096, preexec_fn=heeding_ctrl_c
    ) as running:
        assert running.stderr is not None
        for line in running.stderr:
            if line.rstrip().endswith("jax._src.dtypes"):
                break
        running.send_signal(signal.SIGINT)
        rest = [line for line in running.stderr if not line.startswith("import time:")]
        assert running.wait(60) == 130
    assert [line.strip() for line in rest if line.strip()] == ["jaxcap: stopped"]


def test_no_cache_goes_with_any_verb(capsys):
    assert "there is no 'jaxcap trak'" in fails(capsys, "--no-cache", "trak")
    assert "missing from jaxcap track: BODY" in fails(capsys, "track", "--no-cache")
