"""Learn animatable bodies from registered meshes."""

from .anatomy.joint_evidence import JointEvidence as JointEvidence
from .anatomy.joint_evidence import joint_evidence as joint_evidence
from .learn_body import Learned as Learned
from .learn_body import LearnState as LearnState
from .people.learn_people import LearnedPeople as LearnedPeople
from .people.learn_people import PeopleState as PeopleState
from .people.learn_people import learn_people as learn_people
from .skeleton.solve_joints import JointSolution as JointSolution
from .skeleton.solve_joints import solve_joints as solve_joints
