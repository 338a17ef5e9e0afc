//! Messages of the page's format, read back: for programs that are shown a session as a page is.
//!
//! Entry points: [`Read::of`], [`Picture::read`]. What is cut short or says something else is none.

use super::bytes::ALIGNED;
use super::message::{NeedleView, Picture, StatusView, ThreadPointView, ThreadView, ToolView};
use super::painter::Scalar;

/// Length of the header before the number of sections, by kind \[bytes\].
const HEADERS: [usize; 4] = [24, 50, 16, 16];

/// A message: its header, and its sections by tag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Read<'a> {
    /// 1 geometry, 2 picture, 3 ticks, 4 solves.
    pub kind: u8,
    /// See the format.
    pub flags: u16,
    header: &'a [u8],
    sections: Vec<(u16, &'a [u8])>,
}

/// Numbers of a section, one after the other; `None` at its end.
pub(super) struct Numbers<'a>(&'a [u8]);

impl<'a> Numbers<'a> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take::<1>().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn i16(&mut self) -> Option<i16> {
        self.take().map(i16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f32(&mut self) -> Option<f64> {
        self.take()
            .map(|bytes| f64::from(f32::from_le_bytes(bytes)))
    }

    fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn f32s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut all = [0.0; N];
        for each in &mut all {
            *each = self.f32()?;
        }
        Some(all)
    }

    /// Three parts of a scale.
    fn parts(&mut self, scale: f64) -> Option<[f64; 3]> {
        let mut all = [0.0; 3];
        for each in &mut all {
            *each = f64::from(self.i16()?) / f64::from(i16::MAX) * scale;
        }
        Some(all)
    }

    /// As many as there are.
    fn all<T>(mut self, next: impl Fn(&mut Self) -> Option<T>) -> Vec<T> {
        std::iter::from_fn(|| next(&mut self)).collect()
    }
}

impl<'a> Read<'a> {
    /// Finds the sections of a message.
    pub fn of(bytes: &'a [u8]) -> Option<Self> {
        let [kind, format] = *bytes.first_chunk()?;
        let length = *HEADERS.get(usize::from(kind).checked_sub(1)?)?;
        if format != super::FORMAT {
            return None;
        }
        let mut header = Numbers(bytes.get(2..length)?);
        let flags = header.u16()?;
        let count = Numbers(bytes.get(length..)?).u16()?;
        let mut at = (length + 2).next_multiple_of(ALIGNED);
        let mut sections = Vec::new();
        for _ in 0..count {
            let mut head = Numbers(bytes.get(at..)?);
            let (tag, _, length) = (head.u16()?, head.u16()?, head.u32()?);
            let data = head.0.get(..usize::try_from(length).ok()?)?;
            sections.push((tag, data));
            at = at.checked_add(8 + data.len())?.next_multiple_of(ALIGNED);
        }
        Some(Self {
            kind,
            flags,
            header: header.0,
            sections,
        })
    }

    fn numbers(&self, tag: u16) -> Numbers<'a> {
        let mut found = self.sections.iter().filter(|(own, _)| *own == tag);
        Numbers(found.next().map_or(&[], |(_, data)| *data))
    }

    /// Bytes of a section; none if it is not there.
    pub fn u8s(&self, tag: u16) -> Vec<u8> {
        self.numbers(tag).0.to_vec()
    }

    /// Whole numbers of a section.
    pub fn u16s(&self, tag: u16) -> Vec<u16> {
        self.numbers(tag).all(Numbers::u16)
    }

    /// Whole numbers of a section.
    pub fn u32s(&self, tag: u16) -> Vec<u32> {
        self.numbers(tag).all(Numbers::u32)
    }

    /// Numbers in single precision of a section.
    pub fn f32s(&self, tag: u16) -> Vec<f64> {
        self.numbers(tag).all(Numbers::f32)
    }

    /// Vectors in single precision of a section, (n x 3).
    pub fn vectors(&self, tag: u16) -> Vec<[f64; 3]> {
        self.numbers(tag).all(Numbers::f32s)
    }

    /// Numbers in double precision of a section.
    pub fn f64s(&self, tag: u16) -> Vec<f64> {
        self.numbers(tag).all(Numbers::f64)
    }

    /// Triples of whole numbers of a section, (n x 3).
    pub fn triples(&self, tag: u16) -> Vec<[u32; 3]> {
        self.numbers(tag)
            .all(|from| Some([from.u32()?, from.u32()?, from.u32()?]))
    }
}

