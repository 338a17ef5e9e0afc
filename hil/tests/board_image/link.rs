//! The cable: enumeration, `Hello`, and a line that is flooded.

use super::{Bench, DARK, NO_CURRENT, On, TAKEN};
use sutura_hil::board_image::{ID, reset};
use sutura_shared::link::HostLink;
use sutura_shared::wire::message::{
    Command, Contact, End, Hello, Mode, Ping, Refusal, Tension, Thread,
};
use sutura_shared::wire::{MAX_FRAME, SCHEMA_HASH, Unchecked, decode, encode};

/// Pin modes and functions of the port that the timer drives.
const GPIOC_MODER: u32 = 0x4002_0800;
const GPIOC_AFRL: u32 = 0x4002_0820;
const GPIOC_AFRH: u32 = 0x4002_0824;

on_each_board!(a_reset_of_the_bus_takes_the_torque_off_and_ends_the_session);
/// Torque off first of all: the driver waits for the USB core then, with interrupts masked. A new host finds the console at rest, and no fault.
pub(super) fn a_reset_of_the_bus_takes_the_torque_off_and_ends_the_session(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    bench.changes();
    bench.board.chip().usb.signal_reset();
    bench.board.serve().unwrap();
    let changes = bench.changes();
    assert!(
        changes
            .first()
            .is_some_and(|o| !o.enable && o.duty[2] != NO_CURRENT),
        "{changes:?}"
    );
    assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    // The tick that disarms, and those after it.
    for _ in 0..30 {
        bench.board.chip().lines.encoder_counts[2] -= 1;
        bench.board.tick().unwrap();
        assert_eq!(bench.outputs().duty, [NO_CURRENT; 3]);
    }
    assert_eq!(bench.outputs(), DARK);
    bench.compares = false;
    bench.board.enumerate().unwrap();
    bench.host = HostLink::new(1000);
    bench.say_hello();
    let state = bench.tick();
    assert_eq!((state.mode, state.faults), (Mode::Idle, 0));
    bench.say_speed("a reset of the bus");
}

on_each_board!(the_image_boots_enumerates_and_answers_with_its_names);
pub(super) fn the_image_boots_enumerates_and_answers_with_its_names(on: On) {
    let mut board = on.start();
    // The amplifiers have never been touched, and both watchdogs run and are fed.
    let chip = board.chip();
    assert!(
        chip.changes.iter().all(|o| !o.enable && !o.pulses),
        "{:?}",
        chip.changes
    );
    assert_eq!(chip.outputs(), DARK);
    assert!(chip.watchdog_runs && chip.feeds.independent > 0);
    assert!(chip.window_runs && chip.feeds.window > 0);
    // PC6 to PC8 are the timer's: alternate function 3.
    assert_eq!(chip.stored(GPIOC_MODER) >> 12 & 0x3F, 0b10_1010);
    assert_eq!(chip.stored(GPIOC_AFRL) >> 24, 0x33);
    assert_eq!(chip.stored(GPIOC_AFRH) & 0xF, 0x3);

    let said = board.enumerate().unwrap_or_else(|error| panic!("{error}"));
    // Of several functions, each with its interfaces.
    assert_eq!(
        (said.vendor, said.product, said.class),
        (0x16C0, 0x27DD, 0xEF)
    );
    // Communications, data, and the log; notification up, data down and up, log up: with the control endpoint all four to the host that
    // the F405 has.
    assert_eq!(said.interfaces, [2, 10, 0xFF]);
    assert_eq!(said.endpoints, [0x81, 0x82, 0x01, 0x83]);
    assert_eq!(said.manufacturer, "github.com/sutura");
    assert_eq!(said.name, "Sutura console");
    let [a, b, c] = ID;
    assert_eq!(said.serial_number, format!("{a:08X}{b:08X}{c:08X}"));

    let mut bench = Bench::of(on, board);
    bench.hello();
    bench.tick();
    let hello = bench.hello.unwrap();
    assert!(hello.device_name.starts_with(on.name().as_bytes()));
    assert!(!hello.simulated && hello.tick_hz == 1000 && hello.session != 0);
    let report = bench.report.unwrap();
    // Power-up, and nothing left behind.
    assert_eq!((report.reset_cause, report.epitaph_kind), (1, 0));
    assert!(
        report.stack_free_bytes > 16 * 1024,
        "{}",
        report.stack_free_bytes
    );
    assert_eq!((report.tick_overruns, report.ticks_late), (0, 0));
    bench.say_speed("boot, enumeration, hello");
}

