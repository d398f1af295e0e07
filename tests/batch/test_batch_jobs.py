"""The jobs of a batch: patterns, lists, and what is refused before the first job runs."""

import ast
import inspect
import itertools
import typing
from pathlib import Path

import pytest
from batch_inputs import write_takes

from jaxcap.batch.size import GIB
from jaxcap.cli.batch.batch import default_table
from jaxcap.cli.batch.file_fields import output_fields
from jaxcap.cli.batch.job_lists import list_jobs
from jaxcap.cli.batch.jobs import INTERACTIVE, make_jobs
from jaxcap.cli.batch.memory import job_memory
from jaxcap.cli.batch.patterns import match_pattern
from jaxcap.cli.console.groups import JAXCAP
from jaxcap.cli.console.verbs import VerbGroup, find_verb, parse_command
from jaxcap.errors import InputError

CUT = ("edit", "cut", "{input}", "-o", "out/{person}/{take}.bvh", "--frames", "0", "3")


@pytest.fixture
def takes(tmp_path, monkeypatch):
    monkeypatch.chdir(write_takes(tmp_path))
    return tmp_path


def jobs_of(pattern: str, *words: str):
    return make_jobs(list_jobs(pattern, words))


def test_a_pattern_gives_its_names_in_natural_order(takes):
    found = match_pattern("takes/{person}/t{take}.bvh")
    assert [(values["person"], values["take"]) for values in found] == [
        ("anna", "1"),
        ("anna", "10"),
        ("ben", "1"),
        ("ben", "10"),
    ]
    assert found[1]["input"] == "takes/anna/t10.bvh"
    assert found[1]["stem"] == "t10"
    assert found[1]["folder"] == "takes/anna"


def test_a_pattern_takes_folders_and_wildcards_and_repeats_names(takes):
    assert [values["person"] for values in match_pattern("takes/{person}")] == ["anna", "ben"]
    assert len(match_pattern("**/{take}.bvh")) == 4
    assert len(match_pattern("takes/[!b]*/{take}.bvh")) == 2
    (takes / "takes" / "anna" / "anna.bvh").touch()
    assert [values["input"] for values in match_pattern("takes/{person}/{person}.bvh")] == [
        "takes/anna/anna.bvh"
    ]


def test_lists_of_jobs(takes):
    Path("jobs.toml").write_text(
        'command = "jaxcap edit cut {input} -o out/{take}.bvh --frames {first} 3"\n'
        'inputs = ["takes/anna/{take}.bvh"]\n'
        "[[jobs]]\ninput = 'takes/ben/t1.bvh'\ntake = 'own'\nfirst = 2\n"
        "[[jobs]]\ncommand = ['edit', 'mirror', 'a b.bvh', '-o', 'c.bvh']\n"
    )
    listed = list_jobs("jobs.toml", ())
    assert len(listed) == 4
    assert listed[2].values == {"input": "takes/ben/t1.bvh", "take": "own", "first": "2"}
    assert listed[3].template == ("edit", "mirror", "a b.bvh", "-o", "c.bvh")
    with pytest.raises(InputError, match="'{first}' has no value; the names are take, input"):
        make_jobs(listed)
    Path("jobs.csv").write_text("take,first\nt1,1\nt10,2\n")
    words = ("edit", "cut", "takes/anna/{take}.bvh", "-o", "{take}.bvh", "--frames", "{first}", "3")
    jobs = jobs_of("jobs.csv", *words)
    assert [job.command.frames for job in jobs] == [(1, 3), (2, 3)]
    assert [job.label for job in jobs] == ["t1, 1", "t10, 2"]


def test_commands_are_those_of_the_command_line(takes):
    """Filled after parsing, or parsed for each job: as if the words had been typed."""
    for job in (
        *jobs_of("takes/{person}/{take}.bvh", *CUT),
        *jobs_of("takes/{person}/t{n}.bvh", *CUT[:4], "{stem}{person}.bvh", "--seconds", "0", "{n}"),
    ):
        verb, prog, rest = find_verb(JAXCAP, "jaxcap", list(job.words))
        assert job.command == parse_command(verb, prog, rest)
        assert list(job.outputs()) == [job.words[4]]


def test_urls_keep_their_slashes(takes):
    words = ("edit", "mirror", "s3://in/{stem}.bvh", "-o", "s3://out/{person}/{stem}.bvh")
    job = jobs_of("takes/{person}/*.bvh", *words)[0]
    assert list(job.outputs()) == ["s3://out/anna/t1.bvh"]
    assert job.urls[str(job.command.motion)] == "s3://in/t1.bvh"


@pytest.mark.parametrize("out", ["--out=s3://out/{stem}.bvh", "--out=memory://out/{stem}.bvh"])
def test_urls_within_words(takes, out):
    job = jobs_of("takes/anna/*.bvh", "edit", "mirror", "{input}", out)[0]
    assert list(job.outputs()) == [out.partition("=")[2].replace("{stem}", "t1")]


@pytest.mark.parametrize(
    "words", [("-o", "./out/{person}/{take}.bvh"), ("--out=out/{person}/{take}.bvh",), ("-o", "out//{take}")]
)
def test_the_table_is_in_the_folder_of_the_outputs(takes, words):
    pattern = "takes/anna/{take}.bvh" if words[-1] == "out//{take}" else "takes/{person}/{take}.bvh"
    listed = list_jobs(pattern, ("edit", "mirror", "{input}", *words))
    assert default_table(pattern, listed, make_jobs(listed)) == Path("out/batch.jsonl")


