"""Nothing leaves the machine: verbs that load a network send nothing, look up no name, and write
where they are told.

Each runs with a home of its own, without a network where that is permitted, and is watched: under
strace, which sees what compiled modules do, or, where there is none, by an audit hook of Python.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from splitknit.cli.app import build_app, words_of_verbs
from splitknit_simulator.population.folder import simulate_population
from splitknit_simulator.population.sessions import PopulationSettings

SYSCALLS = (
    "connect,sendto,sendmsg,sendmmsg,open,openat,openat2,creat,mkdir,mkdirat,mknod,mknodat,"
    "rename,renameat,renameat2,link,linkat,symlink,symlinkat"
)
HOOK = """
import json, os, sys
log = os.open(os.environ["AUDIT_LOG"], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
LAST = {"os.mkdir": 0, "os.rename": 1, "os.link": 1, "os.symlink": 1, "sqlite3.connect": 0}

def hook(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        writes = arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        kind, of = "write" if writes else "read", arguments[0]
    elif event in LAST:
        kind, of = "write", arguments[LAST[event]]
    elif event in ("socket.connect", "socket.sendto", "socket.sendmsg"):
        address = arguments[1]
        kind, of = ("address", address[0]) if isinstance(address, tuple) else ("write", address)
    elif event in ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr"):
        kind, of = "lookup", arguments[0]
    else:
        return
    if of is not None and not isinstance(of, int):
        of = os.fsdecode(of)
        of = os.path.abspath(of) if kind in ("read", "write") else of
        os.write(log, (json.dumps([kind, of]) + "\\n").encode())

sys.addaudithook(hook)
"""
VERBS = """
import json, sys
from splitknit.cli.main import main
for arguments in json.loads(sys.argv[1]):
    assert main(arguments) == 0, arguments
"""
PROCESSES = """
import sys
from splitknit_match.batch.cases import preset_cases
from splitknit_match.batch.engine import run_batch
from splitknit.cli.main import main
people = sys.argv[1]
assert main(["enroll", "all.skg", "--population", people, "--workers", "2", "--preset", "snk"]) == 0
run_batch(people, "store", cases=preset_cases(("snk",)), matchers=())
assert "onnxruntime" not in sys.modules  # but in the workers
"""
# metric runs its two networks from this size of the images on
DEMO_RUN = [["demo", "--scale", "0.165"]]
VERBS_RUN = [  # snk runs its network at any size
    ["reconstruct", "CAPTURE", "--out", "result", "--preset", "snk"],
    ["print", "CAPTURE", "--out", "print", "--preset", "snk"],
    ["match", "CAPTURE", "--template", "finger.skt", "--preset", "snk"],
    [
        "enroll",
        "one.skg",
        "CAPTURE",
        "--person",
        "one",
        "--finger",
        "right_index",
        "--preset",
        "snk",
    ],
    ["identify", "one.skg", "CAPTURE", "--preset", "snk"],
    ["export", "CAPTURE", "--to", "iso-19794-2", "--out", "records", "--preset", "snk"],
    ["batch", "PEOPLE", "--out", "store", "--cases", "pr", "--matchers", "none"],
]
NETWORKS = {
    "demo": ("relief.onnx", "shape.onnx"),
    "verbs": ("direct.onnx",),
    "processes": ("direct.onnx",),
}


SYSTEM = re.compile(r"/dev/(null|tty|shm/sem\.[^/]*)|/proc/self/[^/]*")


def works(*command):
    return (
        shutil.which(command[0]) is not None
        and not subprocess.run(command, capture_output=True, check=False).returncode
    )


def watched(code, folder, *arguments, strace):
    """Run Python code in `folder`; return what it reads, writes, looks up and connects to, and what
    it leaves."""
    outside, work = folder / "outside", folder / "work"
    for name in (outside / "home", outside / "tmp", outside / "log", outside / "hook", work):
        name.mkdir(parents=True)
    (outside / "hook" / "sitecustomize.py").write_text(HOOK)
    environment = {
        key: value
        for key, value in os.environ.items()
        if not key.startswith(("XDG_", "ORT_", "PYTEST"))
    }
    environment |= {
        "HOME": str(outside / "home"),
        "TMPDIR": str(outside / "tmp"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = ["unshare", "-rn"] if works("unshare", "-rn", "true") else []
    if strace:
        command += [*f"strace -ff -y --seccomp-bpf -qq -o {outside}/log/of -e".split(), SYSCALLS]
    else:
        path = os.pathsep.join(
            [str(outside / "hook"), *filter(None, [environment.get("PYTHONPATH")])]
        )
        environment |= {"PYTHONPATH": path, "AUDIT_LOG": str(outside / "log" / "of")}
    command += [sys.executable, "-c", code, *arguments]
    run = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=work, env=environment
    )
    assert run.returncode == 0, run.stdout + run.stderr
    lines = [
        line
        for log in (outside / "log").iterdir()
        for line in log.read_text(errors="replace").splitlines()
    ]
    events = (
        [event for line in lines for event in of_strace(line, work)]
        if strace
        else [tuple(json.loads(line)) for line in lines]
    )
    left = [*(outside / "home").rglob("*"), *(outside / "tmp").rglob("*")]
    return [*events, *(("left", str(path)) for path in left)]


def of_strace(line, work):
    """Events of one line of a log of strace -y."""
    call = line.partition("(")[0]
    if call in ("connect", "sendto", "sendmsg", "sendmmsg"):
        unix = [("write", path) for path in re.findall(r'sun_path="([^"]*)"', line)]
        return [
            *unix,
            *(
                ("address", address)
                for address in re.findall(r'(?:inet_addr\(|AF_INET6, )"([^"]*)"', line)
            ),
        ]
    if call not in SYSCALLS.split(",") or " = -1 " in line:
        return []
    *_, (base, name) = re.findall(r'(?:<([^>]*)>, )?"((?:[^"\\]|\\.)*)"', line)
    path = os.path.normpath(work / base / name)
    if path == "/etc/resolv.conf":
        return [("lookup", line)]
    reads = call.startswith("open") and not re.search("O_WRONLY|O_RDWR|O_CREAT", line)
    return [("read" if reads else "write", path)]


def violations(events, folder):
    allowed = [
        str(folder / "work"),
        str(folder / "outside" / "tmp"),
        str(folder / "outside" / "log"),
    ]
    return [
        (kind, of)
        for kind, of in events
        if kind in ("lookup", "left")
        or (kind == "address" and not (of.startswith("127.") or of == "::1"))
        or (
            kind == "write"
            and not any(of == folder or of.startswith(folder + os.sep) for folder in allowed)
            and not SYSTEM.fullmatch(of)
        )
    ]


STRACE = works("strace", "-f", "true")


@pytest.fixture(params=["strace", "audit hook"])
def strace(request):
    if request.param == "strace" and not STRACE:
        pytest.skip("strace is not installed, or may not trace")
    return request.param == "strace"


PLANTED = {
    "connection": (
        "address",
        "import socket; socket.socket(type=socket.SOCK_DGRAM).connect_ex(('192.0.2.1', 9))",
    ),
    "look-up": (
        "lookup",
        "import socket\ntry: socket.getaddrinfo('splitknit.invalid', 9)\nexcept OSError: pass",
    ),
    "file in the home": (
        "write",
        "import pathlib; pathlib.Path.home().joinpath('id').write_text('x')",
    ),
    "folder beside the output": ("write", "import os; os.mkdir('../id')"),
    "moved there": ("write", "import os; open('id', 'w').close(); os.rename('id', '../id')"),
    "temporary file left": ("left", "import tempfile; tempfile.mkstemp()"),
    "telemetry of onnxruntime": ("left", "import onnxruntime"),
}


@pytest.mark.parametrize("what", PLANTED)
def test_what_leaves_is_seen(tmp_path, what, strace):
    kind, code = PLANTED[what]
    seen = violations(watched(code, tmp_path, strace=strace), tmp_path)
    if what.startswith("telemetry") and not seen:
        pytest.skip("this onnxruntime has no telemetry")
    assert kind in {kind for kind, _ in seen}


def test_what_stays_is_allowed(tmp_path, strace):
    code = (
        "import socket, tempfile; socket.socket(type=socket.SOCK_DGRAM).connect_ex(('127.0.0.1',"
        " 9)); "
    )
    code += (
        "tempfile.TemporaryFile().close(); open('result', 'w').close(); open('/etc/passwd').close()"
    )
    events = watched(code, tmp_path, strace=strace)
    assert ("address", "127.0.0.1") in events and ("read", "/etc/passwd") in events
    assert violations(events, tmp_path) == []


FINGERS = ("right_index", "left_index")


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    """Two fingers, 132 x 192 pixels."""
    folder = tmp_path_factory.mktemp("watched") / "people"
    simulate_population(
        folder,
        PopulationSettings(seed=4, scale=0.06),
        subjects=1,
        sessions=1,
        fingers=FINGERS,
        workers=1,
    )
    return folder


@pytest.mark.parametrize(
    "run", ["verbs", "processes", pytest.param("demo", marks=pytest.mark.slow)]
)
def test_nothing_leaves_the_machine(tmp_path, people, run):
    places = {"PEOPLE": str(people), "CAPTURE": str(people / "S01" / "session_1" / "right_index")}
    before = sorted(people.rglob("*"))
    if run != "processes":
        arguments = [
            [places.get(word, word) for word in verb]
            for verb in (VERBS_RUN if run == "verbs" else DEMO_RUN)
        ]
        events = watched(VERBS, tmp_path, json.dumps(arguments), strace=STRACE)
    else:
        events = watched(PROCESSES, tmp_path, str(people), strace=STRACE)
    assert {Path(of).name for _, of in events if of.endswith(".onnx")} == set(NETWORKS[run])
    assert violations(events, tmp_path) == []
    assert sorted(people.rglob("*")) == before


def test_every_verb_that_loads_a_network_is_watched():
    app = build_app()
    options = {
        words[0]: {
            option
            for argument in app[words[0]].assemble_argument_collection()
            for option in argument.names
        }
        for words in words_of_verbs(app)
        if app[words[0]].default_command is not None
    }
    reconstruct = {name for name, names in options.items() if {"--preset", "--cases"} & names}
    assert reconstruct | {"demo"} == {verb[0] for verb in DEMO_RUN + VERBS_RUN}
