//! What users are told of bad input: in the book's words, once, in lines that end, with nothing in it that steers a terminal.

use crate::support::{Ran, sutura_in};
use std::path::Path;

/// Words of the language and the system that say nothing to whoever writes a scene.
const NOT_OURS: [&str; 17] = [
    "usize",
    "u8",
    "u16",
    "u32",
    "u64",
    "i32",
    "i64",
    "f32",
    "f64",
    "invalid type",
    "untagged",
    "variant",
    "Utf8Error",
    "panicked",
    "valid UTF-8",
    "invalid digit",
    "float literal",
];

/// Letters that a line has at most.
const MOST_LETTERS: usize = 2100;

/// A scene that is good, on a slab.
const SCENE: &str = "\
device = \"cartesian-bench\"
seconds = 0.1

[mesh.slab]
size_m = [0.04, 0.04, 0.02]
divisions = [4, 4, 2]

[tissue]
youngs_modulus_pa = 10e3
poisson_ratio = 0.4

[[fixed]]
plane = { axis = \"z\", at_m = -0.02 }

[[tool]]
radius_m = 0.03

[hand]
stiffness_n_per_m = 1000.0
damping_n_s_per_m = 10.0
way_point = [
    { time_s = 0.0, position_m = [0.0, 0.0, 0.032] },
    { time_s = 0.1, position_m = [0.0, 0.0, 0.030] },
]
";

/// What is changed in it, and what is said of that.
const SLIPS: [(&str, &str, &str); 12] = [
    (
        "divisions = [4, 4, 2]",
        "divisions = [4, 4]",
        "a list of 3 is needed",
    ),
    (
        "divisions = [4, 4, 2]",
        "divisions = [4, 4, -2]",
        "a whole number from 0 up is needed here, not `-2`",
    ),
    (
        "divisions = [4, 4, 2]",
        "divisions = [4, 4, 2.5]",
        "a whole number from 0 up is needed here, not `2.5`",
    ),
    (
        "divisions = [4, 4, 2]",
        "divisions = \"fine\"",
        "not the text \"fine\"",
    ),
    (
        "0.4\n\n[[fixed",
        "\"soft\"\n\n[[fixed",
        "a number is needed",
    ),
    (
        "radius_m = 0.03",
        "radius_m = 0.03\nid = 300",
        "a whole number from 0 to 255 is needed",
    ),
    (
        "radius_m = 0.03",
        "radius_m = 0.03\nid = -1",
        "a whole number from 0 to 255 is needed",
    ),
    ("radius_m = 0.03", "radius_m = [1.0]", "a number is needed"),
    ("axis = \"z\"", "axis = \"\\u001b[31mz\"", "unknown value"),
    ("[hand]", "[hand]\n\"\\u001b[2J\" = 1", "unknown key"),
    (
        "seconds = 0.1",
        "seconds = nan",
        "seconds = NaN: must be more than 0",
    ),
    ("seconds = 0.1", "seconds = ", "scene.toml:2"),
];

fn is_told_well(ran: &Ran, what: &str) {
    assert!(
        [1, 2, 3].contains(&ran.code),
        "{what}: exit code {}: {}{}",
        ran.code,
        ran.stdout,
        ran.stderr
    );
    let said = format!("{}{}", ran.stderr, ran.stdout);
    assert!(said.len() > 10, "{what}: nothing is said");
    let is_steering = |letter: char| letter.is_control() && letter != '\n' && letter != '\t';
    assert!(!said.contains(is_steering), "{what}: {said:?}");
    for line in said.lines() {
        assert!(
            line.chars().count() <= MOST_LETTERS,
            "{what}: a line of {} letters",
            line.len()
        );
    }
    let words = |text: &str| -> Vec<String> {
        let words = text.split(|c: char| !c.is_alphanumeric() && c != '_');
        words.map(str::to_owned).collect()
    };
    for word in NOT_OURS {
        let is_there = match word.contains(' ') {
            true => said.contains(word),
            false => words(&said).contains(&word.to_owned()),
        };
        assert!(!is_there, "{what}: `{word}` in {said}");
    }
    for reason in [
        "No such file or directory",
        "Is a directory",
        "Permission denied",
    ] {
        assert!(
            ran.stderr.matches(reason).count() <= 1,
            "{what}: twice: {}",
            ran.stderr
        );
    }
}

fn check(at: &Path, scene: &str) -> Ran {
    std::fs::write(at.join("scene.toml"), scene).expect("writable");
    sutura_in(at, &["scene", "check", "scene.toml"])
}

#[test]
fn slips_in_a_scene_are_told_in_words() {
    let folder = tempfile::tempdir().expect("a folder");
    let good = check(folder.path(), SCENE);
    assert_eq!(good.code, 0, "{}", good.stderr);
    for (from, to, said) in SLIPS {
        let scene = SCENE.replacen(from, to, 1);
        assert_ne!(scene, SCENE, "{from}");
        let ran = check(folder.path(), &scene);
        assert_eq!(ran.code, 2, "{to}: {}", ran.stderr);
        is_told_well(&ran, to);
        assert!(
            ran.stderr.contains(said),
            "{to}: no \"{said}\" in {}",
            ran.stderr
        );
    }
}

/// Names and lines of files are the users', and may have anything in them.
#[cfg(unix)]
#[test]
fn names_and_files_that_are_no_text_are_told_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let long = format!(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 {}\n$EndNodes\n",
        "0 ".repeat(200_000)
    );
    std::fs::write(at.join("long.msh"), long).expect("writable");
    std::fs::write(at.join("binary.msh"), [0xFF, 0x1B, b'[', b'2', b'J', 0, 7]).expect("writable");
    std::fs::write(at.join("binary.toml"), [0xFF, 0x1B, b'[', b'2', b'J', 0, 7]).expect("writable");
    std::fs::write(
        at.join("line.toml"),
        format!("a = \"{}\"\n", "x".repeat(1_000_000)),
    )
    .expect("writable");
    std::fs::create_dir(at.join("folder.toml")).expect("made");
    std::fs::create_dir(at.join("folder.msh")).expect("made");
    let steering = "no\u{1b}[31m\u{7}\nsuch.toml";
    for line in [
        &["scene", "check", steering][..],
        &["run", steering],
        &["run", "--console", "/dev/\u{1b}[31mtty"],
        &["scene", "check", "binary.toml"],
        &["scene", "check", "line.toml"],
        &["scene", "check", "folder.toml"],
        &["scene", "check", "none.toml"],
        &["mesh", "info", "no\u{1b}[31m.msh"],
        &["mesh", "info", "long.msh"],
        &["mesh", "info", "binary.msh"],
        &["mesh", "info", "folder.msh"],
        &["mesh", "info", "none.msh"],
        &["mesh", "info", "none.msh", "--scale", "-1"],
        &["replay", "none.mcap"],
        &["replay", "binary.toml"],
        &["replay", "folder.toml"],
        &["view", "none.mcap"],
        &["solve", "none.toml", "--out", "a.json"],
        &["run", "--series", "none/\u{0}x"][..2],
        &["flash", "none.bin"],
        &["flash", "binary.toml"],
        &["device", "log", "1", "--elf", "binary.toml"],
        &["device", "selftest", "/dev/none"],
        &["doctor", "--scene", "none.toml"],
        &["run", "--seconds", "x"],
        &["run", "--host-hz", "-1"],
        &["run", "--host-hz", "fast"],
        &[
            "mesh", "fill", "none.stl", "--nodes", "-5", "--out", "a.msh",
        ],
        &["mesh", "fill", "none.stl", "--nodes", "", "--out", "a.msh"],
        &["tradeoff", "merge", "binary.toml"],
        &["console", "--device", "binary.toml"],
        &["run", "--tissue", "\u{1b}[31m"],
        &["run", "--fixture", "wall:\u{1b}"],
        &["mesh", "info", "none.msh", "--rows", "x"],
        &["tradeoff", "--only", "\u{1b}[31mnothing"],
        &["stability", "--only", "\u{1b}[31mnothing"],
        &["fidelity", "--only", "\u{1b}[31mnothing"],
    ] {
        for json in [false, true] {
            let more = if json { &["--format", "json"][..] } else { &[] };
            is_told_well(&sutura_in(at, &[line, more].concat()), &format!("{line:?}"));
        }
    }
}

