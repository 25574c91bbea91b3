"""Bundle three.js into the one script that a report holds.

    npm pack three@0.183.2 esbuild@0.28.2 ...    # any folder with both below node_modules
    python tools/vendor_three.py FOLDER/node_modules
    python tools/vendor_three.py --check        # is the script here the one that was made?

The bundle holds what `report/static/surface.js` uses, as the global name ``THREE``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

TARGET = (
    Path(__file__).resolve().parents[1] / "packages/splitknit/src/splitknit/report/static/three"
)
VERSIONS = {"three": "0.183.2", "esbuild": "0.28.2"}
NAMES = (
    "AmbientLight BufferAttribute BufferGeometry DirectionalLight DoubleSide Group Line"
    " LineBasicMaterial Mesh MeshPhongMaterial OrthographicCamera Raycaster Scene Vector2 Vector3"
    " WebGLRenderer"
)


def main() -> int:
    """Make the bundle, or compare it with what was made."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "modules", type=Path, nargs="?", help="a node_modules folder with three and esbuild"
    )
    parser.add_argument(
        "--check", action="store_true", help="compare the script here with its hash"
    )
    options = parser.parse_args()
    if options.check:
        wanted = json.loads((TARGET / "source.json").read_text())["sha256"]
        return int(wanted != hashlib.sha256((TARGET / "three.min.js").read_bytes()).hexdigest())
    if options.modules is None:
        parser.error("name a node_modules folder, or --check")
    bundle(options.modules.resolve())
    return 0


def bundle(modules: Path) -> None:
    """Write ``three.min.js``, its licence and ``source.json``."""
    for name, version in VERSIONS.items():
        present = json.loads((modules / name / "package.json").read_text())["version"]
        if present != version:
            sys.exit(f"{modules} holds {name} {present}, but {version} is wanted.")
    TARGET.mkdir(parents=True, exist_ok=True)
    script = TARGET / "three.min.js"
    with tempfile.TemporaryDirectory(dir=modules.parent) as folder:
        entry = Path(folder) / "entry.js"
        controls = "three/examples/jsm/controls/OrbitControls.js"
        entry.write_text(
            f'export {{ {", ".join(NAMES.split())} }} from "three";\nexport {{ OrbitControls }}'
            f' from "{controls}";\n'
        )
        flags = [
            "--bundle",
            "--minify",
            "--format=iife",
            "--global-name=THREE",
            "--legal-comments=none",
        ]
        command = [str(modules / ".bin" / "esbuild"), str(entry), *flags, f"--outfile={script}"]
        subprocess.run(command, check=True, cwd=modules.parent)
    shutil.copyfile(modules / "three" / "LICENSE", TARGET / "LICENSE")
    digest = hashlib.sha256(script.read_bytes()).hexdigest()
    source = {"packages": VERSIONS, "licence": "MIT", "sha256": digest}
    (TARGET / "source.json").write_text(json.dumps(source, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
