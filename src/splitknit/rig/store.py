"""The folder that a sweep grows in: one file a candidate, whole or not there; taken up again where it was left."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splitknit import __version__
from splitknit.check import require
from splitknit.io import atomic_file, canonical_json, plain_json, settings_hash
from splitknit.io.fields import read_json
from splitknit.rig.candidates import Candidate
from splitknit.rig.study import Study

FORMAT = "splitknit-rig-sweep"
STUDY_FILE = "sweep.json"
CANDIDATES = "candidates"
OURS = re.compile(r"(sweep|results)\.json|results\.csv|index\.html|[a-z_]+\.svg|candidates/[\w.+-]+\.json")
_STRAY = re.compile(r"(.*/)?(\.[^/]*\.tmp|\.DS_Store|Thumbs\.db|desktop\.ini)")
"""What a killed run or a file manager leaves behind."""


class SweepFolder:
    """A folder of finished candidates of one study."""

    def __init__(self, out: Path, study: Study) -> None:
        """Make the folder, or see that it holds a sweep of this very study.

        Raises
        ------
        BadInput
            If `out` is a file, holds files that are not ours, or a sweep with other settings.
        """
        self.out = out
        self.document = json.loads(
            canonical_json({"format": FORMAT, "version": 1, "software": __version__, "study": study})
        )
        self.hash = settings_hash(self.document)
        require(not out.exists() or out.is_dir(), f"'{out}' is a file; name a folder to write into.")
        if out.is_dir() and self._files():
            self._check()
        else:
            self._write(out / STUDY_FILE, self.document)

    def read(self, candidate: Candidate) -> dict[str, Any] | None:
        """The candidate's record, or None where it is not finished (or its file is damaged)."""
        try:
            stored, _ = read_json(self._file(candidate))
            if stored["study_sha256"] != self.hash or stored["record"]["candidate"]["name"] != candidate.name:
                return None
            record: dict[str, Any] = stored["record"]
            return record
        except (ValueError, KeyError, TypeError):
            return None

    def write(self, candidate: Candidate, record: Mapping[str, Any]) -> None:
        """Keep a finished candidate."""
        self._write(self._file(candidate), {"study_sha256": self.hash, "record": plain_json(record)})

    def _file(self, candidate: Candidate) -> Path:
        return self.out / CANDIDATES / f"{candidate.name}.json"

    def _files(self) -> list[str]:
        found = (path for path in self.out.rglob("*") if path.is_symlink() or not path.is_dir())
        names = (path.relative_to(self.out).as_posix() for path in found)
        return sorted(name for name in names if not _STRAY.fullmatch(name))

    def _check(self) -> None:
        names = self._files()
        foreign = [name for name in names if not OURS.fullmatch(name)]
        require(
            not foreign and STUDY_FILE in names,
            f"'{self.out}' holds '{(foreign or names)[0]}' and no sweep of ours to go on with; name another folder.",
        )
        before, _ = read_json(self.out / STUDY_FILE, f"'{self.out / STUDY_FILE}' is damaged; name another folder.")
        changed = sorted(_differences(before, self.document))
        require(
            not changed,
            f"the sweep in '{self.out}' was made with other settings ({', '.join(changed)}); give the same ones, or "
            "name another folder.",
        )

    def _write(self, path: Path, document: Any) -> None:
        with atomic_file(path) as stream:
            stream.write((json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n").encode())


def _differences(before: Any, now: Any, where: str = "") -> set[str]:
    """Names of the settings that differ."""
    if isinstance(before, dict) and isinstance(now, dict):
        found: set[str] = set()
        for name in {*before, *now}:
            found |= _differences(before.get(name), now.get(name), f"{where}.{name}" if where else str(name))
        return found
    return set() if before == now else {where.removeprefix("study.") or "format"}
