"""The same job on a Dask cluster of this machine."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from command import Done, run
from walks import walk, without

import graphtrack as gt
from graphtrack.errors import GraphtrackError
from graphtrack.scale import job, smooth_dataset

distributed = pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
dask = pytest.importorskip("dask")


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Sixteen tracks in any order, one of them without a position."""
    tracks = [walk(300, seed=k, track_id=k) for k in range(16)]
    tracks[5] = without(tracks[5], "position", slice(None))
    table = gt.TrackSet(tuple(tracks)).to_table().sample(frac=1.0, random_state=2)
    table.to_parquet(tmp_path / "in.parquet", index=False)
    return tmp_path / "in.parquet"


@pytest.fixture
def two_workers():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=100
    ) as cluster:
        yield cluster


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_changes_nothing_of_the_result(data, two_workers, tmp_path):
    # GTSAM takes long enough over a batch that the killed worker has some in its hands.
    options = {"engine": "gtsam", "batch_frames": 300}
    expected = smooth_dataset(data, tmp_path / "expected.parquet", **options)
    lost: list[set[str]] = []

    def kill(_: int) -> None:
        if not lost:
            states = two_workers.scheduler.workers.values()
            victim = max(states, key=lambda state: len(state.processing))
            lost.append({task.key for task in victim.processing})
            os.kill(two_workers.workers[victim.name].pid, signal.SIGKILL)

    address = two_workers.scheduler_address
    found = smooth_dataset(data, tmp_path / "out.parquet", cluster=address, progress=kill, **options)
    assert lost and lost[0]
    assert (tmp_path / "out.parquet").read_bytes() == (tmp_path / "expected.parquet").read_bytes()
    assert [failure.track_id for failure in found.failures] == [5]
    assert found.n_frames == expected.n_frames and found.unconverged == expected.unconverged
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.slow
def test_the_command_on_a_local_cluster_gives_the_bytes_of_one_process(data, tmp_path):
    local = command(
        data, tmp_path / "local.parquet", "--cluster", "local", "--jobs", 2, "--batch-frames", 700
    )
    plain = command(data, tmp_path / "plain.parquet")
    assert local.returncode == plain.returncode == 2
    for done in (local, plain):
        assert "error: track 5" in done.stderr and "Traceback" not in done.stderr
    assert (tmp_path / "local.parquet").read_bytes() == (tmp_path / "plain.parquet").read_bytes()
    assert set(pd.read_parquet(tmp_path / "plain.parquet").track_id) == set(range(16)) - {5}


@pytest.mark.slow
def test_a_batch_that_ends_every_worker_is_one_error(data, two_workers, tmp_path, monkeypatch):
    def fatal(work: object, batch: object) -> None:
        os._exit(1)

    monkeypatch.setattr(job, "smooth_batch", fatal)
    with pytest.raises(GraphtrackError, match="ended while they had the same batch"):
        smooth_dataset(data, tmp_path / "out.parquet", cluster=two_workers.scheduler_address)
    assert [entry.name for entry in tmp_path.iterdir()] == ["in.parquet"]


@pytest.mark.slow
def test_a_scheduler_that_is_lost_is_one_error(data, tmp_path):
    code = """
import distributed, time
if __name__ == "__main__":
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        time.sleep(300)
"""
    (tmp_path / "cluster.py").write_text(code)
    line = [sys.executable, tmp_path / "cluster.py"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(line, text=True, start_new_session=True, **pipes) as scheduler:
        assert scheduler.stdout is not None
        address = scheduler.stdout.readline().strip()
        try:
            with pytest.raises(GraphtrackError, match=r"scheduler at .* was lost"):
                options = {"engine": "gtsam", "batch_frames": 300, "cluster": address}
                end = lambda _: os.kill(scheduler.pid, signal.SIGKILL)  # noqa: E731
                smooth_dataset(data, tmp_path / "out.parquet", progress=end, **options)
        finally:
            os.killpg(scheduler.pid, signal.SIGKILL)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["cluster.py", "in.parquet"]


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    source, output, *options = map(str, arguments)
    line = [sys.executable, "-c", "from graphtrack.cli import main; main()", "smooth", source, "-o", output]
    return subprocess.run([*line, "--stream", *options], capture_output=True, text=True, timeout=300)


def without_workers(source: Path, output: Path, *options: object) -> Done:
    arguments = (source, "-o", output, "--stream", *options)
    with dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        return run("smooth", *arguments, program="graphtrack")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nobody", "somebody else", "no address"])
def test_a_cluster_that_does_not_answer_is_one_error(kind, data, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:  # accepts and never answers
        port = server.getsockname()[1]
        if kind == "nobody":
            server.close()
        address = "nowhere" if kind == "no address" else f"tcp://127.0.0.1:{port}"
        done = without_workers(data, tmp_path / "out.parquet", "--cluster", address)
    assert done.returncode == 2
    *_, last = done.stderr.splitlines()
    assert last.startswith(f"error: found no answer from a Dask scheduler at {address}")
    assert done.stderr.count("error") == 1 and "Traceback" not in done.stderr
    assert [entry.name for entry in tmp_path.iterdir()] == ["in.parquet"]


@pytest.mark.slow
def test_wrong_use_is_one_error(data, tmp_path):
    for options, words in (
        (("--cluster", "tcp://127.0.0.1:9", "--jobs", "3"), "3 jobs on a cluster"),
        (("--report", tmp_path / "r.html"), "--report when streaming"),
        (("--cluster", "local", "--format", "csv"), "--format when streaming"),
    ):
        done = without_workers(data, tmp_path / "out.parquet", *options)
        assert done.returncode == 2 and words in done.stderr
    done = without_workers(data, tmp_path / "out.csv")
    assert done.returncode == 2 and ".parquet" in done.stderr
    assert [entry.name for entry in tmp_path.iterdir()] == ["in.parquet"]
