"""Verbs that write, stopped at drawn moments by SIGINT, SIGTERM and SIGKILL: ``python -m
tests.fuzz.kills``.

What was there is there unchanged, or the new one is there whole. After SIGINT and SIGTERM nothing
else is left; what SIGKILL leaves, the next command on the same place removes.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import http.client
import io
import json
import os
import random
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
import traceback
from functools import partial
from pathlib import Path

import cv2

from splitknit.cli.main import main as splitknit
from splitknit.io.atomic import MANIFEST, manifest_of
from splitknit_match.gallery.file import GalleryFile

# words: {out} is what is written, {base} the folder of what is read, {gallery} a gallery of A and B
VERBS: dict[str, str] = {
    "simulate": "simulate --out {out} --seed 1 --scale 0.05 --overwrite",
    "simulate-bench": "simulate --bench --out {out} --seed 1 --scale 0.1 --overwrite",
    "simulate-population": (
        "simulate population --out {out} --subjects 1 --fingers left_index --scale 0.05 --workers 1"
    ),
    "capture": "capture --device twin --out {out} --seed 3 --scale 0.05 --overwrite",
    "calibrate-camera": "calibrate camera {base}/bench/board --board 9x6 --square-mm 3 --out {out}",
    "calibrate-lights": (
        "calibrate lights --images {base}/nail --rig {base}/bench/rig_true.json --out {out}"
    ),
    "calibrate-radiometry": (
        "calibrate radiometry {base}/bench/card --rig {base}/bench/rig_true.json --out {out}"
    ),
    "reconstruct": "reconstruct {base}/capture --out {out} --preset ea",
    "print": "print {base}/result --out {out}",
    "import-images": (
        "import --images {base}/flat --lights {base}/lights.txt --px-per-mm 9 --out {out}"
        " --overwrite"
    ),
    "import-prints": "import {base}/result/print.png --out {out}",
    "export": "export {base}/result --to iso-19794-2 --out {out}",
    "gallery-export": "gallery export {gallery} --out {out}",
    "gallery-import": "gallery import {gallery} {base}/exported",
    "rig-target": "rig target --out {out}",
    "compare": "compare {base}/result {base}/result --out {out}",
    "match-template": "match {base}/result {base}/result --template {out}",
    "evaluate": "evaluate --scores {base}/scores.csv --replicates 20 --out {out}",
    "evaluate-calibrate": (
        "evaluate --scores {base}/scores.csv --replicates 20 --out {base}/rates --calibrate {out}"
    ),
    "profile": "profile {base}/result -4,-6 4,6 --cutoff 2.5 --out {out}",
    "demo": "demo --out {out} --seed 1 --scale 0.05",
    "batch": "batch {base}/population --out {out} --cases ea --matchers ridge --jobs 1",
    "export-mesh": "export {base}/result --to glb --out {out}",
    "enroll": "enroll {gallery} {base}/result --person C --finger right_index",
    "gallery-remove": "gallery remove {gallery} --person A",
    "serve": "serve --gallery {gallery} --token-file {base}/key --port {port}",
}
NOT_STOPPED = {
    "calibrate polarisers": (
        "writes a rig file as `calibrate radiometry` does; its photographs take a minute"
    ),
    "gallery info": "reads",
    "gallery list": "reads",
    "identify": "reads",
    "records what": "reads",
    "rig check": "writes a folder as `capture` does; its photographs take half a minute",
}
"""Verbs that are not stopped here, and why."""
PARTS = ("simulate-population", "batch", "demo")
"""What these write comes in parts, each of them whole."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