impl Picture {
    /// What a picture's message says; `None` if it is another one.
    pub fn read(bytes: &[u8]) -> Option<Self> {
        let read = Read::of(bytes).filter(|read| read.kind == 2)?;
        let mut header = Numbers(read.header);
        let (sequence, time_s) = (header.u32()?, header.f64()?);
        let (console_time_us, solves) = (header.u64()?, header.u32()?);
        let (geometry, vertices) = (header.u32()?, header.u32()?);
        let [scale, low, high] = header.f32s()?;
        let scalar = Scalar::numbered(header.u8()?);
        let displacement_m = read.numbers(1).all(|from| from.parts(scale));
        if displacement_m.len() != vertices as usize {
            return None;
        }
        let value = |part: u16| low + f64::from(part) / f64::from(u16::MAX) * (high - low);
        let values = || read.u16s(2).into_iter().map(value).collect();
        let threads = read.sections.iter().filter(|(tag, _)| *tag == 5);
        Some(Self {
            sequence,
            recorded: read.flags & 1 != 0,
            withheld: read.flags & 2 != 0,
            time_s,
            console_time_us,
            solves,
            geometry,
            displacement_m,
            scalar: scalar.map(|scalar| (scalar, values())),
            tools: read.numbers(3).all(ToolView::read),
            needles: read.numbers(4).all(NeedleView::read),
            threads: threads
                .map(|(_, data)| ThreadView::read(&mut Numbers(data)))
                .collect::<Option<_>>()?,
            contacts: read
                .numbers(6)
                .all(|from| Some((from.u32()?, from.f32s()?))),
            status: StatusView::read(&mut read.numbers(7))?,
        })
    }
}

impl ToolView {
    fn read(from: &mut Numbers<'_>) -> Option<Self> {
        let (id, driven, _) = (from.u8()?, from.u8()? != 0, from.u16()?);
        Some(Self {
            id,
            driven,
            position_m: from.f32s()?,
            orientation: from.f32s()?,
            wrench: from.f32s()?,
            gap_m: from.f32()?,
            rows: from.u32()?,
        })
    }
}

impl NeedleView {
    fn read(from: &mut Numbers<'_>) -> Option<Self> {
        let (id, tip, held_by, _) = (from.u8()?, from.u8()?, from.u8()?, from.u8()?);
        let new = Self {
            id,
            tip,
            held_by: Some(held_by).filter(|tool| *tool != u8::MAX),
            position_m: from.f32s()?,
            orientation: from.f32s()?,
            crossings: from.u32()?,
            punctures: from.u32()?,
            axial_n: from.f32()?,
            hold_n: from.f32()?,
            puncture_n: from.f32()?,
        };
        from.u32()?;
        Some(new)
    }
}

impl ThreadView {
    fn read(from: &mut Numbers<'_>) -> Option<Self> {
        let (id, state, _, count) = (from.u8()?, from.u8()?, from.u16()?, from.u32()?);
        let (origin_m, scale) = (from.f32s::<3>()?, from.f32()?);
        let point = |from: &mut Numbers<'_>| {
            let way = from.parts(scale)?;
            let at_m = [0, 1, 2].map(|axis: usize| origin_m[axis] + way[axis]);
            let (what, _) = (from.u8()?, from.u8()?);
            let tension_n = from.f32()?;
            Some(ThreadPointView {
                at_m,
                what,
                tension_n,
            })
        };
        let points = Numbers(from.0).all(point);
        (points.len() == count as usize).then_some(Self { id, state, points })
    }
}

impl StatusView {
    fn read(from: &mut Numbers<'_>) -> Option<Self> {
        let (word, touches, _) = (from.u8()?, from.u8()? != 0, from.u16()?);
        let is_said = |value: &f64| !value.is_nan();
        Some(Self {
            word,
            touches,
            rows: from.u32()?,
            touching: from.u32()?,
            iterations: from.u32()?,
            residual: from.f32()?,
            energy_j: from.f32()?,
            tension_n: Some(from.f32()?).filter(is_said),
            bridge_ratio: Some(from.f32()?).filter(is_said),
            grip_m: from.f32s()?,
        })
    }
}
