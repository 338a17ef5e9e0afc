//! Recordings that went wrong in a place or two, read and replayed.
//!
//! Entry points: [`run`]; [`recording`] is the target as fuzzers call it. A seed is taken apart into its records, those of its
//! chunks included, which drops the chunks' checksums: what is changed then is looked at and not only refused.

use crate::files::Files;
use crate::forge::{Stamp, frame};
use crate::mutate;
use crate::seeds::{Binary, root};
use fastrand::Rng;
use std::time::Instant;
use sutura_host::recording::Recording;
use sutura_host::recording::replay::{NativeTicks, replay_console};

/// What an MCAP file begins and ends with.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const CHUNK: u8 = 0x06;
const MESSAGE: u8 = 0x05;
/// Bytes of a message before its data: channel, sequence and two times.
const MESSAGE_HEAD: usize = 22;
/// Messages that are kept of a seed: some 150 ticks.
const MOST_MESSAGES: usize = 300;

/// A recording from its bytes, and its console's ticks run again; true if all of them came out as recorded.
///
/// # Panics
/// On a defect.
pub fn recording(bytes: &[u8]) -> bool {
    match Recording::from_bytes(&root().join("fuzz.mcap"), bytes) {
        Ok(recording) => {
            let mut console = NativeTicks::new(&recording.about.plan.device);
            let verdict = replay_console(&recording, &mut console);
            assert!(verdict.verified_ticks <= verdict.ticks);
            verdict.verified_ticks == verdict.ticks
        }
        Err(error) => {
            assert!(!error.to_string().is_empty());
            false
        }
    }
}

/// Mutated recordings, one after the other.
///
/// # Panics
/// On a defect, and on a recording that keeps its reader busy for a minute.
pub fn run(seeds: &[Binary], seed: u64, files: u64, mut before: impl FnMut(&[u8])) -> Files {
    let mut rng = Rng::with_seed(seed);
    let mut tally = Files::default();
    let parts: Vec<Vec<Record>> = seeds.iter().map(|seed| records(&seed.bytes)).collect();
    for _ in 0..files {
        let Some(whole) = rng.choice(&parts) else {
            break;
        };
        let bytes = mutated(whole.clone(), &mut rng);
        before(&bytes);
        let began = Instant::now();
        let accepted = recording(&bytes);
        tally.count(accepted, began.elapsed());
    }
    tally
}

/// One record of the container.
#[derive(Clone, Debug)]
struct Record {
    opcode: u8,
    body: Vec<u8>,
}

fn u64_at(bytes: &[u8], at: usize) -> Option<usize> {
    let bytes = bytes.get(at..)?.first_chunk()?;
    usize::try_from(u64::from_le_bytes(*bytes)).ok()
}

/// The records up to where the file is cut off, those of chunks in their places.
fn records(bytes: &[u8]) -> Vec<Record> {
    let mut found = Vec::new();
    take_apart(bytes.strip_prefix(MAGIC).unwrap_or(bytes), &mut found);
    let mut messages = 0;
    found.retain(|record| {
        messages += usize::from(record.opcode == MESSAGE);
        record.opcode != MESSAGE || messages <= MOST_MESSAGES
    });
    found
}

fn take_apart(mut rest: &[u8], found: &mut Vec<Record>) {
    while let (Some(&opcode), Some(length)) = (rest.first(), u64_at(rest, 1)) {
        let Some(body) = rest.get(9..).and_then(|rest| rest.get(..length)) else {
            return;
        };
        rest = rest.get(9 + length..).unwrap_or_default();
        if opcode == CHUNK {
            // Two times, a size and a checksum, then the compression's name, which is empty, then the records' length.
            take_apart(body.get(28 + 4 + 8..).unwrap_or_default(), found);
        } else {
            found.push(Record {
                opcode,
                body: body.to_vec(),
            });
        }
    }
}

fn joined(records: &[Record]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    for Record { opcode, body } in records {
        bytes.push(*opcode);
        bytes.extend((body.len() as u64).to_le_bytes());
        bytes.extend(body);
    }
    bytes
}

fn mutated(mut records: Vec<Record>, rng: &mut Rng) -> Vec<u8> {
    for _ in 0..rng.u8(1..=4) {
        let at = rng.usize(0..records.len().max(1));
        let other = rng.usize(0..records.len().max(1));
        match rng.u8(0..8) {
            0 if records.len() > 1 => drop(records.remove(at)),
            1 if at != other => records.swap(at, other),
            2 => {
                let copy = records.get(at).cloned();
                records.splice(other..other, copy);
            }
            3 => {
                if let Some(byte) = records.get_mut(at).and_then(|r| rng.choice(&mut r.body)) {
                    *byte = rng.u8(..);
                }
            }
            4 => {
                if let Some(record) = records.get_mut(at) {
                    number(&mut record.body, rng);
                }
            }
            _ => {
                if let Some(record) = records.get_mut(at) {
                    restamp(record, rng);
                }
            }
        }
    }
    let mut bytes = joined(&records);
    if rng.u8(0..16) == 0 {
        mutate::line(&mut bytes, rng);
    }
    bytes
}

/// Another number in a text.
fn number(body: &mut Vec<u8>, rng: &mut Rng) {
    let digits = body.iter().filter(|byte| byte.is_ascii_digit()).count();
    let nth = rng.usize(0..digits.max(1));
    let mut places = (0..body.len()).filter(|at| body[*at].is_ascii_digit());
    if let (Some(at), Some(new)) = (
        places.nth(nth),
        rng.choice(["", "0", "-", "9999", "1e9", "."]),
    ) {
        body.splice(at..=at, new.bytes());
    }
}

/// A frame in a message with other values and a checksum that fits.
fn restamp(record: &mut Record, rng: &mut Rng) {
    let data = record.body.get(MESSAGE_HEAD..).unwrap_or_default();
    let Some((0, stuffed)) = data.split_last().filter(|_| record.opcode == MESSAGE) else {
        return;
    };
    let mut packet = vec![0; stuffed.len()];
    let Ok(report) = cobs::decode(stuffed, &mut packet) else {
        return;
    };
    packet.truncate(report.frame_size());
    let Some((header, rest)) = packet.split_first_chunk::<18>() else {
        return;
    };
    let mut body = rest[..rest.len().saturating_sub(4)].to_vec();
    let [version, kind, s0, s1, s2, s3, q0, q1, q2, q3, time @ ..] = *header;
    let mut stamp = Stamp {
        version,
        kind,
        session: u32::from_le_bytes([s0, s1, s2, s3]),
        sequence: u32::from_le_bytes([q0, q1, q2, q3]),
        console_time_us: u64::from_le_bytes(time),
    };
    match rng.u8(0..6) {
        0 => stamp.session = rng.u32(..),
        1 => stamp.sequence = stamp.sequence.wrapping_add(rng.u32(0..4)),
        2 => stamp.console_time_us = rng.u64(..) >> rng.u8(0..64),
        _ => mutate::body(kind, &mut body, rng),
    }
    record.body.truncate(MESSAGE_HEAD);
    record.body.extend(frame(&stamp, &body));
}
