"""One of several verbs from the command line's words."""

from collections.abc import Mapping, Sequence


def run_verb(verbs: Mapping[str, type], prog: str, description: str, arguments: Sequence[str]) -> None:
    """Make the verb that the arguments name of the rest of them, and run it."""
    import tyro

    command = tyro.extras.subcommand_cli_from_dict(
        dict(verbs),
        prog=prog,
        description=description,
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    command.run()