/// A file in another coding than UTF-8, or none of text, is told by its name and the first byte that is not, with what to do.
#[test]
fn a_file_that_is_no_text_is_told_by_its_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(at.join(name), bytes).expect("writable");
    };
    let latin = SCENE.replace("seconds", "name = \"K\u{f6}rper\"\nseconds");
    let latin: Vec<u8> = latin.chars().map(|letter| letter as u8).collect();
    write("latin.toml", &latin);
    let wide: Vec<u8> = "\u{feff}a = 1\n"
        .encode_utf16()
        .flat_map(u16::to_le_bytes)
        .collect();
    write("wide.toml", &wide);
    write(
        "on-latin.toml",
        SCENE
            .replace("\"cartesian-bench\"", "\"latin.toml\"")
            .as_bytes(),
    );
    for (line, file, byte) in [
        (
            &["scene", "check", "latin.toml"][..],
            "latin.toml",
            "byte 36, in line 2, is 0xF6",
        ),
        (
            &["run", "latin.toml", "--lockstep"],
            "latin.toml",
            "byte 36, in line 2, is 0xF6",
        ),
        (
            &["scene", "check", "on-latin.toml"],
            "latin.toml",
            "byte 36, in line 2, is 0xF6",
        ),
        (
            &["console", "--device", "latin.toml"],
            "latin.toml",
            "byte 36, in line 2, is 0xF6",
        ),
        (
            &["solve", "wide.toml", "--out", "a.json"],
            "wide.toml",
            "byte 0, in line 1, is 0xFF",
        ),
        (
            &["tradeoff", "merge", "latin.toml"],
            "latin.toml",
            "byte 36, in line 2, is 0xF6",
        ),
    ] {
        let ran = sutura_in(at, line);
        assert_eq!(ran.code, 2, "{line:?}: {}", ran.stderr);
        is_told_well(&ran, &format!("{line:?}"));
        let said = format!("cannot read {file}: it is no text: {byte}");
        assert!(ran.stderr.contains(&said), "{line:?}: {}", ran.stderr);
        let help = match line[0] {
            "tradeoff" => "sutura tradeoff --cases",
            _ if file.starts_with("wide") => "iconv -f UTF-16 -t UTF-8",
            _ => "iconv -f LATIN1 -t UTF-8",
        };
        assert!(ran.stderr.contains(help), "{line:?}: {}", ran.stderr);
    }
    // Meshes that are text: by the byte in the line that cannot be understood.
    for (name, before) in [
        ("a.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n"),
        ("a.mesh", "MeshVersionFormatted 2\n"),
        ("a.inp", "*NODE\n"),
        ("a.vtk", "# vtk DataFile Version 2.0\n\n"),
        ("a.vtu", "<VTKFile>\n"),
    ] {
        write(
            name,
            &[before.as_bytes(), b"\xF6 \x1B[31m 1 2 3\n"].concat(),
        );
        let told = |ran: &Ran| {
            is_told_well(ran, name);
            assert_eq!(ran.code, 2, "{name}: {}", ran.stderr);
            let byte = format!("byte {}: expected ", before.len());
            for words in [name, &byte, "found 0xF6, which is no text"] {
                assert!(ran.stderr.contains(words), "{name}: {}", ran.stderr);
            }
        };
        let info = sutura_in(at, &["mesh", "info", name]);
        told(&info);
        assert!(info.stderr.contains("write it again"), "{}", info.stderr);
        let slab = "slab]\nsize_m = [0.04, 0.04, 0.02]\ndivisions = [4, 4, 2]";
        let file = format!("]\nfile = \"{name}\"\nscale_to_m = 0.001");
        let scene = SCENE.replace(&format!(".{slab}"), &file);
        assert_ne!(scene, SCENE);
        told(&check(at, &scene));
    }
}

