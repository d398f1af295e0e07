"""The verdict on a frame: good, doubtful or lost, and why, by part."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .evidence import POINTS, Evidence
from .surface import JudgedSurface
from .usual import INSIDE, Usual, observed

#: excesses over the usual at which a frame is lost, in one region and of the whole body, of the rows of `observed`
LIMITS = ((0.005, 0.012), (0.016, 0.03), (0.02, 0.03))
#: the rows in words, for a limb
WORDS = (
    "unexplained points near the {}",
    "{} where a camera sees nothing",
    "{} within another part of the body",
)
#: what is added to the limits for each unit of the usual level: where much is unexplained more of it changes
RELATIVE = 0.25
#: standard deviations of a share of so many points that are added to the limits (Poisson)
SAMPLING = 3.0
#: deviations of the good frames that an excess has to surpass, too
DEVIATIONS = 5.0
#: times of the limits that they are at most in a sequence that varies much, and of which an excess over the sequence's
#: beginning (`Usual.base`) is held against them
WIDEST = 2.0
#: parts with so much less of the points than their share of the surface are not seen; next to one that is not seen a part
#: needs more, as points of what lies before it are taken for its own
UNSEEN, UNSEEN_ADJACENT = 0.3, 0.5
#: share of the limits from which on a frame is doubtful; and after a frame that was not good, as a fault at the limit does
#: not go away where noise has it below for a frame
DOUBT, STILL = 0.7, 0.6
#: limits of a first frame, of which nothing is usual, are so many times as wide before it is lost
FIRST = 10.0


class Judgement(eqx.Module):
    """A frame compared with the sequence's usual ones: shares of the limits at which a frame is lost."""

    #: of each row of `observed`, by region and, last, of the whole body
    shares: Float[Array | np.ndarray, "3 Q"]
    #: one, or more for a first frame, for which nothing is usual
    tolerance: Float[Array | np.ndarray, ""]
    #: share of a limit from which on the frame is doubtful
    doubt: Float[Array | np.ndarray, ""]
    #: points of each part, as a share of those that its area leads to expect
    support: Float[Array | np.ndarray, "P"]
    #: of the regions
    names: tuple[str, ...] = eqx.field(static=True)
    #: of the parts, by the joints that move them
    parts: tuple[str, ...] = eqx.field(static=True)
    #: number of the part that each hangs on, minus one for the root
    above: tuple[int, ...] = eqx.field(static=True)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Name the parts of the body that no sensor shows, by their joints: their pose is a guess, whatever the verdict."""
        support = np.asarray(self.support)
        hidden, sparse = ~(support >= UNSEEN), ~(support >= UNSEEN_ADJACENT)
        links = [[part, above] for part, above in enumerate(self.above) if above >= 0]
        # parents come first: up the tree, then down it, reaches every part along a chain
        for link in (*reversed(links), *links):
            hidden[link] |= sparse[link] & hidden[link].any()
        return tuple(np.array(self.parts)[hidden].tolist())

    @property
    def worst(self) -> float:
        """The largest share of a limit, infinite where there is none."""
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
        """What is wrong and where, without a full stop, the worst first; empty where the verdict is good."""
        found: dict[str, float] = {}
        doubt = float(self.doubt)
        for row, what in zip(np.asarray(self.shares, float), WORDS, strict=True):
            regions = row[:-1]
            # a whole body over its limit is named by the regions with most of it
            named = (regions >= doubt) | ((row[-1] >= doubt) & (regions >= 0.5 * regions.max()))
            for region in np.flatnonzero(named | ~np.isfinite(regions)):
                reason = what.format(self.names[region])
                found[reason] = max(found.get(reason, 0.0), regions[region])
        return tuple(sorted(found, key=lambda reason: -found[reason]))


@eqx.filter_jit
def judge_evidence(surface: JudgedSurface, usual: Usual, evidence: Evidence) -> Judgement:
    """Compare the evidence of a frame with what is usual.

    Before the first frame nothing is usual (`nothing_usual`): absolute limits then make a frame doubtful, and `FIRST`
    times wider ones lost, as clothes leave as much unexplained as a limb that lies a little wrong. A fault that grows so slowly
    that it becomes usual is seen against the level of the first frames.
    """
    plain = jnp.asarray([[row[0]] * len(surface.names) + [row[1]] for row in LIMITS], usual.level.dtype)
    # no body runs through itself, however often it did
    level, base = usual.level.at[INSIDE].set(0.0), usual.base.at[INSIDE].set(0.0)
    limits = _limits(plain, usual.level)
    limits = jnp.clip(DEVIATIONS * usual.deviation, limits, WIDEST * limits)
    value = observed(evidence)
    shares = jnp.maximum(
        (value - level) / limits,
        jnp.where(usual.frames > 0, (value - base) / (WIDEST * _limits(plain, usual.base)), 0.0),
    )
    tolerance = jnp.where(usual.frames > 0, 1.0, FIRST).astype(limits.dtype)
    doubt = jnp.where(usual.warned > 0, STILL, DOUBT).astype(limits.dtype)
    return Judgement(shares, tolerance, doubt, evidence.support, surface.names, surface.joints, surface.above)


def _limits(plain: Float[Array, "3 Q"], level: Float[Array, "3 Q"]) -> Float[Array, "3 Q"]:
    """Limits of excesses over a level, which has its own share of chance."""
    chance = SAMPLING * jnp.sqrt(jnp.maximum(level, 0.0) / POINTS)
    return plain + jnp.maximum(RELATIVE * level, chance)
