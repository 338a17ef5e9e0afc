"""The examples, which need more than the package: scipy, gymnasium, and what runs a notebook."""

import runpy
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.full

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str) -> dict:
    return runpy.run_path(str(EXAMPLES / name))


def test_a_modulus_is_found_in_a_force_curve():
    fit = example("fit_modulus.py")
    depths_m = np.linspace(0.001, 0.005, 5)
    exact_n = fit["press"](8e3, depths_m)
    assert (np.diff(exact_n) > 0.0).all()
    modulus_pa, _ = fit["fit"](exact_n, depths_m)
    assert modulus_pa == pytest.approx(8e3, rel=1e-5)
    # The deviation that is said covers what noise does.
    noisy_n = exact_n + np.random.default_rng(2).normal(0.0, 0.005, exact_n.shape)
    modulus_pa, deviation_pa = fit["fit"](noisy_n, depths_m)
    assert 0.0 < abs(modulus_pa - 8e3) < 4.0 * deviation_pa < 2e3


def test_a_needle_is_driven_through_a_slab():
    from gymnasium.utils.env_checker import check_env

    driving = example("needle_driving.py")
    environment = driving["NeedleDriving"]()
    check_env(environment, skip_render_check=True)
    down = np.array([0.0, 0.0, -1.0])
    paid, observed, through = driving["drive"](environment, down)
    # In at the top, out at the bottom; friction pulls the grip back up, and costs.
    assert through and observed[6] == 2.0
    assert observed[5] > 0.1
    assert 0.0 < paid < -observed[2]
    # An episode is the same to the bit after another.
    again, last, _ = driving["drive"](environment, down)
    assert again == paid and (last == observed).all()
    paid_up, observed, through = driving["drive"](environment, -down, 20)
    assert paid_up < 0.0 and not through and observed[6] == 0.0


def test_the_notebook_runs():
    import nbclient
    import nbformat

    path = EXAMPLES / "palpation.ipynb"
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(EXAMPLES)}}).execute()
    pictures = [
        output
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    ]
    assert len(pictures) == 2