def test_memory_of_verbs_with_many_scans():
    assert job_memory(["info", "register"]) == job_memory(["adapt"]) == 4 * GIB


@pytest.mark.parametrize(
    ("source", "words", "sentence"),
    [
        ("takes/{person}/*.c3d", CUT, "no file or folder matches this pattern"),
        ("takes/{input}.bvh", CUT, "the name 'input' is that of the file itself"),
        ("takes/{person}/{take}.bvh", (), "takes/{person}/{take}.bvh: there is no verb; give one after `--`"),
        ("takes/{person}/{take}.bvh", ("edit", "dance", "{input}"), "there is no 'jaxcap edit dance'"),
        ("takes/{person}/{take}.bvh", ("{take}", "{input}"), "a batch has one verb"),
        ("takes/{person}/{take}.bvh", ("view", "{input}"), "`jaxcap view` cannot run in a batch"),
        ("takes/{person}/{take}.bvh", (*CUT, "--help"), "--help is not an option of a job"),
        ("takes/{person}/{take}.bvh", (*CUT, "--speed", "3"), "--speed"),
        ("takes/{person}/{take}.bvh", (*CUT[:-1], "x"), "--frames is '0 x'; give 2 integers."),
        ("takes/{person}/{take}.bvh", (*CUT[:-1], "{tale}"), "'{tale}' has no value; the names are person, take"),
        (
            "takes/{person}/{take}.bvh",
            (*CUT[:4], "out/{take}.bvh", *CUT[5:]),
            "out/t1.bvh: the jobs takes/anna/t1.bvh and takes/ben/t1.bvh both write this output",
        ),
        (
            "jobs.csv",
            ("edit", "mirror", "{input}", "-o", "{out}"),
            "out/a/b.bvh: the job jobs.csv:3 writes this within",
        ),
        (
            "urls.csv",
            ("edit", "mirror", "{input}", "--out={out}"),
            "s3://out/a/b.bvh: the job urls.csv:3 writes this within s3://out/a",
        ),
        (
            "same.csv",
            ("edit", "mirror", "{input}", "-o", "{out}"),
            "out/b/../a.bvh: the jobs same.csv:2 and same.csv:3 both write this output; give 'out' values",
        ),
        (
            "takes/{person}/{take}.bvh",
            ("edit", "gaze", "{input}", "-o", "out/{person}/{take}.bvh"),
            "takes/anna/t1.bvh: Give either --target or --direction",
        ),
        (
            "takes/{person}/{take}.bvh",
            ("track", "human", "{input}", "-o", "out/{person}/{take}", "--resume"),
            "a batch continues unfinished jobs itself; leave out --resume",
        ),
        ("none.toml", CUT, "there is no such file"),
    ],
)  # fmt: skip
def test_refused_before_the_first_job(takes, source, words, sentence):
    for name, first, second in (
        ("jobs.csv", "out/a", "./out/a/b.bvh"),
        ("urls.csv", "s3://out/a", "s3://out/a/b.bvh"),
        ("same.csv", "out/a.bvh", "out/b/../a.bvh"),
    ):
        Path(name).write_text(f"input,out\ntakes/anna/t1.bvh,{first}\ntakes/ben/t1.bvh,{second}\n")
    with pytest.raises(InputError) as error:
        jobs_of(source, *words)
    assert sentence in str(error.value)
    assert error.value.message.endswith(".")
    assert not (takes / "out").exists()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("jobs = [", "not a valid TOML file"),
        ("job = 3", "'job' is unknown; the names are command, inputs and jobs"),
        ("inputs = 3", "'inputs' is not a pattern"),
        ("jobs = 3", "'jobs' is not a list of tables"),
        ("command = 'a'", "there are no jobs"),
        ("command = ['a', 3]\n[[jobs]]\na = 1", "words that are no texts"),
        ('command = "a \'b"\n[[jobs]]\na = 1', "cannot be split"),
        ("command = 'a'\n[[jobs]]\na = [1]", "neither a text nor a number"),
    ],
)
def test_invalid_lists(tmp_path, text, sentence):
    path = tmp_path / "jobs.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=sentence):
        list_jobs(str(path), ())


def verbs(group=JAXCAP, name=""):
    """All verbs with their classes."""
    for word, found in group.verbs.items():
        if isinstance(found, VerbGroup):
            yield from verbs(found, f"{name}{word} ")
        else:
            yield f"{name}{word}", found.load()


@pytest.mark.parametrize(("name", "verb"), [pytest.param(*each, id=each[0]) for each in verbs()])
def test_outputs_are_what_the_help_calls_outputs(name, verb):
    """The help of an option that writes begins with these words; all other paths are inputs."""
    (tree,) = ast.parse(inspect.getsource(verb)).body
    pairs = itertools.pairwise(tree.body)
    texts = {
        a.target.id: b.value.value
        for a, b in pairs
        if isinstance(a, ast.AnnAssign) and isinstance(b, ast.Expr)
    }
    types = typing.get_type_hints(verb)
    paths = [field for field in texts if "Path" in str(types[field])]
    written = [field for field in paths if texts[field].startswith(("Output", "Also write"))]
    if name not in INTERACTIVE:
        assert sorted(output_fields(name, verb)) == sorted(written)
