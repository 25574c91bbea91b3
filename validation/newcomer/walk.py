"""What a newcomer does, command by command, in a fresh environment that has nothing but the wheels.

    python validation/newcomer/walk.py [photographs] [prints] [rig] [--out DIR] [--python EXE] [--log FILE.md]

photographs: a folder of photographs to a surface and a print; prints: real prints to ISO records and a DET curve; rig:
from the parts to the first finger, on the simulated rig. Each walk also takes the wrong steps that newcomers take; the
message of each is printed, and is what is judged: exit code 2 and the words that tell what to do.

Without ``--python`` the wheels of ``packages/`` are built and put into a new environment; with it, that interpreter's
splitknit walks. ``log.md`` holds what came out.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import venv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = {"photographs": "", "prints": "[minutiae,records]", "rig": ""}
"""Extras of splitknit-match that each walk installs with the wheels."""
LIGHTS = """5.25 0.0 14.0
3.27 4.1 14.0
-1.17 5.12 14.0
-4.73 2.28 14.0
-4.73 -2.28 14.0
-1.17 -5.12 14.0
3.27 -4.1 14.0
"""


@dataclass(frozen=True, slots=True)
class Step:
    """One command of a walk."""

    command: str
    """As a newcomer types it, without the program's name."""
    code: int = 0
    says: str = ""
    """What must be in its output."""
    makes: str = ""
    """A file that must be there afterwards."""


def photographs(folder: Path) -> Iterator[Step]:
    """Photographs to a surface and a print."""
    yield Step("simulate --seed 3 --scale 0.3 --out finger", makes="finger/white_0.png")
    mine = folder / "photos"
    mine.mkdir()
    for file in sorted((folder / "finger").glob("white_*.png")):
        shutil.copy(file, mine)
    yield Step("reconstruct photos --out wrong", 2, "--images")  # a plain folder where a capture is wanted
    yield Step("reconstruct --images photos --out wrong", 2, "--lights")
    (mine / "lights.txt").write_text("\n".join(LIGHTS.splitlines()[:6]) + "\n")
    yield Step("reconstruct --images photos --lights photos/lights.txt --out wrong", 2, "7")  # a line is missing
    (mine / "lights.txt").write_text(LIGHTS.replace(".", ",").replace(" ", ","))  # decimal commas, and commas between
    yield Step("reconstruct --images photos --lights photos/lights.txt --out wrong", 2, "decimals with a point")
    (mine / "lights.txt").write_text(LIGHTS)
    images = "--images photos --lights photos/lights.txt --material skin"
    for command in (f"import {images} --px-per-mm 22.7", "simulate --seed 4"):
        yield Step(f"{command} --out finger", 2, "--overwrite")  # photographs are not replaced by mistake
    (mine / "white_6.png").replace(mine / "seventh")
    (mine / "white_6.png").symlink_to(mine / "seventh")
    yield Step(f"reconstruct {images} --out wrong", 2, "white_6.png' is a link")
    (mine / "seventh").replace(mine / "white_6.png")
    yield Step(f"reconstruct {images} --out pixels", says="scale", makes="pixels/report.html")
    yield Step("print pixels --out wrong", 2, "--px-per-mm")  # no scale, no print
    crossed = folder / "crossed"
    crossed.mkdir()
    for file in sorted(mine.glob("white_*.png"))[1:]:
        shutil.copy(file, crossed)
    yield Step(f"import {images} --crossed crossed --out wrong", 2, "crossed 6")  # one photograph is missing
    yield Step("separate polarised photos --out wrong", 2, "polarised PARALLEL CROSSED")
    yield Step(f"reconstruct {images} --px-per-mm 22.7 --out photos", 2, "photos")  # nothing of the user's is replaced
    yield Step(f"reconstruct {images} --px-per-mm 22.7 --out surface", makes="surface/phalange.ply")
    (folder / "ball").mkdir()
    y, x = np.mgrid[1:-1:240j, -1:1:240j] / 0.9
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, 1))
    for k, line in enumerate(LIGHTS.splitlines()):  # a matt ball, as a telephone writes it
        a, b, c = np.array(line.split(), float) / np.linalg.norm(np.array(line.split(), float))
        shade = 0.8 * np.clip(a * x + b * y + c * z, 0, 1) * (z > 0)
        cv2.imwrite(str(folder / "ball" / f"{k}.jpg"), np.uint8(255 * shade ** (1 / 2.2)))
    yield Step(
        "calibrate lights --sphere grey --images ball --out found.txt", says="--lights found.txt", makes="found.txt"
    )
    by_ball = "reconstruct --images photos --lights found.txt --material skin --px-per-mm 22.7"
    yield Step(f"{by_ball} --out by_ball", makes="by_ball/phalange.ply")
    mirrored = [" ".join([str(-float(x)), y, z]) for x, y, z in (line.split() for line in LIGHTS.splitlines())]
    (folder / "mirrored.txt").write_text("\n".join(mirrored) + "\n")
    yield Step(
        "reconstruct --images photos --lights mirrored.txt --material skin --px-per-mm 22.7 --out mirrored",
        2,
        "--light-frame",
    )
    reverse = LIGHTS.splitlines()[::-1]
    (folder / "reversed.txt").write_text("\n".join(reverse) + "\n")
    yield Step(
        "reconstruct --images photos --lights reversed.txt --preset ea --px-per-mm 22.7 --out reversed",
        says="7 6 5 4 3 2 1 (reversed)",
    )
    for scale in ("961", "0.03785", "37850"):  # a slip of the decimal point
        yield Step(f"reconstruct {images} --px-per-mm {scale} --out wrong", 2, "--px-per-mm")
    (folder / "stored").mkdir()
    for file in mine.glob("*.png"):  # of a grey camera, stored as colour
        grey = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(folder / "stored" / file.name), cv2.merge([grey] * 3))
    stored = "--images stored --lights photos/lights.txt --preset ea --px-per-mm 22.7"
    yield Step(f"reconstruct {stored} --out grey", makes="grey/report.html")
    yield Step("print surface --out print", makes="print/print.png")
    for kind in ("stl", "obj", "glb"):
        yield Step(f"export surface --to {kind} --out {kind}", says="in mm", makes=f"{kind}/surface.{kind}")


