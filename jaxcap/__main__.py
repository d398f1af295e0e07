"""The program `jaxcap` as `python -m jaxcap`, where its installation folder is not on the path."""

from .cli import main

main()
