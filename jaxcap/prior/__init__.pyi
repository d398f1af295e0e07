"""Priors of poses: Gaussian mixtures of joints and their parents, as data and learned from motion."""

from ..energy.priors.pair_likelihood import LikelihoodPrior as LikelihoodPrior
from ..energy.priors.pair_likelihood import MahalanobisPrior as MahalanobisPrior
from .learn_pose_prior import learn_pair_prior as learn_pair_prior
from .learn_pose_prior import learn_ranges as learn_ranges
from .pair_prior import PairPrior as PairPrior
from .pair_prior import likelihood as likelihood
from .pair_prior import make_pair_prior as make_pair_prior
