"""Scenes: from dicts, from text and from files; what is wrong is said as the command says it."""

import copy
import json
import pickle
import re
import tomllib

import numpy as np
import pytest
from conftest import FULL, ROOT
from drawn import Draw, keys, toml

import sutura

SCENES = ROOT / "scenes"


def felt(scene: sutura.Scene, positions_m: list[list[float]]) -> tuple[list[str], bytes]:
    """How each of some steps ended, and the bits of the state after them and of what the tool feels, and how many warnings there are."""
    solver = sutura.Solver(scene)
    steps = [solver.step(position_m, most_steps=20) for position_m in positions_m]
    felt = [each for step in steps if step.has_balance for each in (step.wrench(), step.tangent())]
    numbers = [solver.positions_m(), scene.points_m(), *felt]
    bits = b"".join(each.tobytes() for each in numbers)
    return [step.status for step in steps], bits + solver.hash().to_bytes(8, "big") + bytes([len(scene.warnings)])


def pressed(scene: sutura.Scene) -> tuple[list[str], bytes]:
    return felt(scene, [[0.001, 0.002, height_m] for height_m in (0.02, 0.009, 0.007)])


@pytest.mark.parametrize("part", range(10))
def test_a_dict_is_its_text_to_the_bit(part):
    count = 100 if FULL else 6
    balanced = 0
    for seed in range(part * count, (part + 1) * count):
        draw = Draw(seed)
        text = toml(draw.scene, seed)
        assert tomllib.loads(text) == draw.scene, text
        as_text = felt(sutura.scene(text, directory=ROOT), draw.positions_m)
        as_dict = felt(sutura.scene(draw.scene, directory=ROOT), draw.positions_m)
        assert as_text == as_dict, text
        balanced += as_text[0][-1] == "ok"
    # Where nothing is solved, nothing is compared.
    assert balanced >= 0.6 * count


def test_drawn_scenes_name_whatever_a_scene_can_name():
    folder = ROOT / "host/scene-file/src"
    sources = [(folder / name).read_text() for name in ("scene.rs", "jaws.rs", "wound.rs")]
    said = {key for source in sources for key in re.findall(r"^    pub (\w+): ", source, re.MULTILINE)}
    spring = {"spring", "from_m", "to_m", "to_is_fixed"}
    # Arrays with regions are of files, which no scene is drawn with.
    known = (said - {"cuboid", "region_array"}) | {"box"} | spring
    short = [Draw(seed).scene for seed in range(60)]
    assert set().union(*map(keys, short)) == known
    models = re.findall(r'TissueModel::\w+ => "([\w-]+)"', sources[0])
    drawn = {Draw(seed).scene["tissue"].get("model", "linear") for seed in range(300)}
    assert drawn == set(models) - {"auto"}


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


def test_a_file_that_is_no_text_is_told_by_its_byte(tmp_path):
    path = tmp_path / "latin.toml"
    path.write_bytes('# K\u00f6rper\nname = "a"\n'.encode("latin-1"))
    with pytest.raises(sutura.SceneError, match="latin.toml: it is no text: byte 3, in line 1, is 0xF6") as raised:
        sutura.load(path)
    assert "iconv -f LATIN1 -t UTF-8" in str(raised.value)
    with pytest.raises(ValueError, match="cannot read .*latin.toml: it is no text: byte 3, in line 1, is 0xF6"):
        sutura.merge([path])


LONG = "x" * 100_000
STEERING = "no\x1b[31m\x07such"


@pytest.mark.parametrize("name", [LONG, STEERING])
@pytest.mark.parametrize(
    "call",
    [
        lambda name, slab: sutura.scene(slab | {"tissue": {name: 1}}),
        lambda name, slab: sutura.scene(f"{json.dumps(name)} = 1", name=name),
        lambda name, slab: sutura.scene(slab | {name: None}),
        lambda name, slab: sutura.scene(slab | {"tissue": {name: {1: 2}}}),
        lambda name, slab: sutura.scene(slab | {"mesh": {"file": name, "scale_to_m": 1.0}}),
        lambda name, slab: sutura.load(name),
        lambda name, slab: sutura.replay(name),
        lambda name, slab: sutura.run(sutura.scene(slab), rendering=name),
        lambda name, slab: sutura.run(sutura.scene(slab), console=name, lockstep=True),
        lambda name, slab: sutura.tradeoff(name),
        lambda name, slab: sutura.tradeoff(cases=name),
        lambda name, slab: sutura.stability(name),
        lambda name, slab: sutura.fidelity(name),
        lambda name, slab: sutura.merge([{name: 1}]),
        lambda name, slab: sutura.run_task({"measure": name}),
        lambda name, slab: sutura.run_task({"measure": "tradeoff", "case": "beam", name: 1}),
        lambda name, slab: next(sutura.sweep([], name)),
        lambda name, slab: sutura.Console(name),
    ],
)
def test_messages_steer_no_terminal_and_their_lines_end(call, name, slab):
    with pytest.raises((sutura.Error, ValueError, TypeError)) as raised:
        call(name, slab)
    said = str(raised.value)
    steering = [letter for letter in said if not letter.isprintable() and letter not in "\n\t"]
    assert said and not steering, said
    assert max(map(len, said.split("\n"))) <= 2100, len(said)


def test_warnings_of_a_scene_steer_no_terminal(slab):
    # A density without gravity is warned of, at its line.
    slab["tissue"]["density_kg_per_m3"] = 1000.0
    scene = sutura.scene(sutura.to_toml(slab), name=STEERING)
    assert scene.warnings and all("\x1b" not in warning for warning in scene.warnings)


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
