"""Tables of the studies, and sweeps: the command's keys, errors that are the same wherever they are found."""

import json
import pickle
import re
import subprocess
import sys
import warnings

import pytest
from conftest import FULL, ROOT

import sutura

#: Keys that are of the machine.
TIMES = {"step_us", "worst_us", "spread_pct", "runs", "pareto", "p99_us"}


def test_the_tradeoff_is_measured_and_says_where():
    table = sutura.tradeoff("beam-tension linear")
    assert table["status"] == "ok" and table["extent"] == "short"
    lines = table["cases"]
    assert {line["case"] for line in lines} == {"beam-tension"} and all(line["step_us"] > 0.0 for line in lines)
    assert any(line["pareto"] for line in lines)
    made = table["made"][0]
    assert (made["share"], made["timed"], made["cases"]) == ("1/1", True, ["beam-tension"])
    assert made["machine"]["threads"] >= 1 and made["machine"]["simd"] and made["program"].startswith(sutura.__version__)
    # The same course without a clock: the same errors to the bit, and nothing that is of the machine.
    errors = sutura.tradeoff("beam-tension linear", timed=False)
    for timed, untimed in zip(lines, errors["cases"], strict=True):
        assert untimed["step_us"] is None and untimed["runs"] == 0 and not untimed["pareto"]
        assert {k: v for k, v in timed.items() if k not in TIMES} == {k: v for k, v in untimed.items() if k not in TIMES}
    assert errors["best"] == []


def test_times_come_from_a_second_pass_case_by_case():
    words = "beam linear" if FULL else "beam-tension linear"
    cases = [task["case"] for task in sutura.tradeoff_tasks(words)]
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        table = sutura.tradeoff_times(words)
    assert [made["cases"] for made in table["made"]] == [[case] for case in cases]
    for made in table["made"]:
        assert made["timed"] and made["machine"]["simd"] and made["load_before"] is not None
        assert made["idle"] is (made["others"] <= 0.5)
    # Marked and warned of, where the machine had other work.
    busy = [made["cases"][0] for made in table["made"] if not made["idle"]]
    assert [str(each.message).split(":")[0] for each in warned] == busy
    for case in cases:
        assert any(line["pareto"] for line in table["cases"] if line["case"] == case)
    whole = sutura.tradeoff(words, timed=False)
    assert [line["error_pct"] for line in table["cases"]] == [line["error_pct"] for line in whole["cases"]]


def test_shares_are_merged_or_refused_by_name(tmp_path):
    first, second = (sutura.tradeoff("beam linear", timed=False, cases=share) for share in ("1/2", "2/2"))
    path = tmp_path / "second.json"
    path.write_text(json.dumps(second))
    table = sutura.merge([path, first])
    whole = sutura.tradeoff("beam linear", timed=False)
    for key in ("cases", "truths", "best", "sutures"):
        assert table[key] == whole[key], key
    assert [made["share"] for made in table["made"]] == ["1/2", "2/2"]
    with pytest.raises(ValueError, match="of the 2 shares 2/2 are missing: measure them with"):
        sutura.merge([first])
    second["made"][0]["program"] = "another"
    with pytest.raises(ValueError, match=r"shares\[0\] and shares\[1\] are not of one table: the program is .* and another"):
        sutura.merge([first, second])
    with pytest.raises(ValueError, match=r"shares\[0\] is no table of `sutura tradeoff`: it has no `cases`"):
        sutura.merge([{}])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: sutura.tradeoff("nothing"), "no case and tissue have all the words `nothing`: words are parts"),
        (lambda: sutura.tradeoff(cases="3/2"), "cases: `3/2` is no share: give I/N with I from 1 to N"),
        (lambda: sutura.tradeoff("beam", cases="9/9"), "the share 9/9 has no case: there are 2: give at most 2 shares"),
        (lambda: sutura.stability("nothing"), "no case has all the words `nothing`: words are parts of a tissue"),
        (lambda: sutura.fidelity("nothing"), "no case has all the words `nothing`: words are whole"),
        (lambda: sutura.fidelity("palpation", threads=0), "threads is 0: give 1 or more"),
        (lambda: next(sutura.sweep([], "slurm")), "engine is 'slurm': give one of 'local', 'dask', 'ray'"),
        (lambda: sutura.tradeoff_times("beam", engine="slurm"), "engine is 'slurm': give one of 'local', 'dask', 'ray'"),
        (lambda: sutura.run_task({"measure": "time"}), r"task\['measure'\] is 'time': give one of 'tradeoff', 'force'"),
        (lambda: sutura.run_task({"measure": "tradeoff"}), "has no 'case': it needs case"),
        (
            lambda: sutura.run_task({"measure": "tradeoff", "case": "beam", "timed": True}),
            "has the key 'timed': it knows case, full",
        ),
    ],
)
def test_what_cannot_be_measured_is_named(call, said):
    with pytest.raises(ValueError, match=said):
        call()


def test_extremes_of_rows_and_one_case_of_the_force():
    table = sutura.stability("rows unit")
    assert table["status"] == "ok" and {line["outcome"] for line in table["cases"]} <= {"stable", "degraded", "refused"}
    report = sutura.fidelity("palpation presses rows 30-hz", threads=1)
    case = report["cases"][0]
    assert case["rendering"] == "rows" and case["rms_pct"] > 0.0, case


def force_task(slab):
    return {
        "measure": "force",
        "scene": slab,
        "vary": {"tissue.model": "corotational"},
        "positions_m": [[0.0, 0.0, 0.013], [0.0, 0.0, 0.011]],
    }