def forked(words, log, stop=lambda child: None):
    """Run a command in a fork, which has all modules already; its exit code, negative where a
    signal ended it."""
    child = os.fork()
    if child == 0:
        code = 130  # stopped before the command began
        try:
            for stream in (1, 2):
                os.dup2(os.open(log, os.O_CREAT | os.O_WRONLY | os.O_APPEND), stream)
            sys.argv = ["splitknit", *words]
            code = splitknit()
        except Exception:
            code = 99
            traceback.print_exc()
        finally:
            os._exit(code)
    stop(child)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def command(name, base, out, gallery, port):
    """The words of a verb, its gallery a fresh one."""
    shutil.copyfile(base / "people.skg", gallery)
    return VERBS[name].format(out=out, base=base, gallery=gallery, port=port).split()


def free_port():
    """A port of this machine at which nothing listens."""
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return int(place.getsockname()[1])


def served(child, port, base, number, seconds):
    """Enrol C over HTTP and stop the service after some time or its answer; whether it answered."""
    fields = {"person": "C", "finger": "right_index", "print": (base / "print").read_text()}
    service = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    for _ in range(600):
        try:
            service.connect()
            break
        except ConnectionRefusedError:
            time.sleep(0.1)
    timer = threading.Timer(600.0 if seconds is None else seconds, os.kill, (child, number))
    timer.start()
    try:
        service.request(
            "POST",
            "/enroll",
            json.dumps(fields),
            {"Authorization": f"Bearer {(base / 'key').read_text()}"},
        )
        return service.getresponse().status == 200
    except (OSError, http.client.HTTPException):
        return False
    finally:
        if seconds is None:
            timer.cancel()
            os.kill(child, number)
        timer.join()
        service.close()


def contents(place):
    """A file, or the files of a folder by name, but for what lies in temporary folders."""
    files = [place] if place.is_file() else [file for file in place.rglob("*") if file.is_file()]
    names = {file.relative_to(place).as_posix(): file for file in files}
    return {name: file.read_bytes() for name, file in names.items() if ".splitknit-" not in name}


def people(gallery):
    """Who is in a gallery that is sound."""
    with GalleryFile(gallery) as opened:
        return frozenset(entry.person for entry in opened.people().entries.values())


def left_in(tree):
    """Temporary folders and journals."""
    return [
        str(path)
        for pattern in (".splitknit-*", "*-journal", "*-wal", "*-shm")
        for path in tree.rglob(pattern)
    ]


def prepared(base):
    """What the verbs read."""
    for words in (
        "simulate --out {0}/capture --seed 3 --scale 0.12",
        "reconstruct {0}/capture --out {0}/result --preset ea",
        "enroll {0}/people.skg {0}/result --person A --finger right_index",
        "enroll {0}/people.skg {0}/result --person B --finger right_index",
        "gallery export {0}/people.skg --out {0}/exported",
        "simulate --bench --out {0}/bench --seed 1 --scale 0.15",
        (
            "simulate population --out {0}/population --subjects 2 --fingers left_index --sessions"
            " 2 --scale 0.05"
        ),
    ):
        with contextlib.redirect_stdout(io.StringIO()):
            assert splitknit(words.format(base).split()) == 0, words
    (base / "bench/nail/nail_0").rename(base / "nail")
    (base / "flat").mkdir()
    for k in range(3):
        shutil.copyfile(base / f"bench/card/white_{k}.png", base / f"flat/{k}.png")
    (base / "lights.txt").write_text("0 0.5 0.8\n0.5 0 0.8\n-0.5 0 0.8\n")
    (base / "print").write_text(base64.b64encode((base / "result/print.png").read_bytes()).decode())
    (base / "key").write_text("0f" * 32)
    (base / "key").chmod(0o600)
    (base / "scores.csv").write_text(
        "label,score\n" + "".join(f"{k % 2},{k % 7}\n" for k in range(200))
    )


