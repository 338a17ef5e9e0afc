//! Scene and mesh files that went wrong in a place or two.
//!
//! Entry points: [`run`]; [`scene`] and [`mesh`] are the targets as fuzzers call them.

use crate::seeds::{File, root};
use fastrand::Rng;
use std::path::Path;
use std::time::{Duration, Instant};
use sutura_host::mesh::{RawMesh, read_raw_mesh_with};
use sutura_host::scene::{Document, Scene, read_device};

/// What stands between the two files of a tetgen mesh in one text.
const TETGEN_CUT: &str = "# ele\n";
/// No small file may keep a reader busy for longer; a hundred times what the largest of them take on a busy machine.
const SLOWEST: Duration = Duration::from_secs(60);

/// Counts of one kind of file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Files {
    /// Files read.
    pub files: u64,
    /// Of them: accepted.
    pub accepted: u64,
    /// Longest time for one \[us\].
    pub slowest_us: u64,
}

impl Files {
    /// One more.
    ///
    /// # Panics
    /// If it kept its reader busy for a minute.
    pub(crate) fn count(&mut self, accepted: bool, took: Duration) {
        assert!(took < SLOWEST, "its reader is busy for {took:?}");
        self.files += 1;
        self.accepted += u64::from(accepted);
        self.slowest_us = self
            .slowest_us
            .max(u64::try_from(took.as_micros()).unwrap_or(u64::MAX));
    }
}

/// A scene, or a device, from its text; true if it was accepted. A scene's mesh is looked for beside the corpus.
///
/// # Panics
/// On a defect.
pub fn scene(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(bytes);
    let folder = root().join("fuzz/corpus/mesh");
    let document = Document::embedded("fuzz.toml", &folder, &text);
    let scene = Scene::read(&document, "fuzz");
    let device = read_device(&document);
    if let Err(error) = &scene {
        assert!(!error.to_string().is_empty());
    }
    scene.is_ok() || device.is_ok()
}

/// A mesh from its text, in the format that its beginning tells; true if it was accepted.
///
/// # Panics
/// On a defect.
pub fn mesh(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(bytes);
    let name = match text.trim_start() {
        text if text.contains(TETGEN_CUT) => "a.node",
        text if text.starts_with('$') => "a.msh",
        text if text.starts_with('<') => "a.vtu",
        text if text.starts_with('*') => "a.inp",
        text if text.starts_with("MeshVersion") => "a.mesh",
        _ => "a.vtk",
    };
    let (node, ele) = text.split_once(TETGEN_CUT).unwrap_or_default();
    let raw = read_raw_mesh_with(Path::new(name), 1.0, None, |path| {
        Ok(
            match path.extension().and_then(|extension| extension.to_str()) {
                Some("node") => node.as_bytes().to_vec(),
                Some("ele") => ele.as_bytes().to_vec(),
                _ => bytes.to_vec(),
            },
        )
    });
    let checked = raw.and_then(|raw| {
        // What the commands tell of a mesh before they look at it.
        let worst = raw.qualities().into_iter().fold(1.0, f64::min);
        assert!(!worst.is_nan(), "a quality is no number");
        RawMesh::check(raw)
    });
    match checked {
        Ok(mesh) => {
            assert!(mesh.points_m().iter().flatten().all(|x| x.is_finite()));
            true
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

/// Mutated files, one after the other.
///
/// # Panics
/// On a defect, and on a file that keeps a reader busy for a minute.
pub fn run(
    target: fn(&[u8]) -> bool,
    seeds: &[File],
    seed: u64,
    files: u64,
    mut before: impl FnMut(&[u8]),
) -> Files {
    let mut rng = Rng::with_seed(seed);
    let mut tally = Files::default();
    let words = words(seeds);
    for _ in 0..files {
        let Some(file) = rng.choice(seeds) else {
            break;
        };
        let text = mutated(&file.text, &words, &mut rng);
        before(text.as_bytes());
        let began = Instant::now();
        let accepted = target(text.as_bytes());
        tally.count(accepted, began.elapsed());
    }
    tally
}

/// What a number may become. A mesh that a scene asks for stays below 100000 cubes, which is work and no defect.
const NUMBERS: [&str; 24] = [
    "0",
    "-0.0",
    "1",
    "-1",
    "2",
    "3",
    "4",
    "5",
    "7",
    "1e-300",
    "1e-12",
    "0.001",
    "0.5",
    "1.5",
    "40",
    "33",
    "1e6",
    "4294967296",
    "9223372036854775807",
    "-9223372036854775808",
    "1e308",
    "1e400",
    "nan",
    "inf",
];

/// Words, numbers and signs of all seeds.
fn words(seeds: &[File]) -> Vec<String> {
    let mut words: Vec<String> = seeds
        .iter()
        .flat_map(|file| tokens(&file.text))
        .map(str::to_owned)
        .collect();
    words.sort();
    words.dedup();
    words
}

/// Runs of letters, of digits, and single signs, in order and without loss.
fn tokens(text: &str) -> Vec<&str> {
    let sort = |c: char| match c {
        'a'..='z' | 'A'..='Z' | '_' => 0,
        '0'..='9' | '.' | '-' | '+' => 1,
        ' ' => 2,
        _ => 3,
    };
    let mut tokens = Vec::new();
    let (mut start, mut last) = (0, 3);
    for (at, c) in text.char_indices() {
        let now = sort(c);
        if (now != last || now == 3) && at > start {
            tokens.extend(text.get(start..at));
            start = at;
        }
        last = now;
    }
    tokens.extend(text.get(start..));
    tokens
}

fn mutated(text: &str, words: &[String], rng: &mut Rng) -> String {
    let mut tokens = tokens(text);
    for _ in 0..rng.u8(1..=4) {
        let at = rng.usize(0..=tokens.len());
        let end = (at + rng.usize(0..12)).min(tokens.len());
        match rng.u8(0..8) {
            // Numbers are what most files are made of.
            0..=3 => {
                let is_number =
                    |token: &&str| token.starts_with(|c: char| c.is_ascii_digit() || c == '-');
                let number = tokens
                    .iter()
                    .enumerate()
                    .skip(at)
                    .find(|(_, token)| is_number(token));
                let number = number.map_or(at, |(at, _)| at);
                if let (Some(token), Some(other)) = (tokens.get_mut(number), rng.choice(NUMBERS)) {
                    *token = other;
                }
            }
            4 => drop(tokens.drain(at..end)),
            5 => {
                let piece: Vec<&str> = tokens.iter().skip(at).take(end - at).copied().collect();
                let to = rng.usize(0..=tokens.len());
                tokens.splice(to..to, piece);
            }
            6 => {
                if let (Some(token), Some(word)) = (tokens.get_mut(at), rng.choice(words)) {
                    *token = word;
                }
            }
            _ => tokens.truncate(if rng.u8(0..8) == 0 { at } else { tokens.len() }),
        }
    }
    let mut text = tokens.concat();
    if rng.u8(0..16) == 0 {
        let mut bytes = text.into_bytes();
        crate::mutate::line(&mut bytes, rng);
        text = String::from_utf8_lossy(&bytes).into_owned();
    }
    text
}
