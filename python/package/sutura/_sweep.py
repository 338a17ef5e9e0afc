"""Many tasks at once: here, or handed to Dask or Ray, which must be installed (extras `dask` and `ray`).

A task is a dict that can be pickled, run whole by one worker; a worker that is lost has its tasks run again by the engine. What comes
back are errors of models, the same to the bit on every engine; times are of the machine and never among them: `tradeoff_times` takes
them in a second pass, one case at a time.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _sutura
from ._studies import merge, tradeoff
from ._sutura import harmless
from ._toml import to_toml

_Found = Iterator[tuple[int, dict[str, Any]]]

#: Times that Ray runs a task again whose worker was lost; how many workers a task may cost is Dask's own setting, `allowed-failures`.
RETRIES = 3

#: Keys of a task, by what it measures: those that it must have, and those that it may have.
_KEYS = {
    "tradeoff": ({"case"}, {"full"}),
    "force": ({"scene", "positions_m"}, {"vary", "reference", "most_steps", "directory"}),
}

#: Keys of the trade-off's lines that are of the machine.
_TIMES = ("step_us", "worst_us", "spread_pct", "runs", "pareto", "p99_us")


def tradeoff_tasks(only: str = "", *, full: bool = False) -> list[dict[str, Any]]:
    """The trade-off's cases as tasks: all of which the case or some tissue has the words `only` in its name."""
    cases = _sutura.tradeoff_cases(only, full)
    return [{"measure": "tradeoff", "case": case, "full": full} for case in cases]


def run_task(task: Mapping[str, Any]) -> dict[str, Any]:
    """Runs a task here.

    `{"measure": "tradeoff", "case": "beam-tension", "full": False}` gives the errors of every model on a case of
    `sutura.tradeoff`: `cases`, `truths` and `sutures`, without what is of a machine.

    `{"measure": "force", "scene": {...}, "vary": {"tissue.model": "corotational"}, "reference": {"tissue.model":
    "hyperelastic"}, "positions_m": [[0, 0, 0.01]]}` holds the tool of a scene's description at each pose, (k, 3) [m], one after
    the other, and compares its force with that of the same scene with other keys, `reference`: `largest_n`, `rms_n` and
    `reference_n` [N] over the `compared` poses at which both found a balance.
    """
    measure = task.get("measure")
    if measure not in _KEYS:
        raise ValueError(harmless(f"task['measure'] is {measure!r}: give one of {', '.join(map(repr, _KEYS))}"))
    needed, allowed = _KEYS[measure]
    for key in sorted(needed - set(task)):
        raise ValueError(harmless(f"a task that measures {measure!r} has no {key!r}: it needs {', '.join(sorted(needed))}"))
    for key in sorted(set(task) - needed - allowed - {"measure"}):
        known = ", ".join(sorted(needed | allowed))
        raise ValueError(harmless(f"a task that measures {measure!r} has the key {key!r}: it knows {known}"))
    return _tradeoff_errors(task) if measure == "tradeoff" else _force_errors(task)


def sweep(
    tasks: Iterable[Mapping[str, Any]], engine: Literal["local", "dask", "ray"] = "local", *, client: Any = None
) -> _Found:
    """Runs all tasks and gives, as they come, the number of each, from 0, and its errors.

    "local" runs one after the other, in order. "dask" hands them to `client`, a `dask.distributed.Client`, or the one that is current,
    or one of this machine's own; "ray" to the cluster that `ray.init` has joined, or one of this machine's own. What a task
    raises is raised here. See `run_task` for what a task is.
    """
    engines: dict[str, Callable[[list[dict[str, Any]], Any], _Found]] = {"local": _local, "dask": _dask, "ray": _ray}
    if engine not in engines:
        raise ValueError(harmless(f"engine is {engine!r}: give one of {', '.join(map(repr, engines))}"))
    if client is not None and engine != "dask":
        raise ValueError(harmless(f"client is for the engine 'dask', and engine is {engine!r}: leave it out"))
    return engines[engine]([dict(task) for task in tasks], client)


