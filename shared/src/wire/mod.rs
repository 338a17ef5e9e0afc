//! The wire protocol, version 1: COBS(header | postcard body | CRC-32) 0x00.
//!
//! Received bytes go through three types, so that nothing unchecked can be used by mistake:
//! [`Accumulator`] -> [`decode`] -> [`Decoded`] -> [`Decoded::unpack`] -> [`Unchecked`] ->
//! [`Unchecked::validate`] -> [`Checked`], [`Valid`]. The other way: [`encode`].
//! [`crate::link`] has both ends of a session on top of this.

mod accumulator;
pub mod faults;
mod frame;
pub mod inputs;
mod list;
pub mod message;
mod reject;
mod rows;
mod schema;
pub mod validate;

pub use accumulator::Accumulator;
pub use frame::{
    Decoded, EncodeError, HEADER_SIZE, Header, Kind, MAX_CONTACT_FRAME, MAX_FRAME,
    MAX_REAL_TIME_FRAME, MAX_STATE_FRAME, decode, encode, frame_size,
};
pub(crate) use frame::{decode_unsound, hello_version};
pub use list::List;
pub use reject::Reject;
pub use schema::SCHEMA_HASH;
pub use validate::{
    Checked, Direction, Message, Unchecked, Valid, ValidCommand, ValidContact, ValidFixture,
    ValidNeedle, ValidRows, ValidSimulate, ValidThread,
};

/// Version of the protocol. What its frames look like and mean is fixed; another layout takes another version.
pub const PROTOCOL_VERSION: u8 = 1;
