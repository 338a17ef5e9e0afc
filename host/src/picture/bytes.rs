//! Headers and sections of the page's format.
//!
//! Entry point: [`Message`].

use super::FORMAT;

/// Multiple at which sections begin \[bytes\].
pub(super) const ALIGNED: usize = 8;

/// A message that is being written to a buffer.
pub(super) struct Message<'a> {
    out: &'a mut Vec<u8>,
    /// Where its header has the number of sections.
    count_at: usize,
    count: u16,
}

/// Numbers to the end of a buffer, little-endian.
pub(super) struct Bytes<'a>(&'a mut Vec<u8>);

impl<'a> Message<'a> {
    /// Begins a message of this kind; `header` writes what comes between its first four bytes and the number of sections.
    pub fn begin(
        out: &'a mut Vec<u8>,
        kind: u8,
        flags: u16,
        header: impl FnOnce(&mut Bytes<'_>),
    ) -> Self {
        out.clear();
        out.extend_from_slice(&[kind, FORMAT]);
        out.extend_from_slice(&flags.to_le_bytes());
        header(&mut Bytes(out));
        let count_at = out.len();
        out.extend_from_slice(&[0, 0]);
        let mut message = Self {
            out,
            count_at,
            count: 0,
        };
        message.align();
        message
    }

    fn align(&mut self) {
        let length = self.out.len().next_multiple_of(ALIGNED);
        self.out.resize(length, 0);
    }

    /// Adds a section.
    pub fn section(&mut self, tag: u16, write: impl FnOnce(&mut Bytes<'_>)) {
        self.out.extend_from_slice(&tag.to_le_bytes());
        self.out.extend_from_slice(&[0; 6]);
        let begin = self.out.len();
        write(&mut Bytes(self.out));
        let length = (self.out.len() - begin) as u32;
        if let Some(place) = self.out.get_mut(begin - 4..begin) {
            place.copy_from_slice(&length.to_le_bytes());
        }
        self.align();
        self.count += 1;
        let count = self.count.to_le_bytes();
        if let Some(place) = self.out.get_mut(self.count_at..self.count_at + 2) {
            place.copy_from_slice(&count);
        }
    }
}

impl Bytes<'_> {
    pub fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub fn u16(&mut self, value: u16) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn i16(&mut self, value: i16) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn u32(&mut self, value: u32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn i32(&mut self, value: i32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn f32(&mut self, value: f32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    /// In single precision, one after the other.
    pub fn f32s(&mut self, values: impl IntoIterator<Item = f64>) {
        values.into_iter().for_each(|value| self.f32(value as f32));
    }
}

/// The least number in single precision that is not below `value`.
pub(super) fn not_below(value: f64) -> f32 {
    let near = value as f32;
    if f64::from(near) < value {
        near.next_up()
    } else {
        near
    }
}

/// A length as a part of `scale`, which is not below its magnitude.
pub(super) fn as_i16(value: f64, scale: f32) -> i16 {
    let part = value / f64::from(scale).max(f64::MIN_POSITIVE);
    // Out of range saturates; what is no number is 0.
    (part * f64::from(i16::MAX)).round() as i16
}

/// A value between the two ends.
pub(super) fn as_u16(value: f64, [low, high]: [f32; 2]) -> u16 {
    let (low, high) = (f64::from(low), f64::from(high));
    let part = (value - low) / (high - low).max(f64::MIN_POSITIVE);
    (part * f64::from(u16::MAX)).round() as u16
}
