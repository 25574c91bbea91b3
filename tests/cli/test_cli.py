import ast
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import splitknit_match
from handmade import capture_of, finger
from splitknit import pipeline
from splitknit.cli.app import build_app, options_of, words_of_verbs
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.capture import write_capture
from splitknit.report.result import FILES


@pytest.fixture
def capture_folder(tmp_path):
    result, truth = finger()
    write_capture(capture_of(result), tmp_path / "capture", truth)
    return tmp_path / "capture"


@pytest.fixture
def seen(monkeypatch):
    """Put a stage of our own in the pipeline's place; return what it was called with."""
    calls = {}

    def stand_in(capture, preset="metric", settings=None, progress=None, kept=None):
        calls.update(
            preset=preset,
            settings=dict(settings or {}),
            shape=capture.shape,
            tip=capture.tip_direction_deg,
        )
        if progress is not None:
            progress("normals", 0.5)
        if "raise" in calls:
            raise calls["raise"]
        return finger(preset=preset)[0]

    monkeypatch.setattr(pipeline, "reconstruct", stand_in)
    return calls


def test_reconstruct_writes_and_says_so(capture_folder, seen, capsys):
    out = capture_folder.parent / "result"
    code = main(
        f"reconstruct {capture_folder} --out {out} --preset snk --set knit.method=addition".split()
    )
    output = capsys.readouterr()
    assert code == 0
    assert seen == {
        "preset": "snk",
        "settings": {"knit.method": "addition"},
        "shape": (440, 640),
        "tip": None,
    }
    assert {path.name for path in out.iterdir()} >= set(FILES)
    assert "preset snk" in output.out
    assert "Please note: No flexion crease is in view" in output.out
    assert "Against the truth (snk): surface rms 0.000 mm" in output.out
    assert str(out / "report.html") in output.out
    assert output.err == ""  # no progress in a pipe


def test_json_is_one_object_and_nothing_else(capture_folder, seen, capsys):
    out = capture_folder.parent / "result"
    assert main(f"reconstruct {capture_folder} --out {out} --json".split()) == 0
    output = capsys.readouterr()
    facts = json.loads(output.out)
    assert facts["preset"] == "metric"
    assert facts["files"] == list(FILES)
    assert facts["findings"][0]["severity"] in ("spoils", "doubt", "note")
    assert facts["comparison"]["metric"]["ridge_correlation"] > 0.99
    assert output.err == ""


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (BadInput("the mask is\nempty."), 2, r"capture: the mask is\nempty."),
        (
            KeyError("height"),
            1,
            "KeyError: 'height' (internal error, please report it; --traceback shows where)",
        ),
        (ValueError("no BadInput"), 1, "internal error, please report it"),
        (MemoryError(), 1, "not enough memory"),
        (KeyboardInterrupt(), 130, "interrupted; nothing was left half-written"),
    ],
)
def test_failures_have_their_codes(  # noqa: PLR0917
    capture_folder, seen, capsys, error, code, words
):
    seen["raise"] = error
    out = capture_folder.parent / "deep" / "result"
    assert main(f"reconstruct {capture_folder} --out {out}".split()) == code
    output = capsys.readouterr()
    assert words in output.err
    assert output.err.count("\n") == 1
    assert "Traceback" not in output.err
    assert output.out == ""
    assert [path.name for path in capture_folder.parent.iterdir()] == ["capture"]


def test_a_folder_of_another_user_is_one_sentence(monkeypatch, capsys):
    def denied(options):
        raise PermissionError(13, "Permission denied", "theirs/x")

    monkeypatch.setattr("splitknit.io.results.read_result", denied)
    assert main(["profile", "theirs/x", "1,1", "2,2"]) == 2
    assert (
        capsys.readouterr().err
        == "splitknit: error: 'theirs/x' cannot be reached: Permission denied.\n"
    )


def test_traceback_is_shown_on_request(capture_folder, seen, capsys):
    seen["raise"] = RuntimeError("odd")
    out = capture_folder.parent / "result"
    assert main(f"reconstruct {capture_folder} --out {out} --traceback".split()) == 1
    assert "stand_in" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        "",
        "dance",
        "reconstruct",
        "reconstruct x",
        "reconstruct x --out y --preset best",
        "simulate --out x --scale nan",
        "simulate --out x --scale 7",
        "simulate --out x --set scale",
        "simulate --out x --set scale=-1",
        "simulate --out x --set no.such=1",
        "simulate --out x --pattern paisley",
        "simulate --out x --settings nowhere.toml",
    ],
)
def test_wrong_usage_is_code_2(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments.split()) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", ["--help", "--version", "demo --help", "simulate --help"])
def test_help_is_code_0(arguments, capsys):
    assert main(arguments.split()) == 0
    assert "splitknit" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full device")
