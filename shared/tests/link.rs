//! Sessions between the two ends of the link, over lines that lose, double, delay and replay.

#![allow(clippy::unwrap_used)]

use crate::common;
use crate::common::{forge, frame, header_bytes, padded, sample};
use proptest::prelude::*;
use sutura_shared::control::ContactRows;
use sutura_shared::link::{
    Checks, ConsoleLink, Counters, EXPIRES_AFTER_US, HostEvent, HostLink, Identity, LinkEvent,
    Mismatch, OWNED_FOR_US, REFUSED_EVERY_US, SendError,
};
use sutura_shared::wire::message::{Command, Contact, Hello, Refusal, Report, Simulate, State};
use sutura_shared::wire::{MAX_FRAME, PROTOCOL_VERSION, Reject, SCHEMA_HASH, Unchecked};

const NOW_US: u64 = 10_000_000;
/// When a session in which something came just now is free for others.
const LATER_US: u64 = NOW_US + OWNED_FOR_US;

fn identity() -> Identity {
    Identity {
        tick_hz: 1000,
        simulated: true,
        device_name: padded("desk"),
    }
}

fn console() -> ConsoleLink {
    ConsoleLink::new(identity(), 0x5eed)
}

fn feed(console: &mut ConsoleLink, bytes: &[u8]) -> Vec<LinkEvent> {
    feed_at(console, bytes, NOW_US)
}

fn feed_at(console: &mut ConsoleLink, bytes: &[u8], now_us: u64) -> Vec<LinkEvent> {
    let mut rest = bytes;
    std::iter::from_fn(|| console.receive(&mut rest, now_us)).collect()
}

/// The commands among events that are nothing else.
fn commands(events: &[LinkEvent]) -> Vec<Command> {
    let command = |event: &LinkEvent| match event {
        LinkEvent::Command(command) => *command.body(),
        other => panic!("{other:?}"),
    };
    events.iter().map(command).collect()
}

fn hear(host: &mut HostLink, bytes: &[u8]) -> Vec<HostEvent> {
    bytes.iter().filter_map(|b| host.receive(*b)).collect()
}

fn hello(host: &mut HostLink, nonce: u32) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let len = host.hello(nonce, &mut out).unwrap();
    out[..len].to_vec()
}

fn reply(console: &mut ConsoleLink) -> Option<Vec<u8>> {
    let mut out = [0; MAX_FRAME];
    let len = console.take_reply(NOW_US, &mut out)?;
    Some(out[..len].to_vec())
}

fn send<M: sutura_shared::wire::Message>(host: &mut HostLink, body: &M) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let len = host.send(NOW_US, body, &mut out).unwrap();
    out[..len].to_vec()
}

fn state_frame(console: &mut ConsoleLink) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let len = console.encode_state(NOW_US, &sample::state(), &mut out);
    out[..len].to_vec()
}

/// Runs the handshake; returns the session and the host's `Hello`.
fn connect(host: &mut HostLink, console: &mut ConsoleLink, nonce: u32) -> (u32, Vec<u8>) {
    let question = hello(host, nonce);
    let opened = feed_at(console, &question, LATER_US);
    assert_eq!(opened, [LinkEvent::SessionOpened]);
    let events = hear(host, &reply(console).unwrap());
    let [HostEvent::Opened(answer)] = events[..] else {
        panic!("not opened: {events:?}");
    };
    assert_eq!(reply(console), None, "one answer to one question");
    (answer.session, question)
}

fn pair() -> (HostLink, ConsoleLink, u32) {
    let (mut host, mut console) = (HostLink::new(1000), console());
    let (session, _) = connect(&mut host, &mut console, 7);
    (host, console, session)
}

/// The `Hello` of a host, with something changed.
fn host_hello(change: impl FnOnce(&mut Hello)) -> Vec<u8> {
    let mut hello = Hello {
        schema_hash: SCHEMA_HASH,
        max_frame: MAX_FRAME as u16,
        ..sample::hello_host()
    };
    change(&mut hello);
    frame(0, 0, 0, &hello)
}

