"""Where a study runs: processes of this machine, or any running Dask scheduler whose workers have the same code."""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import dask
from distributed import Client, LocalCluster

from scenarios.study_store import trial_digest
from sim.scenario import ScenarioError

_CONNECT_S = 5
_WORKERS_S = 30
# What must agree for results, and the messages that carry them, to be the same.
_PACKAGES = ("dask", "distributed", "numpy", "scipy", "numba", "pandas", "pyarrow", "pydantic")
_TRANSPORT = ("dask", "distributed")


def identity() -> dict[str, str]:
    """What this process computes with."""
    found = {"Python": platform.python_version()} | {name: version(name) for name in _PACKAGES}
    return found | {"pruefstand's code": trial_digest()[:12]}


@contextlib.contextmanager
def connected(workers: int | None, scheduler: str | None) -> Iterator[Client]:
    """A client of a local cluster with so many workers (by default the cores we may use), or of a running scheduler.

    Raises
        ScenarioError: the scheduler is not there, has no workers, or has another version of anything that matters.
    """
    for name in [n for n in logging.root.manager.loggerDict if n.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is said in one line
    dask.config.set(
        {
            "distributed.comm.timeouts.connect": f"{_CONNECT_S}s",
            "distributed.worker.profile.enabled": False,  # an hour of call stacks would fill the memory
        }
    )
    with contextlib.ExitStack() as stack:
        if scheduler is None:
            cluster = LocalCluster(
                n_workers=workers or len(os.sched_getaffinity(0)),
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",  # the default port may belong to another study
                memory_limit=0,
                silence_logs=logging.CRITICAL,
            )
            stack.enter_context(cluster)
            yield stack.enter_context(Client(cluster))
        else:
            client = _client(scheduler)
            stack.callback(client.close)
            _check(client, scheduler)
            yield client


def _client(address: str) -> Client:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # versions are compared below, in one line
        try:
            return Client(address, timeout=_CONNECT_S)
        except Exception as error:  # sockets, streams and handshakes each raise their own
            raise ScenarioError(f"--scheduler {address}: no Dask scheduler there: {_one_line(error)}") from error


def _check(client: Client, address: str) -> None:
    """Refuses a scheduler whose versions differ from ours, and workers that would compute something else."""
    try:
        found = client.get_versions()["scheduler"]
        theirs = {"Python": found["host"]["python"].split(".final")[0]}
        theirs |= {name: found["packages"][name] for name in _TRANSPORT}
        _compare(address, "the scheduler", theirs)
        client.wait_for_workers(1, timeout=_WORKERS_S)
        for worker, identified in client.run(identity).items():
            _compare(address, f"the worker {worker}", identified)
    except ScenarioError:
        raise
    except TimeoutError as error:
        raise ScenarioError(f"--scheduler {address}: has no workers; start them with: dask worker {address}") from error
    except Exception as error:  # what a foreign worker sends back may be anything
        raise ScenarioError(f"--scheduler {address}: its workers cannot run pruefstand: {_one_line(error)}") from error


def _compare(address: str, who: str, theirs: dict[str, Any]) -> None:
    for name, mine in identity().items():
        if name in theirs and theirs[name] != mine:
            raise ScenarioError(f"--scheduler {address}: {who} has {name} {theirs[name]}, here it is {mine}")


def _one_line(error: BaseException) -> str:
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0].rstrip(". ")
