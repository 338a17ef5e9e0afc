//! Changes to bytes: fields of a message by what they are, and a line by what happens to lines.
//!
//! Entry points: [`body`] and [`line`].

use crate::layout::{Field, Sort, fields, varint};
use fastrand::Rng;

/// Numbers at which something happens: limits of the checks, and what floating point has at its ends.
const FLOATS: [f32; 26] = [
    0.0,
    -0.0,
    1.0,
    -1.0,
    f32::MIN_POSITIVE,
    1e-45,
    -1e-45,
    1e-7,
    1e-6,
    1e-3,
    0.01,
    -0.01,
    10.0,
    -10.0,
    10.000_001,
    100.0,
    1e3,
    3600.0,
    1e4,
    -1e4,
    1e7,
    -1e7,
    1e9,
    f32::MAX,
    f32::INFINITY,
    f32::NAN,
];

const WORDS: [u64; 14] = [
    0,
    1,
    2,
    11,
    12,
    23,
    24,
    127,
    128,
    300,
    0x7fff_ffff,
    0xffff_ffff,
    0x1_0000_0000,
    u64::MAX,
];

/// Changes up to four fields of a body, in place; mostly to values that a console might take.
pub fn body(kind: u8, body: &mut Vec<u8>, rng: &mut Rng) {
    for _ in 0..rng.u8(1..=4) {
        let fields = fields(kind, body);
        let Some(field) = rng.choice(&fields) else {
            return;
        };
        match field.sort {
            Sort::Float if is_direction(field.name) && rng.u8(0..8) > 0 => {
                turn(body, &fields, field, rng)
            }
            Sort::Float => float(body, field, rng),
            Sort::Byte => set(
                body,
                field.at,
                if rng.bool() {
                    rng.u8(..)
                } else {
                    rng.u8(0..16)
                },
            ),
            Sort::Flag => set(
                body,
                field.at,
                if rng.u8(0..32) == 0 {
                    rng.u8(..)
                } else {
                    rng.u8(0..2)
                },
            ),
            Sort::Varint => replace(body, field, word(rng)),
            Sort::Variant(count) => {
                let beyond = u32::from(rng.u8(0..32) == 0);
                replace(body, field, u64::from(rng.u32(0..count + beyond)));
            }
            Sort::Length => replace(body, field, u64::from(rng.u8(0..30))),
        }
        if rng.u16(0..400) == 0 {
            body.truncate(rng.usize(0..=body.len()));
        }
    }
}

fn set(body: &mut [u8], at: usize, value: u8) {
    if let Some(place) = body.get_mut(at) {
        *place = value;
    }
}

fn replace(body: &mut Vec<u8>, field: &Field, value: u64) {
    body.splice(field.at..field.at + field.len, varint(value));
}

fn word(rng: &mut Rng) -> u64 {
    match rng.u8(0..4) {
        0 => *rng.choice(&WORDS).unwrap_or(&0),
        1 => rng.u64(..) >> rng.u8(0..64),
        // Times, counts and numbers of things are smaller.
        _ => rng.u64(0..200_000),
    }
}

fn read_float(body: &[u8], at: usize) -> f32 {
    let bytes = body.get(at..).and_then(|rest| rest.first_chunk());
    bytes.map_or(0.0, |bytes| f32::from_le_bytes(*bytes))
}

fn write_float(body: &mut [u8], at: usize, value: f32) {
    if let Some(place) = body.get_mut(at..).and_then(|rest| rest.first_chunk_mut()) {
        *place = value.to_le_bytes();
    }
}

fn float(body: &mut [u8], field: &Field, rng: &mut Rng) {
    let old = read_float(body, field.at);
    let signed = 2.0 * rng.f32() - 1.0;
    let value = match rng.u8(0..8) {
        0 => *rng.choice(&FLOATS).unwrap_or(&0.0),
        1 => f32::from_bits(rng.u32(..)),
        2 => signed * 10_f32.powi(rng.i32(-6..=4)),
        3 => -old,
        4 => old * (1.0 + 1e-3 * signed),
        5 => old + 0.01 * signed,
        _ => old * 4.0 * rng.f32(),
    };
    write_float(body, field.at, value);
}

/// Whether a field is a unit vector or a unit quaternion.
fn is_direction(name: &str) -> bool {
    matches!(name, "normal" | "direction" | "orientation")
}

/// Puts another unit vector into the place of the one that `field` is an entry of.
fn turn(body: &mut [u8], fields: &[Field], field: &Field, rng: &mut Rng) {
    let entries: Vec<usize> = fields
        .iter()
        .filter(|other| other.name == field.name)
        .map(|other| other.at)
        .collect();
    let vector: Vec<f32> = entries.iter().map(|_| 2.0 * rng.f32() - 1.0).collect();
    let length = vector.iter().map(|x| x * x).sum::<f32>().sqrt();
    for (at, x) in entries.into_iter().zip(vector) {
        write_float(body, at, x / length);
    }
}

/// What a line does to bytes on their way: flips, losses, doubles, noise. May end without a delimiter.
pub fn line(bytes: &mut Vec<u8>, rng: &mut Rng) {
    for _ in 0..rng.u8(1..=3) {
        let at = rng.usize(0..=bytes.len());
        let len = rng.usize(0..=(bytes.len() - at).min(40));
        match rng.u8(0..8) {
            0..=2 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << rng.u8(0..8);
                }
            }
            3 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = rng.u8(..);
                }
            }
            4 => drop(bytes.drain(at..at + len)),
            5 => {
                let piece: Vec<u8> = bytes.iter().skip(at).take(len).copied().collect();
                let to = rng.usize(0..=bytes.len());
                bytes.splice(to..to, piece);
            }
            6 => bytes.truncate(at),
            _ => noise(bytes, at, rng),
        }
    }
}

/// Mostly a little; now and then more than a frame may have.
fn noise(bytes: &mut Vec<u8>, at: usize, rng: &mut Rng) {
    let most = if rng.u8(0..64) == 0 { 6000 } else { 60 };
    let count = rng.usize(0..most);
    let zeros = rng.bool();
    let noise: Vec<u8> = (0..count)
        .map(|_| if zeros { rng.u8(..) } else { rng.u8(1..) })
        .collect();
    bytes.splice(at..at, noise);
}
