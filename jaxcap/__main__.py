"""`python -m jaxcap`: the program `jaxcap`, where the folder of installed programs is not on the path."""

from .cli import main

main()
