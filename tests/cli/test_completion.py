"""``ikgrad completion``: scripts that shells accept, and that complete what the parser knows."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ikgrad.cli.completion import SHELLS, actions
from ikgrad.cli.main import COMMANDS, build_parser, main
from ikgrad.resources import builtin_names

needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The script for bash."""
    path = tmp_path_factory.mktemp("completion") / "ikgrad.bash"
    command = [sys.executable, "-m", "ikgrad", "completion", "bash"]
    path.write_text(subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout)
    return path


@pytest.fixture
def printed(request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["completion", request.param]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return out


def complete(script: Path, folder: Path, *words: str) -> list[str]:
    """What the Tab key offers in bash after some words; the last may be begun or empty."""
    quoted = " ".join(f"'{word}'" for word in words)
    code = f"""
source '{script}'
COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}
$(complete -p ikgrad | sed 's/.*-F \\([^ ]*\\) .*/\\1/') ikgrad "${{COMP_WORDS[COMP_CWORD]}}"
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, cwd=folder, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


def leaves(parser: argparse.ArgumentParser, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], list[str]]]:
    """Every command, its sub-commands included, with its options."""
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    yield path, list(parser._option_string_actions)
    for group in groups:
        for name, child in group.choices.items():
            yield from leaves(child, (*path, name))


@needs_bash
def test_bash_accepts_its_script(script: Path):
    subprocess.run(["bash", "-n", str(script)], check=True, timeout=60)


@pytest.mark.parametrize("shell", [name for name in ("zsh", "fish") if shutil.which(name)])
def test_other_shells_accept_theirs(shell: str, tmp_path: Path, capsys):
    assert main(["completion", shell]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    subprocess.run([shell, "-n", str(tmp_path / "script")], check=True, timeout=60)


@needs_bash
@pytest.mark.parametrize(("command", "options"), list(leaves(build_parser())), ids=lambda x: " ".join(x)[:30])
def test_every_command_completes_all_of_its_options(script: Path, tmp_path: Path, command, options):
    long = {option for option in options if option.startswith("--")}
    assert set(complete(script, tmp_path, "ikgrad", *command, "--")) == long


@pytest.mark.parametrize("printed", SHELLS, indirect=True)
def test_every_shell_knows_all_commands_options_and_robots(printed: str):
    words = {module.__name__.rsplit(".", 1)[1] for module in COMMANDS} | set(builtin_names("urdf"))
    long = {name[2:] for action in actions(build_parser()) for name in action.option_strings if name[:2] == "--"}
    assert len(long) > 60
    assert [word for word in words | long if word not in printed] == []


@needs_bash
def test_names_and_files_are_offered(script: Path, tmp_path: Path):
    for name in ("palm.urdf", "palm.txt", "denser.yaml"):
        (tmp_path / name).touch()
    (tmp_path / "parts").mkdir()
    assert set(complete(script, tmp_path, "ikgrad", "fk", "--robot", "pa")) == {"panda", "palm.urdf", "parts"}
    assert set(complete(script, tmp_path, "ikgrad", "evaluate", "pa")) == {"panda", "parts"}
    assert "palm.txt" in complete(script, tmp_path, "ikgrad", "solve", "--robot", "panda", "pal")
    assert {"denso_feedback", "denser.yaml"} <= set(complete(script, tmp_path, "ikgrad", "train", "--config", "den"))
    assert complete(script, tmp_path, "ikgrad", "solve", "--solver", "") == ["lm", "apps", "newton", "puma560"]
    assert complete(script, tmp_path, "ikgrad", "reproduce", "a") == ["apps"]
    assert complete(script, tmp_path, "ikgrad", "completion", "z") == ["zsh"]


def test_an_unknown_shell_is_one_line(capsys):
    assert main(["completion", "tcsh"]) == 2
    assert "unknown 'tcsh' (known: bash, zsh, fish)" in " ".join(capsys.readouterr().err.split())


def test_completion_imports_nothing_heavy():
    code = "import sys, ikgrad.cli.main as cli; cli.main(['completion', 'zsh']); print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert not {"torch", "numpy", "numba"} & {name.split(".")[0] for name in done.stderr.split()}