/// Millimetres that were taken for metres, and kPa for Pa, are told with the factor that mends them.
#[test]
fn unlikely_units_are_told_with_place_limit_and_factor() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    for (from, to, place, said) in [
        (
            "size_m = [0.04, 0.04, 0.02]",
            "size_m = [40.0, 40.0, 20.0]",
            "5:",
            &[
                "the body is 40.0 m in size, larger than 2.0 m",
                "times 0.001 it is 40.0 mm",
            ][..],
        ),
        (
            "size_m = [0.04, 0.04, 0.02]",
            "size_m = [0.0004, 0.0004, 0.00002]",
            "5:",
            &[
                "400.0 um in size, smaller than 2.0 mm",
                "the body is 20.0 um thick, thinner than 100.0 um",
                "times 1000 it is 400.0 mm",
            ],
        ),
        (
            "radius_m = 0.03",
            "radius_m = 15.0",
            "16:",
            &[
                "tool 0 has a radius of 15.0 m, larger than the body of 40.0 mm",
                "times 0.001 it is 15.0 mm",
            ],
        ),
        (
            "youngs_modulus_pa = 10e3",
            "youngs_modulus_pa = 10e9",
            "9:",
            &["a frame takes 1e7 N/m", "times 0.001 it is 1e7"],
        ),
    ] {
        let scene = SCENE.replacen(from, to, 1);
        let scene = scene.replace(
            "at_m = -0.02",
            if to.contains("20.0]") {
                "at_m = -20.0"
            } else if to.contains("0.00002") {
                "at_m = -0.00002"
            } else {
                "at_m = -0.02"
            },
        );
        let ran = check(at, &scene);
        for words in said {
            assert!(
                ran.stderr.contains(words),
                "{to}: no \"{words}\" in {}{}",
                ran.stderr,
                ran.stdout
            );
        }
        assert!(
            ran.stderr.contains(&format!("scene.toml:{place}")),
            "{to}: {}",
            ran.stderr
        );
    }
    let long = SCENE.replace(
        "radius_m = 0.03",
        "radius_m = 0.012\nshape = \"capsule\"\nlength_m = 200.0",
    );
    let ran = check(at, &long);
    for words in [
        "`length_m`: a length of 200.0 m, larger than 2.0 m",
        "times 0.001 it is 200.0 mm",
        "scene.toml:18:",
    ] {
        assert!(ran.stderr.contains(words), "no {words} in {}", ran.stderr);
    }
    let far = SCENE.replace("[0.0, 0.0, 0.032]", "[0.0, 0.0, 32.0]");
    let ran = check(at, &far);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    for words in [
        "(0, 0, 32) m: no console goes farther than 10 m",
        "times 0.001 it is in reach",
        "scene.toml:22:",
    ] {
        assert!(ran.stderr.contains(words), "{}", ran.stderr);
    }
    let info = |scale: &str| {
        let mesh = crate::support::root()
            .join("tests/data/cube_350.msh")
            .display()
            .to_string();
        sutura_in(
            at,
            &["mesh", "info", &mesh, "--scale", scale, "--format", "json"],
        )
        .json()
    };
    let of = |scale: &str| info(scale)["warnings"].as_array().expect("a list").len();
    let large = info("1000");
    assert_eq!((of("1"), of("1000")), (0, 1), "{large}");
    let help = large["warnings"][0]["help"].as_str().expect("words");
    assert!(help.contains("with --scale times 0.001"), "{help}");
}

/// What a session refuses is refused by a check, before anybody waits for a console.
#[test]
fn what_run_refuses_check_refuses() {
    let folder = tempfile::tempdir().expect("a folder");
    for (from, to) in [
        ("[hand]", "[host]\nhost_hz = 5.0\n\n[hand]"),
        ("device = \"cartesian-bench\"\n", ""),
        ("damping_n_s_per_m = 10.0", "damping_n_s_per_m = -10.0"),
        ("time_s = 0.1", "time_s = -0.1"),
        ("0.032] }", "32.0] }"),
        ("radius_m = 0.03", "shape = \"grip\"\n\n[[tool]]\nid = 0"),
        ("[[fixed]]\nplane = { axis = \"z\", at_m = -0.02 }\n", ""),
        ("poisson_ratio = 0.4", "poisson_ratio = 0.5"),
    ] {
        let scene = SCENE.replacen(from, to, 1);
        assert_ne!(scene, SCENE, "{from}");
        let checked = check(folder.path(), &scene);
        let run = sutura_in(folder.path(), &["run", "scene.toml", "--lockstep"]);
        assert_eq!(
            (checked.code, run.code),
            (2, 2),
            "{to}: {}{}",
            checked.stderr,
            run.stderr
        );
    }
}
