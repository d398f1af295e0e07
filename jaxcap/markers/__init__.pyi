"""From raw optical markers to a skeleton and its motion."""

from .body_shape.vertex_markers import vertex_frames as vertex_frames
from .calibration.calibrate import Calibration as Calibration
from .calibration.calibrate import calibrate as calibrate
from .calibration.calibration_parameters import TemplatePrior as TemplatePrior
from .calibration.problem import CalibrationEstimate as CalibrationEstimate
from .calibration.problem import CalibrationProblem as CalibrationProblem
from .calibration.problem import make_calibration_problem as make_calibration_problem
from .calibration.solve_calibration import CalibrationSolution as CalibrationSolution
from .calibration.solve_calibration import solve_calibration as solve_calibration
from .local import LocalFit as LocalFit
from .local import fit_local as fit_local
from .motion.gap_filling import fill_gaps as fill_gaps
from .motion.gap_filling import joint_frames as joint_frames
from .motion.inverse_kinematics import MarkerSolution as MarkerSolution
from .motion.inverse_kinematics import solve_markers as solve_markers
from .motion.stream import make_streamer as make_streamer
from .motion.stream import stream_frame as stream_frame
from .segments.gaps import join_pieces as join_pieces
from .segments.merge_takes import merge_takes as merge_takes
from .segments.partition import find_partition as find_partition
from .segments.segment import Segments as Segments
from .segments.segment import make_segments as make_segments
from .subject import Subject as Subject
from .subject import make_subject as make_subject
from .subject import marker_body as marker_body
from .subject import marker_positions as marker_positions
