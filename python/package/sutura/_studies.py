"""What is asked of models and of the console, as tables: dicts with the keys of the command, of which lists of lines are for
`pandas.DataFrame`."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Union

from . import _sutura

#: A table, or the file of one.
Share = Union[Mapping[str, Any], str, "os.PathLike[str]"]


#: What is called with each line of a table as it is found.
Each = Callable[[dict[str, Any]], object]


def _each(call: Each | None) -> Callable[[str], object] | None:
    return None if call is None else lambda line: call(json.loads(line))


def tradeoff(
    only: str = "", *, full: bool = False, timed: bool = True, cases: str | None = None, each: Each | None = None
) -> dict[str, Any]:
    """Error against time of every tissue model, one case at a time: the keys of `sutura tradeoff --format json`.

    `only` are words that must all be in the name of a case or a tissue, `cases` is a share of the cases, as "2/4", for
    `merge`. Times are this machine's, which `made` names, with what else ran on it; with `timed=False` there are errors
    alone, the same to the bit wherever the processor has the same instructions. Ctrl-C ends it after the line at hand; what
    `each` was called with, a line as it is found, is yours by then: `each=lines.append`.
    """
    table: dict[str, Any] = json.loads(_sutura.tradeoff(only, full, timed, cases, _each(each)))
    return table


def merge(shares: Sequence[Share]) -> dict[str, Any]:
    """One table of all shares of `tradeoff`, given as tables or as files, as `sutura tradeoff merge` makes it.

    Raises ValueError for shares that are not of one table: times of two machines, of two programs, a share twice or none.
    """
    named = []
    for number, share in enumerate(shares):
        if isinstance(share, Mapping):
            named.append((f"shares[{number}]", json.dumps(share).encode()))
        else:
            named.append((os.fspath(share), Path(share).read_bytes()))
    table: dict[str, Any] = json.loads(_sutura.merge_tradeoff(named))
    return table


def stability(only: str = "", *, full: bool = False, each: Each | None = None) -> dict[str, Any]:
    """What tissue models, the row solver and the console do at the extremes: the keys of `sutura stability --format json`.

    `only` are words that must all be in a line's tissue or in what is extreme. A defect is a line whose `outcome` is
    "defect"; `status` is "failed" then. Ctrl-C and `each` as in `tradeoff`.
    """
    table: dict[str, Any] = json.loads(_sutura.stability(only, full, _each(each)))
    return table


def fidelity(
    only: str = "", *, full: bool = False, threads: int | None = None, each: Each | None = None
) -> dict[str, Any]:
    """How true and how stable the console's force is, by simulation: the keys of `sutura fidelity --format json`.

    `only` are whole words of a case's name. `threads` cases run at the same time, as many as the machine has if left out.
    Everything goes by seeds: the figures do not depend on the machine. Ctrl-C and `each` as in `tradeoff`.
    """
    report: dict[str, Any] = json.loads(_sutura.fidelity(only, full, threads, _each(each)))
    return report
