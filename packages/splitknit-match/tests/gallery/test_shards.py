"""Shards: renewable codes in mapped files; what a search finds, what is refused, what a key hides."""

from __future__ import annotations

import builtins
import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.gallery.key import Key, code_secret
from splitknit_match.gallery.shards import RESCORED, Shards, _seal, rescored_count, write_shards
from splitknit_match.matching.code import ProbeSettings, code_of, code_size, probe_codes
from splitknit_match.matching.renewable import BITS, RenewableCode
from splitknit_match.matching.template import Template

KEY, OTHER = Key(bytes(range(32)), raw=True), Key(bytes(32), raw=True)
COUNT, MINE = 3000, 1234


def finger(seed: int) -> Template:
    """Ridges of one direction, with noise: 20 mm square."""
    rng = np.random.default_rng(seed)
    down, right = np.mgrid[0:200, 0:200] * 0.1
    turn = 0.5 + 0.04 * right
    wave = np.cos(2 * np.pi * (np.cos(turn) * right + np.sin(turn) * down) / 0.5) + rng.normal(0, 0.2, (200, 200))
    return Template(np.digitize(wave, (-0.7, 0, 0.7)).astype(np.uint8), np.ones((200, 200), bool), 0.1)


@pytest.fixture(scope="module")
def codes() -> np.ndarray:
    """Codes of nobody, some of them the same, and one of the finger."""
    found = np.random.default_rng(0).normal(0, 26, (COUNT, code_size()))
    found = (360 * found / np.linalg.norm(found, axis=1, keepdims=True)).round().clip(-127, 127).astype(np.int8)
    found[100:130] = found[100]
    found[MINE] = code_of(finger(1))
    return found


