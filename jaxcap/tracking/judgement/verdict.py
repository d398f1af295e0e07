"""The verdict on a frame: good, doubtful or lost, with reasons by part."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .baseline import INSIDE, Baseline, stack_evidence
from .evidence import NUM_POINTS, Evidence
from .region_samples import RegionSamples

#: excesses over the normal level at which a frame is lost, in one region and of the whole body, of the rows
#: of `stack_evidence`
LIMITS = ((0.005, 0.012), (0.016, 0.03), (0.02, 0.03))
#: the rows in words, for a limb
REASON_FORMATS = (
    "unexplained points near the {}",
    "missing points on the {}",
    "{} inside another part of the body",
)
#: increase of the limits per unit of the normal level: a higher level varies more
RELATIVE = 0.25
#: standard deviations of a share of the sampled points that are added to the limits (Poisson)
SAMPLING = 3.0
#: multiple of the good frames' deviations that an excess has to exceed, too
DEVIATIONS = 5.0
#: largest factor on the limits in a sequence that varies much, and factor on the limits of an excess over the
#: sequence's beginning (`Baseline.first_level`)
MAX_FACTOR = 2.0
#: share of the expected points below which a part is unseen; a part adjacent to an unseen one needs more, as
#: points of an occluder may be assigned to it
UNSEEN, UNSEEN_ADJACENT = 0.3, 0.5
#: share of the limits at which a frame is doubtful; and the same after a frame that was not good, so that
#: noise does not hide a persistent fault for a frame
DOUBTFUL_SHARE, DOUBTFUL_SHARE_AFTER = 0.7, 0.6
#: factor on the limits at which a first frame, without a baseline, is lost
FIRST_FRAME_FACTOR = 10.0
#: the reason of a frame without points
NO_PERSON = "no person in the frame"


class Judgement(eqx.Module):
    """A frame compared with a sequence's baseline: shares of the limits at which a frame is lost."""

    #: of each row of `stack_evidence`, by region and, last, of the whole body
    shares: Float[Array | np.ndarray, "3 Q"]
    #: one, or more for a first frame without a baseline; zero if the frame shows no person (`nothing_to_judge`)
    tolerance: Float[Array | np.ndarray, ""]
    #: share of a limit at which the frame is doubtful
    doubt: Float[Array | np.ndarray, ""]
    #: number of points of each part, relative to the number expected from its area
    support: Float[Array | np.ndarray, "P"]
    #: of the regions
    names: tuple[str, ...] = eqx.field(static=True)
    #: of the parts, by the joints that move them
    parts: tuple[str, ...] = eqx.field(static=True)
    #: index of each part's parent, minus one for the root
    part_parents: tuple[int, ...] = eqx.field(static=True)

    @property
    def unseen(self) -> tuple[str, ...]:
        """The unobserved parts of the body, by their joints: their pose is a guess, whatever the verdict."""
        support = np.asarray(self.support)
        hidden, sparse = ~(support >= UNSEEN), ~(support >= UNSEEN_ADJACENT)
        links = [[part, above] for part, above in enumerate(self.part_parents) if above >= 0]
        # parents come first: up the tree, then down it, reaches every part along a chain
        for link in (*reversed(links), *links):
            hidden[link] |= sparse[link] & hidden[link].any()
        return tuple(np.array(self.parts)[hidden].tolist())

    @property
    def worst(self) -> float:
        """The largest share of a limit, infinite where it is not finite."""
        worst = float(np.max(np.asarray(self.shares)))
        return worst if np.isfinite(worst) else np.inf

    @property
    def verdict(self) -> str:
        """`good`, `doubtful` or `lost`."""
        if not self.worst < float(self.tolerance):
            return "lost"
        return "good" if self.worst < float(self.doubt) else "doubtful"

    @property
    def reasons(self) -> tuple[str, ...]:
        """The faults and their parts, without a full stop, worst first; empty where the verdict is good."""
        if float(self.tolerance) == 0:
            return (NO_PERSON,)
        found: dict[str, float] = {}
        doubt = float(self.doubt)
        for row, what in zip(np.asarray(self.shares, float), REASON_FORMATS, strict=True):
            regions = row[:-1]
            # a whole body over its limit is named by the regions with the largest shares
            named = (regions >= doubt) | ((row[-1] >= doubt) & (regions >= 0.5 * regions.max()))
            for region in np.flatnonzero(named | ~np.isfinite(regions)):
                reason = what.format(self.names[region])
                found[reason] = max(found.get(reason, 0.0), regions[region])
        return tuple(sorted(found, key=lambda reason: -found[reason]))


@eqx.filter_jit
def judge_evidence(surface: RegionSamples, baseline: Baseline, evidence: Evidence) -> Judgement:
    """Compare the evidence of a frame with the baseline.

    Before the first frame it has no frames (`initial_baseline`). Absolute limits then make a frame doubtful, and
    `FIRST_FRAME_FACTOR` times wider ones lost, because clothes leave as much unexplained as a slightly wrong
    limb. A fault that grows slowly enough to become normal is detected by comparison with the level of the
    first frames.
    """
    plain = jnp.asarray([[row[0]] * len(surface.names) + [row[1]] for row in LIMITS], baseline.level.dtype)
    # self-intersection is never normal, however frequent
    level, first_level = baseline.level.at[INSIDE].set(0.0), baseline.first_level.at[INSIDE].set(0.0)
    limits = _limits(plain, baseline.level)
    limits = jnp.clip(DEVIATIONS * baseline.deviation, limits, MAX_FACTOR * limits)
    value = stack_evidence(evidence)
    shares = jnp.maximum(
        (value - level) / limits,
        jnp.where(
            baseline.frames > 0,
            (value - first_level) / (MAX_FACTOR * _limits(plain, baseline.first_level)),
            0.0,
        ),
    )
    tolerance = jnp.where(baseline.frames > 0, 1.0, FIRST_FRAME_FACTOR).astype(limits.dtype)
    doubt = jnp.where(baseline.flagged > 0, DOUBTFUL_SHARE_AFTER, DOUBTFUL_SHARE).astype(limits.dtype)
    return Judgement(
        shares, tolerance, doubt, evidence.support, surface.names, surface.joints, surface.part_parents
    )


def nothing_to_judge(surface: RegionSamples, baseline: Baseline) -> Judgement:
    """Make the judgement of a frame that shows no person: lost, with a tolerance of zero."""
    none = jnp.zeros((), baseline.level.dtype)
    support = jnp.zeros(len(surface.joints), none.dtype)
    return Judgement(
        jnp.zeros_like(baseline.level),
        none,
        none,
        support,
        surface.names,
        surface.joints,
        surface.part_parents,
    )


def _limits(plain: Float[Array, "3 Q"], level: Float[Array, "3 Q"]) -> Float[Array, "3 Q"]:
    """Compute limits of excesses over a level, including its sampling error."""
    chance = SAMPLING * jnp.sqrt(jnp.maximum(level, 0.0) / NUM_POINTS)
    return plain + jnp.maximum(RELATIVE * level, chance)
