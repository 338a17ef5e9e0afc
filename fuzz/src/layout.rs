//! Where the fields of a message are in its bytes, from the schema that the message itself derives.
//!
//! Entry point: [`fields`]. A message that is new needs nothing here but its line in [`schema`].

use postcard_schema::Schema;
use postcard_schema::schema::{DataModelType, DataModelVariant, NamedType, NamedValue};
use sutura_shared::wire::message::{
    Command, Contact, Fixture, Hello, Needle, Ping, Pong, Report, Rows, Simulate, State, Thread,
};

/// What a field is on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sort {
    /// Four bytes.
    Float,
    /// One byte of 256.
    Byte,
    /// One byte of two.
    Flag,
    /// Seven bits a byte.
    Varint,
    /// The number of an enum's variant, below this.
    Variant(u32),
    /// How many items follow.
    Length,
}

/// A field of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name of the field that it is, or is an item of.
    pub name: &'static str,
    /// What it is.
    pub sort: Sort,
    /// First byte.
    pub at: usize,
    /// Bytes.
    pub len: usize,
}

/// Layout of the body of a kind.
pub fn schema(kind: u8) -> Option<&'static NamedType> {
    Some(match kind {
        1 => Hello::SCHEMA,
        2 => State::SCHEMA,
        3 => Contact::SCHEMA,
        4 => Command::SCHEMA,
        5 => Report::SCHEMA,
        6 => Simulate::SCHEMA,
        7 => Ping::SCHEMA,
        8 => Pong::SCHEMA,
        16 => Rows::SCHEMA,
        17 => Needle::SCHEMA,
        18 => Thread::SCHEMA,
        20 => Fixture::SCHEMA,
        _ => return None,
    })
}

/// The fields in a body, as far as it has them.
pub fn fields(kind: u8, body: &[u8]) -> Vec<Field> {
    let mut walk = Walk {
        body,
        at: 0,
        fields: Vec::new(),
    };
    // A body that ends early has the fields until there.
    let _ = schema(kind).and_then(|schema| walk.value("", schema));
    walk.fields
}

struct Walk<'a> {
    body: &'a [u8],
    at: usize,
    fields: Vec<Field>,
}

impl Walk<'_> {
    fn value(&mut self, name: &'static str, schema: &NamedType) -> Option<()> {
        match schema.ty {
            DataModelType::F32 => self.field(name, Sort::Float, 4),
            DataModelType::Bool => self.field(name, Sort::Flag, 1),
            DataModelType::U8 | DataModelType::I8 => self.field(name, Sort::Byte, 1),
            DataModelType::U16
            | DataModelType::U32
            | DataModelType::U64
            | DataModelType::I16
            | DataModelType::I32
            | DataModelType::I64 => self.varint(name, Sort::Varint).map(|_| ()),
            DataModelType::NewtypeStruct(of) => self.value(name, of),
            DataModelType::Tuple(items) | DataModelType::TupleStruct(items) => {
                items.iter().try_for_each(|item| self.value(name, item))
            }
            DataModelType::Struct(parts) => self.parts(parts),
            DataModelType::Seq(item) => {
                let count = self.varint(name, Sort::Length)?;
                (0..count).try_for_each(|_| self.value(name, item))
            }
            DataModelType::Enum(variants) => {
                let count = u32::try_from(variants.len()).ok()?;
                let number = self.varint(name, Sort::Variant(count))?;
                match variants.get(usize::try_from(number).ok()?)?.ty {
                    DataModelVariant::UnitVariant => Some(()),
                    DataModelVariant::NewtypeVariant(of) => self.value(name, of),
                    DataModelVariant::TupleVariant(items) => {
                        items.iter().try_for_each(|item| self.value(name, item))
                    }
                    DataModelVariant::StructVariant(parts) => self.parts(parts),
                }
            }
            // No message has others.
            _ => None,
        }
    }

    fn parts(&mut self, parts: &[&NamedValue]) -> Option<()> {
        parts
            .iter()
            .try_for_each(|part| self.value(part.name, part.ty))
    }

    fn field(&mut self, name: &'static str, sort: Sort, len: usize) -> Option<()> {
        self.body.get(self.at..self.at + len)?;
        self.fields.push(Field {
            name,
            sort,
            at: self.at,
            len,
        });
        self.at += len;
        Some(())
    }

    fn varint(&mut self, name: &'static str, sort: Sort) -> Option<u64> {
        let (value, len) = read_varint(self.body.get(self.at..)?)?;
        self.field(name, sort, len)?;
        Some(value)
    }
}

/// Value and length of a varint.
pub fn read_varint(bytes: &[u8]) -> Option<(u64, usize)> {
    let mut value = 0;
    for (index, byte) in bytes.iter().take(10).enumerate() {
        value |= u64::from(byte & 0x7f) << (7 * index);
        if *byte < 0x80 {
            return Some((value, index + 1));
        }
    }
    None
}

/// Bytes of a varint.
pub fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 0x80 {
        bytes.push(value as u8 & 0x7f | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seeds;

    /// Every byte of every seed belongs to one field: a message that is not known here would never be mutated well.
    #[test]
    fn the_fields_of_every_message_are_all_of_its_bytes() {
        let seeds = seeds::frames();
        for seed in &seeds {
            let mut end = 0;
            for field in fields(seed.kind, &seed.body) {
                assert_eq!(field.at, end, "{}: {field:?}", seed.name);
                end += field.len;
            }
            assert_eq!(end, seed.body.len(), "{}", seed.name);
        }
        let kinds: std::collections::BTreeSet<_> = seeds.iter().map(|seed| seed.kind).collect();
        let known = (0..=u8::MAX).filter(|kind| schema(*kind).is_some());
        assert!(known.eq(kinds), "a message has no seed");
    }
}
