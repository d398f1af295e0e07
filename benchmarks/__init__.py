"""Measurements on real input; each is run as `python -m benchmarks.NAME`, without the name of its folder."""

from pathlib import Path

# programs are found in every folder by topic
__path__ += sorted(str(folder) for folder in Path(__file__).parent.iterdir() if folder.is_dir())
