"""Validate learned joint limits on other people and other takes: `python -m benchmarks.limits_transfer`.

Limits of shoulders with elbows and of hips with knees are learned from all takes of one person of the CMU database and
tested on all takes of another person, and the reverse. Margins are chosen by leaving out whole takes of the first person;
the margin between people is a constant from the literature. The figures are the
shares of frames that are allowed, and of pairs of rotations that were never seen together that are rejected. They are
compared with boxes of Euler angles, and with widths chosen by leaving out blocks of ten seconds. With `--takes`, limits
are also learned without one take and tested on it.
"""

import argparse
import time

import numpy as np
from scipy.spatial import KDTree

from benchmarks._scenes import shared_folder
from benchmarks.limits._limits import PAIRS, clear_compiled
from benchmarks.limits.limits_holdout import MAX_PAIR_ANGLE, are_allowed, embed_pairs
from benchmarks.report import finish, progress
from jaxcap.biomechanics.person_samples import gather_person_samples
from jaxcap.io.registry import read_motion
from jaxcap.limits.learning.boxes import learn_boxes
from jaxcap.limits.learning.choice import COVERAGE
from jaxcap.limits.learning.learn_limits import learn_limits
from jaxcap.limits.learning.samples import JointSamples, gather_samples

PEOPLE = ("01", "02")
#: margin between people, degrees: the smallest standard deviation of joint ranges between adults (Roaas and Andersson 1982:
#: 5 to 12)
PERSON_MARGIN = 5.0
#: shares of held-out takes for the curve of allowed against rejected
CURVE = (0.95, 0.98, COVERAGE, 0.995)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--questions", type=int, default=20_000)
    parser.add_argument("--every", type=int, default=1, help="use every n-th frame")
    parser.add_argument("--curve", action="store_true", help="also other shares of held-out takes")
    parser.add_argument("--person-margin", type=float, default=PERSON_MARGIN, help="degrees")
    parser.add_argument("--only", choices=("boxes", "blocks", "takes"), help="one scheme only")
    parser.add_argument("--takes", action="store_true", help="also takes of the same person")
    options = parser.parse_args()
    start = time.perf_counter()
    motions = {person: load(person, options.every) for person in PEOPLE}
    shares = CURVE if options.curve else (COVERAGE,)
    figures, limits = {}, {}
    for source, target in (PEOPLE, PEOPLE[::-1]):
        found = transfer(motions, source, target, options, shares)
        for scheme, (allowed, rejected, worst) in found.items():
            name = f"{source}_to_{target}_{scheme}"
            figures[f"{name}_allowed_percent"] = allowed
            figures[f"{name}_rejected_percent"] = rejected
            figures[f"{name}_worst_take_percent"] = worst
        if "takes" in found:
            limits[f"{source}_to_{target}_takes_allowed_percent"] = (">=", 99.0)
            limits[f"{source}_to_{target}_takes_rejected_percent"] = (">=", 40.0)
        if options.takes:
            figures |= other_takes(motions[source], source)
    for kind in ("allowed", "rejected") if limits else ():
        pair = [figures[f"{a}_to_{b}_takes_{kind}_percent"] for a, b in (PEOPLE, PEOPLE[::-1])]
        figures[f"mean_{kind}_percent"] = float(np.mean(pair))
    finish(
        "limits_transfer", figures, limits, {"every": options.every}, {"total": time.perf_counter() - start}
    )


def load(person: str, every: int):
    """Load all motions of a person."""
    paths = sorted((shared_folder() / "data" / "motion").glob(f"{person}_*.amc"))
    return [
        (skeleton, motion.slice(slice(None, None, every))) for skeleton, motion in map(read_motion, paths)
    ]


def learn(train: JointSamples, scheme: str, skeleton, share: float, person_margin: float):
    """Learn the limits of a joint and its parent by one scheme."""
    assert train.parent is not None
    pair = {train.parent.joint: train.parent, train.joint: train}
    if scheme == "boxes":
        return learn_boxes(skeleton, [train.parent, train])
    if scheme == "blocks":
        return (learn_limits(pair, held_out="blocks"),)
    return (learn_limits(pair, held_out="takes", coverage=share, person_margin=np.radians(person_margin)),)


