"""Where the runs of a trade-off study are made: on Dask, local or at an address; answers in parallel, times alone."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ...errors import FingerSimError, MissingExtraError
from .motion import TradeoffError
from .run import Course, Times, course, portable, times
from .store import Job, code_digest

Outcome = Course | Times | str
"""What a job gave, or why it could not be done."""

CONNECT = 10.0
"""Longest wait for a scheduler and its first worker [s]."""


def require_dask() -> None:
    """Raises MissingExtraError without Dask."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise MissingExtraError("finger_sim tradeoff", "tradeoff") from None


@contextmanager
def connected(address: str | None, workers: int | None = None) -> Iterator[Any]:
    """A Dask client for a `with` block: of the scheduler at an address, or of a cluster of own processes here.

    Raises TradeoffError when nobody answers in CONNECT seconds, or when a worker has another finger_sim.
    """
    require_dask()
    if address is None:
        with _local(workers) as client:
            yield client
        return
    from distributed import Client

    quiet = logging.getLogger("distributed")
    before = quiet.level
    quiet.setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except Exception as error:  # what listens there may be anything
        why = " ".join(str(error).split()) or type(error).__name__
        raise TradeoffError(f"--scheduler: {address}: not reached within {CONNECT:g} s: {why}") from None
    finally:
        quiet.setLevel(before)
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT)
        except TimeoutError:
            raise TradeoffError(f"--scheduler: {address}: has no worker after {CONNECT:g} s") from None
        _same_code(client, address)
        yield client


@contextmanager
def _local(workers: int | None) -> Iterator[Any]:
    """A cluster of single-threaded processes on this machine: one for each allowed processor, or so many."""
    import dask
    from distributed import Client, LocalCluster

    count = workers or (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    with (
        dask.config.set({"distributed.comm.timeouts.connect": "30s"}),
        LocalCluster(
            n_workers=count, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", memory_limit=0,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client


def _same_code(client: Any, address: str) -> None:
    """Raises TradeoffError naming a worker that would give other results than this machine."""
    for worker, digest in client.run(code_digest, on_error="return").items():
        if digest != code_digest():
            raise TradeoffError(f"--scheduler: {address}: worker {worker} has another finger_sim")


def answers(client: Any, jobs: Sequence[Job]) -> Iterator[tuple[Job, Outcome]]:
    """The answers of jobs as they come, all at once; the longest begin first."""
    from distributed import as_completed

    waiting = {
        client.submit(attempt, course, portable(job.scene), job.motion, job.drift, pure=False, priority=-k): job
        for k, job in enumerate(sorted(jobs, key=lambda job: -job.cost))
    }
    for future in as_completed(list(waiting), loop=client.loop):
        yield waiting.pop(future), _outcome(future)


def alone(client: Any, jobs: Sequence[Job]) -> Iterator[tuple[Job, Outcome]]:
    """The times of jobs, one after the other on one worker: on one machine, with nothing else beside them."""
    worker = min(client.scheduler_info(n_workers=-1)["workers"])
    for job in jobs:
        scene = portable(job.scene)
        yield job, _outcome(client.submit(attempt, times, scene, job.motion, pure=False, workers=[worker]))


def attempt(run: Callable[..., Course | Times], *arguments: Any) -> Outcome:
    """A run, or why its scene was refused: errors of this package do not travel between processes."""
    try:
        return run(*arguments)
    except FingerSimError as error:
        return str(error)


def _outcome(future: Any) -> Outcome:
    from distributed import KilledWorker

    try:
        result: Outcome = future.result()
    except KilledWorker as error:
        return f"its worker died: {error}"
    return result