def tradeoff_times(
    only: str = "", *, full: bool = False, engine: Literal["local", "dask", "ray"] = "local", client: Any = None
) -> dict[str, Any]:
    """The table of `tradeoff`, with times and fronts: one case at a time, all on one machine of the engine.

    "dask" takes the host of the client's first worker, and refuses one whose workers have other tasks; "ray" takes all
    processors of the first node, so that it has no other. `made` has an entry for each case: the machine, its load, and how
    many processors `others` kept busy meanwhile. A case beside which that was too much is marked there, `idle` is False, and warned of.
    """
    engines: dict[str, Callable[[_Shares, Any], Iterator[dict[str, Any]]]] = {
        "local": _shares_here,
        "dask": _shares_by_dask,
        "ray": _shares_by_ray,
    }
    if engine not in engines:
        raise ValueError(harmless(f"engine is {engine!r}: give one of {', '.join(map(repr, engines))}"))
    if client is not None and engine != "dask":
        raise ValueError(harmless(f"client is for the engine 'dask', and engine is {engine!r}: leave it out"))
    count = len(_sutura.tradeoff_cases(only, full))
    shares = [(only, full, f"{number}/{count}") for number in range(1, count + 1)]
    table = merge(list(engines[engine](shares, client)))
    for made in table["made"]:
        if made["idle"] is False:
            cases, others = ", ".join(made["cases"]), made["others"]
            message = f"{cases}: other programs kept {others:.1f} processors busy: its times are not those of an idle machine"
            warnings.warn(message, RuntimeWarning, stacklevel=2)
    return table


def _share(only: str, full: bool, cases: str) -> dict[str, Any]:
    return tradeoff(only, full=full, cases=cases)


_Shares = list[tuple[str, bool, str]]


def _shares_here(shares: _Shares, _client: None) -> Iterator[dict[str, Any]]:
    return (_share(*share) for share in shares)


def _shares_by_dask(shares: _Shares, client: Any) -> Iterator[dict[str, Any]]:
    with _dask_client(client) as client:
        client.wait_for_workers(1)
        workers = client.scheduler_info()["workers"]
        host = workers[min(workers)]["host"]
        for share in shares:
            others = sum(len(keys) for address, keys in client.processing().items() if _is_at(address, host))
            if others:
                message = f"workers at {host} have {others} tasks: times are taken where nothing else runs: wait for these"
                raise RuntimeError(message)
            # Any worker there: one that was lost is another when it comes back.
            yield client.submit(_share, *share, workers=[host], pure=False).result()


def _is_at(address: str, host: str) -> bool:
    return address.rpartition("://")[2].rpartition(":")[0] == host


