"""`jaxcap learn`: learn a body from registered meshes alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...energy.energy import AbstractEnergy
from ...errors import InputError
from ...fit.fit_meshes import fit_meshes
from ...io.archives.checkpoint import save_checkpoint
from ...io.archives.journal import hash_files
from ...io.archives.npz import save_body, save_motion
from ...io.meshes.meshes import read_named_meshes
from ...io.system.run_lock import run_lock
from ...learn.anatomy.choose_skeleton import SkeletonName, choose_skeleton
from ...learn.anatomy.find_person import PlacedPerson
from ...learn.check_meshes import check_meshes
from ...learn.correctives.learn_correctives import LearnedCorrectives
from ...learn.learn_body import COARSE_PREFIX, Learned, LearnState, learn_body
from ...learn.parts.check_parts import check_learned
from ...learn.skeleton.check_skeleton import check_skeleton
from ...observe.meshes import MeshSequence
from ...report.learning.learned import report_learning
from ...report.scores import Scores
from ..console.console import say, warn
from ..console.heartbeat import set_activity
from ..console.options import SKELETON_FORMATS, Flag, OptionalCount, OptionalFile, Unit, arg, check_ranges
from ..console.rounds import RoundProgress
from ..fit import MeshesSpec, OptionalFolder, OptionalRate, check_rate_option
from ..motions import load_skeleton
from ..outputs import check_npz, check_parent, is_run_complete, make_folder
from ..scoring import mesh_hashes, print_scores, score_motion
from ..terms import FloorHeight, LimitsFile, LimitWeight, PriorFile
from .correctives import add_correctives, check_number_of_meshes
from .input import learning_terms, read_pairs, skeleton_digest, split_held_out
from .joints import evidence_of, say_joints
from .people import PeopleRun, check_people_options, check_people_skeleton, run_people
from .people_input import names_people
from .state import load_state, make_checkpoint, stop_message

#: values of --skeleton that are not files
SKELETON_NAMES = ("human", "none")
OptionalText = Annotated[str | None, arg(metavar="LEFT:RIGHT,...", help_behavior_hint="")]


@dataclass
class Learn:
    """Learn an animatable body from registered meshes of one actor in many poses; write the body and its poses in the
    meshes. All meshes have the same vertices, in the same order. With --people they are of several people, and the result is a
    body model with shape coefficients.

    An interrupted run continues with --resume. The result is the same as without the interruption."""

    meshes: MeshesSpec
    """Mesh files, a folder, a quoted glob, or an .npz with the arrays `vertices` (F, V, 3), for F meshes of V
    vertices, and `faces`."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="FILE")] = Path("body.npz")
    """Output file for the body, .npz."""
    joints: OptionalCount = None
    """Number of joints between the parts, without the root. Default: determined from the motion."""
    alpha: float = 100.0
    """Weight of the shape of the surface, relative to the positions of its vertices. 0 fits the positions alone; large
    values give a smoother surface."""
    skin: Literal["swing_twist", "lbs", "rigid"] = "swing_twist"
    """Skinning model: separate weights for swing and twist, linear blend skinning, or rigid parts."""
    symmetry: Flag = True
    """Do not constrain left and right limbs to equal lengths."""
    always_symmetric: Flag = False
    """Pair the joints of a symmetric surface even if its two sides move differently."""
    pairs: OptionalText = None
    """Symmetric pairs of left and right joints, by number or, with --skeleton FILE, by name, such as 3:5,4:6. Default:
    by the names of joints, else by the symmetry of the surface, else by the lengths and areas of the limbs. Without
    --skeleton, joints are then found from the motion."""
    people: Flag = False
    """MESHES show several people, and a body model of all is written: a folder, an .npz or the mesh files of a folder are one
    person. A pattern with a named part, such as "meshes/{subject}/*.ply", does the same for the text of this part."""
    components: OptionalCount = None
    """Number of shape coefficients with --people. Default: one less than people, which is also the most."""
    skeleton: Annotated[
        OptionalFile,
        arg(
            metavar="human|none|FILE",
            help="The joints with which learning begins. 'human': the named joints of a person, placed in one of the meshes. "
            "'none': joints are found from the motion. Or a skeleton that is aligned with the first mesh, in a file: "
            f"{SKELETON_FORMATS}. Default: 'human' if a person is recognised, else 'none'; 'none' with --joints.",
        ),
    ] = None
    fix_joints: Flag = False
    """Fix the joints of the skeleton. Without this option, their positions are estimated from the motion."""
    free_bones: Flag = False
    """Learn bones without parents, with linear blend skinning. Their number is one more than --joints."""
    correctives: Flag = False
    """Learn displacements of the surface that depend on the pose, if they lower the errors of poses that are left out of the
    fit."""
    limits: LimitsFile = None
    limit_weight: LimitWeight = 100.0
    prior: PriorFile = None
    floor: FloorHeight = None
    rounds: Annotated[int, arg(metavar="N")] = 30
    """Largest number of rounds, including rounds on a reduced mesh. Each round updates weights, vertices and joints.
    Learning stops earlier if a round gains little."""
    unit: Unit = "m"
    """Unit of meshes and skeleton: m, dm, cm, mm, in or ft."""
    rate: OptionalRate = None
    """Meshes per second. Default: the rate stated in the file, else 30."""
    motion: OptionalFile = None
    """Output file for the poses of the training meshes, .npz. Default: next to the body, `body-motion.npz` for
    `body.npz`."""
    hold_out: OptionalCount = None
    """Hold out every N-th mesh from learning, and score the body on these meshes."""
    report: OptionalFolder = None
    """Output folder for report.json and pictures."""
    resume: Flag = False
    """Continue an interrupted run."""
    overwrite: Flag = False
    """Replace the body and its motion if they exist."""

    def run(self) -> None:
        self.check()
        if self.people or names_people(self.meshes):
            self.run_people()
            return
        motion_path = self.motion or self.out.with_name(f"{self.out.stem}-motion.npz")
        kept = self.out.with_name(f"{self.out.name}.partial")
        for path in (self.out, motion_path):
            check_parent(path)
        with run_lock(self.out, motion_path):
            # a run that was killed while it wrote its results resumes from its last round
            if self.resume and is_run_complete((self.out, motion_path), kept):
                return
            replace = self.overwrite or (self.resume and kept.is_file())
            check_npz(self.out, replace, "a body")
            check_npz(motion_path, replace)
            self.learn_all(motion_path, kept)

    def run_people(self) -> None:
        """Learn one body model from the meshes of several people."""
        for_one = {
            "--free-bones": self.free_bones,
            "--always-symmetric": self.always_symmetric,
            "--correctives": self.correctives,
            "--limits": self.limits is not None,
            "--prior": self.prior is not None,
            "--floor": self.floor is not None,
        }
        check_people_options(for_one, self.components)
        file = self.skeleton_file()
        given = None if file is None else load_skeleton(file, self.unit)
        if given is not None:
            check_people_skeleton(str(file), given)
        own = ("components", "joints", "skin", "alpha", "fix_joints", "rounds")
        learning = {
            **{name: getattr(self, name) for name in own},
            "symmetry": self.symmetry if self.pairs is None else read_pairs(self.pairs, given),
            "skeleton": self.skeleton_name() if given is None else given,
        }
        files = (self.meshes, self.out, self.motion, self.report, self.unit, self.rate)
        run_people(PeopleRun(*files, self.hold_out, self.resume, self.overwrite, learning, self.settings()))

    def learn_all(self, motion_path: Path, checkpoint_path: Path) -> None:
        """Read, learn, write and score, while the lock excludes other runs with the same output files."""
        set_activity("reading the meshes")
        sequence, names = read_named_meshes(self.meshes, self.unit, self.rate)
        train, held = split_held_out(len(sequence), self.hold_out)
        if self.hold_out is not None and not held.size:
            raise InputError(
                f"--hold-out {self.hold_out} leaves out none of {len(sequence)} meshes; give a lower number."
            )
        check_number_of_meshes(len(train), self.correctives)
        for message in check_meshes(sequence, names):
            warn(message)
        # correctives are learned after the body
        header = {**self.settings(), **mesh_hashes(sequence[train]), "correctives": False}
        file = self.skeleton_file()
        given = None if file is None else load_skeleton(file, self.unit)
        resumed = load_state(checkpoint_path, header, self.resume, self.overwrite)
        if self.report is not None:
            make_folder(self.report)
        tree = self.choose(sequence[train], [names[row] for row in train], given, resumed)
        learned = self.learn(sequence[train], tree, checkpoint_path, header, resumed)
        plain, correctives = learned, None
        if self.correctives:
            learned, correctives = add_correctives(learned, sequence[train], self.terms)
        set_activity("writing the body and checking it")
        save_body(self.out, learned.body)
        save_motion(motion_path, learned.motion, learned.body.skeleton)
        body = learned.body
        bones, joints = body.skeleton.num_joints, sum(parent >= 0 for parent in body.skeleton.parents)
        between = "without parents" if self.free_bones else f"with {joints} joints between them"
        say(f"{self.out}: {len(body.vertices)} vertices on {bones} bones {between}; poses in {motion_path}")
        if not self.free_bones:
            say_joints(learned)
        # anatomy has joints that are closer to each other than the limb is wide, such as those of the neck
        doubts = [] if self.free_bones or learned.given is not None else check_skeleton(body)
        for message in [*check_learned(body, learned.motion), *doubts]:
            warn(message)
        self.score(learned, sequence, names, train, held, plain, correctives)
        checkpoint_path.unlink(missing_ok=True)

    def check(self) -> None:
        """Check that options are in range and compatible. Raises `InputError`."""
        ranges = {
            "--joints": (self.joints, self.joints is None or self.joints >= 1, "at least 1"),
            "--alpha": (self.alpha, 0 <= self.alpha < np.inf, "at least 0"),
            "--rounds": (self.rounds, self.rounds >= 1, "at least 1"),
            "--hold-out": (self.hold_out, self.hold_out is None or self.hold_out >= 2, "at least 2"),
        }
        check_ranges(ranges)
        check_rate_option(self.rate)
        if self.resume and self.overwrite:
            raise InputError("--resume continues a run and --overwrite replaces it; give one of them.")
        if self.pairs is not None and not self.symmetry:
            raise InputError(
                "--pairs defines symmetric joints and --no-symmetry disables symmetry; give one of them."
            )
        has_skeleton = self.skeleton_file() is not None or self.skeleton_name() == "human"
        if self.always_symmetric and (
            self.pairs is not None or not self.symmetry or self.free_bones or has_skeleton
        ):
            raise InputError(
                "--always-symmetric excludes --pairs, --no-symmetry, --free-bones and --skeleton other than none."
            )
        if has_skeleton and self.joints is not None:
            raise InputError("--skeleton defines the joints; omit --joints.")
        needing = {"--fix-joints": self.fix_joints, "--limits": self.limits, "--prior": self.prior}
        for option, given in needing.items():
            if given and not has_skeleton:
                raise InputError(f"{option} needs a skeleton; give it with --skeleton.")
        if self.components is not None and not (self.people or names_people(self.meshes)):
            raise InputError("--components is for several people; give --people.")
        if self.free_bones and (has_skeleton or self.pairs is not None):
            raise InputError("--free-bones uses no skeleton and no pairs; omit --skeleton and --pairs.")
        if self.free_bones and self.correctives:
            raise InputError("--correctives depend on joints, and --free-bones has none; give one of them.")

    def skeleton_file(self) -> Path | None:
        """Return --skeleton if it is a file, or `human` with options, and not one of the names."""
        return None if str(self.skeleton) in SKELETON_NAMES else self.skeleton

    def skeleton_name(self) -> SkeletonName:
        """Return the choice of the skeleton if it is not a file."""
        if self.skeleton is not None:
            return "human" if str(self.skeleton) == "human" else "none"
        free = self.joints is not None or self.pairs is not None or self.free_bones
        return "none" if free else "automatic"

    def choose(
        self, meshes: MeshSequence, names: Sequence[str], given: Skeleton | None, resumed: LearnState | None
    ) -> Skeleton | PlacedPerson | None:
        """Choose the skeleton with which learning begins: a given one, or a person's; None for a free search."""
        if resumed is not None:
            return None if resumed.given is None else resumed.body.skeleton
        if given is not None:
            return given
        if self.skeleton_name() == "automatic":
            set_activity("looking for a person in the meshes")
        placed, sentence = choose_skeleton(meshes, self.skeleton_name(), names)
        if self.skeleton_name() != "none":
            say(sentence)
        return placed

    def settings(self) -> dict[str, object]:
        """Collect the settings that affect the result, by the names of the options."""
        names = (
            "joints", "alpha", "skin", "symmetry", "always_symmetric", "pairs", "fix_joints", "free_bones", "correctives", "unit", "rate",
            "hold_out", "limit_weight", "floor",
        )  # fmt: skip
        file = self.skeleton_file()
        skeleton = self.skeleton_name() if file is None else skeleton_digest(file)
        skin = "lbs" if self.free_bones else self.skin
        hashes = hash_files({"limits": self.limits, "prior": self.prior})
        known = {name: getattr(self, name) for name in names}
        return {**known, "skin": skin, "skeleton": skeleton, **hashes}

    def terms(self, meshes: MeshSequence, skeleton: Skeleton | None) -> tuple[AbstractEnergy, ...]:
        """Make the energies of the options, for a body in the shape of the first mesh."""
        return learning_terms(
            meshes,
            skeleton,
            limits=self.limits,
            limit_weight=self.limit_weight,
            floor=self.floor,
            prior=self.prior,
        )

    def learn(
        self,
        meshes: MeshSequence,
        tree: Skeleton | PlacedPerson | None,
        checkpoint_path: Path,
        header: dict[str, object],
        resumed: LearnState | None,
    ) -> Learned:
        """Run the learning loop, with a checkpoint after every round; Ctrl-C keeps the last one."""
        done = 0 if resumed is None else resumed.round
        begins = (
            f"round {done} is complete"
            if done
            else "parts and joints are estimated first, and the first round compiles"
        )
        say(f"learning from {len(meshes)} meshes of {meshes.vertices.shape[1]} vertices; {begins}")
        skeleton = tree.body.skeleton if isinstance(tree, PlacedPerson) else tree
        wanted = "always" if self.always_symmetric else self.symmetry
        symmetry = wanted if self.pairs is None else read_pairs(self.pairs, skeleton)
        with RoundProgress(self.rounds, done) as bar:

            def on_round(state: LearnState) -> None:
                nonlocal done
                save_checkpoint(checkpoint_path, make_checkpoint(state), header)
                done = state.round
                step, value = state.history[-1]
                some = f" on {len(state.body.vertices)} vertices" if step.startswith(COARSE_PREFIX) else ""
                bar.update(done, f"Q {value:.5g} m²{some}")

            try:
                return learn_body(
                    meshes,
                    joints=self.joints,
                    skin="lbs" if self.free_bones else self.skin,
                    alpha=self.alpha,
                    symmetry=symmetry,
                    skeleton="none" if tree is None else tree,
                    fix_joints=self.fix_joints,
                    free_bones=self.free_bones,
                    rounds=self.rounds,
                    terms=self.terms(meshes, skeleton),
                    on_round=on_round,
                    resume=resumed,
                )
            except KeyboardInterrupt:
                raise KeyboardInterrupt(stop_message(done, checkpoint_path)) from None

    def score(
        self,
        learned: Learned,
        sequence: MeshSequence,
        names: tuple[str, ...],
        train: np.ndarray,
        held_out: np.ndarray,
        plain: Learned,
        correctives: LearnedCorrectives | None,
    ) -> None:
        """Score the body on training and on held-out meshes, and the `plain` one before correctives; print and report the scores."""
        groups, scores = self.score_groups(learned, sequence, names, train, held_out, "")
        before: dict[str, Scores] = {}
        if correctives is not None and correctives.is_used:
            suffix = " without correctives"
            before = self.score_groups(plain, sequence, names, train, held_out, suffix)[1]
        print_scores({**before, **scores})
        if self.report is not None:
            shown = {
                label: (motion, sequence[rows], scores[label]) for label, (motion, rows) in groups.items()
            }
            set_activity("drawing the report")
            report_learning(
                self.report,
                learned.body,
                shown,
                learned.history,
                learned.curve,
                self.settings(),
                None if self.free_bones else evidence_of(learned),
                learned.given,
                correctives,
                (learned.symmetry, learned.symmetry_message),
            )
            say(f"report.json and pictures are in {self.report}")

    def score_groups(
        self,
        learned: Learned,
        sequence: MeshSequence,
        names: tuple[str, ...],
        train: np.ndarray,
        held_out: np.ndarray,
        suffix: str,
    ) -> tuple[dict[str, tuple[Motion, np.ndarray]], dict[str, Scores]]:
        """Score a body on training and on held-out meshes; return the motions with the meshes, and the scores, by label."""
        groups = {f"training{suffix}": (learned.motion, np.ones(len(train), bool), train)}
        if held_out.size:
            set_activity("fitting the held-out meshes")
            fit = fit_meshes(learned.body, sequence[held_out])
            groups[f"held out{suffix}"] = (fit.motion, np.asarray(fit.converged), held_out)
        scores = {
            label: score_motion(
                learned.body,
                motion,
                fitted,
                sequence[rows],
                tuple(names[row] for row in rows),
                f"scoring {label}",
            )
            for label, (motion, fitted, rows) in groups.items()
        }
        return {label: (motion, rows) for label, (motion, _, rows) in groups.items()}, scores
