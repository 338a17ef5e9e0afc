"""Sessions with the virtual console: the same bits at every run, and again from a recording."""

import pytest

import sutura


@pytest.fixture
def felt(slab) -> dict:
    """A slab that a hand presses."""
    return slab | {
        "device": "cartesian-bench",
        "seconds": 0.6,
        "hand": {
            "stiffness_n_per_m": 1000.0,
            "damping_n_s_per_m": 10.0,
            "way_point": [
                {"time_s": 0.0, "position_m": [0.0, 0.0, 0.016]},
                {"time_s": 0.4, "position_m": [0.0, 0.0, 0.010]},
            ],
        },
    }


def test_a_session_is_felt_and_comes_out_the_same_again(felt):
    scene = sutura.scene(felt)
    first, again = sutura.run(scene), sutura.run(scene)
    assert (first["status"], first["console"], first["mode"]) == ("ok", "virtual", "armed"), first
    assert first["contact_steps"] > 10
    for key in ("ticks", "contact_steps", "trace_hash", "force_n", "scene"):
        assert first[key] == again[key], key
    shorter = sutura.run(scene, seconds=0.1)
    assert shorter["ticks"] < first["ticks"] and shorter["contact_steps"] < first["contact_steps"]


def test_what_the_device_cuts_off_is_said_by_the_session_and_by_its_replay(felt, tmp_path):
    path = tmp_path / "cut.mcap"
    stiff = felt | {"device": "serial-arm", "tissue": felt["tissue"] | {"youngs_modulus_pa": 200e3}}
    summary = sutura.run(sutura.scene(stiff), record=path)
    limited = summary["ticks_limited"]
    assert summary["status"].startswith("limited: ") and limited["force"] > 10, summary["status"]
    assert summary["force_n"]["peak"] < 2.001 < summary["force_n"]["solved_peak"]
    assert sutura.replay(path)["console"]["ticks_limited"] == limited
    soft = felt | {"tissue": felt["tissue"] | {"youngs_modulus_pa": 15.0}}
    assert sutura.run(sutura.scene(soft))["status"].startswith("faint: ")


def test_a_recording_runs_again_to_the_bit_and_says_where_it_is_cut_off(felt, tmp_path):
    path = tmp_path / "session.mcap"
    sutura.run(sutura.scene(felt), record=path)
    report = sutura.replay(path)
    assert report["diverged_at"] is None and report["cut_off"] is None
    assert report["host"]["identical"] and report["host"]["steps"] == report["host"]["verified_steps"] > 50
    assert report["console"]["verified_ticks"] == report["ticks"] > 500
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert sutura.replay(cut)["cut_off"]
    with pytest.raises(sutura.Error, match="it is no MCAP file: give a file that `sutura run --record FILE` has written"):
        cut.write_bytes(b"no recording")
        sutura.replay(cut)


def test_a_recording_is_written_over_nothing_unless_asked_and_never_over_what_is_read(felt, tmp_path):
    path, scene = tmp_path / "scene.toml", tmp_path / "link.mcap"
    path.write_text(sutura.scene(felt).toml)
    scene.symlink_to("scene.toml")
    for overwrite in (False, True):
        for file in (path, scene):
            with pytest.raises(sutura.Error, match="which the scene is read from"):
                sutura.run(sutura.Scene.load(path), record=file, seconds=0.05, overwrite=overwrite)
    assert sutura.Scene.load(path).seconds == 0.6
    other = tmp_path / "a.mcap"
    other.write_bytes(b"mine")
    with pytest.raises(sutura.Error, match=r"is there already: name another file, or write over it with overwrite=True"):
        sutura.run(sutura.scene(felt), record=other, seconds=0.05)
    assert other.read_bytes() == b"mine"
    sutura.run(sutura.scene(felt), record=other, seconds=0.05, overwrite=True)
    assert sutura.replay(other)["host"]["identical"]


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ({"seconds": 0.0}, "seconds is 0: give a length above 0 and at most 86400, a day"),
        ({"host_hz": 2000.0}, "host_hz is 2000: give a rate above 0 and at most 1000"),
        ({"host_hz": 2.0}, "host_hz: 2 solves a second: a contact is used for"),
        ({"rendering": "force"}, 'rendering is "force": give "hold", "tangent" or "rows"'),
    ],
)
def test_what_no_session_can_be_is_named(felt, named, said):
    with pytest.raises(ValueError) as raised:
        sutura.run(sutura.scene(felt), **named)
    assert said in str(raised.value)


def test_a_scene_without_a_hand_or_a_model_has_no_session(slab, felt):
    with pytest.raises(sutura.Error, match=r"no hand to hold a virtual console: add a \[hand\] section"):
        sutura.run(sutura.scene(slab))
    felt["tissue"]["model"] = "auto"
    with pytest.raises(sutura.Error, match="`auto` tissue, which depends on what this machine can do"):
        sutura.run(sutura.scene(felt))
