"""Read and write files."""

from .archives.limits import load_limits as load_limits
from .archives.limits import read_limits as read_limits
from .archives.limits import save_limits as save_limits
from .archives.prior import Priors as Priors
from .archives.prior import load_prior as load_prior
from .archives.prior import load_priors as load_priors
from .archives.prior import save_prior as save_prior
from .cameras import read_cameras as read_cameras
from .cameras import write_cameras as write_cameras
from .constraints import read_constraints as read_constraints
from .constraints import write_constraints as write_constraints
from .gltf.gltf_reader import read_gltf as read_gltf
from .markers.subject import load_subject as load_subject
from .markers.subject import save_subject as save_subject
from .meshes.clouds import save_clouds as save_clouds
from .meshes.meshes import save_meshes as save_meshes
from .registry import read_motion as read_motion
from .registry import read_skeleton as read_skeleton
from .registry import read_skinned as read_skinned
from .registry import write_motion as write_motion
from .skeletons.amass import read_amass as read_amass
from .skeletons.amass import write_amass as write_amass
from .skeletons.amc import read_amc as read_amc
from .skeletons.asf import read_asf as read_asf
from .usd.usd import write_usd as write_usd
