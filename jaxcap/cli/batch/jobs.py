"""The jobs of a batch: a verb with its options and files for each, checked before the first one runs."""

import contextlib
import hashlib
import inspect
import io
import json
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError, user_message
from ..console.groups import JAXCAP
from ..console.record import record_output
from ..console.verbs import Verb, find_verb, parse_command
from .file_fields import output_paths, replace_outputs, replace_texts
from .job_lists import ListedJob, label_of
from .patterns import INPUT, NAMED, fill, matches_pattern
from .urls import folders_of, is_url, place_of

#: verbs that a person uses while they run, and this one
INTERACTIVE = ("view", "ik", "live", "batch")
#: options of the batch that some verbs do not have
BATCH_OPTIONS = ("--workers", "--memory", "--scheduler", "--slurm", "--list", "--overwrite")
#: number of names that a message advises
MAX_ADVISED = 3


class Job(NamedTuple):
    """A run of a verb."""

    #: identifier: a hash of the command
    key: str
    #: its input, for messages
    label: str
    values: Mapping[str, str]
    #: words of the command, without `jaxcap`
    words: tuple[str, ...]
    #: the verb, such as `markers solve`, and its instance
    verb: str
    command: Any
    #: URLs among the words, by themselves and by their paths, which have lost a slash
    urls: Mapping[str, str]

    def outputs(self) -> Iterator[str]:
        """Iterate over the paths and URLs of the outputs that the command names."""
        for path in output_paths(self.verb, self.command):
            yield self.urls.get(str(path), str(path))


def make_jobs(listed: Sequence[ListedJob]) -> list[Job]:
    """Parse the commands of all jobs, and check their options.

    **Raises:** `InputError` if a verb does not exist or is interactive, an option is wrong, or two jobs have one output.
    """
    parsed: dict[tuple[str, ...], tuple[Verb, str, list[str], Any]] = {}
    jobs = []
    for one in listed:
        with _located(one.where):
            words = tuple(fill(word, one.values) for word in one.template)
        if one.template not in parsed:
            parsed[one.template] = _parse_template(one, words)
        verb, prog, _, unfilled = parsed[one.template]
        if unfilled is None:
            command = _parse(verb, prog, words, one.where)
        else:
            command = replace_texts(unfilled, lambda text, values=one.values: fill(text, values))
        name = prog.removeprefix("jaxcap ")
        key = hashlib.sha256(json.dumps(words).encode()).hexdigest()[:16]
        urls = {
            name: value
            for value in map(value_of, words)
            if is_url(value)
            for name in (value, str(Path(value)))
        }
        jobs.append(Job(key, label_of(one), dict(one.values), words, name, command, urls))
    _check_options(jobs, listed)
    _check_outputs_differ(jobs, listed)
    _check_no_new_inputs(jobs, listed)
    return jobs


@contextlib.contextmanager
def _located(where: str) -> Iterator[None]:
    """Put the place of the fault before the sentence of an `InputError`, if there is one."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {user_message(error)}" if where else user_message(error)) from None


def _parse_template(job: ListedJob, words: tuple[str, ...]) -> tuple[Verb, str, list[str], Any]:
    """Find the verb of a command with named parts, and parse it with them if that is possible.

    Parsing takes a tenth of a second or more. If no named part is in a number or a choice, texts and paths are filled afterwards.
    """
    with _located(job.command_where):
        verb, prog, rest = _find_verb(job.template)
    try:
        return verb, prog, rest, _parse(verb, prog, job.template, "")
    except InputError:
        with _located(job.command_where):
            _check_no_batch_options(rest, {each.name for each in fields(verb.load())})
        # an error of the options themselves is one of every job, too
        _parse(verb, prog, words, job.where)
        return verb, prog, rest, None


def _find_verb(template: Sequence[str]) -> tuple[Verb, str, list[str]]:
    """Find the verb of a command. Raises `InputError` if there is none, or it cannot run in a batch."""
    if "{" in template[0]:
        raise InputError(f"{template[0]}: a batch has one verb; write its name.")
    if {"-h", "--help"} & set(template):
        raise InputError("--help is not an option of a job; ask `jaxcap VERB --help` for the help of a verb.")
    _check_no_batch_options(template[:1])
    try:
        # the name of a group alone asks for its help
        with contextlib.redirect_stdout(io.StringIO()):
            verb, prog, rest = find_verb(JAXCAP, "jaxcap", list(template))
    except SystemExit:
        raise InputError(
            f"`jaxcap {' '.join(template)}` is a group of verbs; add the name of one of them."
        ) from None
    name = prog.removeprefix("jaxcap ")
    if name in INTERACTIVE:
        raise InputError(f"`jaxcap {name}` cannot run in a batch; give a verb that ends by itself.")
    return verb, prog, rest


def _check_no_batch_options(words: Sequence[str], names: Collection[str] = ()) -> None:
    """Check that no options of the batch are among those of a verb with options of some `names`. Raises `InputError`."""
    for word in words:
        option = word.partition("=")[0]
        if option in BATCH_OPTIONS and option.removeprefix("--") not in names:
            raise InputError(
                f"{option} is an option of the batch and not of this verb; write it before `--`."
            )


def _parse(verb: Verb, prog: str, words: Sequence[str], where: str) -> Any:
    with _located(where):
        return parse_command(verb, prog, list(words)[prog.count(" ") :])


def _check_options(jobs: Sequence[Job], listed: Sequence[ListedJob]) -> None:
    """Check the options of each job by the verb's own check, with outputs in a new folder. Raises `InputError`."""
    for job, one in zip(jobs, listed, strict=True):
        check = getattr(type(job.command), "check", None)
        if getattr(job.command, "resume", False):
            raise InputError(
                f"{one.where}: a batch continues unfinished jobs itself; leave out --resume of the verb."
            )
        # a check with arguments is one of files that were read
        if check is None or len(inspect.signature(check).parameters) > 1:
            continue
        with tempfile.TemporaryDirectory() as folder, record_output():
            place = Path(folder)
            trial = replace_outputs(job.verb, job.command, lambda path, place=place: place / path.name)
            try:
                trial.check()
            except InputError as error:
                message = user_message(error).replace(f"{folder}/", "")
                raise InputError(f"{one.where}: {message}") from None


