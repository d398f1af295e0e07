"""The jobs of a batch: a verb with its options and files for each, checked before the first one runs."""

import hashlib
import inspect
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError, user_message
from ..console.groups import JAXCAP
from ..console.record import record_output
from ..console.verbs import Verb, find_verb, parse_command
from .file_fields import output_paths, replace_outputs, replace_texts
from .job_lists import ListedJob, label_of
from .patterns import fill
from .urls import folders_of, is_url, place_of

#: verbs that a person uses while they run, and this one
INTERACTIVE = ("view", "ik", "live", "batch")


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
    for number, one in enumerate(listed):
        words = tuple(fill(word, one.values) for word in one.template)
        label = label_of(one, number)
        if one.template not in parsed:
            parsed[one.template] = _parse_template(one, words)
        verb, prog, _, unfilled = parsed[one.template]
        if unfilled is None:
            command = _parse(verb, prog, words, label)
        else:
            command = replace_texts(unfilled, lambda text, values=one.values: fill(text, values))
        name = prog.removeprefix("jaxcap ")
        key = hashlib.sha256(json.dumps(words).encode()).hexdigest()[:16]
        # also those of words such as --out=s3://bucket/take.bvh
        values = (word.partition("=")[2] if word.startswith("--") else word for word in words)
        urls = {name: value for value in values if is_url(value) for name in (value, str(Path(value)))}
        jobs.append(Job(key, label, dict(one.values), words, name, command, urls))
    _check_options(jobs)
    _check_outputs_differ(jobs)
    return jobs


def _parse_template(job: ListedJob, words: tuple[str, ...]) -> tuple[Verb, str, list[str], Any]:
    """Find the verb of a command with named parts, and parse it with them if that is possible.

    Parsing takes a tenth of a second or more. If no named part is in a number or a choice, texts and paths are filled afterwards.
    """
    if any("{" in word for word in job.template[:1]):
        raise InputError(f"{job.template[0]}: a batch has one verb; write its name.")
    if {"-h", "--help"} & set(job.template):
        raise InputError("--help is not an option of a job; ask `jaxcap VERB --help` for the help of a verb.")
    verb, prog, rest = find_verb(JAXCAP, "jaxcap", list(job.template))
    name = prog.removeprefix("jaxcap ")
    if name in INTERACTIVE:
        raise InputError(f"`jaxcap {name}` cannot run in a batch; give a verb that ends by itself.")
    try:
        return verb, prog, rest, _parse(verb, prog, job.template, "")
    except InputError:
        # an error of the options themselves is one of every job, too
        _parse(verb, prog, words, label_of(job, 0))
        return verb, prog, rest, None


def _parse(verb: Verb, prog: str, words: Sequence[str], label: str) -> Any:
    try:
        return parse_command(verb, prog, list(words)[prog.count(" ") :])
    except InputError as error:
        raise InputError(f"{label}: {user_message(error)}" if label else user_message(error)) from None


def _check_options(jobs: Sequence[Job]) -> None:
    """Check the options of each job by the verb's own check, with outputs in a new folder. Raises `InputError`."""
    for job in jobs:
        check = getattr(type(job.command), "check", None)
        if getattr(job.command, "resume", False):
            raise InputError(
                f"{job.label}: a batch continues unfinished jobs itself; leave out --resume of the verb."
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
                raise InputError(f"{job.label}: {message}") from None


def _check_outputs_differ(jobs: Sequence[Job]) -> None:
    """Check that no two jobs write the same file or folder, or one within another. Raises `InputError`."""
    owners: dict[str, Job] = {}
    for job in jobs:
        for output in job.outputs():
            if Path(output).name == "..":
                raise InputError(
                    f"{output}: this is not the name of an output; write the name of the folder."
                )
            place = place_of(output)
            other = owners.setdefault(place, job)
            if other is not job:
                raise InputError(
                    f"{output}: the jobs {other.label} and {job.label} both write this output; put the names that "
                    "distinguish them into it, such as {stem}."
                )
    for place, job in owners.items():
        for folder in folders_of(place):
            other = owners.get(folder, job)
            if other is not job:
                raise InputError(
                    f"{place}: the job {job.label} writes this within {folder}, the output of the job {other.label}; give them "
                    "separate folders."
                )


def with_settings(command: Any, **settings: Any) -> Any:
    """Return a command with other values of those of the options that its verb has."""
    there = {name: value for name, value in settings.items() if hasattr(command, name)}
    return replace(command, **there)
