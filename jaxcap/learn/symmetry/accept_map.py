"""Criteria for a map to be the left-right symmetry of a surface."""

from .judge_map import MapQuality

#: bounds of an accepted map: deviation of distances, median and 99th percentile, as shares of the largest distance; least
#: shares of the area that are consistent and reversed; least distance of exchanged limbs, as a share of the largest distance
MAX_DEVIATION, MAX_LARGEST_DEVIATION, MIN_CONSISTENT, MIN_REVERSED, MIN_REACH = 0.03, 0.15, 0.8, 0.8, 0.3
#: the reversed share of the area from which a map that is not yet fully refined may become a reflection
MIN_LIKELY = 0.75


def preference(quality: MapQuality) -> tuple[bool, float]:
    """Compute the rank of a map that is not yet fully refined; the lowest one is the best.

    Among reflections that exchange limbs the one with the least deviation comes first; among all others, such as the identity
    and rotations, the one that reverses the orientation most.
    """
    is_likely = quality.reversed >= MIN_LIKELY and quality.reach >= MIN_REACH
    return not is_likely, quality.relative_deviation if is_likely else -quality.reversed


def objections(quality: MapQuality) -> list[str]:
    """List in words what is wrong with the best map."""
    found = []
    if quality.reach < MIN_REACH:
        found.append("no limbs are exchanged by any map that keeps distances along the surface")
    elif quality.reversed < MIN_REVERSED:
        found.append(
            f"the map that keeps distances best is no reflection: it reverses the orientation on {100 * quality.reversed:.0f} % of "
            f"the surface (at least {100 * MIN_REVERSED:.0f} % are needed)"
        )
    if quality.relative_deviation > MAX_DEVIATION:
        found.append(
            f"the best map changes distances along the surface by {1000 * quality.deviation:.0f} mm (median), "
            f"{100 * quality.relative_deviation:.1f} % of the largest one (at most {100 * MAX_DEVIATION:.0f} % are accepted)"
        )
    elif quality.largest_deviation > MAX_LARGEST_DEVIATION:
        found.append(
            f"the best map changes some distances along the surface by {100 * quality.largest_deviation:.0f} % of the largest "
            f"one or more (at most {100 * MAX_LARGEST_DEVIATION:.0f} % are accepted): the surface differs on the two sides"
        )
    if quality.consistent < MIN_CONSISTENT:
        found.append(
            f"the best map, applied twice, brings {100 * quality.consistent:.0f} % of the surface back (at least "
            f"{100 * MIN_CONSISTENT:.0f} % are needed)"
        )
    return found


def describe(quality: MapQuality) -> str:
    """Format the measures of an accepted map as a sentence."""
    return (
        f"A left-right symmetry was found: distances along the surface change by {1000 * quality.deviation:.0f} mm (median, "
        f"{100 * quality.relative_deviation:.1f} % of the largest one), and {100 * quality.consistent:.0f} % of the surface is "
        "consistent."
    )
