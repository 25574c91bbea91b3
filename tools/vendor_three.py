"""Take three.js from its package and put what the viewer needs beside its page.

python tools/vendor_three.py three-0.183.2.tgz    # the package, as `npm pack three@0.183.2` fetches it
python tools/vendor_three.py --check              # are the files here those that were taken?

0.183.2 is the last version whose package holds minified modules. One line differs from the package, because a page
without inline scripts has no import map: OrbitControls imports ``./three.module.min.js`` instead of ``three``.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import json
import sys
import tarfile
from pathlib import Path

TARGET = Path(__file__).resolve().parents[1] / "packages/splitknit/src/splitknit/viewer/static/vendor/three"
VERSION = "0.183.2"
FILES = {
    "three.module.min.js": "package/build/three.module.min.js",
    "three.core.min.js": "package/build/three.core.min.js",
    "OrbitControls.js": "package/examples/jsm/controls/OrbitControls.js",
    "LICENSE": "package/LICENSE",
}


def main() -> int:
    """Take the files, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("package", type=Path, nargs="?", help="three-0.183.2.tgz")
    parser.add_argument("--check", action="store_true", help="compare the files here with what was taken")
    options = parser.parse_args()
    if options.check:
        return check()
    if options.package is None:
        parser.error("name the package, three-0.183.2.tgz, or --check")
    return take(options.package)


def take(package: Path) -> int:
    """Write the files and ``source.json``."""
    integrity = "sha512-" + base64.b64encode(hashlib.sha512(package.read_bytes()).digest()).decode("ascii")
    TARGET.mkdir(parents=True, exist_ok=True)
    hashes = {}
    with tarfile.open(package) as archive:
        about = json.load(archive.extractfile("package/package.json"))  # type: ignore[arg-type]
        if about["version"] != VERSION:
            sys.exit(f"{package} holds three {about['version']}, but {VERSION} is wanted.")
        for name, member in FILES.items():
            data = archive.extractfile(member).read()  # type: ignore[union-attr]
            if name == "OrbitControls.js":
                data = data.replace(b"} from 'three';", b"} from './three.module.min.js';")
            (TARGET / name).write_bytes(data)
            hashes[name] = hashlib.sha256(data).hexdigest()
    source = {"package": f"three@{VERSION}", "licence": "MIT", "integrity": integrity, "sha256": hashes}
    (TARGET / "source.json").write_text(json.dumps(source, indent=1) + "\n")
    return 0


def check() -> int:
    """Return 1 if a file is missing or differs from ``source.json``."""
    wanted = json.loads((TARGET / "source.json").read_text())["sha256"]
    wrong = [
        name
        for name, sha256 in wanted.items()
        if not (TARGET / name).is_file() or hashlib.sha256((TARGET / name).read_bytes()).hexdigest() != sha256
    ]
    for name in wrong:
        sys.stderr.write(f"{TARGET / name} is not the file that was taken from the package.\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