def prints(folder: Path) -> Iterator[Step]:
    """Prints of others to ISO records, a gallery and a DET curve: real ones of SPLITKNIT_DATA, else simulated ones."""
    theirs = folder / "prints"
    theirs.mkdir()
    real = Path(os.environ.get("SPLITKNIT_DATA", ROOT.parent / "shared" / "data")) / "fvc2002_db1b"
    files = [real / f"{finger}_{press}.png" for finger in (101, 102, 103) for press in (1, 2, 3)]
    if not real.is_dir():
        people = "--subjects 3 --sessions 3 --fingers right_index --scale 0.2"
        yield Step(f"simulate population --out people {people}", makes="people/population.json")
        captures = sorted(str(path.relative_to(folder)) for path in folder.glob("people/S*/session_*/right_index"))
        yield Step(f"export {' '.join(captures)} --to png --out made")
        files = sorted((folder / "made").glob("*.png"))
    names = [f"prints/{k // 3 + 1}_{k % 3 + 1}.png" for k in range(9)]
    for file, name in zip(files, names, strict=True):  # stored anew: without a resolution, as most prints are
        cv2.imwrite(str(folder / name), cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
    export = f"export {' '.join(names)} --to iso-19794-2 --out records"
    yield Step(export, 2, "--input-ppi")
    yield Step(f"{export} --input-ppi 500", makes="records/3_3.iso")
    yield Step("match records/1_1.iso records/1_2.iso --methd minutiae", 2, "--method")  # and no usage before it
    yield Step("match records/1_1.iso records/1_2.iso", says="Match, decided at a false match rate of 1 in 10,000")
    yield Step("match prints/1_1.png prints/2_1.png --input-ppi 500", says="No match, decided at")
    for k in (1, 2):
        yield Step(f"print prints/1_{k}.png --input-ppi 500 --out print_{k}", makes=f"print_{k}/minutiae.iso")
    yield Step("match print_1 print_2", says="Match, decided at")
    (folder / "cut.iso").write_bytes((folder / "records" / "1_1.iso").read_bytes()[:60])
    yield Step("match cut.iso records/1_2.iso", 2, "cut.iso")
    yield Step("print records/1_1.iso --out wrong", 2, "minutiae")  # no picture
    yield Step("enroll people.skg prints/1_1.png --input-ppi 500", 2, "--person")
    for k in range(3):
        who = f"--person P{k + 1} --finger right_index --input-ppi 500"
        yield Step(f"enroll people.skg {' '.join(names[3 * k : 3 * k + 3])} {who}", makes="people.skg")
    yield Step("identify people.skg prints/2_3.png --input-ppi 500", says="P2")
    yield Step("evaluate --gallery people.skg --out rates --replicates 100", makes="rates/report.html")
    yield Step("evaluate --gallery peple.skg --out wrong", 2, "peple.skg")
    for k, name in enumerate(names):  # the same as a folder, in one command
        copy = folder / "many" / f"P{k // 3 + 1}" / f"session_{k % 3 + 1}" / "right_index.png"
        copy.parent.mkdir(parents=True)
        copy.write_bytes((folder / name).read_bytes())
    yield Step("enroll many.skg --population many", 2, "--input-ppi")
    yield Step("enroll many.skg --population many --input-ppi 500", makes="many.skg")
    yield Step("forget --person P1 many.skg", 2, "--yes")
    yield Step("forget --person P1 many.skg --yes", says="Erased")
    yield Step("gallery list many.skg --person P1", 2, "holds nothing of person 'P1'")


def rig(folder: Path) -> Iterator[Step]:
    """Parts to the first finger, on the simulated rig."""
    yield Step("rig target --out targets", makes="targets")
    yield Step("simulate --bench --seed 7 --scale 0.35 --out bench", makes="bench/plane.png")
    camera = "calibrate camera bench/board --board 9x6 --plane bench/plane.png --rig bench/rig_drawn.json"
    camera += " --out rig_1.json"
    yield Step(camera.replace("bench/board", "bench/bord"), 2, "bench/bord")
    yield Step(camera.replace("9x6", "8x6") + " --square-mm 3", 2, "8")  # the board has other corners
    yield Step(camera + " --square-mm 30", 2, "--square-mm")  # 3 mm squares
    yield Step(camera.replace("9x6", "10x7") + " --square-mm 3", 2, "not squares")  # squares for corners
    yield Step(camera + " --square-mm 3", makes="rig_1.json")
    yield Step("calibrate lights --images bench/card --rig rig_1.json --out rig_2.json", 2)  # no nail to be seen
    yield Step("calibrate lights --images bench/nail --rig rig_1.json --out rig_2.json", makes="rig_2.json")
    yield Step("calibrate radiometry bench/card --rig rig_2.json --out rig_3.json", makes="rig_3.json")
    first = "capture --device twin --seed 3 --scale 0.35 --subject S01 --finger right_index --out first"
    yield Step(first.replace("right_index", "right_indx"), 2, "right_index")
    yield Step(first, makes="first/capture.json")
    yield Step("reconstruct first --out result --rig no_rig.json", 2, "no_rig.json")
    yield Step("reconstruct first --out result", makes="result/phalange.ply")


WALKS = {"photographs": photographs, "prints": prints, "rig": rig}


def main(arguments: Sequence[str] | None = None) -> int:
    """Take the walks; return 1 if a step went otherwise than it must."""
    parser = argparse.ArgumentParser(description="What a newcomer does, in a fresh environment.")
    parser.add_argument("walks", nargs="*", metavar="WALK", help=f"of {', '.join(WALKS)} (default: all)")
    parser.add_argument("--out", type=Path, default=None, help="folder to walk in (default: a new one, removed)")
    parser.add_argument("--python", type=Path, default=None, help="interpreter that has splitknit")
    parser.add_argument("--log", type=Path, default=None, help="commands and messages as a Markdown page")
    options = parser.parse_args(arguments)
    if unknown := [name for name in options.walks if name not in WALKS]:
        parser.error(f"there is no walk {', '.join(unknown)}")
    chosen = options.walks or list(WALKS)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(options.out or temporary).absolute()
        python = options.python or fresh_environment(folder / "environment", chosen)
        lines: list[str] = []
        steps = ((name, step) for name in chosen for step in _steps(name, folder))
        bad = sum(not _taken(step, name, python.absolute(), folder, lines) for name, step in steps)
    if options.log is not None:
        options.log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{bad} of {sum(line.startswith('    $') for line in lines)} steps went wrong.")
    return int(bad > 0)


def fresh_environment(folder: Path, walks: Sequence[str]) -> Path:
    """Build the wheels and install them, with what the walks need, into a new environment; return its interpreter."""
    wheels, members = folder / "wheels", sorted((ROOT / "packages").iterdir())
    subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", wheels, *members], check=True)
    extras = "".join(sorted({EXTRAS[name] for name in walks}))
    names = [f"{wheel}{extras if wheel.name.startswith('splitknit_match') else ''}" for wheel in wheels.glob("*.whl")]
    venv.create(folder / "venv", with_pip=True)
    python = folder / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"
    subprocess.run([python, "-m", "pip", "install", "-q", *names], check=True)
    return python


def _steps(name: str, folder: Path) -> Iterator[Step]:
    place = folder / name
    place.mkdir(parents=True)
    return WALKS[name](place)


def _taken(step: Step, walk: str, python: Path, folder: Path, lines: list[str]) -> bool:
    """Run one command and judge it."""
    command = [python.with_name("splitknit"), *step.command.split()]
    done = subprocess.run(command, cwd=folder / walk, capture_output=True, text=True, check=False)
    said = (done.stdout + done.stderr).strip()
    good = done.returncode == step.code and step.says in said and (folder / walk / step.makes).exists()
    if step.code:
        # on standard output there may be what `forget` found before it asked
        refusal = [line for line in done.stderr.splitlines() if not line.startswith("See 'splitknit ")]
        good &= len(refusal) == 1 and "Traceback" not in said
    shown = [f"    $ splitknit {step.command}", *(f"    {line}" for line in said.splitlines())]
    if not good:
        must = f"exit code {step.code}, say '{step.says}', make '{step.makes}'"
        shown.append(f"    !! exit code {done.returncode}; must: {must}")
    print("\n".join(shown), flush=True)
    lines += [*shown, ""]
    return good


if __name__ == "__main__":
    sys.exit(main())
