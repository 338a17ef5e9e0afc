"""Scenes: from dicts, from text and from files; what is wrong is said as the command says it."""

import copy
import pickle
import random
import tomllib

import numpy as np
import pytest
from conftest import FULL, ROOT

import sutura

SCENES = ROOT / "scenes"


def drawn(seed: int) -> str:
    """The text of a random scene, written without the package."""
    draw = random.Random(seed)
    near = draw.uniform
    model = draw.choice(["linear", "corotational"])
    tools = "".join(
        f"\n[[tool]]\nid = {index}\nradius_m = {near(0.008, 0.015)!r}\n"
        + ("" if index == 0 else f"position_m = [{near(-0.01, 0.01)!r}, {near(-0.01, 0.01)!r}, {near(0.02, 0.05):.3e}]\n")
        for index in range(draw.randint(1, 2))
    )
    return f"""
name = "drawn \\"{seed}\\" \u00e4"
seconds = {draw.randint(1, 9)}
[mesh.slab]
size_m = [{near(0.05, 0.08)!r}, {near(0.05, 0.08)!r}, {near(0.02, 0.04)!r}]
divisions = [{draw.randint(3, 5)}, {draw.randint(3, 5)}, 2]
[tissue]
model = "{model}"
youngs_modulus_pa = {10 ** near(3.0, 5.0)!r}
poisson_ratio = {near(0.0, 0.48)!r}
[[fixed]]
box = {{ min_m = [-1, -1, -1.0], max_m = [1, 1, -0.0199] }}
{tools}
"""


def pressed(scene: sutura.Scene) -> tuple[int, bytes]:
    """The state after three steps, and what the tool feels by then."""
    solver = sutura.Solver(scene)
    for height_m in (0.02, 0.009, 0.007):
        step = solver.step([0.001, 0.002, height_m], most_steps=100)
    assert step.has_balance, step.status
    return solver.hash(), step.wrench().tobytes() + step.tangent().tobytes()


@pytest.mark.parametrize("part", range(10))
def test_a_dict_is_its_text_to_the_bit(part):
    count = 100 if FULL else 2
    for seed in range(part * count, (part + 1) * count):
        text = drawn(seed)
        as_text, as_dict = sutura.scene(text), sutura.scene(tomllib.loads(text))
        assert as_text.points_m().tobytes() == as_dict.points_m().tobytes(), text
        assert pressed(as_text) == pressed(as_dict), text


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_scene_of_the_project_survives_as_a_dict(path):
    description = tomllib.loads(path.read_text(encoding="utf-8"))
    assert tomllib.loads(sutura.to_toml(description)) == description


def test_arrays_and_tuples_of_a_dict_are_lists(slab):
    plain = sutura.scene(slab)
    slab["mesh"]["slab"]["size_m"] = np.array(slab["mesh"]["slab"]["size_m"])
    slab["mesh"]["slab"]["divisions"] = tuple(np.int64(each) for each in slab["mesh"]["slab"]["divisions"])
    slab["tissue"]["poisson_ratio"] = np.float64(0.45)
    assert sutura.scene(slab).points_m().tobytes() == plain.points_m().tobytes()


def test_a_flaw_is_said_with_its_place_and_its_help(slab):
    wrong = copy.deepcopy(slab)
    wrong["tissue"]["poisson_ratio"] = 0.6
    with pytest.raises(sutura.SceneError) as raised:
        sutura.scene(wrong)
    said = str(raised.value)
    assert "poisson_ratio = 0.6" in said and "scene.toml:" in said, said
    del slab["tissue"]["poisson_ratio"]
    slab["tissue"]["poison_ratio"] = 0.4
    with pytest.raises(sutura.SceneError, match="poisson_ratio"):
        sutura.scene(slab)


def test_what_no_file_can_say_is_named_by_its_place(slab):
    slab["tool"][0]["position_m"] = None
    with pytest.raises(TypeError, match=r"tool\[0\]\.position_m is None: leave the key out"):
        sutura.scene(slab)
    slab["tool"][0]["position_m"] = {1.0, 2.0}
    with pytest.raises(TypeError, match=r"tool\[0\]\.position_m is of the type set: give a number"):
        sutura.scene(slab)
    with pytest.raises(TypeError, match="the key 3 in tissue is of the type int: keys are text"):
        sutura.scene({"tissue": {3: 4}})


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(sutura.SceneError, match="nowhere.toml"):
        sutura.load(tmp_path / "nowhere.toml")


def test_a_scene_goes_to_another_process_with_its_files(slab):
    scene = sutura.scene(slab)
    again = pickle.loads(pickle.dumps(scene))
    assert again.toml == scene.toml and pressed(again) == pressed(scene)


def test_the_mesh_is_given_in_arrays_of_its_own(slab):
    scene = sutura.scene(slab)
    points_m, cells = scene.points_m(), scene.cells()
    assert points_m.shape == (7 * 7 * 4, 3) and cells.shape[1] == 4
    corners = points_m[cells]
    edges = corners[:, 1:] - corners[:, :1]
    assert np.abs(np.linalg.det(edges)).sum() / 6 == pytest.approx(0.06 * 0.06 * 0.03)
    points_m[:] = 0.0
    assert scene.points_m().any()
    assert (scene.points_m()[scene.fixed(), 2] == -0.03).all() and len(scene.fixed()) == 49
