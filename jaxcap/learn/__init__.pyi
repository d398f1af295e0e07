"""Learn animatable bodies from registered meshes."""

from .anatomy.joint_evidence import JointEvidence as JointEvidence
from .anatomy.joint_evidence import joint_evidence as joint_evidence
from .correctives.choose import CorrectiveChoice as CorrectiveChoice
from .correctives.learn_correctives import JointCorrectives as JointCorrectives
from .correctives.learn_correctives import LearnedCorrectives as LearnedCorrectives
from .correctives.learn_correctives import learn_correctives as learn_correctives
from .correctives.learn_correctives import measure_correctives as measure_correctives
from .learn_body import Learned as Learned
from .learn_body import LearnState as LearnState
from .people.learn_people import LearnedPeople as LearnedPeople
from .people.learn_people import PeopleState as PeopleState
from .people.learn_people import learn_people as learn_people
from .skeleton.solve_joints import JointSolution as JointSolution
from .skeleton.solve_joints import solve_joints as solve_joints
from .symmetry.find_symmetry import find_symmetry as find_symmetry
from .symmetry.surface_symmetry import SurfaceSymmetry as SurfaceSymmetry
