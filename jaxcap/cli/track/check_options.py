"""Checks of the options of `jaxcap track` before files are read."""

from typing import Any

import numpy as np

from ...batch.dask_libraries import import_distributed
from ...errors import InputError
from ..body_models import is_model_spec
from ..console.options import check_ranges
from .people import read_count


def is_in_chunks(track: Any) -> bool:
    """Test if a sequence is tracked in chunks on several workers."""
    return track.workers is not None or track.scheduler is not None


def check_options(track: Any) -> None:
    """Check that options are in range. Raises `InputError`."""
    ranges = {
        "--normal-angle": (
            track.normal_angle,
            0 < track.normal_angle <= 180,
            "above 0 and at most 180 degrees",
        ),
        "--sigma0": (track.sigma0, 0 < track.sigma0 < np.inf, "above 0 metres"),
        "--outlier": (track.outlier, 0 < track.outlier < 1, "between 0 and 1"),
        "--damping": (track.damping, 0 <= track.damping < np.inf, "at least 0"),
        "--iterations": (track.iterations, track.iterations is None or track.iterations >= 1, "at least 1"),
        "--rate": (track.rate, track.rate is None or 0 < track.rate < np.inf, "above 0 frames per second"),
    }
    check_ranges(ranges)
    if not (track.clouds or track.depth):
        raise InputError("No clouds were given; give CLOUDS, or depth images with --depth.")
    if track.clouds and track.depth:
        raise InputError("CLOUDS and --depth were both given; give one of them.")
    given = {
        "--cameras": track.cameras is not None,
        "--masks": bool(track.masks),
        "--empty": bool(track.empty),
    }
    for name, there in given.items():
        if there and not track.depth:
            raise InputError(f"{name} is for depth images; give these with --depth.")
    if track.people is not None:
        read_count(track.people)
    if track.resume and track.overwrite:
        raise InputError("--resume continues a run and --overwrite replaces it; give one of them.")
    in_chunks = is_in_chunks(track)
    chunk_ranges = {
        "--workers": (track.workers, track.workers is None or track.workers >= 1, "at least 1"),
        "--chunks": (track.chunks, track.chunks is None or track.chunks >= 1, "at least 1"),
    }
    check_ranges(chunk_ranges)
    if track.workers is not None and track.scheduler is not None:
        raise InputError(
            "--workers starts workers on this computer and --scheduler uses those of a cluster; give one of them."
        )
    if track.chunks is not None and not in_chunks:
        raise InputError("--chunks is for several workers; give --workers or --scheduler.")
    if in_chunks:
        import_distributed()
    if in_chunks and track.people is not None:
        raise InputError("--workers and --scheduler are for one person; leave out --people.")
    if track.deviations and not track.fit_shape:
        raise InputError("--deviations is for --fit-shape; give both.")
    if track.deviations and not is_model_spec(track.body):
        raise InputError("--deviations is for body models; give one as BODY, such as human:betas=20.")
