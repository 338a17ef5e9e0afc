//! The wire protocol, draft 0: COBS(header | postcard body | CRC-32) 0x00.
//!
//! Received bytes go through three types, so that nothing unchecked can be used by mistake:
//! bytes -> [`Decoded`](frame) -> validated message.

pub mod message;
