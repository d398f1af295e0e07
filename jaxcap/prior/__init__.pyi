"""Learn how likely poses are: Gaussian mixtures of successive joints."""

from ..body.pair_prior import PairPrior as PairPrior
from ..body.pair_prior import likelihood as likelihood
from ..body.pair_prior import make_pair_prior as make_pair_prior
from ..energy.priors.pair_prior import LikelihoodPrior as LikelihoodPrior
from ..energy.priors.pair_prior import MahalanobisPrior as MahalanobisPrior
from .learn_pose_prior import learn_pair_prior as learn_pair_prior
from .learn_pose_prior import learn_ranges as learn_ranges
