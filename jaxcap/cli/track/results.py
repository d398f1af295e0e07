"""The folder of a tracking run: its files, its fingerprint, and the columns of a frame."""

import hashlib
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np

from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.archives.journal import Journal, count_records, create_journal, resume_journal
from ...io.archives.npz import save_motion
from ...io.skeletons.bvh import write_bvh
from ...io.table import write_csv, write_json
from ...observe.clouds import Cloud
from ...tracking.track import others_sentences, unseen_sentences, verdict_sentences
from ...tracking.track_frame import Tracker
from ..console.console import warn
from ..console.record import give_figures
from .frame_records import CLOUD_AT, Frame, Results, hash_cloud_name, unpack

#: the shape of the person, if it was estimated
PERSON = "person.npz"
#: beginning of the name of the folder of one person among several, followed by the number from 1
PERSON_FOLDER = "person_"
FILES = ("motion.bvh", "motion.npz", "statistics.csv", "statistics.json")
#: of a run in chunks: the folder of the journals of all tasks, and how the chunks were joined
CHUNKS, REPORT = ".jaxcap-chunks", "chunks.json"
#: advice for clouds that do not show the whole body
CAMERAS_HELP = (
    "clouds do not state which space is empty; if depth cameras took them, give the images with --depth and --cameras, so that hidden parts "
    "stay out of the space that the cameras saw empty"
)
#: the parameters of a body model in AMASS's format
PARAMETERS = "parameters.npz"


def check_folder(folder: Path, journal: str, resume: bool, overwrite: bool, resumable: bool = True) -> Path:
    """Make a folder if it does not exist, and return the path of its journal. `resumable`: the verb has --resume.

    **Raises:** `InputError` if it has no write access, or contains results without permission to resume or
    replace them.
    """
    make_writable(folder)
    of_people = [
        f"{own.name}/{name}"
        for own in sorted(folder.glob(f"{PERSON_FOLDER}*"))
        for name in (*FILES, PARAMETERS, PERSON)
    ]
    there = [name for name in (*FILES, PARAMETERS, *of_people, PERSON, journal) if (folder / name).exists()]
    is_empty = there == [journal] and not (folder / CHUNKS).exists() and not _has_frames(folder / journal)
    if is_empty and not resume:
        # a run that ended before its first frame has nothing to keep
        (folder / journal).unlink()
        there = []
    # all that a run writes before its first frame is done
    begun = [name for name in there if Path(name).name in (PERSON, journal)]
    if there and not (resume or overwrite):
        what = "an unfinished run" if begun == there else "the results of a run"
        mend = (
            "--resume to continue it or --overwrite to replace it"
            if resumable
            else "--overwrite to replace it"
        )
        raise InputError(f"{folder}: this folder contains {what}; give {mend}.")
    if resume and journal not in there and begun != there:
        raise InputError(
            f"{folder}: this folder has no journal to resume from; give --overwrite to begin anew."
        )
    if overwrite:
        for name in there:
            (folder / name).unlink()
        (folder / REPORT).unlink(missing_ok=True)
        shutil.rmtree(folder / CHUNKS, ignore_errors=True)
        for own in folder.glob(f"{PERSON_FOLDER}*"):
            if own.is_dir() and not any(own.iterdir()):
                own.rmdir()
    return folder / journal


def _has_frames(journal: Path) -> bool:
    """Test if a journal may hold frames; one that cannot be read may."""
    try:
        return count_records(journal) > 0
    except (InputError, OSError):
        return True


def person_folder(folder: Path, number: int) -> Path:
    """Return the folder of the results of one person among several; `number` counts from 0."""
    return folder / f"{PERSON_FOLDER}{number + 1}"


