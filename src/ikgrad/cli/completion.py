"""``ikgrad completion``: a script that lets a shell complete commands, options, built-in names and files.

`shtab` makes the script from the parser; here is only said which values are files, folders and built-in names. It takes
no time to speak of, because a shell may ask for it whenever it starts.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from ikgrad.cli.parsing import Commands, example

SHELLS = ("bash", "zsh", "fish")
FILES = {"FILE", "POSES", "JOINTS"}  # metavars of files

DESCRIPTION = """\
print a script that completes commands, options, built-in names and files after the Tab key. Where it belongs:

bash  eval "$(ikgrad completion bash)" in ~/.bashrc
zsh   a file _ikgrad in a folder of $fpath
fish  ~/.config/fish/completions/ikgrad.fish"""


def add(commands: Commands) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "completion",
        help="print a script for the Tab key of bash, zsh or fish",
        description=DESCRIPTION,
        epilog=example("ikgrad completion bash\nikgrad completion fish"),
    )
    parser.add_argument("shell", metavar="SHELL", choices=SHELLS, help="bash, zsh or fish")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from ikgrad.cli.main import build_parser

    print(script(build_parser(), args.shell))
    return 0


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script for a shell.

    Args:
        parser: the parser of all commands; its actions are marked with what their values are.
        shell: one of ``SHELLS``.
    """
    import shtab

    from ikgrad.resources import builtin_names, data_folder

    robots = names_or_files("robot", builtin_names("urdf"), ".urdf")
    configs = names_or_files("config", builtin_names("configs"), ".yaml")
    runs = names_or_files("run", sorted(path.name for path in data_folder("inverters").iterdir()), None)
    kinds = {
        "ROBOT": robots,
        "RUN": runs,
        "DIR": shtab.DIRECTORY,
        "FOLDER": shtab.DIRECTORY,
        **dict.fromkeys(FILES, shtab.FILE),
    }
    for action in actions(parser):
        kind = configs if "--config" in action.option_strings else kinds.get(str(action.metavar))
        if kind is not None:
            action.complete = kind  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell=shell))


def actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Options and arguments of a parser and of all commands below it."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from actions(command)


def names_or_files(kind: str, names: list[str], suffix: str | None) -> dict[str, Any]:
    """A completion of built-in names, files and folders, as `shtab` takes it: a function in each shell's own words.

    Args:
        kind: becomes part of the function's name.
        names: letters, digits and underscores only.
        suffix: of the files; None: folders alone.
    """
    function, words = f"_ikgrad_{kind}", " ".join(names)
    bash = [f"compgen -W '{words}' -- \"$1\"", 'compgen -d -- "$1"']
    zsh = [f"compadd -- {words}", "_files -/"]
    fish = [f"printf '%s\\n' {words}", "__fish_complete_directories"]
    if suffix is not None:
        bash.insert(1, f"compgen -f -X '!*{suffix}' -- \"$1\"")
        zsh[1] = f"_files -g '*{suffix}'"  # folders, too
        fish[1] = f"__fish_complete_suffix {suffix}"
    preamble = {
        "bash": "\n".join([f"{function}() {{", *bash, "}"]),
        "zsh": "\n".join([f"{function}() {{", *zsh, "}"]),
        "fish": "\n".join([f"function {function}", *fish, "end"]),
    }
    return {"bash": function, "zsh": function, "fish": f"({function})", "preamble": preamble}
