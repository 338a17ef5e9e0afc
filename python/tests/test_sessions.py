"""Sessions with the virtual console: the same bits at every run, and again from a recording."""

import os
import pickle
import struct
from pathlib import Path

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
    assert report["status"] == "ok" and report["diverged_at"] is None and report["cut_off"] is None
    assert report["host"]["identical"] and report["host"]["steps"] == report["host"]["verified_steps"] > 50
    assert report["console"]["verified_ticks"] == report["ticks"] > 500
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    report = sutura.replay(cut)
    assert report["cut_off"] and report["status"] == "cut-off"
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


def last_seconds(recording: bytes) -> bytes:
    """The same recording as one that begins in the middle of its session: a word in its second record, which is about it."""
    begins = 8
    begins += 9 + struct.unpack_from("<Q", recording, begins + 1)[0]
    ends = begins + 9 + struct.unpack_from("<Q", recording, begins + 1)[0]
    body = recording[begins + 9 : ends]
    name = 4 + struct.unpack_from("<I", body)[0]
    words = body[name + 4 :]
    key = struct.pack("<I", 6) + b"begins"
    value = words.index(key) + len(key)
    length = struct.unpack_from("<I", words, value)[0]
    words = words[:value] + struct.pack("<I", 5) + b"later" + words[value + 4 + length :]
    body = body[:name] + struct.pack("<I", len(words)) + words
    return recording[: begins + 1] + struct.pack("<Q", len(body)) + body + recording[ends:]


def test_a_replay_says_what_could_not_be_compared(felt, tmp_path):
    path = tmp_path / "session.mcap"
    sutura.run(sutura.scene(felt), record=path)
    path.write_bytes(last_seconds(path.read_bytes()))
    report = sutura.replay(path)
    assert (report["status"], report["diverged_at"]) == ("not-replayed", None)
    host = report["host"]
    assert (host["identical"], host["verified_steps"]) == (False, 0) and "last seconds" in host["why"]
    assert host["contacts"] > 50, "contacts are compared as the command does"


def test_what_a_scene_was_read_from_is_kept_wherever_the_program_goes(felt, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "devices").mkdir()
    device = Path(__file__).parents[2] / "devices/cartesian-bench.toml"
    (tmp_path / "mine.toml").write_text(device.read_text())
    text = sutura.scene(felt | {"device": "mine.toml"}, directory=tmp_path).toml
    (tmp_path / "scene.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    scene = sutura.Scene.load("scene.toml")
    as_text = sutura.Scene.from_toml(text, directory=".")
    monkeypatch.chdir(tmp_path / "elsewhere")
    for one in (scene, as_text, pickle.loads(pickle.dumps(scene))):
        files = ["mine.toml"] if one is as_text else ["mine.toml", "scene.toml"]
        for file in files:
            before = (tmp_path / file).read_bytes()
            with pytest.raises(sutura.Error, match="which the scene is read from"):
                sutura.run(one, record=tmp_path / file, seconds=0.05, overwrite=True)
            assert (tmp_path / file).read_bytes() == before


@pytest.mark.skipif(os.name == "nt", reason="has no such pipes")
def test_a_recording_is_a_plain_file(felt, tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "folder.mcap").mkdir()
    for name in ("pipe", "folder"):
        with pytest.raises(sutura.Error, match=f"it is a {name}, and only plain files are written: name a file"):
            sutura.run(sutura.scene(felt), record=tmp_path / f"{name}.mcap", seconds=0.05, overwrite=True)


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
