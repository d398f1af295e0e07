"""All verbs of the command line in their groups, by class name; a verb is imported only when it runs."""

from .verbs import Group, Verb

MARKERS = Group(
    "Optical markers: a subject from takes, its motion through trials",
    """Optical markers: what is in a file of them, a subject from takes, its motion through trials.

Results are in metres.""",
    {
        "info": Verb("markers.info.Info", "Say what is in a file of markers"),
        "fit": Verb("markers.fit.Fit", "Make a subject from takes of one performer"),
        "solve": Verb("markers.solve.Solve", "Solve the motion of a subject through trials"),
    },
)

LIMITS = Group(
    "Joint limits: learned from motions, checked, enforced",
    """Joint limits: learned from motions, what of a motion is beyond them, a motion turned back into them.

Angles are in degrees.""",
    {
        "learn": Verb("limits.learn.Learn", "Learn limits of joints from motions"),
        "check": Verb("limits.check.Check", "Say which joints of a motion are beyond limits"),
        "project": Verb("limits.project.Project", "Turn the joints of a motion back into limits"),
        "compare": Verb("limits.compare.Compare", "Compare the rotations of two performers' joints"),
    },
)

PRIOR = Group(
    "Pose priors: how likely joints turn together",
    """Pose priors: how likely joints turn together, learned from motions.

Angles are in degrees.""",
    {
        "learn": Verb("prior.learn.Learn", "Learn a pose prior from motions"),
        "info": Verb("prior.info.Info", "Say what a prior holds"),
    },
)

EDIT = Group(
    "Motions edited: retargeted, cut, joined, looped, mirrored",
    """Motions edited: given to another body, cut, joined, looped, mirrored, thinned to keys, made to look somewhere; and a
scan that moves with its body.

Results are in metres, y up.""",
    {
        "retarget": Verb("edit.retarget.Retarget", "Give a motion to another body or skeleton"),
        "gaze": Verb("edit.gaze.Gaze", "Make a person look at a point or into a direction"),
        "glue": Verb("edit.glue.Glue", "Move a raw scan by the body that is fitted to it"),
        "cut": Verb("edit.cut.Cut", "Cut frames out of a motion"),
        "join": Verb("edit.join.Join", "Put one motion behind another"),
        "loop": Verb("edit.loop.Loop", "Make a loop without a seam"),
        "resample": Verb("edit.resample.Resample", "Give a motion another rate"),
        "mirror": Verb("edit.mirror.Mirror", "Mirror a motion: left becomes right"),
        "keys": Verb("edit.keys.Keys", "Find few keys that give a motion back within a tolerance"),
    },
)

JAXCAP = Group(
    "Fit articulated bodies to captures",
    """Fit articulated bodies to point clouds, meshes and markers.

Results are in metres, y up. Compiled functions are kept in the user's cache folder: JAXCAP_CACHE names another one,
--no-cache keeps none.""",
    {
        "demo": Verb("demo.Demo", "Pose, scan and track the embedded human, as a first try"),
        "rig": Verb("rig.Rig", "Put a skeleton into a mesh and bind its vertices to the bones"),
        "learn": Verb("learn.Learn", "Learn an animatable body from registered meshes of one actor"),
        "fit": Verb("fit.Fit", "Pose a body in registered meshes"),
        "adapt": Verb("adapt.adapt.Adapt", "Adapt a template body to the actor in a sequence of scans"),
        "track": Verb("track.track.Track", "Fit a body to a sequence of clouds"),
        "evaluate": Verb("evaluate.Evaluate", "Measure distances from scans to a body, and errors at joints"),
        "scan": Verb("scan.scan.Scan", "Scan a moving body with virtual depth cameras"),
        "markers": MARKERS,
        "limits": LIMITS,
        "prior": PRIOR,
        "edit": EDIT,
        "view": Verb("view.View", "Look at files in the browser"),
        "ik": Verb("ik.Ik", "Pose a body by dragging points of it, in the browser"),
        "info": Verb("info.Info", "Say what is in a file"),
        "convert": Verb("convert.convert.Convert", "Write a file in another format"),
    },
)