def test_a_task_compares_a_scene_with_itself_and_with_another(slab):
    task = force_task(slab)
    none = sutura.run_task(task | {"reference": task["vary"]})
    assert none["largest_n"] == 0.0 and none["compared"] == 2 and none["reference_n"] > 0.05
    stiffer = sutura.run_task(task | {"reference": task["vary"] | {"tissue.youngs_modulus_pa": 30e3}})
    assert stiffer["rms_n"] > 0.1 * stiffer["reference_n"] and stiffer["without_balance"] == 0
    with pytest.raises(ValueError, match="'tool.radius_m': only keys of sections can be varied"):
        sutura.run_task(task | {"vary": {"tool.radius_m": 0.01}})
    with pytest.raises(ValueError, match=r"task\['positions_m'\] has the shape \(3,\): give \(k, 3\)"):
        sutura.run_task(task | {"positions_m": [0.0, 0.0, 0.01]})


def test_a_local_sweep_runs_every_task_that_can_be_shipped(slab):
    tasks = [*sutura.tradeoff_tasks("beam-tension linear"), force_task(slab)]
    assert [task["measure"] for task in tasks] == ["tradeoff", "force"]
    found = dict(sutura.sweep(pickle.loads(pickle.dumps(tasks))))
    assert found == {0: sutura.run_task(tasks[0]), 1: sutura.run_task(tasks[1])}
    assert not TIMES & set(found[0]["cases"][0]) and found[0]["cases"][0]["error_pct"] > 0.0


@pytest.mark.full
@pytest.mark.parametrize("engine", ["dask", "ray"])
def test_two_workers_one_of_them_killed_find_the_errors_of_one_process(engine):
    example = ROOT / "python/examples/sweep_tradeoff.py"
    for extra in (["--times"], ["--kill"]):
        ran = subprocess.run(
            [sys.executable, "-W", "ignore", str(example), engine, *extra], capture_output=True, text=True, timeout=1200
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr
        print(ran.stdout)
        assert "the errors are those of one process" in ran.stdout and "bytes to ship" in ran.stdout
        assert ("a worker was killed" in ran.stdout) == (extra == ["--kill"]), ran.stdout
        assert ("lines at the front, on" in ran.stdout) == (extra == ["--times"]), ran.stdout


#: Times are asked for beside a task that waits; each prints what it is told.
BUSY = {
    # Refused while a worker there has it, and taken after that.
    "dask": """
import time
import sutura
from dask.distributed import Client, Event, LocalCluster

if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        task = client.submit(lambda: Event("go on").wait(timeout="30s"), pure=False)
        while not any(client.processing().values()):
            time.sleep(0.05)
        try:
            sutura.tradeoff_times("beam-tension linear", engine="dask", client=client)
        except RuntimeError as error:
            print("refused:", error)
        Event("go on").set()
        task.result()
        table = sutura.tradeoff_times("beam-tension linear", engine="dask", client=client)
        print("taken:", table["made"][0]["cases"])
""",
    # Not begun before it is over.
    "ray": """
import pathlib
import sys
import threading
import time
import ray
import sutura

ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
go_on = pathlib.Path(sys.argv[1])

def wait():
    while not go_on.exists():
        time.sleep(0.05)

# A worker that has begun once is there at once.
list(sutura.sweep(sutura.tradeoff_tasks("beam-tension"), "ray"))
task = ray.remote(wait).remote()
while ray.available_resources().get("CPU") == 2.0:
    time.sleep(0.05)
tables = []
times = threading.Thread(target=lambda: tables.append(sutura.tradeoff_times("beam-tension linear", engine="ray")))
times.start()
times.join(timeout=20)
print("waits:", not tables)
go_on.touch()
times.join()
print("taken:", tables[0]["made"][0]["cases"])
ray.shutdown()
""",
}


@pytest.mark.full
@pytest.mark.parametrize(
    ("engine", "said"),
    [
        ("dask", r"refused: workers at \S+ have 1 tasks: times are taken where nothing else runs: wait for these"),
        ("ray", "waits: True"),
    ],
)
def test_no_times_are_taken_on_a_worker_with_other_tasks(engine, said, tmp_path):
    script = tmp_path / "busy.py"
    script.write_text(BUSY[engine])
    ran = subprocess.run([sys.executable, "-W", "ignore", str(script), str(tmp_path / "go on")], capture_output=True, text=True, timeout=600)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert re.search(said, ran.stdout) and "taken: ['beam-tension']" in ran.stdout, ran.stdout


@pytest.mark.parametrize(
    ("call", "status"),
    [
        ("tradeoff('beam-tension', timed=False, each=each)", "error_pct"),
        ("stability('chainmail', full=True, each=each)", "outcome"),
        ("fidelity('return point', threads=1, each=each)", "energy_min_j"),
    ],
)
def test_ctrl_c_leaves_the_lines_by_then(call, status):
    # In a process of its own: the signal is of the whole process.
    script = f"""
import os, signal, sutura
# Who starts tests in the background may have had it ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
lines = []
def each(line):
    lines.append(line)
    if len(lines) == 1:
        os.kill(os.getpid(), signal.SIGINT)
try:
    sutura.{call}
except KeyboardInterrupt:
    print(len(lines), {status!r} in lines[0])
"""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    count, has_key = ran.stdout.split()
    assert 1 <= int(count) <= 3 and has_key == "True", ran.stdout + ran.stderr


def test_what_each_raises_ends_a_table():
    with pytest.raises(KeyError, match="mine"):
        sutura.stability("chainmail", full=True, each=lambda line: {}["mine"])
