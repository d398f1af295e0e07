"""Many independent jobs on the workers of a Dask cluster: of this computer, or of others."""

from .cluster import open_cluster as open_cluster
from .mapping import JobResult as JobResult
from .mapping import map_jobs as map_jobs