on_each_board!(a_flooded_line_costs_no_tick_and_no_watchdog);
/// Everything that a line can bring, more of it than a tick takes: ticks come, are told of, and all tasks run.
pub(super) fn a_flooded_line_costs_no_tick_and_no_watchdog(on: On) {
    let mut bench = Bench::start(on);
    bench.arm();
    bench.compares = false;
    let first = bench.state.unwrap().1.tick;
    let mut random = fastrand::Rng::with_seed(5);
    for tick in 1..=100 {
        let fed = bench.board.chip().feeds;
        // 40 orders at once are more than wait for a tick; then contacts, and noise that is no frame.
        if bench.board.waiting() < 100 {
            for order in 0..40 {
                let ticks = if order == 39 { 1 } else { 2 };
                bench.say(&Command::StateEvery { ticks });
            }
            for _ in 0..4 {
                let contact = bench.floor();
                bench.say(&contact);
            }
            bench.say(&Ping { host_us: tick });
            bench.down.extend((0..256).map(|_| random.u8(1..)));
            bench.down.push(0);
        }
        bench.try_tick().unwrap_or_else(|error| panic!("{error}"));
        let feeds = bench.board.chip().feeds;
        assert!(
            feeds.window > fed.window && feeds.independent > fed.independent,
            "{tick}"
        );
        assert!(bench.board.waiting() > 0, "the line is not flooded");
    }
    bench.say(&Command::StateEvery { ticks: 1 });
    while bench.board.waiting() > 0 {
        bench.try_tick().unwrap_or_else(|error| panic!("{error}"));
    }
    let ticks = bench.board.ticks() - bench.booted;
    let state = bench.tick();
    assert_eq!(u64::from(state.tick), ticks + 1, "from {first}");
    assert_eq!((state.mode, state.faults), (Mode::Armed, 0));
    // More at once than wait for a tick, as many as a tick may bring, and the last of them counts.
    for _ in 0..24 {
        bench.say(&Command::StateEvery { ticks: 1 });
    }
    bench.say(&Command::Disarm);
    assert!(bench.down.len() < TAKEN, "{}", bench.down.len());
    for _ in 0..3 {
        bench.tick();
    }
    assert_eq!(bench.state.unwrap().1.mode, Mode::Idle, "an order is lost");
    bench.say_speed("a flooded line");
}

on_each_board!(two_boots_in_a_row_draw_numbers_of_their_own);
/// Without a random generator, and with a converter that gives the same for ever: what RAM keeps makes the difference. The stand-in's
/// generator draws the same every time, and is no chip's.
pub(super) fn two_boots_in_a_row_draw_numbers_of_their_own(on: On) {
    let mut bench = Bench::start(on);
    let mut seeds = vec![bench.seed];
    for _ in 0..3 {
        let mut board = bench.board;
        let again = board.boot_again(reset::SOFTWARE);
        again.unwrap_or_else(|error| panic!("{error}"));
        bench = Bench::of(on, board);
        bench.open();
        seeds.push(bench.seed);
    }
    eprintln!("{seeds:08x?}");
    let mut different = seeds.clone();
    different.sort_unstable();
    different.dedup();
    let expected = if on.board.draws() { 1 } else { seeds.len() };
    assert_eq!(different.len(), expected, "{seeds:08x?}");
}

on_each_board!(a_session_in_which_nothing_comes_for_a_second_is_over);
pub(super) fn a_session_in_which_nothing_comes_for_a_second_is_over(on: On) {
    let mut bench = Bench::start(on);
    bench.compares = false;
    bench.say(&Command::StateEvery { ticks: 10 });
    bench.try_tick().unwrap();
    let mut newest = 0;
    for tick in 0..1050 {
        let before = bench.state;
        bench.try_tick().unwrap();
        newest = if bench.state == before { newest } else { tick };
    }
    // The last frame came with the tick before these.
    assert!((980..1000).contains(&newest), "{newest}");
    bench.say_speed("a session that expires");
}

on_each_board!(a_host_with_other_messages_gets_no_session);
pub(super) fn a_host_with_other_messages_gets_no_session(on: On) {
    let mut board = on.start();
    board.enumerate().unwrap();
    board.send(&wrong_hello());
    (0..3).for_each(|_| board.tick().unwrap());
    assert_eq!(
        answers(&board.take()),
        [(0, Refusal::Schema)],
        "no session, and why"
    );
}

