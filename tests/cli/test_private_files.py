"""What the command line writes is readable by its owner alone, or by the group where that is asked
for."""

import os
import stat

import pytest

from splitknit.cli.main import main
from splitknit.io.atomic import GROUP_READABLE


def _modes(folder):
    modes = {path: stat.S_IMODE(path.stat().st_mode) for path in folder.rglob("*")}
    return {m for p, m in modes.items() if p.is_file()}, {m for p, m in modes.items() if p.is_dir()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "modes"), [([], (0o600, 0o700)), (["--group-readable"], (0o640, 0o750))]
)
def test_verbs_write_private_files(option, modes, twin_folder, tmp_path, capsys):
    out = tmp_path / "out"
    before = os.environ.get(GROUP_READABLE, "")
    umask = os.umask(0)
    try:
        for words in (
            f"reconstruct {twin_folder} --preset ea --keep-steps --out {out}/result".split(),
            ["match", str(out / "result"), "--template", str(out / "templates" / "a.skt")],
            ["print", str(out / "result"), "--out", str(out / "print")],
            f"enroll {out}/people.skg {out}/result --person A --finger left_index".split(),
            f"gallery export {out}/people.skg --out {out}/exported".split(),
            f"simulate --scale 0.1 --out {out}/capture".split(),
        ):
            assert main([*words, *option]) == 0, capsys.readouterr().err
            assert os.environ.get(GROUP_READABLE, "") == before
    finally:
        os.umask(umask)
    files, folders = _modes(out)
    assert files == {modes[0]}
    assert folders == {modes[1]}
