"""The package that a page writes, as an installation leaves it on the path."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```\{code-block\} \w+\n:caption: (.*?)\n\n(.*?)^```", re.DOTALL | re.MULTILINE)
CONTRACT = """
import pytest, sys
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "-p", "no:randomly", "tests"]))
"""
SUCCESS = """
assert run.success, run.summary
assert run.summary["replay"]["exact"]
assert run.summary["rejected_frames"] == 0
"""


class Package:
    """Files of a page, and its other blocks by caption."""

    def __init__(self, page: str, folder: Path) -> None:
        """Write the blocks whose caption is a file."""
        self.folder, self.blocks = folder, dict[str, str]()
        for caption, code in BLOCK.findall((ROOT / "docs/guides" / page).read_text()):
            known = self.blocks.get(caption)
            self.blocks[caption] = code if known is None else f"{known}\n\n{code}"
        for name in [name for name in self.blocks if "." in name]:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(self.blocks[name])
        project = tomllib.loads(self.blocks["pyproject.toml"])["project"]
        installed = folder / f"{project['name']}-{project['version']}.dist-info"
        installed.mkdir()
        metadata = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
        (installed / "METADATA").write_text(metadata)
        groups = project["entry-points"].items()
        lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in each.items()) for group, each in groups]
        (installed / "entry_points.txt").write_text("\n".join(lines))

    def run(self, code: str) -> str:
        """Run Python code where the package is installed; standard output."""
        here = os.environ | {"PYTHONPATH": f"{self.folder}{os.pathsep}{ROOT}"}
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, cwd=self.folder, env=here, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout
