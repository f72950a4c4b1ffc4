"""Dependencies flow one way, and only the command line prints or exits."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "hsvaos"

BASE = {"camera", "surface", "flight", "settings", "geodesy", "hue_statistics", "rarity_model"}
ALLOWED = {
    "camera": set(),
    "surface": {"flight"},
    "flight": {"camera"},
    "settings": set(),
    "geodesy": {"flight"},
    "hue_statistics": set(),
    "rarity_model": set(),
    "reference": {"camera", "surface"},
    "reference_coherence": {"camera", "surface", "reference"},
    "reference_running": set(),
    "kernels": BASE,
    "nav": {"flight", "geodesy", "camera", "settings", "nav"},
    "detect": BASE | {"rarity_model"},
    "formats": BASE | {"nav"},
    "result": BASE | {"detect"},
    "photos": BASE | {"formats", "kernels", "nav"},
    "masking": BASE | {"photos", "kernels"},
    "viewing": BASE,
    "focusing": BASE | {"photos", "kernels", "viewing"},
    "ground_map": BASE | {"viewing"},
    "finding": BASE | {"detect"},
    "relief": BASE | {"photos", "kernels", "viewing", "relief"},
    "fragment_input": BASE | {"kernels", "detect", "rarity_model"},
    "rendering": BASE
    | {"photos", "masking", "kernels", "detect", "result", "finding", "ground_map"}
    | {"fragment_input"},
    "pipeline": BASE
    | {"photos", "masking", "kernels", "detect", "result", "rendering", "focusing", "viewing"}
    | {"finding", "relief"},
    "sweeping": BASE | {"photos", "masking", "kernels", "rendering", "viewing", "focusing"},
    "live": BASE
    | {"kernels", "nav", "detect", "rendering", "formats", "photos", "focusing", "viewing"}
    | {"cli_options", "masking", "finding", "fragment_input", "relief"},
    "demo": BASE | {"formats"},
    "benchmark": BASE | {"kernels", "cli_options", "summary"},
    "report": BASE | {"detect", "result", "sweeping"},
    "viewer": BASE
    | {"photos", "masking", "kernels", "result", "rendering", "focusing", "viewing", "report"}
    | {"nav", "finding", "cli_options", "live", "detect", "fragment_input", "rarity_model"}
    | {"relief"},
    "evaluate": BASE
    | {
        "detect",
        "result",
        "formats",
        "report",
        "viewing",
        "nav",
        "kernels",
        "photos",
        "pipeline",
        "finding",
    },
}
"""What each part may import when it is loaded; parts not named here may import anything."""

MAY_PRINT = {"cli.py", "console.py", "__main__.py", "command.py"}


def part_of(path: Path) -> str:
    inside = path.relative_to(PACKAGE)
    return inside.parts[0].removesuffix(".py")


def imported(tree: ast.Module) -> set[str]:
    """Parts of hsvaos imported at the top of a module; lazy and type-only imports are free."""
    parts = set()
    for node in tree.body:
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == "hsvaos":
                names = [f"hsvaos.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        parts |= {n.split(".")[1] for n in names if n.startswith("hsvaos.")}
    return parts


MODULES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_follow_the_arrows(path: Path) -> None:
    part = part_of(path)
    if part in ALLOWED:
        used = imported(ast.parse(path.read_text())) - {part}
        assert used <= ALLOWED[part], f"{part} must not import {used - ALLOWED[part]}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_the_command_line_prints_or_exits(path: Path) -> None:
    if path.name in MAY_PRINT:
        return
    for node in ast.walk(ast.parse(path.read_text())):
        assert not isinstance(node, ast.Assert), f"assert in line {node.lineno}"
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called not in ("print", "exit", "sys.exit", "quit"), f"line {node.lineno}"


def test_public_names_are_all_there() -> None:
    import hsvaos

    for name in hsvaos.__all__:
        assert getattr(hsvaos, name) is not None