#[test]
fn a_session_carries_every_message_both_ways() {
    let (mut host, mut console, session) = pair();
    assert_ne!(session, 0);
    assert!(host.is_open() && console.is_open());

    let bytes = send(&mut host, &sample::contact());
    let events = feed(&mut console, &bytes);
    let [LinkEvent::Contact(contact)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(*contact.body(), sample::contact());
    assert_eq!(contact.console_time_us(), NOW_US);
    assert_eq!(contact.sequence(), host.sent_sequence());

    let bytes = send(&mut host, &sample::needle());
    let events = feed(&mut console, &bytes);
    let [LinkEvent::Needle(needle)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(*needle.body(), sample::needle());
    assert_eq!(needle.console_time_us(), NOW_US);

    let bytes = send(&mut host, &sample::thread());
    let events = feed(&mut console, &bytes);
    let [LinkEvent::Thread(thread)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(*thread.body(), sample::thread());
    assert_eq!(thread.console_time_us(), NOW_US);

    let bytes = send(&mut host, &sample::rows());
    let events = feed(&mut console, &bytes);
    assert_eq!(events, [LinkEvent::Rows]);
    let sent = common::rows::frame(NOW_US, sample::rows());
    assert_eq!(*console.rows(), ContactRows::unpack(&sent));

    let bytes = send(&mut host, &Command::Arm);
    let events = feed(&mut console, &bytes);
    assert_eq!(commands(&events), [Command::Arm]);

    let order = Simulate::Hand(sample::hand());
    let bytes = send(&mut host, &order);
    let events = feed(&mut console, &bytes);
    let [LinkEvent::Simulate(simulate)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(*simulate.body(), order);

    let events = hear(&mut host, &state_frame(&mut console));
    let [HostEvent::State(state)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(*state.body(), sample::state());
    assert_eq!(state.console_time_us(), NOW_US);

    let clean = |sent, received| Counters {
        frames_sent: sent,
        frames_received: received,
        ..Counters::default()
    };
    // The Hellos count too.
    assert_eq!(host.counters(), clean(7, 2));
    assert_eq!(console.counters(), clean(2, 7));
}

#[test]
fn the_answer_says_who_the_console_is() {
    let (mut host, mut console) = (HostLink::new(1000), console());
    feed(&mut console, &hello(&mut host, 99));
    let events = hear(&mut host, &reply(&mut console).unwrap());
    let [HostEvent::Opened(answer)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(answer.nonce, 99);
    assert_eq!(answer.schema_hash, SCHEMA_HASH);
    assert_eq!(answer.tick_hz, 1000);
    assert_eq!(usize::from(answer.max_frame), MAX_FRAME);
    assert!(answer.simulated);
    assert_eq!(answer.device_name, padded("desk"));
}

#[test]
fn without_a_session_nothing_is_taken_and_nothing_is_sent() {
    let mut console = console();
    for session in [0, 1] {
        assert_eq!(feed(&mut console, &frame(session, 1, 0, &Command::Arm)), []);
        assert_eq!(console.counters().last_reject, Some(Reject::Session));
    }
    assert_eq!(state_frame(&mut console), []);
    let mut host = HostLink::new(1000);
    let sent = host.send(0, &Command::Arm, &mut [0; MAX_FRAME]);
    assert_eq!(sent, Err(SendError::NoSession));
    assert_eq!(hear(&mut host, &frame(0, 1, 0, &sample::state())), []);
    assert_eq!(host.counters().frames_sent, 0);
}

/// Else the host would refuse states of a session that it has not heard of.
#[test]
fn the_answer_goes_out_before_the_first_state() {
    let mut console = console();
    feed(&mut console, &host_hello(|_| {}));
    assert_eq!(state_frame(&mut console), []);
    assert!(reply(&mut console).is_some());
    assert!(!state_frame(&mut console).is_empty());
}

#[test]
fn a_gap_in_the_sequence_counts_as_lost_and_the_frame_is_taken() {
    let (_, mut console, session) = pair();
    let arm = |sequence| frame(session, sequence, 0, &Command::Arm);
    let mut take = |sequence| feed(&mut console, &arm(sequence)).len();
    assert_eq!(take(1), 1);
    assert_eq!(take(5), 1);
    assert_eq!(take(5), 0, "duplicate");
    assert_eq!(take(4), 0, "old");
    assert_eq!(take(1), 0, "old");
    assert_eq!(take(6), 1);
    let counters = console.counters();
    assert_eq!(counters.frames_lost, 3);
    assert_eq!(counters.frames_rejected, 3);
    assert_eq!(counters.last_reject, Some(Reject::Sequence));
    assert_eq!(counters.frames_received, 1 + 3);
}

/// A frame counts once, whether its kind is the last one's or not.
#[test]
fn all_kinds_share_one_sequence() {
    let (mut host, mut console, _) = pair();
    let _lost = send(&mut host, &sample::contact());
    let arm = send(&mut host, &Command::Arm);
    let contact = send(&mut host, &sample::contact());
    assert_eq!(feed(&mut console, &contact).len(), 1);
    assert_eq!(feed(&mut console, &arm), [], "overtaken");
    assert_eq!(console.counters().frames_lost, 2);

    let mut out = [0; MAX_FRAME];
    let _lost = state_frame(&mut console);
    let len = console.encode_report(NOW_US, &Report::default(), &mut out);
    assert_eq!(hear(&mut host, &out[..len]).len(), 1);
    assert_eq!(host.counters().frames_lost, 1);
}

#[test]
fn the_sequence_may_wrap() {
    let (_, mut console, session) = pair();
    let arm = |sequence| frame(session, sequence, 0, &Command::Arm);
    // In steps of less than half the circle, to the top and over it.
    for sequence in [0x7fff_ffff, 0xffff_fffe, 0xffff_ffff, 0, 2] {
        assert_eq!(feed(&mut console, &arm(sequence)).len(), 1, "{sequence:#x}");
    }
    assert_eq!(feed(&mut console, &arm(0xffff_ffff)), [], "old");
    assert_eq!(
        feed(&mut console, &arm(0x8000_0003)),
        [],
        "half the circle back"
    );
    let lost = (0x7fff_ffff_u32 - 1) + (0x7fff_ffff - 1) + 1;
    assert_eq!(console.counters().frames_lost, lost);
}

#[test]
fn a_refused_body_is_not_lost_as_well() {
    let (_, mut console, session) = pair();
    let contact = Contact {
        gap_m: f32::NAN,
        ..sample::contact()
    };
    assert_eq!(feed(&mut console, &frame(session, 1, 0, &contact)), []);
    let arm = frame(session, 2, 0, &Command::Arm);
    assert_eq!(feed(&mut console, &arm).len(), 1);
    let counters = console.counters();
    assert_eq!((counters.frames_lost, counters.frames_rejected), (0, 1));
    assert_eq!(counters.last_reject, Some(Reject::NotFinite));
}

#[test]
fn a_contact_from_the_future_is_refused() {
    let (_, mut console, session) = pair();
    let contact = |sequence, time| frame(session, sequence, time, &sample::contact());
    assert_eq!(feed(&mut console, &contact(1, NOW_US)).len(), 1);
    assert_eq!(feed(&mut console, &contact(2, NOW_US + 1)), []);
    assert_eq!(console.counters().last_reject, Some(Reject::FromTheFuture));
    assert_eq!(feed(&mut console, &contact(3, 0)).len(), 1);
}

#[test]
fn rows_from_the_future_are_refused() {
    let (_, mut console, session) = pair();
    let rows = |sequence, time| frame(session, sequence, time, &sample::rows());
    assert_eq!(feed(&mut console, &rows(1, NOW_US)).len(), 1);
    assert_eq!(feed(&mut console, &rows(2, NOW_US + 1)), []);
    assert_eq!(console.counters().last_reject, Some(Reject::FromTheFuture));
    assert_eq!(feed(&mut console, &rows(3, 0)).len(), 1);
}

#[test]
fn a_needle_from_the_future_is_refused() {
    let (_, mut console, session) = pair();
    let needle = |sequence, time| frame(session, sequence, time, &sample::needle());
    assert_eq!(feed(&mut console, &needle(1, NOW_US)).len(), 1);
    assert_eq!(feed(&mut console, &needle(2, NOW_US + 1)), []);
    assert_eq!(console.counters().last_reject, Some(Reject::FromTheFuture));
    assert_eq!(feed(&mut console, &needle(3, 0)).len(), 1);
}

#[test]
fn a_thread_from_the_future_is_refused() {
    let (_, mut console, session) = pair();
    let thread = |sequence, time| frame(session, sequence, time, &sample::thread());
    assert_eq!(feed(&mut console, &thread(1, NOW_US)).len(), 1);
    assert_eq!(feed(&mut console, &thread(2, NOW_US + 1)), []);
    assert_eq!(console.counters().last_reject, Some(Reject::FromTheFuture));
    assert_eq!(feed(&mut console, &thread(3, 0)).len(), 1);
}

/// Everything that an earlier session sent comes once more: its `Hello` disarms and asks for a session
/// with a new number, so that all that follows is refused.
/// Ticks and times go on together, over the counter's end, too; nothing else is a state of a console that runs.
#[test]
fn a_state_whose_clock_does_not_go_on_is_refused() {
    let (mut host, mut console, _) = pair();
    let mut hears = |tick: u32, time_us: u64| {
        let mut out = [0; MAX_FRAME];
        let state = State {
            tick,
            ..sample::state()
        };
        let len = console.encode_state(time_us, &state, &mut out);
        let events = hear(&mut host, &out[..len]);
        match events.is_empty() {
            true => Err(host.counters().last_reject),
            false => Ok(()),
        }
    };
    let refused = Err(Some(Reject::Clock));
    let last = u32::MAX - 1;
    assert_eq!(hears(last, 7_000_000), Ok(()));
    assert_eq!(hears(last.wrapping_add(3), 7_003_000), Ok(()));
    // The same state once more, in lockstep.
    assert_eq!(hears(1, 7_003_000), Ok(()));
    for (tick, time_us) in [
        (0, 7_004_000),
        (last, 7_004_000),
        (2, 7_002_999),
        (2, 7_003_000),
        (5, 1),
        (1_002_500, 7_503_000),
        (1_000_000, 7_010_000),
    ] {
        assert_eq!(hears(tick, time_us), refused, "{tick} at {time_us}");
    }
    // A console that was late for a second goes on, and so does one whose host did not listen for an hour.
    assert_eq!(hears(900, 7_004_000), Ok(()));
    assert_eq!(hears(901, 9_000_000), Ok(()));
    assert_eq!(hears(3_600_901, 3_609_000_000), Ok(()));
}

#[test]
fn a_replayed_session_is_refused() {
    let (mut host, mut console) = (HostLink::new(1000), console());
    let (first, question) = connect(&mut host, &mut console, 7);
    let mut recording = question;
    for _ in 0..3 {
        recording.extend(send(&mut host, &sample::contact()));
        recording.extend(send(&mut host, &Command::Arm));
    }
    let without_hello = recording.iter().position(|byte| *byte == 0).unwrap() + 1;
    let taken = feed(&mut console, &recording[without_hello..]);
    assert_eq!(taken.len(), 6, "the recording is good");

    // Within another session, without the host's Hello and with it.
    let (second, _) = connect(&mut host, &mut console, 8);
    assert_ne!(first, second);
    assert_eq!(feed(&mut console, &recording[without_hello..]), []);
    assert_eq!(console.counters().last_reject, Some(Reject::Session));
    let arm = send(&mut host, &Command::Arm);
    assert_eq!(feed(&mut console, &arm).len(), 1, "still open");

    // The host that uses the console keeps it; once it is quiet, a session that nobody asked for opens.
    assert_eq!(feed(&mut console, &recording), []);
    let answer = common::unpack_one(&reply(&mut console).unwrap()).unwrap();
    let Unchecked::Hello(_, answer) = answer else {
        panic!("{answer:?}");
    };
    assert_eq!((answer.session, answer.refusal), (0, Refusal::Owned));
    let arm = send(&mut host, &Command::Arm);
    assert_eq!(feed(&mut console, &arm).len(), 1, "still open");
    let events = feed_at(&mut console, &recording, LATER_US);
    assert_eq!(events, [LinkEvent::SessionOpened]);
    assert_eq!(console.counters().last_reject, Some(Reject::Session));
    // The host did not ask: it does not take the answer for its own.
    assert_eq!(hear(&mut host, &reply(&mut console).unwrap()), []);
    assert_eq!(host.counters().last_reject, Some(Reject::Nonce));

    // After a reset with another seed.
    let mut console = ConsoleLink::new(identity(), 0x5eed + 1);
    assert_eq!(feed(&mut console, &recording), [LinkEvent::SessionOpened]);
    assert_eq!(console.counters().frames_rejected, 6);
}

#[test]
fn sessions_do_not_repeat() {
    let mut console = console();
    let mut seen = std::collections::HashSet::new();
    for _ in 0..10_000 {
        feed(&mut console, &host_hello(|_| {}));
        let mut host = HostLink::new(1000);
        hello(&mut host, sample::hello_host().nonce);
        match hear(&mut host, &reply(&mut console).unwrap())[..] {
            [HostEvent::Opened(answer)] => assert!(seen.insert(answer.session)),
            ref events => panic!("{events:?}"),
        }
    }
    assert!(!seen.contains(&0));
}

#[test]
fn a_late_answer_to_an_earlier_attempt_is_not_taken() {
    let (mut host, mut console) = (HostLink::new(1000), console());
    feed(&mut console, &hello(&mut host, 1));
    let late = reply(&mut console).unwrap();
    feed(&mut console, &hello(&mut host, 2));
    let answer = reply(&mut console).unwrap();
    assert_eq!(hear(&mut host, &late), []);
    assert!(!host.is_open());
    assert_eq!(hear(&mut host, &answer).len(), 1);
    let bytes = send(&mut host, &Command::Arm);
    assert_eq!(feed(&mut console, &bytes).len(), 1, "one session");
    assert_eq!(hear(&mut host, &answer), [], "nor a second time");
}

/// What the console says to a host it does not suit, and what the host makes of it.
#[track_caller]
fn mismatch(
    question: &[u8],
    (console, now_us): (&mut ConsoleLink, u64),
    reject: Reject,
    mut host: HostLink,
) {
    let nonce = sample::hello_host().nonce;
    hello(&mut host, nonce);
    let was_open = console.is_open();
    assert_eq!(feed_at(console, question, now_us), []);
    assert_eq!(console.counters().last_reject, Some(reject));
    assert_eq!(console.is_open(), was_open, "changes nothing");
    let answer = reply(console).expect("still answers");
    let events = hear(&mut host, &answer);
    assert!(
        matches!(events[..], [HostEvent::Refused(_)]),
        "the host is told: {events:?}"
    );
    assert!(!host.is_open());
}

#[test]
fn whoever_does_not_fit_gets_an_answer_but_no_session() {
    let host = || HostLink::new(1000);
    let mut console = console();
    let schema = host_hello(|h| h.schema_hash ^= 1);
    mismatch(&schema, (&mut console, NOW_US), Reject::Schema, host());
    let rate = host_hello(|h| h.tick_hz = 500);
    mismatch(
        &rate,
        (&mut console, NOW_US + REFUSED_EVERY_US),
        Reject::TickRate,
        HostLink::new(500),
    );
    let small = host_hello(|h| h.max_frame = MAX_FRAME as u16 - 1);
    mismatch(
        &small,
        (&mut console, NOW_US + 2 * REFUSED_EVERY_US),
        Reject::FrameSize,
        host(),
    );
    // An open session survives it.
    feed(&mut console, &host_hello(|_| {}));
    reply(&mut console);
    mismatch(
        &schema,
        (&mut console, NOW_US + 3 * REFUSED_EVERY_US),
        Reject::Schema,
        host(),
    );
    assert!(console.is_open());
}

/// A host that floods the line with wrong `Hello`s is answered ten times a second, and keeps nobody from a session.
#[test]
fn wrong_hellos_are_answered_ten_times_a_second() {
    let mut console = console();
    let wrong = host_hello(|h| h.schema_hash ^= 1);
    let mut answers = 0;
    for ms in 0..1000 {
        feed_at(&mut console, &wrong, NOW_US + 1000 * ms);
        answers += usize::from(reply(&mut console).is_some());
    }
    assert_eq!(answers, 10);
    let right = host_hello(|_| {});
    let opened = feed_at(&mut console, &right, NOW_US + 1_000_000);
    assert_eq!(opened, [LinkEvent::SessionOpened]);
    assert!(reply(&mut console).is_some());
}

/// A console's reason is passed on where this end finds no difference, and a session's number beside it is none.
#[test]
fn a_refusal_opens_no_session_and_its_reason_is_said() {
    let words = [
        (Refusal::Schema, "another layout"),
        (
            Refusal::TickRate,
            "another control rate, and says that its own is 1000 Hz",
        ),
        (Refusal::FrameSize, "needs larger frames"),
        (Refusal::None, "without a reason"),
        (Refusal::Owned, ""),
    ];
    for (refusal, words) in words {
        for session in [0, 77] {
            let mut host = HostLink::new(1000);
            let answer = Hello {
                schema_hash: SCHEMA_HASH,
                max_frame: MAX_FRAME as u16,
                session,
                refusal,
                ..sample::hello_console()
            };
            hello(&mut host, answer.nonce);
            let events = hear(&mut host, &frame(0, 0, 0, &answer));
            let opens = session != 0 && refusal == Refusal::None;
            assert_eq!(host.is_open(), opens, "{refusal:?} {session}");
            match events[..] {
                [HostEvent::Opened(_)] => assert!(opens),
                [HostEvent::Owned] => assert_eq!(refusal, Refusal::Owned),
                [HostEvent::Refused(mismatch)] => {
                    let said = mismatch.to_string();
                    assert!(said.contains(words), "{said}");
                }
                _ => panic!("{refusal:?} {session}: {events:?}"),
            }
        }
    }
}

#[test]
fn a_host_of_another_version_is_answered_in_this_one() {
    let mut console = console();
    // All that versions have in common: version, kind, CRC.
    let question = forge(&[PROTOCOL_VERSION + 1, 1, 2, 3]);
    assert_eq!(feed(&mut console, &question), []);
    assert_eq!(console.counters().last_reject, Some(Reject::Version));
    assert!(!console.is_open());
    let answer = reply(&mut console).unwrap();
    let answer = common::unpack_one(&answer).unwrap();
    let Unchecked::Hello(header, hello) = answer else {
        panic!("{answer:?}");
    };
    assert_eq!(header.version, PROTOCOL_VERSION);
    assert_eq!((hello.session, hello.nonce), (0, 0));
    // Only a Hello is answered, and only a sound one.
    for other in [forge(&[PROTOCOL_VERSION + 1, 2, 3]), forge(&[7])] {
        assert_eq!(feed(&mut console, &other), []);
        assert_eq!(reply(&mut console), None);
    }
}

#[test]
fn the_host_hears_which_version_the_console_speaks() {
    let mut host = HostLink::new(1000);
    let answer = forge(&[3, 1, 0xff, 0xff]);
    assert_eq!(hear(&mut host, &answer), [], "not asked");
    hello(&mut host, 1);
    let events = hear(&mut host, &answer);
    let mismatch = Mismatch::Version { console: 3 };
    assert_eq!(events, [HostEvent::Refused(mismatch)]);
    assert_eq!(
        mismatch.to_string(),
        "the console speaks protocol version 3, this program version 1: use firmware and program of \
         one release"
    );
    assert_eq!(host.counters().last_reject, Some(Reject::Version));
}

/// The host's own view of each difference, whatever the console thought of it.
#[test]
fn the_host_refuses_a_console_that_does_not_fit() {
    let nonce = 5;
    let fits = Hello {
        schema_hash: SCHEMA_HASH,
        nonce,
        session: 9,
        tick_hz: 1000,
        max_frame: MAX_FRAME as u16,
        simulated: false,
        device_name: padded("desk"),
        refusal: Refusal::None,
    };
    let hear_of = |answer: Hello| {
        let mut host = HostLink::new(1000);
        hello(&mut host, nonce);
        let events = hear(&mut host, &frame(0, 0, 0, &answer));
        assert_eq!(events.len(), 1);
        (events[0], host.is_open())
    };
    assert_eq!(hear_of(fits), (HostEvent::Opened(fits), true));
    let cases = [
        (
            Hello {
                schema_hash: 0xabc,
                ..fits
            },
            Mismatch::Schema { console: 0xabc },
            "0000000000000abc",
        ),
        (
            Hello {
                tick_hz: 4000,
                ..fits
            },
            Mismatch::TickRate {
                console: 4000,
                host: 1000,
            },
            "4000 Hz",
        ),
        (
            Hello {
                max_frame: 100,
                ..fits
            },
            Mismatch::FrameSize { console: 100 },
            "100 bytes",
        ),
        (
            Hello { session: 0, ..fits },
            Mismatch::Refused {
                refusal: Refusal::None,
                tick_hz: fits.tick_hz,
                max_frame: fits.max_frame,
            },
            "refused",
        ),
    ];
    for (answer, mismatch, says) in cases {
        assert_eq!(hear_of(answer), (HostEvent::Refused(mismatch), false));
        assert!(mismatch.to_string().contains(says), "{mismatch}");
    }
}

/// The console's description is checked, and the reason against it is kept until the next question.
#[test]
fn an_answer_that_cannot_be_used_says_why() {
    let answer = Hello {
        schema_hash: SCHEMA_HASH,
        nonce: 5,
        session: 9,
        tick_hz: 1000,
        max_frame: MAX_FRAME as u16,
        simulated: false,
        device_name: padded("\u{1b}[31mx"),
        refusal: Refusal::None,
    };
    let mut host = HostLink::new(1000);
    hello(&mut host, 5);
    assert_eq!(host.unusable_answer(), None);
    assert_eq!(hear(&mut host, &frame(0, 0, 0, &answer)), []);
    // Other refusals meanwhile change nothing: the console takes the session for open.
    assert_eq!(hear(&mut host, &forge(&[PROTOCOL_VERSION, 2, 3])), []);
    let mismatch = host.unusable_answer().unwrap();
    assert_eq!(mismatch, Mismatch::Unusable(Reject::Name));
    assert!(
        mismatch.to_string().contains("a name is not plain UTF-8"),
        "{mismatch}"
    );
    let question = hello(&mut host, 6);
    assert_eq!(host.unusable_answer(), None);
    // A line that echoes is none.
    assert_eq!(hear(&mut host, &question), []);
    assert_eq!(host.unusable_answer(), None);
}

/// A terminal that echoes must not make the console answer itself, nor the host.
#[test]
fn an_echo_is_refused_at_both_ends() {
    for name in [padded("desk"), [0; 16]] {
        let mut console = ConsoleLink::new(
            Identity {
                device_name: name,
                ..identity()
            },
            1,
        );
        let mut host = HostLink::new(1000);
        let question = hello(&mut host, 1);
        assert_eq!(hear(&mut host, &question), []);
        assert_eq!(host.counters().last_reject, Some(Reject::Direction));
        feed(&mut console, &question);
        let answer = reply(&mut console).unwrap();
        assert_eq!(feed(&mut console, &answer), []);
        assert_eq!(console.counters().last_reject, Some(Reject::Direction));
        assert_eq!(reply(&mut console), None);
        // The answer to a stranger, session 0, neither.
        feed(&mut console, &forge(&[PROTOCOL_VERSION + 1, 1]));
        let answer = reply(&mut console).unwrap();
        assert_eq!(feed(&mut console, &answer), []);
        assert_eq!(reply(&mut console), None);
        let state = state_frame(&mut console);
        assert_eq!(feed(&mut console, &state), []);
        assert_eq!(console.counters().last_reject, Some(Reject::Direction));
    }
}

#[test]
fn hello_travels_outside_any_session() {
    let mut console = console();
    let hello = Hello {
        schema_hash: SCHEMA_HASH,
        ..sample::hello_host()
    };
    for (session, sequence) in [(1, 0), (0, 1)] {
        assert_eq!(feed(&mut console, &frame(session, sequence, 0, &hello)), []);
        assert_eq!(console.counters().last_reject, Some(Reject::Session));
        assert_eq!(reply(&mut console), None);
    }
}

#[test]
fn only_a_simulated_console_takes_orders_for_the_simulation() {
    let (mut host, mut real) = (
        HostLink::new(1000),
        ConsoleLink::new(
            Identity {
                simulated: false,
                ..identity()
            },
            1,
        ),
    );
    connect(&mut host, &mut real, 3);
    let order = send(&mut host, &Simulate::EmergencyStop(false));
    assert_eq!(feed(&mut real, &order), []);
    assert_eq!(real.counters().last_reject, Some(Reject::NotSimulated));
}

#[test]
fn the_host_does_not_send_what_the_console_would_refuse() {
    let (mut host, _, _) = pair();
    let mut out = [0; MAX_FRAME];
    let contact = Contact {
        normal: [0.0; 3],
        ..sample::contact()
    };
    let before = host.counters();
    let sent = host.send(0, &contact, &mut out);
    assert_eq!(sent, Err(SendError::Invalid(Reject::Range)));
    let sent = host.send(0, &sample::state(), &mut out);
    assert_eq!(sent, Err(SendError::Invalid(Reject::Direction)));
    assert_eq!(host.counters(), before);
    assert_eq!(host.sent_sequence(), 0, "no gap");
}

#[test]
fn state_every_is_kept_for_one_session() {
    let (mut host, mut console, _) = pair();
    assert_eq!(console.state_every(), 1);
    let command = Command::StateEvery { ticks: 33 };
    let bytes = send(&mut host, &command);
    assert_eq!(commands(&feed(&mut console, &bytes)), [command]);
    assert_eq!(console.state_every(), 33);
    connect(&mut host, &mut console, 8);
    assert_eq!(console.state_every(), 1);
}

#[test]
fn a_report_carries_the_counts_of_the_link() {
    let (mut host, mut console, session) = pair();
    feed(&mut console, &frame(session, 4, 0, &Command::Arm));
    feed(&mut console, &[3, 0]);
    let mut out = [0; MAX_FRAME];
    let report = Report {
        frames_received: 99,
        ..sample::report()
    };
    let len = console.encode_report(NOW_US, &report, &mut out);
    let events = hear(&mut host, &out[..len]);
    let [HostEvent::Report(heard)] = &events[..] else {
        panic!("{events:?}");
    };
    let expected = Report {
        frames_received: 2,
        frames_lost: 3,
        frames_rejected: 1,
        last_reject: Reject::Cobs as u8,
        ..sample::report()
    };
    assert_eq!(*heard.body(), expected);
}

/// What was on the line before belongs to somebody else.
#[test]
fn the_hosts_counts_begin_with_its_session() {
    let (_, mut console, _) = pair();
    let mut host = HostLink::new(1000);
    // A console that still talks to the last host, caught in the middle of a frame.
    hear(&mut host, &state_frame(&mut console)[10..]);
    hear(&mut host, &state_frame(&mut console));
    assert_eq!(host.counters().frames_rejected, 2);
    connect(&mut host, &mut console, 8);
    hear(&mut host, &state_frame(&mut console));
    let clean = Counters {
        frames_sent: 1,
        frames_received: 2,
        ..Counters::default()
    };
    assert_eq!(host.counters(), clean);
}

/// One thing that a bad line does to a frame.
#[derive(Clone, Copy, Debug)]
enum Fate {
    Arrives,
    Lost,
    Doubled,
    Broken(usize, u8),
    Late,
}

fn any_fate() -> impl Strategy<Value = Fate> {
    prop_oneof![
        4 => Just(Fate::Arrives),
        1 => Just(Fate::Lost),
        1 => Just(Fate::Doubled),
        1 => (0usize..MAX_FRAME, 1u8..).prop_map(|(at, flip)| Fate::Broken(at, flip)),
        1 => Just(Fate::Late),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// Over any line: contacts arrive unchanged, in order and at most once, and every frame that did
    /// not arrive before the last that did is counted as lost.
    #[test]
    fn contacts_arrive_in_order_and_at_most_once(fates in prop::collection::vec(any_fate(), 1..60)) {
        let (mut host, mut console, _) = pair();
        let mut late = Vec::new();
        let mut taken = Vec::new();
        for fate in fates {
            let contact = Contact { horizon_us: host.sent_sequence() + 1, ..sample::contact() };
            let mut bytes = send(&mut host, &contact);
            let overtaken = std::mem::take(&mut late);
            match fate {
                Fate::Arrives => {}
                Fate::Lost => bytes.clear(),
                Fate::Doubled => bytes = bytes.repeat(2),
                Fate::Broken(at, flip) => {
                    let at = at % bytes.len();
                    bytes[at] ^= flip;
                    // Ends the frame even if its delimiter is what broke.
                    bytes.push(0);
                }
                Fate::Late => std::mem::swap(&mut bytes, &mut late),
            }
            taken.extend(feed(&mut console, &bytes));
            taken.extend(feed(&mut console, &overtaken));
        }
        let mut last = 0;
        for event in &taken {
            let LinkEvent::Contact(contact) = event else {
                return Err(TestCaseError::fail(format!("{event:?}")));
            };
            prop_assert!(contact.sequence() > last);
            prop_assert_eq!(contact.body().horizon_us, contact.sequence());
            last = contact.sequence();
        }
        let lost = console.counters().frames_lost as usize;
        prop_assert_eq!(lost + taken.len(), last as usize);
    }

    /// Any bytes at any time: both ends survive, and neither opens a session on noise.
    #[test]
    fn noise_opens_nothing(bytes in prop::collection::vec(any::<u8>(), 0..3000)) {
        let mut console = console();
        let mut host = HostLink::new(1000);
        hello(&mut host, 1);
        prop_assert_eq!(feed(&mut console, &bytes), []);
        prop_assert_eq!(hear(&mut host, &bytes), []);
        prop_assert!(!console.is_open() && !host.is_open());
    }

    /// A peer that knows the session and has the right checksum can send any body: the console takes
    /// what is valid and survives the rest.
    #[test]
    fn any_body_in_a_session_is_survived(
        bodies in prop::collection::vec((0u8..20, prop::collection::vec(any::<u8>(), 0..214)), 1..20),
    ) {
        let (_, mut console, session) = pair();
        for (sequence, (kind, body)) in bodies.into_iter().enumerate() {
            let head = header_bytes(PROTOCOL_VERSION, kind, session, sequence as u32 + 1, 0);
            for event in feed(&mut console, &forge(&[head, body].concat())) {
                let finite = match event {
                    LinkEvent::Contact(contact) => {
                        contact.body().wrench.iter().all(|x| x.is_finite())
                    }
                    _ => true,
                };
                prop_assert!(finite);
            }
        }
    }
}

/// A recording replays on any machine only if the session's number is the same there. The number was
/// computed from the formula outside this code: nonce 7, seed 0x5eed, first `Hello`.
#[test]
fn session_numbers_are_the_same_everywhere() {
    let (_, _, session) = pair();
    assert_eq!(session, 0x2186_7745);
}

/// What each check is for: without it alone, what it keeps out gets in.
#[test]
fn every_check_keeps_something_out() {
    type Breach = fn(&mut ConsoleLink, u32) -> bool;
    fn arms(console: &mut ConsoleLink, bytes: &[u8]) -> bool {
        !feed(console, bytes).is_empty()
    }
    let checksum: Breach = |console, session| {
        let mut broken = frame(session, 1, 0, &Command::Arm);
        let last = broken.len() - 2;
        broken[last] ^= 0x55;
        arms(console, &broken)
    };
    let of_another_session: Breach =
        |console, session| arms(console, &frame(session ^ 1, 1, 0, &Command::Arm));
    let doubled: Breach = |console, session| {
        let arm = frame(session, 1, 0, &Command::Arm);
        feed(console, &arm);
        arms(console, &arm)
    };
    let future: Breach =
        |console, session| arms(console, &frame(session, 1, NOW_US + 1, &sample::contact()));
    let schema: Breach = |console, _| arms(console, &host_hello(|hello| hello.schema_hash ^= 1));
    let ownership: Breach = |console, session| {
        feed(console, &frame(session, 1, 0, &Command::Arm));
        arms(console, &host_hello(|_| {}))
    };
    let expiry: Breach = |console, _| {
        let much_later = LATER_US + EXPIRES_AFTER_US;
        console.expire(much_later - 1).is_some() || console.expire(much_later).is_none()
    };
    let companions: Breach = |console, session| {
        let (needle, contact) = (sample::needle(), sample::contact());
        feed(console, &frame(session, 1, 0, &needle));
        feed(console, &frame(session, 2, 0, &contact));
        // The needle between the two is lost.
        arms(console, &frame(session, 4, 0, &contact))
    };
    let all = Checks::ALL;
    let without: [(Checks, Breach); 8] = [
        (
            Checks {
                checksum: false,
                ..all
            },
            checksum,
        ),
        (
            Checks {
                session: false,
                ..all
            },
            of_another_session,
        ),
        (
            Checks {
                sequence: false,
                ..all
            },
            doubled,
        ),
        (
            Checks {
                future: false,
                ..all
            },
            future,
        ),
        (
            Checks {
                schema: false,
                ..all
            },
            schema,
        ),
        (
            Checks {
                ownership: false,
                ..all
            },
            ownership,
        ),
        (
            Checks {
                expiry: false,
                ..all
            },
            expiry,
        ),
        (
            Checks {
                companions: false,
                ..all
            },
            companions,
        ),
    ];
    for (off, breach) in without {
        for (checks, gets_in) in [(off, true), (Checks::ALL, false)] {
            let (mut host, mut console) = (
                HostLink::new(1000),
                ConsoleLink::with_checks(identity(), 0x5eed, checks),
            );
            let (session, _) = connect(&mut host, &mut console, 7);
            assert_eq!(breach(&mut console, session), gets_in, "{checks:?}");
        }
    }
}
