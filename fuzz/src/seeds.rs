//! What is mutated: committed files and those that the project has anyway.
//!
//! Entry points: [`frames`], [`files`]. Of a frame only kind, console time and body are kept; version, session, sequence
//! and checksum are always made anew, so that the frames outlive versions.

use fastrand::Rng;
use std::path::{Path, PathBuf};
use sutura_shared::wire::message::{Hello, Refusal};
use sutura_shared::wire::{MAX_FRAME, SCHEMA_HASH, encode};

/// A message to begin with.
#[derive(Clone, Debug)]
pub struct Seed {
    /// Where it is from.
    pub name: String,
    /// Kind of the message.
    pub kind: u8,
    /// Body in postcard.
    pub body: Vec<u8>,
}

/// How often a message of a kind is sent, of 100: kinds, and their part.
pub type Shares = [(&'static [u8], u8)];

/// What a console is sent: mostly what it renders. Orders to the simulation disarm it before long.
pub const TO_CONSOLE: &Shares = &[
    (&[3], 40),
    (&[16], 14),
    (&[17], 12),
    (&[18], 10),
    (&[20], 8),
    (&[4], 6),
    (&[7], 4),
    (&[6], 3),
    (&[1, 2, 5, 8], 3),
];

/// What a host is sent.
pub const TO_HOST: &Shares = &[
    (&[2], 70),
    (&[8], 12),
    (&[5], 12),
    (&[1, 3, 4, 6, 7, 16, 17, 18, 20], 6),
];

/// One of the seeds.
pub fn choose<'a>(seeds: &'a [Seed], shares: &Shares, rng: &mut Rng) -> Option<&'a Seed> {
    let mut left = rng.u8(0..shares.iter().map(|(_, part)| part).sum());
    let (kinds, _) = shares.iter().find(|(_, part)| {
        let here = left < *part;
        left = left.saturating_sub(*part);
        here
    })?;
    let kind = rng.choice(*kinds)?;
    let of_kind = || seeds.iter().filter(|seed| seed.kind == *kind);
    of_kind().nth(rng.usize(0..of_kind().count().max(1)))
}

/// A file to begin with.
#[derive(Clone, Debug)]
pub struct File {
    /// Name with extension.
    pub name: String,
    /// What is in it.
    pub text: String,
}

/// A file that is no text.
#[derive(Clone, Debug)]
pub struct Binary {
    /// Name with extension.
    pub name: String,
    /// What is in it.
    pub bytes: Vec<u8>,
}

/// Root of the checkout.
pub fn root() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    here.parent().map(Path::to_path_buf).unwrap_or_default()
}

/// The golden frames, and those of `corpus/stream`: files of whole frames.
///
/// Files that cannot be read are left out; the tests see to it that there are all.
pub fn frames() -> Vec<Seed> {
    let golden =
        std::fs::read_to_string(root().join("tests/golden/frames.hex")).unwrap_or_default();
    let lines = golden.lines().filter(|line| !line.starts_with('#'));
    let mut streams: Vec<(String, Vec<u8>)> = lines
        .filter_map(|line| {
            let (name, hex) = line.split_once(' ')?;
            Some((name.to_owned(), bytes_of(hex)))
        })
        .collect();
    // The golden ones have another schema, which is refused before all else.
    let hello = Hello {
        schema_hash: SCHEMA_HASH,
        nonce: 1,
        session: 0,
        tick_hz: 1000,
        max_frame: MAX_FRAME as u16,
        simulated: false,
        device_name: [0; 16],
        refusal: Refusal::None,
    };
    let mut frame = [0; MAX_FRAME];
    let length = encode(0, 0, 0, &hello, &mut frame).unwrap_or_default();
    let frame = frame.get(..length).unwrap_or_default().to_vec();
    streams.push(("hello_of_this_schema".to_owned(), frame));
    for path in listed("stream") {
        let bytes = std::fs::read(&path).unwrap_or_default();
        streams.push((path.display().to_string(), bytes));
    }
    streams
        .into_iter()
        .flat_map(|(name, bytes)| packets(&name, &bytes))
        .collect()
}

/// The frames in a stream.
fn packets(name: &str, bytes: &[u8]) -> Vec<Seed> {
    let frames = bytes.split(|byte| *byte == 0);
    frames
        .filter_map(|frame| {
            let mut packet = vec![0; frame.len()];
            let len = cobs::decode(frame, &mut packet).ok()?.frame_size();
            let kind = *packet.get(1)?;
            let body = packet.get(18..len.checked_sub(4)?)?.to_vec();
            Some(Seed {
                name: name.to_owned(),
                kind,
                body,
            })
        })
        .collect()
}

fn bytes_of(hex: &str) -> Vec<u8> {
    let digits: Vec<u8> = hex
        .chars()
        .filter_map(|digit| {
            digit
                .to_digit(16)
                .and_then(|digit| u8::try_from(digit).ok())
        })
        .collect();
    digits
        .chunks_exact(2)
        .map(|pair| pair.iter().fold(0, |byte, digit| byte << 4 | digit))
        .collect()
}

fn listed(target: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpus")
        .join(target);
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    // Folders are listed in any order.
    paths.sort();
    paths
}

/// The text files of `corpus/<target>`.
pub fn files(target: &str) -> Vec<File> {
    let paths = listed(target);
    let read = |path: &PathBuf| {
        Some(File {
            name: path.file_name()?.to_string_lossy().into_owned(),
            text: std::fs::read_to_string(path).ok()?,
        })
    };
    paths.iter().filter_map(read).collect()
}

/// The recordings of `corpus/recording`, each cut off after its first chunk.
pub fn recordings() -> Vec<Binary> {
    let paths = listed("recording");
    let read = |path: &PathBuf| {
        Some(Binary {
            name: path.file_name()?.to_string_lossy().into_owned(),
            bytes: std::fs::read(path).ok()?,
        })
    };
    paths.iter().filter_map(read).collect()
}
