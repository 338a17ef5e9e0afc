"""Soft tissue, needles and threads that can be felt: the solver of a suturing console.

    scene = sutura.load("scenes/palpation.toml")
    solver = sutura.Solver(scene)
    step = solver.step([0.0, 0.0, 0.01], most_steps=64)
    step.wrench()       # force [N] and moment [N m] on the tool, (6,)
    step.tangent()      # and how they follow its pose, (6, 6)

Arrays are fresh, or those given as `out=`: none views the solver's memory.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from ._sutura import (
    BusyError,
    Console,
    ConsoleError,
    Contact,
    Error,
    Jaws,
    Moment,
    Needle,
    Pose,
    Scene,
    SceneError,
    SolveError,
    Solver,
    Step,
    Thread,
    __version__,
)
from ._sessions import replay, run
from ._studies import fidelity, merge, stability, tradeoff
from ._sweep import run_task, sweep, tradeoff_tasks, tradeoff_times
from ._toml import to_toml

__all__ = [
    "BusyError",
    "Console",
    "ConsoleError",
    "Contact",
    "Error",
    "Jaws",
    "Moment",
    "Needle",
    "Pose",
    "Scene",
    "SceneError",
    "SolveError",
    "Solver",
    "Step",
    "Thread",
    "__version__",
    "fidelity",
    "load",
    "merge",
    "replay",
    "run",
    "run_task",
    "scene",
    "stability",
    "sweep",
    "to_toml",
    "tradeoff",
    "tradeoff_tasks",
    "tradeoff_times",
]


def load(path: str | os.PathLike[str]) -> Scene:
    """Reads a scene file, and the files that it names."""
    return Scene.load(path)


def scene(
    description: Mapping[str, Any] | str,
    *,
    directory: str | os.PathLike[str] = "",
    name: str = "scene.toml",
) -> Scene:
    """A scene from a dict with the keys of a scene file, or from the file's text.

    Numbers, lists, tuples and arrays of numpy are as good as plain ones. Paths in it begin at `directory`; what is wrong
    is said of the text of `to_toml`, as if it were the file `name`.
    """
    text = description if isinstance(description, str) else to_toml(description)
    return Scene.from_toml(text, directory=directory, name=name)
