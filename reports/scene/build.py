"""Bundle the pages' scripts into dist/: ``python reports/scene/build.py`` (needs node and npm, never at run time).

The lock file names versions and checksums and no registry: ``npm ci`` uses the one that is configured.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
PAGES = {"main.js": "report.js", "plain.js": "plain.js"}  # with a 3D scene, and without
BUNDLED = ("three",)  # esbuild only builds; nothing of it ends up in the bundle


def strip_lock(path: Path) -> None:
    """Remove the addresses of packages from a lock file; their checksums stay."""
    lock = json.loads(path.read_text())
    for package in lock["packages"].values():
        package.pop("resolved", None)
    path.write_text(json.dumps(lock, indent=2) + "\n")


def licences() -> str:
    """Versions and licence texts of what is in the bundle."""
    parts = [f"{PAGES['main.js']} contains these packages besides tubeplan's own source in ../src:\n"]
    for name in BUNDLED:
        folder = HERE / "node_modules" / name
        about = json.loads((folder / "package.json").read_text())
        parts.append(f"{name} {about['version']}, {about['license']}\n\n{(folder / 'LICENSE').read_text().strip()}\n")
    return "\n".join(parts)


def sources_digest() -> str:
    """SHA-256 over the sources and the lock file: a test holds the bundle against it."""
    files = [*sorted((HERE / "src").glob("*.js")), HERE / "package-lock.json"]
    return hashlib.sha256(b"".join(file.name.encode() + b"\0" + file.read_bytes() for file in files)).hexdigest()


def build() -> None:
    """Install the locked packages, bundle, and write the licences beside the bundle."""
    subprocess.run(["npm", "ci", "--no-audit", "--no-fund", "--ignore-scripts"], cwd=HERE, check=True)
    dist = HERE / "dist"
    dist.mkdir(exist_ok=True)
    options = ["--bundle", "--minify", "--format=iife", "--target=es2022", "--charset=utf8", "--legal-comments=none"]
    for source, name in PAGES.items():
        subprocess.run(
            [HERE / "node_modules/.bin/esbuild", f"src/{source}", *options, f"--outfile={dist / name}"], cwd=HERE, check=True
        )
        text = (dist / name).read_text()
        if name == PAGES["main.js"]:  # every report is a copy of what is bundled: its licence goes with it
            text = f"/*!\n{licences()}*/\n{text}"
            (dist / name).write_text(text)
        if "</script" in text or "<!--" in text:
            raise SystemExit("the bundle holds text that would end its own script element; rename it in the source")
    (dist / "THIRD_PARTY.txt").write_text(licences())
    (dist / "SOURCES.sha256").write_text(sources_digest() + "\n")


if __name__ == "__main__":
    strip_lock(HERE / "package-lock.json")
    build()