on_each_board!(wrong_hellos_are_answered_ten_times_a_second);
pub(super) fn wrong_hellos_are_answered_ten_times_a_second(on: On) {
    let mut board = on.start();
    board.enumerate().unwrap();
    for _ in 0..300 {
        board.send(&wrong_hello());
        board.tick().unwrap();
    }
    let answers = answers(&board.take()).len();
    assert!((3..=4).contains(&answers), "{answers} in 300 ms");
}

/// A host's first frame, with other messages than this console's.
fn wrong_hello() -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let hello = Hello {
        schema_hash: SCHEMA_HASH ^ 1,
        nonce: 5,
        session: 0,
        tick_hz: 1000,
        max_frame: MAX_FRAME as u16,
        simulated: false,
        device_name: [0; 16],
        refusal: Refusal::None,
    };
    let length = encode(0, 0, 0, &hello, &mut frame).unwrap();
    let mut bytes = vec![0];
    bytes.extend_from_slice(&frame[..length]);
    bytes
}

/// Sessions and refusals of all answers.
fn answers(up: &[u8]) -> Vec<(u32, Refusal)> {
    let frames = up.split(|byte| *byte == 0).filter(|f| !f.is_empty());
    frames.map(|stuffed| answer(stuffed).unwrap()).collect()
}

/// Session and refusal of a `Hello`.
fn answer(stuffed: &[u8]) -> Option<(u32, Refusal)> {
    let mut packet = vec![0; stuffed.len()];
    let length = cobs::decode(stuffed, &mut packet).ok()?.frame_size();
    match decode(&packet[..length]).ok()?.unpack().ok()? {
        Unchecked::Hello(_, hello) => Some((hello.session, hello.refusal)),
        _ => None,
    }
}

on_each_board!(what_is_not_to_be_believed_changes_nothing);
/// Each of these would change what the console does, if it were believed; the twin believes none.
pub(super) fn what_is_not_to_be_believed_changes_nothing(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    let session = bench.hello.unwrap().session;
    let (now_us, _) = bench.state.unwrap();
    let soft = Contact {
        wrench: [0.0; 6],
        ..bench.floor()
    };
    let mut frame = [0; MAX_FRAME];
    let mut raw = |session, sequence, time_us, body: &Contact| {
        let length = encode(session, sequence, time_us, body, &mut frame).unwrap();
        frame[..length].to_vec()
    };
    // Bits that have fallen over; another session; a frame that has been; a state to come; another host.
    let mut fallen = raw(session, 1000, now_us, &soft);
    let middle = fallen.len() / 2;
    fallen[middle] ^= if fallen[middle] == 0x40 { 0x20 } else { 0x40 };
    let stranger = raw(session ^ 1, 1001, now_us, &soft);
    let old = raw(session, 1, now_us, &soft);
    let early = raw(session, 1002, now_us + 60_000, &soft);
    let mut other = HostLink::new(1000);
    let length = other.hello(99, &mut frame).unwrap();
    let owner = frame[..length].to_vec();
    // A contact whose thread the line has lost: only the sequence tells.
    let thread = Thread {
        tool: 0,
        thread: 0,
        end: End::Head,
        state: Tension::Slack,
        direction: [0.0, 0.0, 1.0],
        tension_n: 0.0,
        stiffness_n_per_m: 0.0,
        slack_m: 0.1,
    };
    let length = encode(session, 1003, now_us, &thread, &mut frame).unwrap();
    let mut bare = frame[..length].to_vec();
    for (sequence, contact) in [(1004, &bench.floor()), (1006, &soft)] {
        let length = encode(session, sequence, now_us, contact, &mut frame).unwrap();
        bare.extend_from_slice(&frame[..length]);
    }
    for what in [fallen, stranger, old, early, owner, bare] {
        bench.down.extend(what);
        for _ in 0..3 {
            assert_eq!(bench.tick().mode, Mode::Armed);
        }
    }
    bench.say_speed("what is not to be believed");
}

on_each_board!(a_new_session_finds_the_console_disarmed);
/// A host that has been silent for 0.3 s has lost it to whoever asks.
pub(super) fn a_new_session_finds_the_console_disarmed(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    for _ in 0..320 {
        assert_ne!(bench.tick().mode, Mode::Idle);
    }
    let mut frame = [0; MAX_FRAME];
    let length = bench.host.hello(8, &mut frame).unwrap();
    bench.down.extend_from_slice(&frame[..length]);
    assert_eq!(bench.tick().mode, Mode::Idle);
    assert!(!bench.outputs().enable);
    bench.say_speed("a new session");
}
