"""Depth cameras that people use: image sizes, fields of view, and errors as published."""

from typing import NamedTuple

from .settings import Scanner


class Sensor(NamedTuple):
    """A depth camera: its images and their errors."""

    #: width and height of images, pixels
    resolution: tuple[int, int]
    #: horizontal, degrees
    field_of_view: float
    errors: Scanner


#: Kinect v1: structured light. Noise by distance and angle: Nguyen, Izadi and Lovell, "Modeling Kinect Sensor Noise for
#: Improved 3D Reconstruction and Tracking", 2012. Quantisation: Khoshelham and Elberink, "Accuracy and Resolution of
#: Kinect Depth Data", 2012.
#: Azure Kinect, narrow field of view with 2 x 2 binning: time of flight. Noise and range: Tölgyessy et al., "Evaluation of
#: the Azure Kinect and Its Comparison to Kinect V1 and Kinect V2", 2021.
#: RealSense D435: stereo, with a subpixel error of 0.08 pixels and a baseline of 50 mm (Intel's white paper on tuning
#: depth cameras).
SENSORS = {
    "kinect-v1": Sensor(
        (640, 480),
        57.0,
        Scanner(
            min_range=0.5, max_range=4.0, max_grazing_angle=80.0, baseline=0.075, edge_loss=0.3, holes=0.005, flying=0.05,
            noise=0.0012, noise_growth=0.0019, noise_from=0.4, noise_angle=0.0001, depth_step=0.00285,
        ),
    ),
    "azure-kinect": Sensor(
        (320, 288),
        75.0,
        Scanner(
            min_range=0.5, max_range=5.46, max_grazing_angle=83.0, edge_loss=0.5, holes=0.002, flying=0.2,
            flying_reach=0.5, noise=0.001, noise_growth=0.0002, noise_angle=0.0001, depth_unit=0.001,
        ),
    ),
    "realsense-d435": Sensor(
        (848, 480),
        87.0,
        Scanner(
            min_range=0.3, max_range=8.0, max_grazing_angle=75.0, baseline=0.05, edge_loss=0.3, holes=0.02, hole_size=8.0,
            flying=0.2, flying_reach=0.1, noise=0.0005, noise_growth=0.0036, noise_angle=0.0001, depth_unit=0.001,
        ),
    ),
}  # fmt: skip
