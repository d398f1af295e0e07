"""Windows in a browser: what the library reads and writes, looked at (`app`), posed by hand (`ik`), and from
notebooks (`show`)."""

from .notebook import Player as Player
from .notebook import show as show
