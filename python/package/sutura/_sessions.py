"""Sessions on a virtual console, and recordings run again."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from . import _sutura


def _build() -> str:
    """Which build this is, for replays: only the same one must come to the same bits."""
    return hashlib.sha256(Path(str(_sutura.__file__)).read_bytes()).hexdigest()[:16]


def run(
    scene: _sutura.Scene,
    *,
    seconds: float | None = None,
    host_hz: float | None = None,
    rendering: str | None = None,
    record: str | os.PathLike[str] | None = None,
    console: str = "virtual",
    lockstep: bool | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Runs a scene's session with the virtual console in this process, a tick at a time: two runs give the same bits.

    With `lockstep=False` it runs in real time, or with the console at a serial port, `console`, which always does and has
    motors: keep a hand on its emergency stop.

    What is left out is the scene's: its length [s], the solver's steps a second, and what the console renders from
    ("hold", "tangent" or "rows"). `record` is the file of a recording, for `replay` and for the command; one that is there is
    kept unless `overwrite` says otherwise, and none of the scene's own is written over. Returns the session's summary, with the keys of `sutura run --format json`; `status` says whether it was felt as it
    should be. Ctrl-C ends it.
    """
    path = None if record is None else os.fspath(record)
    if lockstep is None:
        lockstep = console == "virtual"
    if lockstep and console != "virtual":
        message = f"console is {console!r}, which runs by its own clock: lockstep=True goes with console='virtual'"
        raise ValueError(_sutura.harmless(message))
    text = _sutura.run_session(scene, seconds, host_hz, rendering, path, _build(), console, lockstep, overwrite)
    summary: dict[str, Any] = json.loads(text)
    return summary | {"console": console}


def replay(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Runs a recording again, the console's ticks and the solver's steps, and compares them with what was recorded.

    Returns what came of it, with the keys of `sutura replay --format json`. `status` is "ok" where all was compared and came
    out the same, "diverged" where something did not, and `diverged_at` is the first such tick. `diverged_at` is None as well
    where nothing could be compared: then `status` is "partly" (a part could not be), "not-replayed" (none of the ticks or none
    of the solves could be, as in a file of the last seconds) or "cut-off" (the file ends early), and `console.why` and
    `host.why` say why. `host.identical` says that solves were compared and had the same bits.
    """
    report: dict[str, Any] = json.loads(_sutura.replay_session(os.fspath(path), _build()))
    return report
