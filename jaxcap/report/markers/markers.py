"""Fit errors of a subject's markers: figures for tables and `report.json`, and pictures."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...io.table import write_json
from ...markers.subject import Subject
from ...observe.markers import MarkerFrames
from .marker_pictures import draw_residuals, draw_skeleton


class MarkerScore(NamedTuple):
    """Residuals of one marker over all frames in which it is observed, metres; NaN if there are none."""

    label: str
    #: name of its bone; empty if it is loose
    bone: str
    weight: float
    #: share of the frames in which it is observed
    seen: float
    rms: float
    median: float
    worst: float


class Bone(NamedTuple):
    """The straight segment between two joint centres."""

    #: joints at its start and end
    start: str
    end: str
    length: float


def score_markers(
    subject: Subject, residuals: Float[np.ndarray, "F M"], lost: Bool[np.ndarray, "F"] | None = None
) -> tuple[MarkerScore, ...]:
    """Compute the score of each marker of a subject; `lost` frames are ignored."""
    kept = residuals if lost is None else residuals[~np.asarray(lost)]
    weights, bones = np.asarray(subject.weights), np.asarray(subject.bones)
    scores = []
    for marker, label in enumerate(subject.labels):
        own, has_weight = kept[:, marker], weights[marker] > 0
        some = own[np.isfinite(own)] if has_weight else own[:0]
        figures = [float(f(some)) for f in (_rms, np.median, np.max)] if len(some) else [float("nan")] * 3
        seen = float(np.isfinite(own).mean()) if len(own) else 0.0
        bone = subject.skeleton.names[bones[marker]] if has_weight else ""
        scores.append(MarkerScore(label, bone, float(weights[marker]), seen, *figures))
    return tuple(scores)


def assigned_residuals(
    subject: Subject, residuals: Float[np.ndarray, "F M"], lost: Bool[np.ndarray, "F"] | None = None
) -> Float[np.ndarray, "F M"]:
    """Mask residuals with NaN for markers on no bone, and in `lost` frames."""
    kept = np.where(np.asarray(subject.weights) > 0, np.asarray(residuals, float), np.nan)
    return kept if lost is None else np.where(np.asarray(lost)[:, None], np.nan, kept)


def summarise_residuals(residuals: Float[np.ndarray, "F M"]) -> dict[str, float]:
    """Summarise the residuals over all frames and markers, metres; NaN if there are none."""
    some = residuals[np.isfinite(residuals)]
    if not len(some):
        return dict.fromkeys(("rms", "median", "p95", "worst"), float("nan"))
    return {
        "rms": _rms(some),
        "median": float(np.median(some)),
        "p95": float(np.percentile(some, 95)),
        "worst": float(some.max()),
    }


def describe_bones(skeleton: Skeleton) -> tuple[Bone, ...]:
    """List the bones between two joints that are not roots, as a root's centre may be anywhere."""
    centres = np.asarray(skeleton.centres, float)
    return tuple(
        Bone(
            skeleton.names[parent],
            skeleton.names[joint],
            float(np.linalg.norm(centres[joint] - centres[parent])),
        )
        for joint, parent in enumerate(skeleton.parents)
        if parent >= 0 and skeleton.parents[parent] >= 0
    )


def report_markers(
    folder: str | Path,
    subject: Subject,
    motion: Motion,
    frames: MarkerFrames,
    residuals: Float[np.ndarray, "F M"],
    *,
    title: str,
    notes: Sequence[str] = (),
    lost: Bool[np.ndarray, "F"] | None = None,
    extra: Mapping[str, object] | None = None,
) -> list[Path]:
    """Write `report.json`, `skeleton.png` and `residuals.png` into an existing folder; return the pictures.

    **Arguments:** `motion` of the subject through `frames`; `residuals` in the subject's order of markers;
    `notes`, sentences for the user; `extra`, further entries of the report.

    **Raises:** `InputError` if a file cannot be written.
    """
    folder, skeleton = Path(folder), subject.skeleton
    kept = assigned_residuals(subject, residuals, lost)
    pictures = [folder / "skeleton.png", folder / "residuals.png"]
    draw_skeleton(pictures[0], subject, motion, frames, kept, title)
    draw_residuals(pictures[1], subject, kept, frames.rate, title)
    names = ("marker", "bone", "weight", "seen", "rms", "median", "worst")
    scores = score_markers(subject, residuals, lost)
    write_json(
        folder / "report.json",
        {
            "title": title,
            "unit": "m",
            "frames": len(frames),
            "rate": frames.rate,
            "lost_frames": [] if lost is None else np.flatnonzero(lost).tolist(),
            "residuals": summarise_residuals(kept),
            "markers": [dict(zip(names, score, strict=True)) for score in scores],
            "joints": {
                "names": list(skeleton.names),
                "parents": list(skeleton.parents),
                "kinds": list(skeleton.kinds),
                "centres": np.asarray(skeleton.centres, float).tolist(),
            },
            "bones": [bone._asdict() for bone in describe_bones(skeleton)],
            "messages": list(notes),
            **(extra or {}),
        },
    )
    return pictures


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
