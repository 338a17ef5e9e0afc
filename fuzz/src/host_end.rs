//! The host's end of the link under frames of a console that went wrong.
//!
//! Entry point: [`run`]; [`host`] is the target as fuzzers call it.

use crate::forge::{Stamp, frame};
use crate::mutate;
use crate::seeds::{Seed, TO_HOST, choose};
use crate::traffic::Tally;
use fastrand::Rng;
use sutura_shared::link::{ConsoleLink, HostEvent, HostLink, Identity};
use sutura_shared::wire::message::Report;
use sutura_shared::wire::{MAX_FRAME, Message, PROTOCOL_VERSION, Reject};

/// Few: after a state with a late clock a session takes no other.
const SESSION_FRAMES: u64 = 16;

/// A host with a session, and its number.
fn opened(nonce: u32) -> Option<(HostLink, u32)> {
    let identity = Identity {
        tick_hz: 1000,
        simulated: true,
        device_name: *b"bench\0\0\0\0\0\0\0\0\0\0\0",
    };
    let (mut host, mut console) = (HostLink::new(1000), ConsoleLink::new(identity, nonce));
    let mut bytes = [0; MAX_FRAME];
    let len = host.hello(nonce, &mut bytes).ok()?;
    console.receive(&mut bytes.get(..len)?, 0);
    let len = console.take_reply(0, &mut bytes)?;
    let mut session = 0;
    for byte in bytes.get(..len)? {
        if let Some(HostEvent::Opened(hello)) = host.receive(*byte) {
            session = hello.session;
        }
    }
    Some((host, session))
}

/// Whatever a host hands on is right.
fn check(event: &HostEvent) {
    match event {
        HostEvent::State(state) => assert_eq!(state.body().check(), Ok(()), "{state:?}"),
        HostEvent::Report(report) => assert_eq!(report.body().check(), Ok(())),
        _ => {}
    }
}

/// Any bytes from a console.
///
/// # Panics
/// On a defect.
pub fn host(bytes: &[u8]) {
    let Some((mut host, _)) = opened(1) else {
        panic!("no session");
    };
    for byte in bytes {
        if let Some(event) = host.receive(*byte) {
            check(&event);
        }
    }
}

/// Mutated frames for hosts, in sessions of a few frames.
///
/// # Panics
/// On a defect.
pub fn run(seeds: &[Seed], seed: u64, frames: u64) -> Tally {
    let mut rng = Rng::with_seed(seed);
    let mut tally = Tally::default();
    while tally.frames < frames {
        session(seeds, &mut rng, &mut tally);
    }
    tally
}

fn session(seeds: &[Seed], rng: &mut Rng, tally: &mut Tally) {
    let (mut host, session) = opened(rng.u32(..)).unwrap_or_else(|| panic!("no session"));
    let mut sequence = 0;
    tally.sessions += 1;
    for number in 0..SESSION_FRAMES {
        let Some(mut seed) = choose(seeds, TO_HOST, rng).cloned() else {
            return;
        };
        mutate::body(seed.kind, &mut seed.body, rng);
        sequence += rng.u32(1..3);
        let stamp = Stamp {
            version: PROTOCOL_VERSION,
            kind: seed.kind,
            session,
            sequence,
            console_time_us: rng.u64(..) >> rng.u8(0..64),
        };
        let mut bytes = frame(&stamp, &seed.body);
        let bent = rng.u8(0..5) == 0;
        if bent {
            mutate::line(&mut bytes, rng);
        }
        tally.frames += 1;
        tally.mutated += 1;
        tally.restamped += u64::from(!bent);
        hear(&mut host, &bytes, tally);
        if number % 64 == 0 {
            // A delimiter, and the first good frame is heard.
            sequence += 1;
            let stamp = Stamp {
                kind: 5,
                sequence,
                ..stamp
            };
            let report = frame(&stamp, &[0; 13]);
            // It may end a frame that lacked only that.
            host.receive(0);
            let before = host.counters().frames_received;
            let heard = report.iter().filter_map(|byte| host.receive(*byte)).last();
            let heard = matches!(heard, Some(HostEvent::Report(report)) if *report.body() == Report::default());
            assert!(
                heard && host.counters().frames_received == before + 1,
                "a good report was not heard: {:?}",
                host.counters()
            );
            tally.heard_again += 1;
        }
    }
}

fn hear(host: &mut HostLink, bytes: &[u8], tally: &mut Tally) {
    let before = host.counters();
    for byte in bytes {
        if let Some(event) = host.receive(*byte) {
            check(&event);
        }
    }
    let after = host.counters();
    let accepted = u64::from(after.frames_received - before.frames_received);
    let rejected = u64::from(after.frames_rejected - before.frames_rejected);
    tally.accepted += accepted;
    tally.validated += accepted;
    tally.decoded += accepted;
    if let Some(reason) = after.last_reject.filter(|_| rejected > 0) {
        if let Some(count) = tally.refused.get_mut(reason as usize) {
            *count += rejected;
        }
        let decoded = matches!(
            reason,
            Reject::NotFinite | Reject::Range | Reject::Name | Reject::Nonce | Reject::Clock
        );
        tally.decoded += if decoded { rejected } else { 0 };
        let validated = reason == Reject::Clock;
        tally.validated += if validated { rejected } else { 0 };
    }
}
