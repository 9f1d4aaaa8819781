"""Campaigns on a Dask cluster: the same table as local processes, whichever process dies; cluster errors."""

import os
import random
import signal
import socket
import threading
import time

import distributed
import pytest

from drivers.errors import ConfigurationError
from hil.study.campaign import dask_cluster
from hil.study.campaign.command import run_campaign
from hil.study.campaign.plan import identity, read_plan
from hil.study.campaign.store import stored_rows
from tests.hil.study.campaign.campaigns import MANY, SMALL, kill_thrice, started, wait_for_a_row, written
from tests.hil.study.campaign.clusters import cluster
from tests.hil.study.campaign.test_plan_identity import SAMPLED, path_csv

DEADLY = """
import os, signal
from hil.study.campaign import row

if not hasattr(row, "harmless"):
    row.harmless = row.performed

    def deadly(job):
        if job.number == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return row.harmless(job)

    row.performed = deadly
"""
"""Preload of a worker whose process is killed by row 1."""


def campaign(folder, text):
    """A campaign, and the bytes of its table from processes of this machine."""
    plan = read_plan(written(folder, text))
    run_campaign(plan, folder / "here", jobs=2 if len(plan) > 2 else 1)
    return plan, (folder / "here" / "table.parquet").read_bytes()


def local_cluster(workers, threads, *, processes):
    """A cluster that listens only on the loopback; its default port may be in use."""
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=threads,
        processes=processes,
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
    )


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    return campaign(tmp_path_factory.mktemp("two"), SMALL.replace("count: 2", "count: 1"))


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    return campaign(tmp_path_factory.mktemp("many"), MANY)


@pytest.fixture(scope="module")
def threads():
    """Address of a cluster in this process, with one worker of two threads."""
    with local_cluster(1, 2, processes=False) as running:
        yield running.scheduler_address


def test_a_worker_with_two_threads_makes_the_table_of_one_process(two, threads, tmp_path):
    plan, table = two
    seen = []
    run_campaign(plan, tmp_path, scheduler=threads, progress=lambda *counts: seen.append(counts))
    assert (tmp_path / "table.parquet").read_bytes() == table
    assert seen == [(0, 2), (1, 2)]


def test_a_worker_with_another_version_is_refused(two, threads, tmp_path, monkeypatch):
    def version(_):
        return "1.0.0" if threading.current_thread() is threading.main_thread() else "0.9.0"

    monkeypatch.setattr(dask_cluster, "version", version)
    refused = pytest.raises(ConfigurationError, match=r"at a worker: .*hexapod-hil 0\.9\.0, allowed: 1\.0\.0")
    with refused:
        run_campaign(two[0], tmp_path, scheduler=threads)


def test_a_worker_with_different_content_of_a_file_is_refused(threads, tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(path_csv(1.001))
    plan = read_plan(written(tmp_path, SAMPLED))
    file.write_text(path_csv(1.002))
    with pytest.raises(ConfigurationError, match=r"at a worker: /.*path\.csv: has changed since"):
        run_campaign(plan, tmp_path / "out", scheduler=threads)
    assert stored_rows(tmp_path / "out", identity(plan)) == {}


def test_an_exception_at_a_worker_reaches_the_client_even_if_not_picklable(
    two, threads, tmp_path, monkeypatch
):
    """The traceback of this recursion is too deep to be pickled."""

    def deeper(job):
        return deeper(job)

    monkeypatch.setattr(dask_cluster, "run_row", deeper)
    with pytest.raises(ConfigurationError, match=r"at a worker: row [01]: RecursionError"):
        run_campaign(two[0], tmp_path, scheduler=threads)


def test_a_dead_scheduler_address_is_refused_with_an_example(two, tmp_path, monkeypatch):
    monkeypatch.setattr(dask_cluster, "WAIT_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    for address in (f"tcp://127.0.0.1:{port}", "nowhere://at.all:1"):
        with pytest.raises(ConfigurationError, match=r"--scheduler .* allowed: the address"):
            run_campaign(two[0], tmp_path, scheduler=address)


@pytest.mark.long
def test_the_table_is_the_same_after_kill_9_of_command_and_worker(many, tmp_path):
    """The command dies at three random instants; then one of the two workers dies for good."""
    plan, table = many
    with cluster(tmp_path, 2) as running:
        kill_thrice(plan, tmp_path / "out", random.Random(1), "--scheduler", running.address)

        def kill_one(done, of):
            if done == of - 4:
                os.kill(running.workers[0].pid, signal.SIGKILL)

        summary = run_campaign(plan, tmp_path / "out", scheduler=running.address, progress=kill_one)
        assert running.workers[0].wait() == -signal.SIGKILL
        assert running.workers[1].poll() is None
    assert 0 < summary["rows_kept"] < 76
    assert (tmp_path / "out" / "table.parquet").read_bytes() == table


@pytest.mark.long
def test_campaign_row_that_kills_its_workers_fails_alone(tmp_path):
    """The other rows wait at the same workers and run again, one at a time."""
    plan = read_plan(written(tmp_path, SMALL))
    (tmp_path / "deadly.py").write_text(DEADLY)
    with cluster(tmp_path, 1, "--nanny", preload=tmp_path / "deadly.py") as running:
        rows = run_campaign(plan, tmp_path / "out", scheduler=running.address)["matrix"]
    assert [row["ended"] for row in rows] == ["complete", "died", "complete", "fault"]
    assert rows[1]["trouble"] == "its process died, twice"  # as in processes of this machine


@pytest.mark.long
def test_a_dying_scheduler_ends_the_command_and_finished_rows_are_kept(many, tmp_path):
    plan, table = many
    with cluster(tmp_path, 1) as running:

        def kill(done, _):
            if done == 3:
                running.scheduler.kill()

        with pytest.raises(ConfigurationError, match=r"--scheduler .* the same command"):
            run_campaign(plan, tmp_path / "out", scheduler=running.address, progress=kill)
    summary = run_campaign(plan, tmp_path / "out", jobs=2)
    assert 3 <= summary["rows_kept"] < 80
    assert (tmp_path / "out" / "table.parquet").read_bytes() == table


@pytest.mark.long
def test_ctrl_c_removes_the_rows_from_the_cluster(tmp_path):
    plan = read_plan(written(tmp_path, MANY.replace("count: 40", "count: 400")))
    with (
        cluster(tmp_path, 1) as running,
        started(plan, tmp_path / "out", "--scheduler", running.address) as process,
    ):
        wait_for_a_row(tmp_path / "out", process)
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 130
        with distributed.Client(running.address, set_as_default=False) as client:
            end = time.monotonic() + 20.0
            while any(client.processing().values()):  # the row that a worker had begun
                assert time.monotonic() < end, "rows are still on the cluster"
                time.sleep(0.1)
