"""`jaxcap demo`: perform, scan, track, and show the errors."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import equinox as eqx
import numpy as np

from ..body.body import pose_body
from ..body.kinematics import forward_kinematics, joint_positions
from ..body.people.human import human
from ..body.people.walk_and_wave import walk_and_wave
from ..body.pose import Motion
from ..errors import InputError
from ..geometry.camera import ring_of_cameras
from ..io.meshes.clouds import save_clouds
from ..io.system.atomic import atomic_path, write_text
from ..io.system.run_lock import run_lock
from ..metrics import distance_summary, joint_errors, scan_to_surface
from ..observe.clouds import make_cloud
from ..report.distance_pictures import FrameView, draw_views
from ..scanner.scan import scan_frame
from ..scanner.settings import Scanner
from ..tracking.track import track_frames, verdict_sentences
from ..tracking.track_frame import make_tracker
from .console.console import print_table, progress, say, warn
from .console.options import Flag, OptionalCount, arg
from .console.timed import timed
from .track.frame_records import pack, row_template, unpack_results
from .track.results import FILES, check_folder, make_writable, write_results

PICTURE = "demo.png"
CLOUDS = "clouds.npz"
#: the virtual cameras on a ring around the body, and the size of their images, pixels
CAMERAS, RESOLUTION = 6, (320, 240)
#: share of outliers among the points
OUTLIERS = 0.03
#: number of points in a picture's cloud
SHOWN = 5000


@dataclass
class Demo:
    """Pose the embedded human, scan it with noisy virtual cameras, and track the scans.

    The results are the scans (clouds.npz), motion.bvh, motion.npz, statistics.csv, statistics.json and a picture,
    demo.png."""

    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")] = Path("jaxcap-demo")
    """Output folder. A new folder gets a file .gitignore, so that git ignores the folder."""
    seconds: float = 2.0
    """Length of the performance, seconds."""
    points: int = 5000
    """Number of points per cloud."""
    noise: float = 0.004
    """Standard deviation of the error of the points, metres."""
    vertices: OptionalCount = None
    """Number of vertices of the fitted body. Default: 5,000."""
    overwrite: Flag = False
    """Replace the results of an earlier demo."""

    def run(self) -> None:
        if self.seconds < 0.1 or self.points < 200 or not self.noise >= 0:
            raise InputError("A demo needs at least 0.1 seconds, 200 points, and noise that is not negative.")
        self.make_folder()
        with run_lock(self.out):
            self.perform()

    def perform(self) -> None:
        """Generate, scan and track the performance, while the lock excludes other runs in the folder."""
        self.check_folder()
        true_body = human()
        body = human(resolution=self.vertices or "medium")
        truth = walk_and_wave(true_body.skeleton, self.seconds)
        scanner = Scanner(noise=self.noise, flying=0.05, points=self.points, outliers=OUTLIERS)
        cameras = ring_of_cameras(CAMERAS, 360, 2.5, 0.5, [0.0, 0.1, 0.0], RESOLUTION)
        scans, joints = [], []
        say(
            f"scanning {truth.num_frames} frames with {CAMERAS} virtual cameras, "
            f"{1000 * self.noise:g} mm noise, {100 * scanner.outliers:g} % outliers"
        )
        for frame in range(truth.num_frames):
            posed = pose_body(true_body, truth[frame])
            vertices, faces = np.asarray(posed.vertices, float), np.asarray(true_body.faces)
            scans.append(scan_frame(scanner, cameras, vertices, faces, frame=frame))
            joints.append(np.asarray(posed.joints))
        say(
            f"tracking {self.points} points per frame with {len(body.vertices)} vertices; the first frame compiles"
        )
        clouds = [make_cloud(scan.points, scan.normals, name=f"frame {k}") for k, scan in enumerate(scans)]
        save_clouds(self.out / CLOUDS, clouds)
        tracker = make_tracker(body)
        steps = progress(timed(track_frames(tracker, clouds)), len(clouds))
        results = unpack_results(
            row_template(tracker), np.stack([pack(frame, took) for frame, took in steps])
        )
        names, seconds = [f"scan {number}" for number in range(len(clouds))], results.seconds
        write_results(self.out, body.skeleton, results, truth.rate, names)
        motion = Motion(results.poses, truth.rate)
        places = np.array([np.asarray(_joints(body.skeleton, motion[frame])) for frame in range(len(motion))])
        errors = joint_errors(places, np.array(joints))
        self.picture(body, motion, clouds, errors)
        summary = distance_summary(errors.reshape(-1))
        print_table(
            ["joint centres, mm", "mean", "median", "99 %", "worst"],
            [
                [
                    "error",
                    *(
                        f"{1000 * v:.1f}"
                        for v in (summary.mean, summary.median, np.quantile(errors, 0.99), errors.max())
                    ),
                ]
            ],
        )
        steady = seconds[len(seconds) // 2 :]
        say(
            f"{len(motion)} frames: {seconds[0]:.1f} s for the first, then {1 / np.median(steady):.0f} frames per second"
        )
        for sentence in verdict_sentences(results.verdicts):
            warn(sentence)
        say(f"{CLOUDS}, {', '.join(FILES)} and {PICTURE} are in {self.out}")

    def make_folder(self) -> None:
        """Make the folder; a new one gets a `.gitignore` file. Raises `InputError`."""
        new = not self.out.exists()
        make_writable(self.out)
        if new:
            write_text(self.out / ".gitignore", "# made by jaxcap demo\n*\n")

    def check_folder(self) -> None:
        """Check that the folder has no results, or that they may be replaced. Raises `InputError`."""
        if not self.overwrite and any((self.out / name).exists() for name in (*FILES, CLOUDS, PICTURE)):
            raise InputError(
                f"{self.out}: this folder contains the results of a run; give --overwrite to replace them, or choose "
                "another folder with -o."
            )
        check_folder(self.out, "journal", False, self.overwrite)

    def picture(self, body, motion, clouds, errors) -> None:
        views = []
        for number in np.linspace(0.25, 0.95, 3) * (len(motion) - 1):
            number = round(number)
            points = np.asarray(clouds[number].points)[np.asarray(clouds[number].weights) > 0][:SHOWN]
            vertices = np.asarray(pose_body(body, motion[number]).vertices)
            views.append(
                FrameView(
                    f"frame {number}: mean joint error {1000 * errors[number].mean():.1f} mm",
                    vertices,
                    points,
                    scan_to_surface(points, vertices, np.asarray(body.faces)),
                )
            )
        with atomic_path(self.out / PICTURE) as temporary:
            title = f"jaxcap: {self.points:,} noisy points per frame, mean joint error {1000 * errors.mean():.1f} mm"
            draw_views(temporary, views, np.asarray(body.faces), title)


@eqx.filter_jit
def _joints(skeleton, pose):
    return joint_positions(skeleton, forward_kinematics(skeleton, pose))
