"""All verbs of the command line in their groups, by class name; a verb is imported only when it runs."""

from .verbs import Verb, VerbGroup

MARKERS = VerbGroup(
    "Optical markers: calibrate a subject, solve its motion",
    """Optical markers: inspect a file of markers, calibrate a subject from takes, label raw markers, solve motion in trials.

Results are in metres; TRC and C3D files are in millimetres. The axes of the files are kept unless --up is given.""",
    {
        "info": Verb("markers.info.Info", "Describe a file of markers"),
        "fit": Verb("markers.fit.Fit", "Calibrate a subject from its takes"),
        "label": Verb("markers.label.Label", "Label unlabelled markers by a calibrated subject"),
        "solve": Verb("markers.solve.Solve", "Solve for the motion of a subject in trials"),
    },
)

LIMITS = VerbGroup(
    "Joint limits: learn, check and enforce them",
    """Joint limits: learn them from motions, find violations in a motion, project a motion onto them.

Angles are in degrees.""",
    {
        "learn": Verb("limits.learn.Learn", "Learn joint limits from motions"),
        "check": Verb("limits.check.Check", "Report the joints of a motion that violate limits"),
        "project": Verb("limits.project.Project", "Project a motion onto joint limits"),
        "compare": Verb("limits.compare.Compare", "Compare the joint rotations of two subjects"),
    },
)

PRIOR = VerbGroup(
    "Pose priors: learn and inspect them",
    """Pose priors: learn from motions how probable the rotations of joints are, for each joint with its parent.

Angles are in degrees.""",
    {
        "learn": Verb("prior.learn.Learn", "Learn a pose prior from motions"),
        "info": Verb("prior.info.Info", "Describe the contents of a prior"),
    },
)

EDIT = VerbGroup(
    "Edit motions: retarget, cut, join, loop, mirror and more",
    """Edit motions: retarget, cut, join, loop, resample or mirror them, change the gaze, or reduce them to keys.
A raw scan can also be animated, with the body that is fitted to it.

Lengths are in metres, and in centimetres in BVH files.""",
    {
        "retarget": Verb("edit.retarget.Retarget", "Transfer a motion to another body or skeleton"),
        "gaze": Verb("edit.gaze.Gaze", "Make a person look at a point or in a direction"),
        "glue": Verb("edit.glue.Glue", "Animate a raw scan with the body that is fitted to the scan"),
        "cut": Verb("edit.cut.Cut", "Extract a range of frames of a motion"),
        "join": Verb("edit.join.Join", "Append one motion to another, with a blend"),
        "loop": Verb("edit.loop.Loop", "Make a seamless loop"),
        "resample": Verb("edit.resample.Resample", "Resample a motion to another rate"),
        "mirror": Verb("edit.mirror.Mirror", "Mirror a motion: exchange left and right"),
        "keys": Verb("edit.keys.Keys", "Reduce a motion to few keys within a tolerance"),
    },
)

JAXCAP = VerbGroup(
    "Fit articulated bodies to captures",
    """Fit articulated bodies to point clouds, depth images, meshes and markers.

Results are in metres and have y up. Exceptions: BVH files are in centimetres, TRC and C3D files in millimetres, and
AMASS files have z up. The first run of a verb compiles its functions, and caches them in a folder of
the user for later runs. The environment variable JAXCAP_CACHE names another folder; --no-cache disables the cache.""",
    {
        "demo": Verb("demo.Demo", "Pose, scan and track the embedded human, as a first test"),
        "rig": Verb("rig.Rig", "Place a skeleton in a mesh and bind the mesh to the bones"),
        "learn": Verb("learn.learn.Learn", "Learn an animatable body from registered meshes of one actor"),
        "fit": Verb("fit.Fit", "Fit the poses of a body to registered meshes"),
        "adapt": Verb("adapt.adapt.Adapt", "Adapt a template body to the actor in a sequence of scans"),
        "register": Verb("register.register.Register", "Register scans of a person to one topology"),
        "track": Verb("track.track.Track", "Fit a body to a sequence of point clouds"),
        "live": Verb("live.live.Live", "Fit a body to depth images or clouds as they arrive"),
        "evaluate": Verb("evaluate.Evaluate", "Measure distances from scans to a body, and joint errors"),
        "scan": Verb("scan.scan.Scan", "Scan a moving body with virtual depth cameras"),
        "markers": MARKERS,
        "limits": LIMITS,
        "prior": PRIOR,
        "edit": EDIT,
        "batch": Verb("batch.batch.Batch", "Run a verb over many inputs, on all cores or on a cluster"),
        "view": Verb("view.View", "Show files in the browser"),
        "ik": Verb("ik.Ik", "Pose a body by dragging its points, in the browser"),
        "info": Verb("info.Info", "Describe a file and suggest the next command"),
        "convert": Verb("convert.convert.Convert", "Convert a file to another format"),
    },
)