def _shares_by_ray(shares: _Shares, _client: None) -> Iterator[dict[str, Any]]:
    with _ray_cluster() as ray:
        node = next(node for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU"))
        strategies = _installed("ray", "ray.util.scheduling_strategies")
        there = strategies.NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
        alone = ray.remote(max_retries=RETRIES, num_cpus=node["Resources"]["CPU"], scheduling_strategy=there)(_share)
        for share in shares:
            yield ray.get(alone.remote(*share))


def _tradeoff_errors(task: Mapping[str, Any]) -> dict[str, Any]:
    table = tradeoff(task["case"], full=task.get("full", False), timed=False)
    lines = {name: table[name] for name in ("cases", "truths", "sutures")}
    return {
        name: [{key: value for key, value in line.items() if key not in _TIMES} for line in each]
        for name, each in lines.items()
    }


def _force_errors(task: Mapping[str, Any]) -> dict[str, Any]:
    positions_m = np.asarray(task["positions_m"], dtype=np.float64)
    if positions_m.ndim != 2 or positions_m.shape[1] != 3 or not len(positions_m):
        raise ValueError(f"task['positions_m'] has the shape {positions_m.shape}: give (k, 3), one row for each pose")
    ours, theirs = (_forces_n(task, key, positions_m) for key in ("vary", "reference"))
    both = np.isfinite(ours).all(axis=1) & np.isfinite(theirs).all(axis=1)
    off_n = np.linalg.norm(ours[both] - theirs[both], axis=1)
    compared = int(both.sum())
    return {
        "largest_n": float(off_n.max(initial=0.0)),
        "rms_n": float(np.sqrt(np.square(off_n).sum() / max(compared, 1))),
        "reference_n": float(np.linalg.norm(theirs[both], axis=1).max(initial=0.0)),
        "compared": compared,
        "without_balance": len(positions_m) - compared,
    }


def _forces_n(task: Mapping[str, Any], key: str, positions_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Force at each pose [N], (k, 3); not a number where there is no balance."""
    description = _varied(task["scene"], task.get(key, {}), key)
    scene = _sutura.Scene.from_toml(to_toml(description), directory=task.get("directory", ""))
    solver = _sutura.Solver(scene)
    forces_n = np.full(positions_m.shape, np.nan)
    for force_n, position_m in zip(forces_n, positions_m):
        step = solver.step(position_m, most_steps=task.get("most_steps", 1000))
        if step.status == "ok":
            force_n[:] = step.wrench()[:3]
    return forces_n


def _varied(description: Mapping[str, Any], vary: Mapping[str, Any], what: str) -> dict[str, Any]:
    """The description with other values at places like `tissue.model`."""
    varied = copy.deepcopy(dict(description))
    for place, value in vary.items():
        *sections, key = place.split(".")
        table: Any = varied
        for section in sections:
            table = table.setdefault(section, {}) if isinstance(table, dict) else None
        if not isinstance(table, dict):
            raise ValueError(harmless(f"task[{what!r}] has {place!r}: only keys of sections can be varied, as 'tissue.model'"))
        table[key] = value
    return varied


def _local(tasks: list[dict[str, Any]], _client: None) -> _Found:
    for number, task in enumerate(tasks):
        yield number, run_task(task)


def _dask(tasks: list[dict[str, Any]], client: Any) -> _Found:
    distributed = _installed("dask", "dask.distributed")
    with _dask_client(client) as client:
        # Equal tasks are tasks of their own.
        futures = [client.submit(run_task, task, pure=False) for task in tasks]
        numbers = {future.key: number for number, future in enumerate(futures)}
        for future in distributed.as_completed(futures):
            yield numbers[future.key], future.result()


@contextlib.contextmanager
def _dask_client(client: Any) -> Iterator[Any]:
    """The client that is given, or the one that is current, or one of this machine's own, which ends with it."""
    distributed = _installed("dask", "dask.distributed")
    if client is None:
        with contextlib.suppress(ValueError):
            client = distributed.get_client()
    if client is not None:
        yield client
        return
    with distributed.Client(threads_per_worker=1, dashboard_address=None) as own:
        yield own


def _ray(tasks: list[dict[str, Any]], _client: None) -> _Found:
    with _ray_cluster() as ray:
        run = ray.remote(max_retries=RETRIES)(run_task)
        numbers = {run.remote(task): number for number, task in enumerate(tasks)}
        waiting = list(numbers)
        while waiting:
            ready, waiting = ray.wait(waiting)
            for reference in ready:
                yield numbers[reference], ray.get(reference)


@contextlib.contextmanager
def _ray_cluster() -> Iterator[Any]:
    """Ray with the cluster that was joined, or one of this machine's own, which ends with it."""
    ray = _installed("ray", "ray")
    if ray.is_initialized():
        yield ray
        return
    ray.init(include_dashboard=False, log_to_driver=False)
    try:
        yield ray
    finally:
        ray.shutdown()


def _installed(engine: str, module: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        message = f"{engine} is not installed: pip install 'sutura[{engine}]', or take engine='local'"
        raise ImportError(message) from error
