"""The places where verbs take files, for `test_cli_matrix`."""

from file_kinds import ANIMATED, BODIES, FILE, MARKERS, MESHES, MOTIONS, Place

#: that are a mesh as well
SKINNED = ("skinned.glb", "animated.glb", "skinned.gltf", "doll.obj")
CLOUDS = (*MESHES, *SKINNED, "meshes.npz", "clouds.npz", "folder of clouds", "folder of meshes", "scans")
SURFACES = (*SKINNED, "meshes.npz", "folder of meshes", "ball.obj", "ball.off", "ball.ply", "ball.glb")
#: bodies by themselves, and with motions
ALL_BODIES = (*BODIES, *ANIMATED)
SKELETONS = (
    *ALL_BODIES,
    "motion.npz",
    "amass.npz",
    "walk.bvh",
    "02_01.amc",
    "02.asf",
    "bones.skl",
    "subject.npz",
)
LIMITS = ("limits.npz", "limits.cst", "02.asf")
#: a file that is not there: it is named only where all before it were right
GONE, BODY, OUT = "gone.npz", "body.npz", "out.npz"
PLACES = [
    Place("rig.Rig", {"mesh": FILE, "out": OUT}, (*MESHES, *SKINNED)),
    Place("learn.learn.Learn", {"meshes": (FILE,), "out": OUT, "hold_out": 9}, SURFACES),
    Place("learn.learn.Learn", {"meshes": ("small",), "skeleton": FILE, "out": "kept.npz"}, SKELETONS),
    Place("fit.Fit", {"body": FILE, "meshes": (GONE,), "out": OUT}, ALL_BODIES),
    Place("fit.Fit", {"body": "giant.npz", "meshes": (FILE,), "out": OUT}, SURFACES),
    Place("adapt.adapt.Adapt", {"body": FILE, "clouds": (GONE,), "out": OUT}, ALL_BODIES),
    Place("adapt.adapt.Adapt", {"body": BODY, "clouds": (FILE,), "out": OUT}, CLOUDS),
    Place("register.register.Register", {"body": FILE, "clouds": (GONE,), "out": OUT}, ALL_BODIES),
    Place("register.register.Register", {"body": BODY, "clouds": (FILE,), "out": OUT}, CLOUDS),
    Place("track.track.Track", {"body": FILE, "clouds": (GONE,), "out": "new"}, ALL_BODIES),
    Place("track.track.Track", {"body": "giant.npz", "clouds": (FILE,), "out": "new"}, CLOUDS),
    Place("track.track.Track", {"body": BODY, "clouds": (GONE,), "out": "new", "limits": FILE}, LIMITS),
    Place(
        "track.track.Track",
        {"body": "small.obj", "clouds": (GONE,), "out": "new", "skl": FILE, "vj": "small.vj"},
        SKELETONS,
    ),
    Place(
        "track.track.Track",
        {"body": "small.obj", "clouds": (GONE,), "out": "new", "skl": "bones.skl", "vj": FILE},
        ("parts.vj",),
    ),
    Place("live.live.Live", {"body": FILE, "watch": (GONE,), "out": "new"}, ALL_BODIES),
    Place("evaluate.Evaluate", {"body": FILE, "motion": GONE, "clouds": (GONE,)}, ALL_BODIES),
    Place("evaluate.Evaluate", {"body": BODY, "motion": FILE, "clouds": ("clouds.npz",)}, MOTIONS),
    # clouds are read when their frame comes, after the number of frames is checked
    Place(
        "evaluate.Evaluate",
        {"body": BODY, "motion": "two.npz", "clouds": (FILE,)},
        (*CLOUDS, "empty.obj", "empty.glb"),
    ),
    Place(
        "evaluate.Evaluate",
        {"body": BODY, "motion": "two.npz", "clouds": ("clouds.npz",), "truth": FILE},
        (*MOTIONS, "joints.npz"),
    ),
    Place("scan.scan.Scan", {"body": FILE, "motion": GONE, "out": "new"}, ALL_BODIES),
    Place("scan.scan.Scan", {"body": BODY, "motion": FILE, "out": "new", "rate": 1e6}, MOTIONS),
    Place("markers.info.Info", {"file": FILE}, MARKERS),
    Place("markers.fit.Fit", {"files": (FILE,), "out": OUT}, MARKERS),
    Place(
        "markers.solve.Solve", {"subject_file": FILE, "trials": (GONE,), "out": "out.bvh"}, ("subject.npz",)
    ),
    Place(
        "markers.solve.Solve", {"subject_file": "subject.npz", "trials": (FILE,), "out": "out.bvh"}, MARKERS
    ),
    Place("limits.learn.Learn", {"motions": (FILE,), "joints": "nobody", "out": OUT}, (*MOTIONS, *MARKERS)),
    Place("limits.check.Check", {"motion": FILE, "limits": "limits.npz"}, MOTIONS),
    Place("limits.check.Check", {"motion": "strange motion.npz", "limits": FILE}, LIMITS),
    Place("limits.check.Check", {"motion": GONE, "limits": "limits.npz", "body": FILE}, ALL_BODIES),
    Place("limits.project.Project", {"motion": FILE, "limits": "limits.npz", "out": OUT}, MOTIONS),
    Place("limits.compare.Compare", {"reference": FILE, "other": GONE, "joints": "root"}, MOTIONS),
    Place("prior.learn.Learn", {"motions": (FILE,), "out": OUT, "body": "strange.npz"}, MOTIONS),
    Place("prior.learn.Learn", {"motions": (GONE,), "out": OUT, "body": FILE}, ALL_BODIES),
    Place("prior.info.Info", {"file": FILE}),
    Place("edit.cut.Cut", {"motion": FILE, "out": OUT, "frames": (90, 99)}, MOTIONS),
    Place("edit.mirror.Mirror", {"motion": FILE, "out": OUT}, MOTIONS),
    Place("edit.resample.Resample", {"motion": FILE, "out": OUT, "rate": 1e12}, MOTIONS),
    Place("edit.loop.Loop", {"motion": FILE, "out": OUT, "frames": (90, 99)}, MOTIONS),
    Place(
        "edit.gaze.Gaze", {"motion": FILE, "out": OUT, "target": (0.0, 1.0, 2.0), "joints": "nobody"}, MOTIONS
    ),
    Place(
        "edit.gaze.Gaze", {"motion": GONE, "out": OUT, "target": (0.0, 1.0, 2.0), "body": FILE}, ALL_BODIES
    ),
    Place("edit.join.Join", {"first": FILE, "second": GONE, "out": OUT}, MOTIONS),
    Place("edit.join.Join", {"first": "strange motion.npz", "second": FILE, "out": OUT}, MOTIONS),
    Place("edit.retarget.Retarget", {"motion": FILE, "target": "strange.npz", "out": OUT}, MOTIONS),
    Place("edit.retarget.Retarget", {"motion": GONE, "target": FILE, "out": OUT}, SKELETONS),
    Place("edit.retarget.Retarget", {"motion": GONE, "target": BODY, "source": FILE, "out": OUT}, ALL_BODIES),
    Place("edit.glue.Glue", {"scan": FILE, "body": BODY, "motion": GONE, "out": "new"}, (*MESHES, *SKINNED)),
    Place("edit.glue.Glue", {"scan": "ball.obj", "body": FILE, "motion": GONE, "out": "new"}, ALL_BODIES),
    Place(
        "edit.glue.Glue",
        {"scan": "ball.obj", "body": BODY, "motion": FILE, "out": "new", "frame": 99},
        MOTIONS,
    ),
    Place("ik.Ik", {"body": FILE, "limits": GONE}, ALL_BODIES),
    Place("ik.Ik", {"body": BODY, "limits": FILE, "pose": GONE}, LIMITS),
    Place("ik.Ik", {"body": BODY, "prior": FILE}),
    Place("ik.Ik", {"body": BODY, "pose": FILE, "frame": 99}, MOTIONS),
    Place("convert.convert.Convert", {"source": FILE, "target": "out.bvh", "overwrite": True}, MOTIONS),
    Place(
        "convert.convert.Convert",
        {"source": FILE, "target": "out.trc", "overwrite": True},
        (*MOTIONS, *MARKERS),
    ),
    Place(
        "convert.convert.Convert",
        {"source": FILE, "target": "out.csv", "as_": "angles", "overwrite": True},
        MOTIONS,
    ),
    Place("convert.convert.Convert", {"source": FILE, "target": "out.skl", "overwrite": True}, SKELETONS),
    # one at a time
    Place(
        "convert.convert.Convert",
        {"source": FILE, "target": "out.ply", "overwrite": True},
        tuple(dict.fromkeys((*(name for name in CLOUDS if "." in name), *ALL_BODIES))),
    ),
    Place(
        "convert.convert.Convert",
        {"source": FILE, "target": "out.npz", "as_": "body", "overwrite": True},
        ALL_BODIES,
    ),
    Place(
        "convert.convert.Convert",
        {"source": BODY, "target": "out.glb", "motion": FILE, "overwrite": True},
        MOTIONS,
    ),
    Place(
        "convert.convert.Convert",
        {"source": "motion.npz", "target": "out.bvh", "body": FILE, "overwrite": True},
        ALL_BODIES,
    ),
    # by joints, as the motion has no surface
    Place(
        "convert.convert.Convert",
        {"source": "motion.npz", "target": "out.bvh", "to": FILE, "overwrite": True},
        ALL_BODIES,
    ),
]