@pytest.fixture(scope="module")
def folder(codes: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three shards under a key; rows count in sevens; not to be changed."""
    out = tmp_path_factory.mktemp("shards") / "codes"
    facts = write_shards(out, 7 * np.arange(COUNT), codes, KEY, rows_a_shard=10_000)
    assert facts["written"] == 3
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


def test_the_finger_is_found_and_the_best_are_those_of_the_codes(folder: Path, codes: np.ndarray) -> None:
    shards = Shards(folder, KEY)
    assert len(shards) == COUNT
    hits = shards.search(finger(2), 5)
    assert hits.rows[0] == 7 * MINE
    variants = probe_codes(finger(2))
    products = variants @ codes[hits.rows // 7].T.astype(np.float32)
    assert np.allclose(hits.similarity, products.max(axis=0), atol=0.02)
    assert hits.variant[0] == products[:, 0].argmax()
    assert (np.diff(hits.similarity) <= 0).all()


def test_bits_come_before_numbers_and_equal_ones_by_row(folder: Path, codes: np.ndarray) -> None:
    """By arithmetic of its own: the nearest thousand by Hamming distance, then the best of these by products."""
    shards, probe = Shards(folder, KEY), finger(3)
    settings = ProbeSettings()
    coarse, ready = shards._code.probe(probe_codes(probe, settings))
    bits, fine = shards._code.stored(codes)
    apart = np.unpackbits(bits[:, None] ^ coarse[settings.coarse()][None], axis=2).sum(axis=2, dtype=int).min(axis=1)
    near = np.lexsort((np.arange(COUNT), apart))[: rescored_count(COUNT)]
    best = (ready @ fine[near].T.astype(np.float32)).max(axis=0)
    order = np.lexsort((near, -best))[:400]
    hits = shards.search(probe, 400)
    assert hits.rows.tolist() == (7 * near[order]).tolist()
    assert hits.similarity.tolist() == best[order].tolist()


def test_shards_threads_and_numpy_change_nothing(
    folder: Path, codes: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    faiss = pytest.importorskip("faiss")
    shards, probe = Shards(folder, KEY), finger(2)
    # the same salt in one file: as if the folder had been begun with it
    header = json.loads(shards.files[0].read_bytes()[:4096])
    monkeypatch.setattr("splitknit_match.gallery.shards.os.urandom", lambda count: bytes.fromhex(header["salt"]))
    write_shards(tmp_path / "one", 7 * np.arange(COUNT), codes, KEY)
    expected = shards.search(probe, 900)
    found = [Shards(tmp_path / "one", KEY).search(probe, 900)]
    before = faiss.omp_get_max_threads()
    for threads in (1, 3):
        faiss.omp_set_num_threads(threads)
        found.append(shards.search(probe, 900))
    faiss.omp_set_num_threads(before)
    real = builtins.__import__

    def without_faiss(name: str, *rest: object) -> object:
        if name == "faiss":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_faiss)
    found.append(shards.search(probe, 900))
    for one in found:
        assert one.rows.tolist() == expected.rows.tolist()
        assert one.similarity.tolist() == expected.similarity.tolist()


def test_in_steps_or_at_once_the_bytes_are_the_same(codes: np.ndarray, tmp_path: Path) -> None:
    rows = np.arange(COUNT)
    out = tmp_path / "codes"
    write_shards(out, rows[:900], codes[:900], rows_a_shard=1000)
    first = contents(out)
    facts = write_shards(out, rows, codes, rows_a_shard=1000)
    assert (facts["written"], facts["kept"]) == (3, 0)
    facts = write_shards(out, rows[rows != 2500], codes[rows != 2500], rows_a_shard=1000)
    assert (facts["written"], facts["kept"]) == (1, 2)
    assert 2500 not in Shards(out).search(finger(1), 900).rows
    write_shards(out, rows[:900], codes[:900], rows_a_shard=1000)
    assert contents(out) == first
    write_shards(out, rows[:900], codes[:900], rows_a_shard=1000, renew=True)
    assert contents(out).keys() == first.keys()
    assert contents(out) != first


def test_what_a_killed_run_left_goes_where_nothing_is_written(codes: np.ndarray, tmp_path: Path) -> None:
    write_shards(tmp_path, np.arange(10), codes[:10], KEY)
    left = tmp_path / ".splitknit-0123456789ab.tmp"
    left.mkdir()
    (left / "mark.json").write_text('{"format": "splitknit-temporary", "version": 1, "target": "shards.json"}')
    assert write_shards(tmp_path, np.arange(10), codes[:10], KEY)["written"] == 0
    assert not left.exists()


def test_a_stolen_file_is_worthless_beside_the_renewed_one(codes: np.ndarray) -> None:
    """Distances of the same fingers under two keys are those of other fingers under two keys: D_sys by ISO/IEC 30136
    is measured by ``validation/match/shards.py``."""
    one, other = (RenewableCode(secret).stored(codes) for secret in (b"one", b"other"))
    same = np.unpackbits(one[0] ^ other[0], axis=1).sum(axis=1, dtype=int)
    strange = np.unpackbits(one[0] ^ np.roll(other[0], 500, axis=0), axis=1).sum(axis=1, dtype=int)
    assert abs(same.mean() - BITS / 2) < 1
    assert abs(same.mean() - strange.mean()) < 1
    assert abs(same.std() / strange.std() - 1) < 0.1
    products = np.einsum("nk,nk->n", one[1].astype(float), other[1].astype(float)) / 360**2
    assert abs(products.mean()) < 0.01


def test_a_transform_keeps_angles_and_follows_from_the_key(codes: np.ndarray) -> None:
    bits, fine = RenewableCode(b"a secret").stored(codes)
    before, after = (values[:200].astype(float) @ values[:200].T.astype(float) / 360**2 for values in (codes, fine))
    assert np.abs(before - after).max() < 0.02
    again = RenewableCode(b"a secret").stored(codes)
    assert np.array_equal(bits, again[0])
    assert np.array_equal(fine, again[1])
    cosine = after[0, 1:] / after[0, 0]
    apart = np.unpackbits(bits[:1] ^ bits[1:200], axis=1).sum(axis=1, dtype=int)
    assert np.abs(np.cos(np.pi * apart / BITS) - cosine).max() < 0.25  # Goemans and Williamson
    # the very bytes: a shard that was written today is searched in years
    bits, fine = RenewableCode(b"a secret").stored(np.arange(-96, 96, dtype=np.int8)[None])
    assert (bits[0, :4].tolist(), fine[0, :4].tolist()) == ([241, 158, 115, 249], [18, 12, 8, 5])


def test_few_variants_have_their_bits_compared() -> None:
    settings = ProbeSettings()
    turns, right, down = settings.variants()
    kept = settings.coarse()
    found = {(round(np.rad2deg(turns[n])), int(right[n]), int(down[n])) for n in kept.tolist()}
    assert found == {(0, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (10, 0, 0), (-10, 0, 0)}
    assert len(ProbeSettings(turn_deg=0, right_mm=0, down_mm=0).coarse()) == 1
    assert len(ProbeSettings(turn_deg=20, right_mm=4, down_mm=4).coarse()) == 5 * 5 * 5 + 4 + 4


def test_how_many_are_rescored() -> None:
    assert [rescored_count(n) for n in (10, 1000, 100_000, 10**6, 10**8)] == [10, 1000, 1000, RESCORED, RESCORED]


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lambda data: data[:-1], "not a shard of codes, or damaged"),
        (lambda data: data + b"x", "not a shard of codes, or damaged"),
        (lambda data: data[:100], "not a shard of codes, or damaged"),
        (lambda data: b"", "not a shard of codes, or damaged"),
        (lambda data: data.replace(b'"rows": 1429', b'"rows": 9**9', 1), "not a shard of codes, or damaged"),
        (lambda data: data.replace(b'"rows": 1429', b'"rows": -429', 1), "not a shard of codes, or damaged"),
        (lambda data: data.replace(b'"code_version": 1', b'"code_version": 9', 1), "of another version"),
        (lambda data: data.replace(b"splitknit-code", b"somebody-elses", 1), "not a shard of codes, or damaged"),
    ],
)
def test_damaged_files_are_refused_before_they_are_mapped(folder: Path, tmp_path: Path, harm, words: str) -> None:
    out = tmp_path / "codes"
    out.mkdir()
    for name, data in contents(folder).items():
        changed = harm(data) if name == "codes-000000.skc" else data
        assert changed != data or name != "codes-000000.skc"
        (out / name).write_bytes(changed)
    with pytest.raises(BadInput, match=words):
        Shards(out, KEY)


HEADER = 4096


def flipped(file: Path, place: int) -> None:
    data = bytearray(file.read_bytes())
    data[place] ^= 1
    file.write_bytes(data)


def exchanged(folder: Path) -> None:
    """Another shard's rows and codes in the place of the first's."""
    (folder / "codes-000000.skc").write_bytes((folder / "codes-000001.skc").read_bytes())


def unsealed(folder: Path) -> None:
    """A row number is changed, and the list is made anew, but for the key."""
    flipped(folder / "codes-000000.skc", HEADER)
    document = json.loads((folder / "shards.json").read_text())
    document["shards"]["codes-000000.skc"] = hashlib.sha256((folder / "codes-000000.skc").read_bytes()).hexdigest()
    header = json.loads((folder / "codes-000000.skc").read_bytes()[:HEADER])
    document["seal"] = _seal(document["shards"], code_secret(None, bytes.fromhex(header["salt"])))
    (folder / "shards.json").write_text(json.dumps(document))


TAMPERED: dict[str, Callable[[Path], object]] = {
    "a row number": lambda folder: flipped(folder / "codes-000000.skc", HEADER),
    "a bit": lambda folder: flipped(folder / "codes-000001.skc", HEADER + 9 * 1429),
    "a number": lambda folder: flipped(folder / "codes-000002.skc", -1),
    "one taken away": lambda folder: (folder / "codes-000001.skc").unlink(),
    "one added": lambda folder: shutil.copy(folder / "codes-000000.skc", folder / "codes-000009.skc"),
    "one exchanged": exchanged,
    "no list": lambda folder: (folder / "shards.json").unlink(),
    "a damaged list": lambda folder: (folder / "shards.json").write_text('{"shards": []}'),
    "a list without the key": unsealed,
}


@pytest.mark.parametrize("what", TAMPERED)
def test_what_something_else_changed_is_found_and_made_anew(
    folder: Path, codes: np.ndarray, tmp_path: Path, what: str
) -> None:
    """One changed row number made a match "no match"."""
    out = Path(shutil.copytree(folder, tmp_path / "codes"))
    before = contents(out)
    assert Shards(out, KEY).search(finger(2), 5).rows[0] == 7 * MINE
    TAMPERED[what](out)
    with pytest.raises(BadInput, match=r"are not those that were last written .* gallery index"):
        Shards(out, KEY).search(finger(2), 5)
    write_shards(out, 7 * np.arange(COUNT), codes, KEY, rows_a_shard=10_000)
    assert contents(out) == before
    assert Shards(out, KEY).search(finger(2), 5).rows[0] == 7 * MINE


def test_a_change_under_an_open_folder_is_found(folder: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(folder, tmp_path / "codes"))
    shards = Shards(out, KEY)
    shards.search(finger(2), 5)
    flipped(out / "codes-000000.skc", HEADER)
    with pytest.raises(BadInput, match="are not those that were last written"):
        shards.search(finger(2), 5)


def test_every_byte_is_compared_with_the_gallery(folder: Path, codes: np.ndarray, tmp_path: Path) -> None:
    """Without a key anyone can make list and digests anew; the gallery's codes remain."""
    rows = 7 * np.arange(COUNT)
    Shards(folder, KEY).require_same(rows, codes)
    for other in ((rows[:-1], codes[:-1]), (rows + 1, codes), (rows, np.roll(codes, 1, axis=0))):
        with pytest.raises(BadInput, match="does not hold the codes of the gallery"):
            Shards(folder, KEY).require_same(*other)
    out = tmp_path / "plain"
    write_shards(out, rows, codes)
    Shards(out).require_same(rows, codes)
    unsealed(out)
    assert 7 * MINE in Shards(out).search(finger(2), 5).rows
    with pytest.raises(BadInput, match="does not hold the codes of the gallery"):
        Shards(out).require_same(rows, codes)


def test_keys_that_do_not_fit(folder: Path, codes: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="holds no shards"):
        Shards(tmp_path)
    with pytest.raises(BadInput, match="with a key; give it"):
        Shards(folder)
    with pytest.raises(BadInput, match="the key is not that"):
        Shards(folder, OTHER)
    with pytest.raises(BadInput, match="the key is not that"):
        write_shards(folder, np.arange(3), codes[:3], OTHER)
    write_shards(tmp_path, np.arange(3), codes[:3])
    with pytest.raises(BadInput, match="without a key"):
        Shards(tmp_path, KEY)
    write_shards(tmp_path, np.arange(3), codes[:3], KEY, renew=True)
    assert len(Shards(tmp_path, KEY)) == 3
    opened = Shards(tmp_path, KEY)
    (tmp_path / "codes-000000.skc").write_bytes((folder / "codes-000000.skc").read_bytes())
    with pytest.raises(BadInput, match="of another key than the probe"):
        opened.search(finger(1), 10)
    write_shards(tmp_path, np.arange(3), codes[:3], KEY, renew=True)
    (tmp_path / "codes-000007.skc").write_bytes((folder / "codes-000000.skc").read_bytes())
    with pytest.raises(BadInput, match="several keys"):
        Shards(tmp_path, KEY)


def test_codes_that_are_none(codes: np.ndarray, tmp_path: Path) -> None:
    for rows, wrong in (([1, 1], codes[:2]), ([2, 1], codes[:2]), ([1], codes[:2]), ([1], codes[:1].astype(float))):
        with pytest.raises(BadInput):
            write_shards(tmp_path / "codes", np.array(rows), wrong)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(BadInput, match="cannot be a folder of shards"):
        write_shards(tmp_path / "file", np.arange(3), codes[:3])
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "shards.json").write_text("mine")
    with pytest.raises(BadInput, match="is not empty and holds no shards"):
        write_shards(tmp_path / "mine", np.arange(3), codes[:3])
    write_shards(tmp_path / "linked", np.arange(3), codes[:3])
    (tmp_path / "linked" / "codes-000000.skc").unlink()
    (tmp_path / "linked" / "codes-000000.skc").symlink_to(tmp_path / "file")
    with pytest.raises(BadInput, match="is a link, through which nothing is written"):
        write_shards(tmp_path / "linked", np.arange(3), codes[:3])
    assert [(tmp_path / name).read_text() for name in ("file", "mine/shards.json")] == ["mine", "mine"]
    with pytest.raises(BadInput, match="no code to keep"):
        write_shards(tmp_path / "codes", np.zeros(0, np.int64), codes[:0])
    with pytest.raises(BadInput, match="k must be at least 1"):
        write_shards(tmp_path / "codes", np.arange(3), codes[:3])
        Shards(tmp_path / "codes").search(finger(1), 0)