def make_writable(folder: Path) -> None:
    """Make a folder if it does not exist, and check write access. Raises `InputError`."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(13, "Permission denied")
    except OSError as error:
        raise InputError(
            f"{folder}: this folder cannot be written to ({error.strerror}); give another one."
        ) from None


def fingerprint(trackers: Sequence[Tracker], first: Cloud) -> dict[str, object]:
    """Compute the fingerprint of the inputs: hashes of the body with its limits and of the first cloud. Later
    clouds may be repaired, or added after the solved ones, before a run resumes (`check_same_clouds`)."""
    body = hashlib.sha256()
    for leaf in jax.tree.leaves(list(trackers)):
        body.update(np.asarray(leaf).tobytes())
    cloud = hashlib.sha256(np.asarray(first.points).tobytes())
    return {
        "body arrays": body.hexdigest(),
        "first cloud": cloud.hexdigest(),
        "precision": str(trackers[0].body.vertices.dtype),
    }


def open_journal(path: Path, header: Mapping[str, object], width: int, resume: bool) -> Journal:
    """Open the journal of an interrupted run, or create one."""
    going_on = resume and path.is_file()
    return (resume_journal if going_on else create_journal)(path, dict(header), width)


def last_frame(journal: Journal, names: Sequence[str], template: Frame) -> Frame | None:
    """Read the last frame of an interrupted run of the clouds `names`; None if the run is new.

    **Raises:** `InputError` as `check_same_clouds` does.
    """
    check_same_clouds(journal, names)
    return None if journal.last is None else unpack(template, journal.last)[0]


def check_same_clouds(journal: Journal, names: Sequence[str]) -> None:
    """Check that the frames of a resumed run are those of the first clouds present now.

    **Raises:** `InputError` that names the first different one, for example if files were added before
    others.
    """
    solved = journal.read(slice(CLOUD_AT, CLOUD_AT + 1))[:, 0]
    for number, (name, was) in enumerate(zip(names, solved, strict=False)):
        if hash_cloud_name(name) != was:
            raise InputError(
                f"{journal.path}: frame {number} of this run was not {Path(name).name}, which is now the cloud of that "
                f"number; resume with the {len(solved)} solved clouds first, or give --overwrite to begin anew."
            )


def write_results(
    folder: Path,
    skeleton: Skeleton,
    results: Results,
    rate: float,
    names: Sequence[str],
    summary: Mapping[str, object] | None = None,
) -> None:
    """Write the motion and the statistics of a run; `names` are those of the clouds, `summary` is added to the statistics."""
    motion = Motion(results.poses, rate)
    write_bvh(folder / "motion.bvh", skeleton, motion)
    save_motion(folder / "motion.npz", motion, skeleton, [verdict for verdict, _ in results.verdicts])
    statistics = results.statistics
    columns = {
        # per point, per metre^3: the objective that expectation maximisation minimises
        "energy": -statistics.log_likelihood,
        "sigma": statistics.sigma,
        "outlier_share": statistics.outlier_share,
        "mean_distance": statistics.mean_distance,
        "verdict": np.array([verdict for verdict, _ in results.verdicts]),
        "reasons": np.array(["; ".join(reasons) for _, reasons in results.verdicts]),
        "unseen": np.array(["; ".join(parts) for parts in results.unseen]),
        "seconds": results.seconds,
    }
    rows = [
        {"frame": number, "cloud": Path(name).name, **dict(zip(columns, values, strict=True))}
        # a stopped run has fewer frames than names
        for number, (name, *values) in enumerate(
            zip(names, *(column.tolist() for column in columns.values()), strict=False)
        )
    ]
    verdicts = [verdict for verdict, _ in results.verdicts]
    give_figures(
        {
            "frames": len(rows),
            **{f"{verdict}_frames": verdicts.count(verdict) for verdict in ("good", "doubtful", "lost")},
            "mean_distance": float(np.mean(columns["mean_distance"][: len(rows)])) if rows else np.nan,
        }
    )
    write_csv(folder / "statistics.csv", rows)
    write_json(folder / "statistics.json", {"rate": rate, **(summary or {}), "frames": rows})


def warn_of_results(results: Results, *, of_clouds: bool) -> None:
    """Warn of frames that are not good, of parts that were not seen, and of other people.

    `of_clouds`, the frames are clouds without the cameras that took them.
    """
    hidden = unseen_sentences(results.unseen)
    for sentence in (
        *verdict_sentences(results.verdicts),
        *hidden,
        *([CAMERAS_HELP] if of_clouds and hidden else []),
        *others_sentences(results.others),
    ):
        warn(sentence)


def check_some_found(folder: Path, verdicts: Sequence[tuple[str, Sequence[str]]]) -> None:
    """Check that the body was found in some frame of the written results. Raises `InputError`."""
    if len(verdicts) and all(verdict == "lost" for verdict, _ in verdicts):
        raise InputError(
            f"{folder}: the body was found in none of the {len(verdicts)} frames, so the written results are useless. "
            "Check the unit, the up axis and the body; `jaxcap track --fit-shape` fits a human body to the person."
        )


def check_complete(count: int, clouds: Sequence) -> None:
    """Report that tracking was stopped before the last frame, by a `KeyboardInterrupt`."""
    if count < len(clouds):
        raise KeyboardInterrupt(
            f"stopped after {count} of {len(clouds)} frames, which are written; --resume continues"
        )
