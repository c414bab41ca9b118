"""The shape of the package: layers, public names, lazy imports."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import ikgrad as ik

SOURCE = Path(ik.__file__).parent

# From the bottom up; a module may import from its own row and from rows above it in this list.
LAYERS = [
    {"errors", "extras", "garbage", "resources"},
    {"rotations", "trajectory", "optim"},
    {"segments", "robot", "pk_chain", "dh", "urdf", "config"},
    {"kinematics", "engine"},
    {"solvers", "collision", "data", "files"},
    {"networks", "planning", "workspace"},
    {"training", "export", "jobs"},
    {"evaluation"},
    {"papers", "plots", "bench"},
    {"view"},
    {"cli", "__main__"},
]
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}


def modules() -> list[tuple[str, Path]]:
    paths = [path for path in SOURCE.rglob("*.py") if path.parent != SOURCE or path.stem != "__init__"]
    return [(path.relative_to(SOURCE).parts[0].removesuffix(".py"), path) for path in paths]


def imported(path: Path) -> set[str]:
    """Top-level parts of ikgrad that a file imports, at any depth, type-checking blocks aside."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            node.body = []
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "ikgrad":
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("ikgrad."):
            names.add(node.module.split(".")[1])
        elif isinstance(node, ast.Import):
            names |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("ikgrad.")}
    return names - {"__version__"}


def test_every_module_has_a_layer():
    assert {part for part, _ in modules()} <= set(LEVEL)


@pytest.mark.parametrize(("part", "path"), modules(), ids=lambda x: str(x) if isinstance(x, str) else x.stem)
def test_modules_import_from_lower_layers_only(part: str, path: Path):
    for name in imported(path):
        assert LEVEL[name] <= LEVEL[part], f"{path.name} ({part}) imports {name}, which lies higher"


def test_only_the_command_line_prints():
    for part, path in modules():
        calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
        printed = [call.lineno for call in calls if getattr(call.func, "id", "") == "print"]
        assert part == "cli" or not printed, f"{path}: prints in line {printed}"


@pytest.mark.parametrize("name", [name for name in ik.__all__ if name != "__version__"])
def test_public_names_exist_and_are_documented(name: str):
    assert getattr(ik, name).__doc__.strip()


def test_an_unknown_attribute_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'solve_everything'"):
        ik.solve_everything  # noqa: B018


def loaded(code: str) -> set[str]:
    """Packages in memory after running some code in a fresh interpreter."""
    script = f"import sys\n{code}\nprint(*sorted(name.split('.')[0] for name in sys.modules))"
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120)
    return set(out.stdout.split())


def test_importing_the_package_imports_nothing_heavy():
    assert not loaded("import ikgrad") & {"torch", "numpy", "matplotlib", "yourdfpy", "pytorch_kinematics", "numba"}


def test_solving_does_not_import_matplotlib_or_chains():
    code = "import ikgrad as ik, torch\nr = ik.load_robot('panda')\nik.forward_kinematics(r, torch.zeros(7))"
    assert not loaded(code) & {"matplotlib", "pytorch_kinematics", "roma"}