def stopped_once(name, base, tree, seconds, draw):
    """Stop one run of a verb; what is wrong afterwards."""
    out, gallery, number = tree / "out", tree / "people.skg", draw.choice(SIGNALS)
    port, asked = free_port(), list[bool]()
    words = command(name, base, out, gallery, port)
    if (base / f"{name}.out").exists():
        (shutil.copytree if (base / f"{name}.out").is_dir() else shutil.copyfile)(
            base / f"{name}.out", out
        )
    before, names = contents(out), set(contents(base / f"{name}.new"))
    after = {"gallery-remove": {"B"}, "enroll": {"A", "B", "C"}, "serve": {"A", "B", "C"}}
    possible = [{"A", "B"}, after.get(name, {"A", "B"})]

    def stop(child):
        if name == "serve":
            asked.append(served(child, port, base, number, draw.uniform(0.0, 1.05 * seconds)))
        else:
            time.sleep(draw.uniform(0.0, 1.05 * seconds))
            os.kill(child, number)

    def wrong(when):
        faults, there = [], contents(out)
        whole = there == before or set(there) == names
        if MANIFEST in there and there != before:
            whole &= set(manifest_of(out)) == set(there) - {MANIFEST}
        faults += (
            [] if whole or (name in PARTS and set(there) <= names) else [f"{when}: {sorted(there)}"]
        )
        # what was answered is there
        if people(gallery) not in (possible[1:] if True in asked else possible):
            faults.append(f"{when}: {sorted(people(gallery))}")
        return faults

    (tree / "log").touch()  # it may be stopped before it opens its log
    code = forked(words, tree / "log", stop)
    log = (tree / "log").read_text()
    stray = left_in(tree)
    faults = [] if code in (0, 130, -number) else [f"exit code {code}: {log[-200:]}"]
    faults += [f"Traceback: {log[-500:]}"] if "Traceback" in log else []
    if number != signal.SIGKILL:
        faults += [f"left: {stray}"] if stray else []
        return [*faults, *wrong("after the signal")]
    faults += wrong("after SIGKILL")
    again = f"gallery list {gallery}".split() if name == "serve" else words
    code = forked(again, tree / "log")  # what is done already is no longer possible
    faults += [] if code in (0, 2) else [f"the next run: exit code {code}"]
    faults += [f"left after the next run: {left_in(tree)}"] if left_in(tree) else []
    return [*faults, *wrong("after the next run")]


def main(arguments=None):
    """Stop every verb again and again; the number of findings as exit code, at most 1."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=4, help="of every verb")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)  # a fork has no threads of others
    draw, findings = random.Random(options.seed), 0
    with tempfile.TemporaryDirectory() as root:
        base = Path(root) / "base"
        base.mkdir()
        prepared(base)
        for name in VERBS:
            new, gallery, log, port = (
                base / f"{name}.new",
                base / "copy.skg",
                base / "log",
                free_port(),
            )
            if name != "serve":
                with contextlib.redirect_stdout(io.StringIO()):
                    # its modules are loaded, too
                    assert splitknit(command(name, base, new, gallery, port)) == 0, name
            words = command(name, base, base / f"{name}.again", gallery, port)
            started = time.perf_counter()
            if name == "serve":
                asked = partial(served, port=port, base=base, number=signal.SIGTERM, seconds=None)
                code = forked(words, log, asked)
                assert people(gallery) == {"A", "B", "C"}, log.read_text()
            else:
                code = forked(words, log)
            assert code in ((0, -signal.SIGTERM) if name == "serve" else (0,)), (
                name,
                code,
                log.read_text(),
            )
            seconds = time.perf_counter() - started
            if name not in ("export", "gallery-export", *PARTS):
                with contextlib.suppress(FileNotFoundError):
                    (base / f"{name}.again").rename(base / f"{name}.out")
            for run in range(options.runs):
                tree = Path(root) / f"{name}-{run}"
                tree.mkdir()
                faults = stopped_once(name, base, tree, seconds, draw)
                findings += len(faults)
                for fault in faults:
                    print(f"{name}: {fault}")
                shutil.rmtree(tree)
    print(f"{len(VERBS)} verbs, {options.runs * len(VERBS)} runs, {findings} findings")
    return int(findings > 0)


if __name__ == "__main__":
    sys.exit(main())