def transfer(motions, source: str, target: str, options, shares) -> dict[str, tuple[float, float, float]]:
    """Compute the percentages of allowed frames, of rejected pairs, and of allowed frames in the worst take, by scheme: means
    over the pairs of joints."""
    schemes = {"boxes": 0.0, "blocks": 0.0, "takes": COVERAGE}
    schemes |= {f"takes_{1000 * share:.0f}": share for share in shares if share != COVERAGE}
    schemes = {name: share for name, share in schemes.items() if name.startswith(options.only or "")}
    rows = {scheme: [] for scheme in schemes}
    skeleton = motions[source][0][0]
    for parent, joint in PAIRS:
        test = gather_samples(motions[target], joint, parent)
        poses = never_together(motions, test, options.questions)
        one_side, both_sides = (
            gather_person_samples(motions[source], joint, parent, both_sides=both) for both in (False, True)
        )
        for scheme, share in schemes.items():
            train = both_sides if scheme.startswith("takes") else one_side
            limits = learn(train, scheme, skeleton, share, options.person_margin)
            assert test.parent is not None
            good = are_allowed(limits, skeleton, {parent: test.parent.rotations, joint: test.rotations})
            no = 100 * (1 - are_allowed(limits, skeleton, poses).mean())
            takes = [100 * good[test.takes == take].mean() for take in np.unique(test.takes)]
            rows[scheme].append((100 * good.mean(), no, min(takes)))
            sizes = "" if scheme == "boxes" else describe(limits[0])
            progress(
                f"{source} to {target} {joint} {scheme}: allows {100 * good.mean():.2f} %, worst take {min(takes):.1f} %, "
                f"rejects {no:.1f} % of {len(poses[joint])}{sizes}"
            )
        clear_compiled()
    return {
        scheme: (float(np.mean(each[:, 0])), float(np.mean(each[:, 1])), float(each[:, 2].min()))
        for scheme, each in ((scheme, np.array(row)) for scheme, row in rows.items())
    }


def describe(limits) -> str:
    """Describe margins and keyframes of a joint and its parent."""
    above, below = limits.surfaces
    margins = ", ".join(f"{np.degrees(2 * float(each.margin)):.0f}" for each in (above, below))
    return f"; margins {margins} degrees, {below.centres.shape[0]} keyframes"


def never_together(motions, test: JointSamples, count: int) -> dict[str, np.ndarray]:
    """Combine rotations of a joint and its parent from different frames that no frame of either person is near."""
    assert test.parent is not None
    whole = gather_samples(motions[PEOPLE[0]] + motions[PEOPLE[1]], test.joint, test.parent.joint)
    assert whole.parent is not None
    some = np.random.default_rng(2).integers(0, len(test.rotations), (2, count))
    children, parents = test.rotations[some[0]], test.parent.rotations[some[1]]
    seen = KDTree(embed_pairs(whole.rotations, whole.parent.rotations))
    distances = seen.query(embed_pairs(children, parents), p=np.inf)[0]
    never = distances > 2 * np.sin(np.radians(MAX_PAIR_ANGLE) / 4)
    return {test.parent.joint: parents[never], test.joint: children[never]}


def other_takes(motions, person: str) -> dict[str, float]:
    """Compute the percentages of allowed frames of takes that limits of the same person were learned without."""
    skeleton, kept = motions[0][0], {"blocks": [], "takes": []}
    for parent, joint in PAIRS:
        one_side, both_sides = (
            gather_person_samples(motions, joint, parent, both_sides=both) for both in (False, True)
        )
        test = gather_samples(motions, joint, parent)
        assert test.parent is not None and test.takes is not None
        for take in range(len(motions)):
            own = test.takes == take
            poses = {parent: test.parent.rotations[own], joint: test.rotations[own]}
            for scheme, whole in (("blocks", one_side), ("takes", both_sides)):
                train = whole.take(np.flatnonzero(whole.takes != take))
                assert train.parent is not None
                limits = learn_limits({parent: train.parent, joint: train}, held_out=scheme)
                kept[scheme].append(100 * are_allowed((limits,), skeleton, poses).mean())
            progress(f"{person} {joint} take {take}: {kept['blocks'][-1]:.2f} %, {kept['takes'][-1]:.2f} %")
        clear_compiled()
    return {
        f"{person}_other_takes_{scheme}_{name}_percent": float(value)
        for scheme, values in kept.items()
        for name, value in (("allowed", np.mean(values)), ("worst", min(values)))
    }


if __name__ == "__main__":
    main()
