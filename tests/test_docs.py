"""The documentation is true: its code runs, its commands are real, its links, paths and names lead somewhere."""

from __future__ import annotations

import argparse
import importlib
import json
import re
import shlex
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
import yaml
from job_folders import run_here

import ikgrad as ik
from ikgrad.cli import train
from ikgrad.cli.main import build_parser, main
from ikgrad.collision import link_segments
from ikgrad.export.files import SUFFIXES
from ikgrad.resources import find_config

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)

# What takes minutes where a reader has them: the page's text, and what the test runs in its place.
SHORTER = {"minutes=15": "steps=5"}
SHORTER_COMMANDS = {"--count 10000000": "--count 40 --partition-rows 20"}

# Commands of the default tests that are run, not only parsed.
QUICK = re.compile(
    r"(robots|sample|fk|solve|merge|plot|doctor|completion|map --robot arm4)\b|train --config \S+ --hidden"
)
# Run by -m slow, on a smaller question; see `shorter`.
SHORT = re.compile(r"train|evaluate|export|view .*--export")
# The others, and what runs them instead.
ELSEWHERE = {
    r"ikgrad reproduce": "minutes, with small settings in tests/papers",
    r"ikgrad map": "a minute, with larger cells in tests/cli/test_map.py",
    r"ikgrad bench": "minutes, with small settings in tests/test_bench.py",
    r"ikgrad view": "serves until Ctrl-C: tests/view/test_page.py",
    r"torchrun": "two processes, tests/training/test_processes.py",
    r"python scripts/": "minutes, the shorter ones in tests/test_scripts.py; options are compared with the source",
    r"python -m pytest": "this",
    r"pip install": "changes the environment; extras are compared with pyproject.toml",
    r"bash scripts/": "install, then the commands and tests that run here",
}
# What the blocks of each language are: all of them are named here.
LANGUAGES = {
    "python": "run, page by page",
    "bash": "commands, above",
    "console": "commands and what they print, above",
    "": "commands, or what a program prints",
    "text": "what lies in a folder; lines for several hosts",
    "xml": "written to the file that their first line names",
    "cpp": "tests/test_cpp.py",
    "cmake": "tests/test_cpp.py",
    "sh": "tests/test_cpp.py",
}
FOLDERS = r"(?<![\w./-])((?:scripts|tests|docs|notebooks|configs|urdf|src)/[\w./*-]*\w)"


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def prose(path: Path) -> str:
    """The Markdown of a page or of a notebook's cells."""
    if path.suffix == ".md":
        return path.read_text()
    cells = json.loads(path.read_text())["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


def blocks(path: Path, *kinds: str) -> list[str]:
    return [code for kind, code in FENCE.findall(path.read_text()) if kind in kinds]


def given_files(folder: Path, page: Path) -> None:
    """What the pages call a file of the reader's own, and what this one writes out in full."""
    for code in blocks(page, "xml"):
        name = re.match(r"<!-- (\S+) -->", code)
        assert name is not None, "the first line names the file"
        (folder / name[1]).write_text(code)
    (folder / "arm.urdf").write_text((ROOT / "urdf/ur5e.urdf").read_text())
    (folder / "configs").symlink_to(ROOT / "configs")
    (folder / "mine.yaml").write_text((ROOT / "configs/puma_qp.yaml").read_text())
    (folder / "runs/ur5e_loop").mkdir(parents=True)
    ik.Inverter(ik.load_robot("ur5e"), feedback=True, hidden=(8,)).save(folder / "runs/ur5e_loop/model")


def small_inverter() -> ik.Inverter:
    robot = ik.load_robot("panda")
    return ik.Inverter(robot, feedback=True, hidden=(8,), encoding="quaternion", dtype=torch.float32)


# ---------------------------------------------------------------- code


def trajectories(page: dict[str, Any]) -> None:
    assert page["hand"].flatten().tolist() == pytest.approx(
        [15.584, 2.748, 21.081, -0.866, -0.500, 21.428, 17.241, 9.954, 18.675], abs=6e-4
    )
    assert page["highest"].rad2deg().max().item() == pytest.approx(68, abs=0.5)
    assert page["slow"].duration.item() == pytest.approx(24.8, abs=0.05)
    assert page["slow"].peak().max().item() == pytest.approx(0.2, rel=1e-12)
    assert page["vias"].flatten().tolist() == pytest.approx([0.10, 0.50, 0.90], abs=0.006)
    assert page["residual"].item() < 1e-9


def planning(page: dict[str, Any]) -> None:
    found = page["found"]
    assert bool(found.success)
    assert float(found.clearance) == pytest.approx(0.0296, abs=2e-4)
    assert float(found.trajectory.duration) == pytest.approx(1.50, abs=0.01)
    line = ik.via_point_trajectory(torch.stack([page["start"], page["goal"]]), [0.0, 1.0], kind="quintic")
    links = link_segments(page["robot"], line.position(torch.linspace(0, 1, 1000).double()))
    assert float(page["balls"].distance(links, 0.06).min()) == pytest.approx(-0.17, abs=0.005)


def collision(page: dict[str, Any]) -> None:
    check = page["check"]
    assert bool(check.touches)
    assert float(check.time) == pytest.approx(0.56, abs=0.005)
    assert check.names[check.link] == ("panda_link4", "panda_link5")


def readme(page: dict[str, Any]) -> None:
    assert page["solution"].success.all()
    assert page["T"].grad.isfinite().all()
    assert page["T"].grad.abs().max() > 0


def solving(page: dict[str, Any]) -> None:
    assert page["solution"].success.all()
    assert page["several"].success.all()
    assert page["solution"].counts() == {"converged": 100}


def start(page: dict[str, Any]) -> None:
    assert page["solution"].success.all()
    found = ik.pose_error(ik.forward_kinematics(page["panda"], page["q"]), page["T"])
    assert found[:, :3].norm(dim=-1).median() < 1e-4


def gradients(page: dict[str, Any]) -> None:
    assert page["T"].grad.abs().max() > 0
    assert page["losses"][-1] < 0.9 * page["losses"][0]


def partial_poses(page: dict[str, Any]) -> None:
    for name in ("anywhere", "turning", "level", "reach", "whole"):
        assert page[name].success.all(), name


def paths(page: dict[str, Any]) -> None:
    straight = ik.pose_error(ik.forward_kinematics(page["robot"], page["way"]), page["line"])
    assert straight.abs().max() < 2e-6
    assert page["way"].diff(dim=0).abs().max() < 0.05  # no jump


def urdf(page: dict[str, Any]) -> None:
    assert page["robot"].joint_names == ("rise", "turn", "bend")
    assert page["seen_by_lamp"].joint_names == ("turn", "bend")
    with pytest.raises(ik.RobotError, match=r"choose one with tip=.*: hand, lamp"):
        ik.load_robot("lift.urdf")
    T = [ik.forward_kinematics(page[name], page["q"])[2, 3] for name in ("robot", "longer")]
    assert float(T[1] - T[0]) == pytest.approx(0.1)


def closed_form(page: dict[str, Any]) -> None:
    assert page["valid"].any(dim=-1).all()
    torch.testing.assert_close(page["nearest"].q, page["q0"], rtol=0, atol=1e-6)


def calibrate(page: dict[str, Any]) -> None:
    assert page["offset"].tolist() == pytest.approx([0.002, -0.001, 0.003], abs=1e-8)


def training(page: dict[str, Any]) -> None:
    assert page["result"].test_errors[0].joint_mse == pytest.approx(9.76e-13, rel=3)  # another machine rounds otherwise
    assert len(page["result"].curves[0].validation) == 68


# What a page says of the numbers that its code gives.
CLAIMS: dict[str, Callable[[dict[str, Any]], None]] = {
    "README.md": readme,
    "docs/collision.md": collision,
    "docs/levenberg-marquardt.md": lambda page: _below(page["loss"], 1e-4),  # 4.6e-6 where it was written
    "docs/howto/calibrate.md": calibrate,
    "docs/howto/gradients.md": gradients,
    "docs/howto/partial.md": partial_poses,
    "docs/howto/paths.md": paths,
    "docs/howto/urdf.md": urdf,
    "docs/index.md": start,
    "docs/papers/puma-closed-form.md": closed_form,
    "docs/planning.md": planning,
    "docs/solving.md": solving,
    "docs/training-rules.md": lambda page: _below(page["loss"], 0.03),  # the page says 0.012; others round otherwise
    "docs/training.md": training,
    "docs/trajectories.md": trajectories,
}


def _below(loss: torch.Tensor, limit: float) -> None:
    assert loss.item() < limit


def check_shapes(code: str, scope: dict[str, Any]) -> None:
    """``q = ...  # (1000, 7)`` is a claim, too."""
    for name, shape in re.findall(r"^([\w.]+)(?: = .*?)? +# \(((?:\d+, ?)+\d*)\)", code, re.MULTILINE):
        expected = tuple(int(size) for size in shape.split(",") if size.strip())
        assert tuple(eval(name, scope).shape) == expected, name


@pytest.mark.parametrize("path", [path for path in PAGES if blocks(path, "python")], ids=name_of)
def test_the_code_of_a_page_runs_and_gives_what_is_written(path: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    given_files(tmp_path, path)
    if path.name in ("export.md", "cpp.md"):
        ik.export_inverter(small_inverter(), "panda.onnx")  # the page's own takes a minute
    scope: dict[str, Any] = {}
    for code in blocks(path, "python"):
        for long, short in SHORTER.items():
            code = code.replace(long, short)
        exec(compile(code, name_of(path), "exec"), scope)
        check_shapes(code, scope)
    if (claim := CLAIMS.get(name_of(path))) is not None:
        claim(scope)


# ---------------------------------------------------------------- commands


def commands(path: Path) -> Iterator[str]:
    """Command lines of a page: in blocks for a shell, after ``$`` on screens, and indented by four spaces."""
    text = path.read_text()
    shell = [line for code in blocks(path, "bash", "") for line in code.replace("\\\n", " ").splitlines()]
    shell += [line[2:] for code in blocks(path, "console", "") for line in code.splitlines() if line.startswith("$ ")]
    rest = FENCE.sub("", text).replace("\\\n", " ")
    shell += re.findall(r"^    (\S.*)", rest, re.MULTILINE)
    for line in shell:
        if re.match(r"(ikgrad|torchrun|python|pip|bash) (?!\w+( \w+)?:)", line):
            for long, short in SHORTER_COMMANDS.items():
                line = line.replace(long, short)
            yield line.split("  #")[0].split(" #")[0].strip()


def ikgrad_arguments(path: Path) -> list[list[str]]:
    """Arguments of the page's ``ikgrad`` commands, started directly or as a module."""
    found = [re.split(r"^ikgrad | -m ikgrad ", line) for line in commands(path)]
    return [shlex.split(parts[1]) for parts in found if len(parts) == 2]


def sub_parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(actions[0].choices) if actions else {}


def unknown_options(words: list[str]) -> list[str]:
    """What a command that is named in a sentence, maybe without all that it needs, has wrong."""
    parser = build_parser()
    while words and words[0] in (choices := sub_parsers(parser)):
        parser, words = choices[words[0]], words[1:]
    if words and sub_parsers(parser) and not words[0].startswith("-"):
        return [words[0]]
    options = [word.split("=")[0] for word in words if re.match(r"--?[a-z]", word)]
    return [option for option in options if option not in parser._option_string_actions]


COMMANDS = [path for path in PAGES if ikgrad_arguments(path)]


@pytest.mark.parametrize("path", COMMANDS, ids=name_of)
def test_commands_are_accepted_and_the_quick_ones_run(path: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ikgrad.jobs.run_local", run_here)  # its processes take seconds to start
    given_files(tmp_path, path)
    for words in ikgrad_arguments(path):
        if words[-1] == "--help" or words[0] == "--version":
            assert main(words) == 0
            continue
        args = build_parser().parse_args(words)
        if args.command == "train":
            train._settings(args)  # the YAML inside
        given = getattr(args, "config", None) or []
        assert all(find_config(name).exists() for name in ([given] if isinstance(given, str) else given))
        if args.command == "export":
            assert Path(args.output).suffix in SUFFIXES
        if getattr(args, "report", None):
            assert Path(args.report).suffix in {".png", ".html"}
        if args.command == "solve" and not Path(args.poses).exists():
            assert main(["sample", "--robot", args.robot, "--count", "20", "-o", args.poses]) == 0
        if QUICK.match(" ".join(words)):
            assert main(words) == 0, words


def shorter(words: list[str]) -> list[str]:
    """The same command for a moment instead of minutes."""
    if words[0] == "evaluate":
        return [*words, "--count", "20"]
    if words[0] != "train":
        return words
    if "--config" in words or "classic" in words:
        return [*words, "--epochs", "2"]
    if "--minutes" in words:
        at = words.index("--minutes")
        words = words[:at] + words[at + 2 :]
    rounds = [] if "increment" in words else ["--rounds", "1"]
    return [*words, *rounds, "--steps", "3", "--checks", "1", "--test-rows", "50", "--threads", "1"]


def given_run(words: list[str]) -> None:
    """The run that a command speaks of, where the page has not trained it before; small, also for ready-made names."""
    args = build_parser().parse_args(words)
    folder = Path(words[1])
    if not folder.exists():
        robot = ik.load_robot(args.robot, base=args.base, tip=args.tip) if args.robot else ik.load_robot("panda")
        ik.UnrolledInverter(robot, rounds=1, width=8).save(folder)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", COMMANDS, ids=name_of)
def test_the_long_commands_run_on_a_smaller_question(path: Path, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    given_files(tmp_path, path)
    shutil.rmtree("runs/ur5e_loop")  # trained here
    if path.name == "view.md":
        assert main(["sample", "--robot", "panda", "--count", "20", "-o", "poses.csv"]) == 0
        assert main(["solve", "--robot", "panda", "poses.csv", "-o", "joints.csv"]) == 0
    for words in ikgrad_arguments(path):
        line = " ".join(words)
        if SHORT.match(line) and not QUICK.match(line) and "--help" not in words:
            if words[0] in ("evaluate", "export"):
                given_run(words)
            assert main(shorter(words)) == 0, words


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_what_is_not_run_here_is_run_elsewhere_or_named(path: Path):
    kinds = {kind for kind, _ in FENCE.findall(path.read_text())}
    assert kinds <= set(LANGUAGES), f"blocks that no test reads: {kinds - set(LANGUAGES)}"
    for line in commands(path):
        here = re.match(r"ikgrad (--version|\S+ --help)", line) or any(
            kind.match(line.removeprefix("ikgrad ")) for kind in (QUICK, SHORT)
        )
        assert here or any(re.match(start, line) for start in ELSEWHERE), f"nothing runs: {line}"


def test_the_tests_that_run_them_exist():
    for reason in [*ELSEWHERE.values(), *LANGUAGES.values()]:
        assert all((ROOT / name).exists() for name in re.findall(r"tests/[\w./]*\w", reason)), reason


@pytest.mark.parametrize("path", [*PAGES, *NOTEBOOKS], ids=name_of)
def test_commands_and_options_in_sentences_exist(path: Path):
    wrong = []
    for line in re.findall(r"`(ikgrad [^`]+)`", FENCE.sub("", prose(path))):
        wrong += [f"{option} in `{line}`" for option in unknown_options(shlex.split(line.replace("...", ""))[1:])]
    for line in re.findall(r"`((?:ik|fk|jacobian) --[^`]+)`", prose(path)):
        wrong += [f"{option} in `{line}`" for option in unknown_options(["bench", *shlex.split(line)])]
    assert not wrong


@pytest.mark.parametrize("path", [*PAGES, *NOTEBOOKS], ids=name_of)
def test_scripts_have_the_options_that_are_named(path: Path):
    lines = re.findall(r"`(python [^`]+)`", FENCE.sub("", prose(path)))
    lines += commands(path) if path.suffix == ".md" else []
    for script, rest in (
        match.groups() for line in lines if (match := re.match(r"python (scripts/\S+)(.*)", line, re.S))
    ):
        source = (ROOT / script).read_text()
        assert all(f'"{option}"' in source for option in re.findall(r"--[a-z-]+", rest)), f"{script} {rest}"


def test_extras_that_are_named_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    sources = [*PAGES, *(ROOT / "src").rglob("*.py")]
    named = {
        (name_of(path), extra)
        for path in sources
        for several in re.findall(r"ikgrad\[([\w,]+)\]", path.read_text())
        for extra in several.split(",")
    }
    assert {extra for _, extra in named} <= set(extras), named
    assert set(re.findall(r"`\[(\w+)\]`", (ROOT / "README.md").read_text())) <= set(extras)


# ---------------------------------------------------------------- links, paths, names


def anchors(path: Path) -> set[str]:
    """What a heading can be linked by: lower case, words joined by hyphens."""
    headings = re.findall(r"^#+ +(.*)", FENCE.sub("", prose(path)), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", [*PAGES, ROOT / "CHANGELOG.md", *NOTEBOOKS], ids=name_of)
def test_links_lead_to_files_and_headings(path: Path):
    text = FENCE.sub("", prose(path))
    targets = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r"(?:src|href)=\"([^\"]+)\"", text)
    for target in targets:
        if re.match(r"[a-z]+:", target) or not re.match(r"[\w.#/-]+$", target):
            continue  # the web, or a formula
        file, _, anchor = target.partition("#")
        goal = (path.parent / file).resolve() if file else path
        assert goal.exists(), f"{target} leads nowhere"
        assert goal.is_relative_to(ROOT), f"{target} leads out of the repository"
        assert not anchor or anchor in anchors(goal), f"{target}: no such heading"


@pytest.mark.parametrize("path", [*PAGES, ROOT / "CHANGELOG.md", *NOTEBOOKS], ids=name_of)
def test_paths_of_the_repository_exist(path: Path):
    for named in re.findall(
        r"(?<![\w./-])((?:scripts|tests|docs|notebooks|configs|urdf|src)/[\w./*-]*\w)", prose(path)
    ):
        assert list(ROOT.glob(named)), f"{named} does not exist"


@pytest.mark.parametrize("path", [*PAGES, ROOT / "CHANGELOG.md", *NOTEBOOKS], ids=name_of)
def test_names_of_the_package_exist(path: Path):
    for dotted in set(re.findall(r"`(?:ik|ikgrad)\.([A-Za-z_][\w.]*\w)", prose(path))):
        assert exists(dotted), f"ikgrad.{dotted} does not exist"


def exists(dotted: str) -> bool:
    """A module of the package, or an attribute of one."""
    thing: Any = ik
    parts = dotted.split(".")
    for depth, part in enumerate(parts, 1):
        try:
            thing = getattr(thing, part)
        except AttributeError:
            try:
                thing = importlib.import_module(".".join(["ikgrad", *parts[:depth]]))
            except ImportError:
                return False
    return True


# ---------------------------------------------------------------- the site


def site_pages(entries: list[Any]) -> list[str]:
    """Pages in the navigation, in order."""
    values = [value for entry in entries for value in (entry.values() if isinstance(entry, dict) else [entry])]
    return [page for value in values for page in (site_pages(value) if isinstance(value, list) else [value])]


def test_the_navigation_has_every_page_and_every_notebook_once():
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    pages = [str(path.relative_to(ROOT / "docs")) for path in PAGES[1:]]
    pages += [f"notebooks/{path.stem}.md" for path in NOTEBOOKS]
    assert sorted(site_pages(nav)) == sorted(pages)


def test_the_reference_has_every_public_name():
    text = "".join(path.read_text() for path in (ROOT / "docs/reference").glob("*.md"))
    shown = re.findall(r"^::: ikgrad\.(\S+)\n    options:\n      heading: ik\.(\S+)$", text, re.MULTILINE)
    assert len(shown) == text.count(":::")
    for path, heading in shown:
        assert exists(path), path
        assert path.rpartition(".")[2] == heading.rpartition(".")[2]
    headings = {heading for _, heading in shown}
    public = {name for name in ik.__all__ if name[0] != "_" and not isinstance(getattr(ik, name), ModuleType)}
    assert public <= headings, public - headings
    assert {f"optim.{name}" for name in ik.optim.__all__} <= headings


def test_the_table_of_choosing_has_lines_of_the_benchmarks():
    head = "| what | measured (ratios with their 95 % interval) | command: `ikgrad bench ...` |"
    full, short = (
        (ROOT / f"docs/{page}.md").read_text().split(head)[1].split("\n\n")[0].splitlines()
        for page in ("benchmarks", "choosing")
    )
    assert len(short) > 7
    assert set(short) <= set(full)
