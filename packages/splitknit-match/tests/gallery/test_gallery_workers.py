"""A gallery searched by the workers of a cluster: the answers of one machine, whoever is lost."""

import os
import pickle
import signal
import sys

import pytest

import splitknit_match
from clusters import local_cluster
from refusals import bad_input
from splitknit.cli.main import main
from splitknit_match.gallery.file import _part

from test_open_gallery import PPI, press  # isort: skip


@pytest.fixture(scope="module")
def templates():
    return {
        f"p{seed}": splitknit_match.make_template(press(seed), resolution_ppi=PPI).payload or b""
        for seed in range(1, 7)
    }


@pytest.fixture(scope="module")
def probe():
    """The finger of p2, pressed again."""
    return splitknit_match.make_template(press(2, -7, 12.0), resolution_ppi=PPI).payload


@pytest.fixture
def file(templates, tmp_path, monkeypatch):
    """A gallery of three parts, searched by its indexes."""
    monkeypatch.setattr("splitknit_match.gallery.file.PART", 2)
    monkeypatch.setattr("splitknit_match.gallery.identify.ALL_PRINTS", 1)
    with splitknit_match.Gallery(tmp_path / "g.skg") as gallery:
        for name, template in templates.items():
            gallery.enroll(template, name, "right_index", duplicates="allow")
    return gallery.path


@pytest.fixture(scope="module")
def scheduler():
    with local_cluster(2, processes=False, protocol="tcp://") as cluster:
        yield cluster.scheduler_address


def test_workers_answer_as_this_machine_does(file, scheduler, templates, probe):
    here = splitknit_match.Gallery(file)
    with splitknit_match.Gallery(file, scheduler=scheduler) as gallery:
        for how in ({"top": 1}, {}, {"finger": "right_index"}, {"person": "p2"}, {"merge": "none"}):
            assert gallery.identify(probe, **how) == here.identify(probe, **how)
        assert here.identify(probe, top=1).searched.compared == 3  # one of each part
        gallery.enroll(templates["p1"], "p9", "right_index", duplicates="allow")
        assert gallery.identify(probe) == here.identify(probe)


def test_candidates_lie_with_workers(file, scheduler, probe):
    load = splitknit_match.Candidates.load
    spread = load(file, scheduler=scheduler)
    spread.prepare()
    assert spread.search(probe) == load(file).search(probe)
    with bad_input("what workers hold cannot be changed"):
        spread.remove("p2")


def test_the_verb_takes_a_scheduler(file, scheduler, probe, tmp_path, capsys):
    (tmp_path / "probe.skt").write_bytes(probe)
    words = ["identify", str(file), str(tmp_path / "probe.skt")]
    answers = []
    for options in ([], ["--scheduler", scheduler]):
        assert main([*words, *options]) == 0
        answers.append(capsys.readouterr().out)
    assert answers[0] == answers[1] and "Match: p2" in answers[0]
    assert main([*words, "--scheduler", "tcp://10.0.0.1:8786"]) == 2
    assert "can send code that its workers run" in capsys.readouterr().err


def test_what_dask_moves_or_puts_aside_is_how_a_part_is_read(file):
    part = _part(file, (3, 4))
    moved = pickle.dumps(part)
    assert len(moved) < 1000 < sys.getsizeof(part)
    again = pickle.loads(moved)
    assert again.templates == part.templates
    assert [*again.entries] == [3, 4]


@pytest.mark.slow
def test_a_killed_worker_changes_no_answer(file, probe, caplog):
    expected = splitknit_match.Gallery(file).identify(probe)
    with local_cluster(2) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]

        def kill(stage, fraction):
            if stage == "comparing" and fraction > 0.6 and len(pids) == 2:
                os.kill(pids.pop(), signal.SIGKILL)

        with splitknit_match.Gallery(file, scheduler=cluster.scheduler_address) as gallery:
            assert gallery.identify(probe, progress=kill) == expected
            assert len(pids) == 1
            assert gallery.identify(probe) == expected
    assert "was lost; others do its tasks again." in caplog.text


@pytest.mark.slow
def test_a_cluster_that_is_gone_is_said(file, probe):
    import dask

    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        cluster = local_cluster(2, processes=False, protocol="tcp://")
        with splitknit_match.Gallery(file, scheduler=cluster.scheduler_address) as gallery:
            gallery.identify(probe)
            cluster.close()
            with bad_input("the cluster was lost"):
                gallery.identify(probe)
