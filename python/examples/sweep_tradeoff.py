"""The trade-off's errors by two workers of Dask or Ray, compared with those of one process.

    python sweep_tradeoff.py dask
    python sweep_tradeoff.py ray --kill      one worker is killed in the middle
    python sweep_tradeoff.py dask --full     all cases
    python sweep_tradeoff.py dask --times    and their times in a second pass, one case at a time on one worker

Each case is a task. What a task costs to ship is printed: its bytes, those of its result, and the engine's time for a task
that does nothing.
"""

from __future__ import annotations

import argparse
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import sutura

#: Empty tasks that are timed.
EMPTY = 50


def dask(use: Callable[[Any, Callable[[], int], Callable[[], float]], None]) -> None:
    from dask.distributed import Client, LocalCluster

    cluster = LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with cluster, Client(cluster) as client:

        def victim() -> int:
            busy = {address: keys for address, keys in client.processing().items() if keys}
            return int(client.run(os.getpid, workers=list(busy)[:1]).popitem()[1])

        def empty_s() -> float:
            start = time.perf_counter()
            for _ in range(EMPTY):
                client.submit(int, pure=False).result()
            return (time.perf_counter() - start) / EMPTY

        use(client, victim, empty_s)


def ray(use: Callable[[Any, Callable[[], int], Callable[[], float]], None]) -> None:
    import ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)

    def victim() -> int:
        # Ray calls a worker by what it runs.
        titles = {pid: _read(pid, "cmdline") for pid in os.listdir("/proc") if pid.isdigit()}
        return next(int(pid) for pid, title in titles.items() if title.startswith("ray::run_task") and _is_below(pid))

    def empty_s() -> float:
        nothing = ray.remote(lambda: 0)
        ray.get(nothing.remote())
        start = time.perf_counter()
        for _ in range(EMPTY):
            ray.get(nothing.remote())
        return (time.perf_counter() - start) / EMPTY

    try:
        use(None, victim, empty_s)
    finally:
        ray.shutdown()


def _read(pid: str, name: str) -> str:
    try:
        with open(f"/proc/{pid}/{name}") as file:
            return file.read()
    except OSError:
        return ""


def _is_below(pid: str) -> bool:
    """Whether a process was started by this one, or by one that was."""
    while pid not in ("", "0", "1"):
        if pid == str(os.getpid()):
            return True
        pid = (_read(pid, "stat").rpartition(")")[2].split() + ["", ""])[1]
    return False


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engine", choices=["dask", "ray"])
    parser.add_argument("--kill", action="store_true", help="kill a worker after the first result")
    parser.add_argument("--full", action="store_true", help="all cases, settings and meshes")
    parser.add_argument("--times", action="store_true", help="take times in a second pass")
    parser.add_argument("--only", default="", help="words in the names of cases or tissues")
    options = parser.parse_args()
    tasks = sutura.tradeoff_tasks(options.only, full=options.full)
    found: dict[int, dict[str, Any]] = {}

    def use(client: Any, victim: Callable[[], int], empty_s: Callable[[], float]) -> None:
        ship_ms = 1e3 * empty_s()
        start = time.perf_counter()
        for number, errors in sutura.sweep(tasks, options.engine, client=client):
            if options.kill and not found:
                pid = victim()
                os.kill(pid, signal.SIGKILL)
                print(f"a worker was killed: process {pid}, {len(tasks) - 1} of {len(tasks)} tasks to go")
            assert number not in found, number
            found[number] = errors
        took_s = time.perf_counter() - start
        task_bytes = max(len(pickle.dumps(task)) for task in tasks)
        result_bytes = max(len(pickle.dumps(errors)) for errors in found.values())
        print(
            f"{options.engine}: {len(tasks)} tasks in {took_s:.1f} s; a task is at most {task_bytes} bytes to ship, a result {result_bytes}; "
            f"an empty task takes {ship_ms:.1f} ms"
        )
        if options.times:
            table = sutura.tradeoff_times(options.only, full=options.full, engine=options.engine, client=client)
            for made in table["made"]:
                front = [line for line in table["cases"] if line["case"] in made["cases"] and line["pareto"]]
                print(
                    f"{', '.join(made['cases'])}: {len(front)} lines at the front, on {made['machine']['host']}, load "
                    f"{made['load_before']}; others kept {made['others']:.2f} processors busy, idle: {made['idle']}"
                )

    {"dask": dask, "ray": ray}[options.engine](use)
    if options.full:
        print(f"{sum(len(errors['cases']) for errors in found.values())} lines")
        return 0
    alone = dict(sutura.sweep(tasks))
    differ = [tasks[number]["case"] for number in alone if found.get(number) != alone[number]]
    if differ:
        print(f"the errors differ: {', '.join(differ)}")
        return 1
    lines = sum(len(errors["cases"]) + len(errors["sutures"]) for errors in alone.values())
    print(f"the errors are those of one process, to the bit: {lines} lines of {len(alone)} cases")
    return 0


if __name__ == "__main__":
    sys.exit(main())
