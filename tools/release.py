"""`make release`: sdist, wheel with the FMUs of all platforms, and bill of materials of HEAD, in `dist/`.

python -m tools.release            # build, check, install without a compiler and try
python -m tools.release --publish  # the same, after a check of what a published release needs

The same commit and the same locked tools give the same bytes. No uncommitted change enters.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
MOST_BYTES = 8_000_000
"""Size limit of the wheel."""
FMUS = """
import sys
from pathlib import Path
from plant_fmu.stewart.build import MODEL_IDENTIFIER, build
for version in ("2.0", "3.0"):
    build(version, Path(sys.argv[1]) / f"{MODEL_IDENTIFIER}_fmi{version[0]}.fmu", release=True)
"""
FIGURES = (
    "--base-radius 0.2 --platform-radius 0.12 --length-min 0.25 --stroke 0.1 --mass 5 --leg-mass 0 "
    "--drive-force 200 --drive-speed 0.2"
)
TRIED = (
    "--version -v",
    "sim virtual --log sim.mcap",
    "run virtual --plant --arm --log run.mcap",
    "replay run.mcap",
    f"new my.yaml --yes {FIGURES}",
    "sim my.yaml",
    "report run.mcap",
)
"""Commands of `hil` that run from the wheel in an empty environment."""
UNSTATED = {"FMPy": "BSD-2-Clause", "protobuf": "BSD-3-Clause", "ruckig": "MIT"}
"""Licences, from their licence files, of packages whose metadata name none."""
GPL = re.compile(r"(?<!L)GPL|GNU (Affero )?General Public", re.IGNORECASE)


def run(*command: str | Path, folder: Path = ROOT, **environment: str) -> str:
    """Standard output of a command. Raises SystemExit with the end of its output if it fails."""
    done = subprocess.run(
        command, cwd=folder, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        shown, said = " ".join(map(str, command[:6])), (done.stdout + done.stderr)[-3000:]
        sys.exit(f"release: {shown} failed with exit code {done.returncode}:\n{said}")
    return done.stdout


def project() -> dict[str, Any]:
    """Table `project` of pyproject.toml."""
    found: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return found


def obstacles() -> list[str]:
    """Missing parts of a published release, one sentence each."""
    version = project()["version"]
    heading = rf"^## \[{re.escape(version)}\] - \d{{4}}-\d\d-\d\d$"
    cited = f'version: "{version}"' in (ROOT / "CITATION.cff").read_text()
    checks = {
        "project.urls in pyproject.toml has placeholders (example.invalid): enter the addresses":
            "example.invalid" in "".join(project()["urls"].values()),
        f"CHANGELOG.md has no heading '## [{version}] - DATE': date the section":
            not re.search(heading, (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE),
        f"CITATION.cff does not have version {version}: update it": not cited,
        "the work tree has changes: commit them": bool(run("git", "status", "--porcelain")),
        f"HEAD has no tag v{version}: tag it":
            f"v{version}" not in run("git", "tag", "--points-at", "HEAD").split(),
    }  # fmt: skip
    return [text for text, missing in checks.items() if missing]


def build(out: Path) -> Path:
    """Write sdist and wheel of HEAD into `out`; return the wheel. The wheel is built from the sdist."""
    epoch = run("git", "log", "-1", "--format=%ct").strip()
    hatch = (sys.executable, "-m", "hatchling", "build", "--directory", out)
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tree"
        run("git", "archive", "--output", tree.with_suffix(".tar"), "HEAD")
        with tarfile.open(tree.with_suffix(".tar")) as archive:
            archive.extractall(tree, filter="data")
        run(*hatch, "--target", "sdist", folder=tree, SOURCE_DATE_EPOCH=epoch)
        (sdist,) = out.glob("*.tar.gz")
        with tarfile.open(sdist) as archive:
            archive.extractall(scratch, filter="data")
        tree = Path(scratch) / sdist.name.removesuffix(".tar.gz")
        fresh = {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": scratch}
        fresh["ZIG_GLOBAL_CACHE_DIR"] = str(ROOT / "build/zig")  # the libraries of the systems, as they are
        run(sys.executable, "-c", FMUS, tree / "plant_fmu/stewart", folder=tree, **fresh)
        run(*hatch, "--target", "wheel", folder=tree, SOURCE_DATE_EPOCH=epoch)
    (wheel,) = out.glob("*.whl")
    return wheel


def environment(wheel: Path, folder: Path) -> Path:
    """Install the wheel with its dependencies into an empty environment; return its folder."""
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
    pip = (sys.executable, "-m", "pip", "--python", folder / "venv/bin/python")
    run(*pip, "install", "--quiet", wheel, folder=folder, PYTHONPATH="")
    return folder / "venv"


def materials(venv: Path, out: Path) -> None:
    """Write the bill of materials (CycloneDX). Raises SystemExit for the GPL, or for no licence."""
    run(sys.executable, "-m", "cyclonedx_py", "environment", "--pyproject", ROOT / "pyproject.toml",
        "--output-reproducible", "--output-file", out, venv / "bin/python")  # fmt: skip
    bill = json.loads(out.read_text())
    for part in bill["components"]:
        if part["name"] in UNSTATED:
            part.setdefault("licenses", [{"license": {"id": UNSTATED[part["name"]]}}])
        licences = json.dumps(part.get("licenses", "unknown"))
        if GPL.search(licences) or "unknown" in licences.lower():
            sys.exit(f"release: {part['name']}: licence {licences}, allowed: any but the GPL")
    out.write_text(json.dumps(bill, indent=2) + "\n")


def attempt(venv: Path, folder: Path) -> None:
    """Run TRIED without compiler, caches and home of the user; print wall and processor time of each."""
    (folder / "home").mkdir()
    alone = {"PATH": str(venv / "bin"), "HOME": str(folder / "home"), "PYTHONPATH": "", "CC": ""}
    for words in TRIED:
        begun, used = time.monotonic(), sum(os.times()[2:4])
        run(venv / "bin/hil", *words.split(), folder=folder, XDG_CACHE_HOME="", **alone)
        wall, processor = time.monotonic() - begun, sum(os.times()[2:4]) - used
        print(f"{wall:6.1f} s, processor {processor:6.1f} s  hil {words}", flush=True)


def main() -> None:
    """Build, check and try the distributions of HEAD."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--publish", action="store_true", help="refuse to build what must not be published")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder, emptied before")
    options = parser.parse_args()
    if options.publish and (found := obstacles()):
        sys.exit("\n".join(f"release: {each}" for each in found))
    out = options.out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    wheel = build(out)
    if (size := wheel.stat().st_size) > MOST_BYTES:
        sys.exit(f"release: {wheel.name} has {size} bytes; at most {MOST_BYTES} are allowed")
    run(sys.executable, "-m", "twine", "check", "--strict", *out.iterdir())
    run(sys.executable, "-m", "check_wheel_contents", wheel)
    with tempfile.TemporaryDirectory() as scratch:
        begun = time.monotonic()
        venv = environment(wheel, Path(scratch))
        print(f"{time.monotonic() - begun:6.1f} s  pip install {wheel.name} ({size} bytes)", flush=True)
        materials(venv, out / f"{project()['name']}-{project()['version']}.cdx.json")
        attempt(venv, Path(scratch))
    print(*(f"{path}" for path in sorted(out.iterdir())), sep="\n")


if __name__ == "__main__":
    main()