def _check_outputs_differ(jobs: Sequence[Job], listed: Sequence[ListedJob]) -> None:
    """Check that no two jobs write the same file or folder, or one within another. Raises `InputError`."""
    owners: dict[str, int] = {}
    for number, job in enumerate(jobs):
        for output in job.outputs():
            if Path(output).name == "..":
                raise InputError(
                    f"{output}: this is not the name of an output; write the name of the folder."
                )
            other = owners.setdefault(place_of(output), number)
            if other != number:
                raise InputError(
                    f"{output}: the jobs {listed[other].where} and {listed[number].where} both write this output; "
                    f"{_distinction(listed[other], listed[number], output)}."
                )
    for place, number in owners.items():
        for folder in folders_of(place):
            other = owners.get(folder, number)
            if other != number:
                raise InputError(
                    f"{place}: the job {listed[number].where} writes this within {folder}, the output of the job "
                    f"{listed[other].where}; give them separate folders."
                )


def _check_no_new_inputs(jobs: Sequence[Job], listed: Sequence[ListedJob]) -> None:
    """Check that no output would be an input when the same batch continues. Raises `InputError`."""
    patterns = dict.fromkeys(one.pattern for one in listed if one.pattern)
    inputs = {place_of(one.values[INPUT]) for one in listed if one.pattern}
    for job in jobs:
        for output in job.outputs():
            pattern = next((each for each in patterns if matches_pattern(each, output)), None)
            if pattern is not None and place_of(output) not in inputs:
                raise InputError(
                    f"{output}: this output matches the pattern {pattern}, so it would be an input of the same batch when it "
                    "continues; write outputs to a folder, or with an ending, that the pattern does not match."
                )


def _distinction(one: ListedJob, other: ListedJob, output: str) -> str:
    """Describe how to give two jobs with the same output different ones."""
    if one.template != other.template:
        return "give them different outputs"
    differing = [name for name, value in one.values.items() if other.values.get(name) != value]
    if not differing:
        return "they are the same job, so leave one out"
    used = {
        name
        for word in one.template
        if place_of(value_of(fill(word, one.values))) == place_of(output)
        for name in NAMED.findall(word)
    }
    if lost := [name for name in differing if name in used]:
        return f"give '{lost[0]}' values that are different paths"
    # the whole path is a name for an output only where nothing else differs
    free = [name for name in differing if name != INPUT] or differing
    names = " or ".join(f"{{{name}}}" for name in free[:MAX_ADVISED])
    return f"put {names} into its path, where these jobs differ"


def value_of(word: str) -> str:
    """Return the value of a word of a command, also of one such as --out=s3://bucket/take.bvh."""
    return word.partition("=")[2] if word.startswith("--") else word


def with_settings(command: Any, **settings: Any) -> Any:
    """Return a command with other values of those of the options that its verb has."""
    there = {name: value for name, value in settings.items() if hasattr(command, name)}
    return replace(command, **there)
