"""The prior of a subject's posture, as an energy of each frame."""

from ..energy.energy import AbstractEnergy, sum_energies
from ..energy.priors.reference_pose import RestPrior
from .subject import Subject


def posture_prior(subject: Subject, terms: AbstractEnergy | None = None) -> AbstractEnergy | None:
    """Add the prior of the subject's posture to other energies; None where there are none."""
    own = () if subject.posture is None else (RestPrior(subject.posture),)
    return sum_energies((*own, *(() if terms is None else (terms,))))
