//! The wire protocol, draft 0: COBS(header | postcard body | CRC-32) 0x00.
//!
//! Received bytes go through three types, so that nothing unchecked can be used by mistake:
//! [`Accumulator`] -> [`decode`] -> [`Decoded`] -> [`Decoded::unpack`] -> [`Unchecked`] ->
//! [`Unchecked::validate`] -> [`Checked`], [`Valid`]. The other way: [`encode`].
//! [`crate::link`] has both ends of a session on top of this.

mod accumulator;
pub mod faults;
mod frame;
mod list;
pub mod message;
mod reject;
mod rows;
mod schema;
pub mod validate;

pub use accumulator::Accumulator;
pub(crate) use frame::hello_version;
pub use frame::{
    Decoded, EncodeError, HEADER_SIZE, Header, Kind, MAX_CONTACT_FRAME, MAX_FRAME,
    MAX_REAL_TIME_FRAME, MAX_STATE_FRAME, decode, encode, frame_size,
};
pub use list::List;
pub use reject::Reject;
pub use schema::SCHEMA_HASH;
pub use validate::{
    Checked, Direction, Message, Unchecked, Valid, ValidContact, ValidFixture, ValidNeedle,
    ValidRows, ValidSimulate, ValidThread,
};

/// Version of the protocol; 0 is a draft that any commit may change.
pub const PROTOCOL_VERSION: u8 = 0;