@pytest.mark.parametrize(
    "words", [["--version"], ["match", "--help"], ["simulate", "--scale", "0.05", "--out", "OUT"]]
)
def test_a_closed_pipe_is_no_error_and_a_full_disk_is_one_sentence(tmp_path, words):
    command = [
        sys.executable,
        "-m",
        "splitknit",
        *(str(tmp_path / "out") if word == "OUT" else word for word in words),
    ]
    reading, closed = os.pipe()
    os.close(reading)
    with os.fdopen(closed, "wb") as pipe:
        run = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")
    with Path("/dev/full").open("wb") as full:
        again = [*command, "--overwrite"] if words[0] == "simulate" else command
        run = subprocess.run(again, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert run.returncode == 2
    assert (
        run.stderr.startswith("splitknit: error: stdout cannot be written: No space left")
        and "done" in run.stderr
    )
    assert run.stderr.count("\n") == 1
    assert words[0] != "simulate" or (tmp_path / "out" / "capture.json").is_file()


INTERRUPTED_AT_IMPORT = """
import os, sys
which, number, seen = int(sys.argv.pop(1)), int(sys.argv.pop(1)), 0

def interrupt(event, arguments):
    global seen
    if event == "import" and (seen or arguments[0] == "splitknit.cli.app"):  # the first of main's
        seen += 1
        if seen == which:
            os.kill(os.getpid(), number)

sys.addaudithook(interrupt)
from splitknit.cli.main import main
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("which", "number"), [(1, signal.SIGTERM), (100, signal.SIGINT), (300, signal.SIGTERM)]
)
def test_an_interrupt_in_an_import_is_one_line(tmp_path, which, number):
    """Of the verb, of numpy, of what the verb loads."""
    arguments = [str(which), str(int(number)), "reconstruct", "nowhere", "--out", "x"]
    assert_interrupted(INTERRUPTED_AT_IMPORT, *arguments, cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


def assert_interrupted(code, *arguments, cwd=None):
    """One line and no more where `code` runs the program, which is interrupted."""
    run = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
    )
    assert (run.returncode, run.stderr) == (
        130,
        "splitknit: interrupted; nothing was left half-written.\n",
    )


@pytest.mark.parametrize("error", ["ImportError", "BadInput"])
def test_an_interrupt_that_a_module_makes_an_error_of_is_one(error):
    """As pybind11 does where the import of a compiled module is interrupted."""
    code = f"""
import os, signal, sys
from splitknit import pipeline
from splitknit.cli import main as cli

def run(*given, **named):
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt as error:
        raise {error}("initialization failed") from error

import splitknit.io.results
splitknit.io.results.read_result = run
sys.exit(cli.main())
"""
    assert_interrupted(code, "profile", "a", "1,1", "2,2")


def test_an_interrupt_in_a_finalizer_ends_the_verb():
    """Python prints and forgets an exception of a weak reference's callback."""
    code = """
import os, signal, sys, time, weakref
from splitknit.cli import main as cli

class Image:
    pass

def interrupted(*arguments, **options):
    image = Image()
    finalizer = weakref.ref(image, lambda _: os.kill(os.getpid(), signal.SIGINT))
    del image
    time.sleep(10)

import splitknit.io.results
splitknit.io.results.read_result = interrupted
sys.exit(cli.main())
"""
    assert_interrupted(code, "profile", "a", "1,1", "2,2")


def test_an_interrupt_at_exit_is_no_traceback():
    code = "import atexit, os, signal, sys; from splitknit.cli.main import main; "
    code += (
        "atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT)); sys.argv[1:] = ['simulate'];"
        " main()"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 130
    assert run.stderr.endswith("splitknit: interrupted; nothing was left half-written.\n")
    assert "Traceback" not in run.stderr


def test_the_program_begins_with_next_to_no_imports():
    """Until its main begins, an interrupt is Python's own and shows a traceback."""
    code = "import sys; from splitknit.cli import main as cli; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(run.stdout.split()) & {"contextlib", "cyclopts", "json", "numpy", "typing"}


@pytest.mark.parametrize(
    "arguments",
    [
        ["reconstruct", "no\nwhere\x1b[1m", "--out", "x"],
        ["match", "no\nwhere\x1b[1m", "no\nwhere\x1b[1m", "--json"],
        ["simulate", "--out", "x", "--seed", "a\nb\x1b[1m"],
        ["simulate", "--out", "x", "--set", "a\nb\x1b[1m"],
        ["simulate", "--out", "x", "--no\nsuch\x1b[1m"],
    ],
)
def test_an_error_is_one_line_whatever_it_quotes(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    (line,) = [
        line for line in capsys.readouterr().err.split("\n") if "error:" in line or "\x1b" in line
    ]
    assert line.startswith("splitknit") and line.isprintable()
    assert "x1b[1m" in line


def test_a_success_moves_no_cursor_whatever_its_files_are_called(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--scale", "0.05", "--out", "a\x1b[2Jb\nc\u202eexe"]) == 0
    out = capsys.readouterr().out
    assert all(line.isprintable() for line in out.split("\n"))
    assert "a\\x1b[2Jb\\nc\\u202eexe" in out


ASCII = (
    {"PYTHONIOENCODING": "ascii"},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
)


@pytest.mark.parametrize("ascii_only", ASCII)
def test_what_a_terminal_cannot_show_is_escaped(ascii_only):
    """Facts, errors and argparse's messages; the result may be written already."""
    program = "import sys; from splitknit import profile; from splitknit.arguments import Report; "
    program += "from splitknit.cli import main as cli; "
    program += "profile.profile = lambda: Report({}, ['3 mm' + chr(178)]); sys.exit(cli.main())"
    for arguments, code, wanted in (
        (["profile"], 0, "3 mm\\xb2"),
        (["profile", "²"], 2, "Unused Tokens"),
    ):
        run = subprocess.run(
            [sys.executable, "-c", program, *arguments],
            capture_output=True,
            check=False,
            env={**os.environ, **ascii_only},
        )
        assert run.returncode == code, run.stderr
        assert wanted in (run.stdout + run.stderr).decode("ascii")


def test_a_kill_leaves_nothing_behind(tmp_path):
    """SIGTERM in the middle of the work: code 130 and an empty folder."""
    code = (
        "import os, signal, sys; sys.argv = ['splitknit', 'simulate', '--out', sys.argv[1]]; "
        "from splitknit.cli import main as cli; from splitknit_simulator import twin; "
        "twin.simulate_capture = lambda *_, **__: os.kill(os.getpid(), signal.SIGTERM); "
        "sys.exit(cli.main())"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 130, run.stderr
    assert "interrupted" in run.stderr
    assert list(tmp_path.iterdir()) == []


def test_experiments_and_benchmarks_import_no_command_line():
    """They call the library, or run the program."""
    root = Path(__file__).resolve().parents[2]
    scripts = [
        script
        for folder in ("validation", "benchmarks", "examples")
        for script in (root / folder).rglob("*.py")
    ]
    assert len(scripts) > 50
    imported = re.compile(r"^\s*(from|import) splitknit\.cli", re.MULTILINE)
    assert [
        script.name for script in scripts if imported.search(script.read_text(encoding="utf-8"))
    ] == []


OF_FUNCTIONS = {"intensities", "memory", "pitch_mm", "resolution_ppi", "view"}
"""Arguments of functions that no verb has."""


@pytest.mark.slow
def test_arguments_that_messages_name_are_fields_of_verbs():
    """A message of the library names an argument between backticks; the command line writes its
    option."""
    app = build_app()
    known = OF_FUNCTIONS.union(*(options_of(app, words) for words in words_of_verbs(app)))
    named = set()
    for file in (Path(__file__).parents[2] / "packages").glob("*/src/**/*.py"):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") in (
                "require",
                "BadInput",
                "Refused",
            ):
                texts = [node.value for node in ast.walk(call) if isinstance(node, ast.Constant)]
                named |= {
                    name for text in texts for name in re.findall("`([a-z_0-9]+)`", str(text))
                }
    assert len(named) > 20
    assert named - known == set()


def test_an_error_names_the_option(tmp_path, capsys):
    words = f"identify {tmp_path}/people.skg {tmp_path} --top 0".split()
    assert main(words) == 2
    assert capsys.readouterr().err == "splitknit: error: --top must be at least 1, but it is 0.\n"
    with pytest.raises(BadInput, match="`top` must be at least 1, but it is 0"):
        splitknit_match.identify(tmp_path / "people.skg", tmp_path, top=0)
