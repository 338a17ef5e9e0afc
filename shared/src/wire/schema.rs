//! One number for the layout of everything on the wire: two ends that differ in it refuse torque.

use super::PROTOCOL_VERSION;
use super::frame::Kind;
use super::message::{
    Command, Contact, Fixture, Hello, Needle, Ping, Pong, Report, Rows, Simulate, State, Thread,
};
use super::validate::Message;
use postcard_schema::{Schema, key::Key};

/// Hash over version, kinds, and each message's fields: their names (units are in the names), types and
/// order. FNV-1a over the keys that `postcard-schema` computes.
pub const SCHEMA_HASH: u64 = {
    let mut hash = fold(0xcbf2_9ce4_8422_2325, &[PROTOCOL_VERSION]);
    hash = message::<Hello>(hash, Hello::KIND);
    hash = message::<State>(hash, State::KIND);
    hash = message::<Contact>(hash, Contact::KIND);
    hash = message::<Command>(hash, Command::KIND);
    hash = message::<Report>(hash, Report::KIND);
    hash = message::<Simulate>(hash, Simulate::KIND);
    hash = message::<Ping>(hash, Ping::KIND);
    hash = message::<Pong>(hash, Pong::KIND);
    hash = message::<Needle>(hash, Needle::KIND);
    hash = message::<Thread>(hash, Thread::KIND);
    hash = message::<Rows>(hash, Rows::KIND);
    message::<Fixture>(hash, Fixture::KIND)
};

const fn message<M: Schema>(hash: u64, kind: Kind) -> u64 {
    let key = Key::for_path::<M>("").to_bytes();
    fold(fold(hash, &[kind as u8]), &key)
}

const fn fold(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    hash
}
