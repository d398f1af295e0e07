"""Browser windows: view the library's files (`app`), pose a body by hand (`ik`), and view from notebooks
(`show`)."""

from .notebook import Player as Player
