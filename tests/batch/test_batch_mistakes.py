"""Mistakes in the command line of a batch and in lists of jobs: what the message names, and what it advises."""

import dataclasses
from pathlib import Path

import pytest
from batch_inputs import write_takes
from command_line import fails, runs

from jaxcap.cli import main
from jaxcap.cli.batch.batch import Batch, report
from jaxcap.cli.batch.job_lists import label_of, list_jobs
from jaxcap.cli.batch.jobs import BATCH_OPTIONS, make_jobs
from jaxcap.cli.batch.results import ResultTable
from jaxcap.errors import InputError

pytest.importorskip("distributed")

CUT = ("edit", "cut", "{input}", "-o", "out/{stem}.bvh", "--frames", "0", "3")
PATTERN = "takes/{person}/*.bvh"


@pytest.fixture
def takes(tmp_path, monkeypatch):
    monkeypatch.chdir(write_takes(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "sentences"),
    [
        # the verb's -o and options would be those of the batch
        (
            (PATTERN, "edit", "mirror", "{input}", "-o", "o/{stem}.bvh"),
            ["`--` is missing", "JOBS -- edit ..."],
        ),
        ((PATTERN, "--list", *CUT), ["`--` is missing before the verb 'edit'"]),
        ((PATTERN, "edti", "cut", "{input}"), ["'edti' is not an option of the batch", "after `--`"]),
        ((PATTERN, "-o", "o/{stem}.bvh", "--", *CUT), ["o/{stem}.bvh: the table", "after `--`"]),
        # the shell has replaced a pattern
        (("takes/anna/t1.bvh", "takes/anna/t10.bvh", "--", *CUT), ["2 paths", "quotation marks"]),
        (("takes/anna/t1.bvh", "takes/anna/t10.bvh", "--list", "--", *CUT), ["2 paths", "quotation marks"]),
        (("a.csv", "--", "info", "{input}"), ["a.csv:1: there is no column 'input'", "quotation marks"]),
        (("none.csv", "--", *CUT), ["none.csv: there is no such file"]),
        (("takes/none", "--", *CUT), ["takes/none: there is no such file or folder"]),
        # options of the batch among those of a verb
        ((PATTERN, "--", "info", "{input}", "--list"), ["--list is an option of the batch", "before `--`"]),
        ((PATTERN, "--", *CUT, "--workers=2"), ["--workers is an option of the batch", "before `--`"]),
        ((PATTERN, "--", "--workers", "2", *CUT), ["--workers is an option of the batch", "before `--`"]),
        ((PATTERN, "--", "edit"), ["`jaxcap edit` is a group of verbs"]),
        ((PATTERN, "--", "info", "--help"), ["--help is not an option of a job"]),
        # a command too many
        (("a.toml", "--", *CUT), ["a.toml: this list has commands", "leave one of them out"]),
    ],
)
def test_mistakes_on_the_command_line(takes, capsys, words, sentences):
    Path("a.csv").write_text("LKNE.x,LKNE.y,LKNE.z\n1,2\n")
    Path("a.toml").write_text("command = 'info {input}'\ninputs = 'takes/{person}/*.bvh'\n")
    line = fails(capsys, "batch", *words)
    assert all(sentence in line for sentence in sentences), line
    assert line.endswith((".", "..."))


def test_options_of_a_batch():
    """`-o` is one of most verbs, too."""
    names = {f"--{each.name}" for each in dataclasses.fields(Batch)}
    assert names - {"--jobs", "--command", "--out"} == set(BATCH_OPTIONS)


def test_a_verb_with_an_option_of_the_batch_keeps_it(takes):
    """`track` has `--workers`, so its own mistake is named."""
    with pytest.raises(InputError, match="--speed"):
        make_jobs(list_jobs(PATTERN, ("track", "human", "{input}", "--workers", "2", "--speed", "1")))


@pytest.mark.parametrize(
    ("name", "text", "words", "sentence"),
    [
        ("a.csv", "a,command\n1,info {a}\n\n2,inf {a}\n", (), "a.csv:4: there is no 'jaxcap inf'"),
        ("a.csv", "a,command\n1,info {a}\n2,info '{a}\n", (), "a.csv:3: the command cannot be split"),
        ("a.csv", "a,command\n1,info {a}\n2,info {b}\n", (), "a.csv:3: '{b}' has no value; the names are a."),
        ("a.csv", "a,b\n1,2\n\n3\n", CUT[:2], "a.csv:4: the number of cells in this row is 1, and in the header 2"),
        ("a.csv", 'a,b\n1,2\n"3,4\n5,6\n', CUT[:2], "a.csv:3: this row is not one of a table"),
        ("a.csv", "a,b\nanna,1\nben,\n", ("info", "{a}/{b}.bvh"), "a.csv:3: the value of '{b}' is empty"),
        ("a.csv", "a,b,a\n1,2,3\n", ("info", "{a}"), "a.csv:1: two columns are named 'a'"),
        ("a.csv", "a,b\n1,2\n", (), "a.csv:2: there is no verb; give one after `--`: jaxcap batch a.csv -- VERB {a} ..."),
        ("a.csv", "a,b\n", ("info", "{a}"), "a.csv: there are no jobs in this table"),
        ("a.csv", "first\n0\nx\n", (*CUT[:2], "a.bvh", "-o", "{first}.bvh", "--frames", "{first}", "3"), "a.csv:3: --frames is 'x 3'"),
        ("a.csv", "a\nt1\n", ("edit", "gaze", "{a}.bvh", "-o", "{a}o.bvh"), "a.csv:2: Give either --target or --direction"),
        ("a.toml", "command = 'info {b}'\n[[jobs]]\nb = 'c'\n\n[[jobs]]\na = 1\n", (), "a.toml:5: '{b}' has no value; the names are a."),
        ("a.toml", "jobs = [{b = 1}, {a = 1}]\ncommand = 'info {b}'", (), "a.toml: job 2: '{b}' has no value"),
        ("a.toml", "[[jobs]]\ncommand = 'info a'\n[[jobs]]\ncommand = 'inf a'", (), "a.toml:3: there is no 'jaxcap inf'"),
        ("a.toml", "command = 'inf {b}'\n[[jobs]]\nb = 'c'", (), "a.toml: there is no 'jaxcap inf'"),
        ("a.toml", "command = 'info {b}'\ninputs = 'takes/*/*.bvh'", (), "a.toml: takes/anna/t1.bvh: '{b}' has no value"),
    ],
)  # fmt: skip
def test_mistakes_in_lists_of_jobs_name_the_line(takes, name, text, words, sentence):
    Path(name).write_text(text)
    with pytest.raises(InputError) as error:
        make_jobs(list_jobs(name, words))
    assert error.value.message.startswith(sentence)


@pytest.mark.parametrize("delimiter", [";", "\t", ", "])
def test_delimiters_of_tables(takes, delimiter):
    Path("a.csv").write_text("subject,take\r\nanna,t1\r\n,\r\nben,t10\r\n".replace(",", delimiter))
    listed = list_jobs("a.csv", ("info", "takes/{subject}/{take}.bvh"))
    assert [job.values for job in listed] == [
        {"subject": "anna", "take": "t1"},
        {"subject": "ben", "take": "t10"},
    ]
    assert [job.where for job in listed] == ["a.csv:2", "a.csv:4"]
    assert [label_of(job) for job in listed] == ["anna, t1", "ben, t10"]


@pytest.mark.parametrize(
    ("source", "out", "advice"),
    [
        # only a name that is not there yet, and that these jobs have
        ("takes/{person}/*.bvh", "out/{stem}.bvh", "takes/ben/t1.bvh both write this output; put {person} or {folder} into"),
        ("takes/*/*.bvh", "out/{stem}.bvh", "put {folder} into its path"),
        ("a.csv", "out/{a}.bvh", "out/1.bvh: the jobs a.csv:2 and a.csv:3 both write this output; put {b} into its path"),
        ("a.csv", "out/all.bvh", "a.csv:2 and a.csv:3 both write this output; put {b} into its path"),
        ("same.csv", "out/{a}.bvh", "they are the same job, so leave one out"),
    ],
)  # fmt: skip
def test_what_distinguishes_outputs(takes, source, out, advice):
    Path("a.csv").write_text("a,b\n1,2\n1,3\n")
    Path("same.csv").write_text("a,b\n1,2\n1,2\n")
    with pytest.raises(InputError) as error:
        make_jobs(list_jobs(source, ("edit", "mirror", "a.bvh", "--out", out)))
    assert advice in error.value.message
    assert "{stem}" not in error.value.message


@pytest.mark.parametrize(
    ("pattern", "out", "matches"),
    [
        ("takes/anna/*.bvh", "takes/anna/{stem}_cut.bvh", True),
        ("takes/anna/{take}.bvh", "./takes/ben/../anna/{take}_cut.bvh", True),
        ("**/*.bvh", "out/{folder}/{stem}.bvh", True),
        ("takes/anna/*.bvh", "takes/anna/{stem}.npz", False),
        # in place
        ("takes/anna/*.bvh", "{input}", False),
    ],
)
def test_outputs_do_not_become_inputs(takes, pattern, out, matches):
    """Otherwise the same command would find more jobs each time."""
    listed = list_jobs(pattern, ("edit", "cut", "{input}", "-o", out, "--frames", "0", "3"))
    if not matches:
        assert len(make_jobs(listed)) == len(listed)
        return
    for each in (pattern, str(takes / pattern)):
        listed = list_jobs(each, listed[0].template)
        with pytest.raises(InputError, match="this output matches the pattern"):
            make_jobs(listed)


def test_a_verb_after_two_dashes_is_not_one_of_the_batch(takes, capsys):
    """A folder with the name of a verb is an input."""
    Path("takes").rename("scan")
    assert runs(capsys, "batch", "--list", "scan", "--", "info", "{input}") == "scan: jaxcap info scan\n"


@pytest.mark.parametrize(("pattern", "words"), [("takes/anna/t1.bvh", "1 of 1 job is done"), ("takes/anna/*", "2 of 2 jobs are done")])  # fmt: skip
def test_the_last_line_counts_jobs(takes, capsys, pattern, words):
    jobs = make_jobs(list_jobs(pattern, ("info", "{input}")))
    table = ResultTable(takes / "batch.jsonl")
    for job in jobs:
        table.append({"key": job.key, "job": job.label, "status": "done"})
    report(jobs, table, already=0)
    assert words in capsys.readouterr().out


def test_the_help_shows_where_the_verb_is_written(capsys):
    with pytest.raises(SystemExit):
        main(["batch", "--help"])
    assert capsys.readouterr().out.startswith("usage: jaxcap batch [-h] [OPTIONS] JOBS [-- VERB...]\n")
