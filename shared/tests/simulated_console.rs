//! The assembled console over its bytes: what comes when, and what counts as replaced.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{arm, bench, hand, wall};
use sutura_shared::control::TICK_US;
use sutura_shared::link::{EXPIRES_AFTER_US, HostEvent, HostLink, OWNED_FOR_US};
use sutura_shared::simulated_console::{Pace, SimulatedConsole};
use sutura_shared::wire::message::{Command, Mode, Ping, Pong, Report, Simulate, State};
use sutura_shared::wire::{MAX_FRAME, Message, inputs};

struct Host {
    console: SimulatedConsole,
    link: HostLink,
    states: Vec<(u64, State)>,
    reports: Vec<Report>,
    pongs: Vec<Pong>,
    turned_away: u32,
    ticked: u32,
}

impl Host {
    fn new() -> Self {
        let mut host = Host {
            console: SimulatedConsole::new(&bench(), 0).unwrap(),
            link: HostLink::new(1000),
            states: Vec::new(),
            reports: Vec::new(),
            pongs: Vec::new(),
            turned_away: 0,
            ticked: 0,
        };
        host.hello(1);
        host
    }

    fn send<M: Message>(&mut self, time_us: u64, body: &M) {
        let mut frame = [0; MAX_FRAME];
        let len = self.link.send(time_us, body, &mut frame).unwrap();
        self.console.feed(&frame[..len]);
    }

    /// A live host: a ping every 100 ticks.
    fn tick(&mut self, pace: Pace) {
        self.ticked += 1;
        if self.ticked.is_multiple_of(100) && self.link.is_open() {
            self.send(0, &Ping { host_us: 0 });
        }
        self.console.tick(pace);
        let mut up = Vec::new();
        self.console.drain(&mut up);
        for byte in up {
            match self.link.receive(byte) {
                Some(HostEvent::State(state)) => {
                    self.states.push((state.console_time_us(), *state.body()));
                }
                Some(HostEvent::Report(report)) => self.reports.push(*report.body()),
                Some(HostEvent::Opened(hello)) => {
                    assert!(hello.simulated && hello.tick_hz == 1000);
                    assert_eq!(hello.device_name, bench().name);
                }
                Some(HostEvent::Refused(mismatch)) => panic!("{mismatch}"),
                Some(HostEvent::Owned) => self.turned_away += 1,
                Some(HostEvent::Pong(pong)) => self.pongs.push(*pong.body()),
                None => {}
            }
        }
        assert_eq!(self.link.counters().frames_rejected, 0);
    }

    /// Ticks that nobody listens to, and in which nothing is sent.
    fn silence(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.console.tick(Pace::default());
            self.console.drain(&mut Vec::new());
        }
    }

    fn hello(&mut self, nonce: u32) {
        let mut frame = [0; MAX_FRAME];
        let len = self.link.hello(nonce, &mut frame).unwrap();
        self.console.feed(&frame[..len]);
    }

    fn ticks(&mut self, count: u32) {
        for _ in 0..count {
            self.tick(Pace::default());
        }
    }
}

#[test]
fn time_is_the_tick_count_and_states_and_reports_come_at_their_rates() {
    let mut host = Host::new();
    host.ticks(1);
    host.send(0, &Command::StateEvery { ticks: 4 });
    host.tick(Pace {
        overrun: true,
        late: true,
    });
    host.tick(Pace {
        overrun: false,
        late: true,
    });
    host.ticks(2997);
    let ticks: Vec<u32> = host.states.iter().map(|(_, state)| state.tick).collect();
    assert_eq!(ticks[..4], [1, 4, 8, 12]);
    assert_eq!(ticks.last(), Some(&3000));
    assert!(
        host.states
            .iter()
            .all(|(time_us, state)| *time_us == u64::from(state.tick) * 1000)
    );
    let counts: Vec<_> = host
        .reports
        .iter()
        .map(|r| (r.ticks, r.tick_overruns, r.ticks_late))
        .collect();
    // The first comes with the answer to the hello.
    assert_eq!(
        counts,
        [(1, 0, 0), (1000, 1, 2), (2000, 1, 2), (3000, 1, 2)]
    );
}

/// A second session starts from what the first one had counted, in the very first tick.
#[test]
fn every_session_begins_with_a_report() {
    let mut host = Host::new();
    host.ticks(1);
    host.send(0, &Command::Arm);
    host.ticks(4);
    host.silence(OWNED_FOR_US / TICK_US);
    host.hello(78);
    host.ticks(3);
    let counts: Vec<_> = host
        .reports
        .iter()
        .map(|r| (r.ticks, r.frames_received))
        .collect();
    assert_eq!(counts, [(1, 1), (306, 3)]);
}

#[test]
fn a_contact_that_no_tick_used_is_superseded_not_lost() {
    let mut host = Host::new();
    host.ticks(2);
    host.send(0, &Command::Arm);
    for _ in 0..3 {
        host.send(2000, &wall(1000.0, [0.0; 3]));
    }
    host.ticks(998);
    let report = host.reports[1];
    assert_eq!((report.frames_superseded, report.frames_lost), (2, 0));
    assert_eq!(host.states[2].1.contact_sequence, 4);
    assert_eq!(host.states[2].1.applied_age_us, 1000);
}

#[test]
fn it_becomes_the_device_and_takes_the_hand_that_it_is_given() {
    let mut host = Host::new();
    host.ticks(2);
    let mut script = hand(
        400.0,
        8.0,
        &[(0.0, [0.1, 0.05, 0.1]), (0.5, [0.05, 0.0, 0.1])],
    );
    script.start_joint = [0.1, 0.6, -1.3];
    host.send(0, &Simulate::Device(arm()));
    host.send(0, &Simulate::Hand(script));
    host.send(0, &Command::Arm);
    host.ticks(1200);
    let modes: Vec<Mode> = host.states.iter().map(|(_, state)| state.mode).collect();
    assert_eq!(
        modes[..5],
        [Mode::Boot, Mode::Idle, Mode::Boot, Mode::Armed, Mode::Armed]
    );
    let (_, last) = host.states.last().unwrap();
    assert_eq!((last.mode, last.faults), (Mode::Armed, 0));
    // To the friction of the joints, which the spring of 400 N/m feels as a millimetre or less.
    let [x, y, z] = last.position_m;
    assert!(
        (x - 0.05).abs() < 1e-3 && y.abs() < 1e-3 && (z - 0.1).abs() < 1e-3,
        "{last:?}"
    );
    // While it is armed it stays what it is, and a new hand takes the grip where it is.
    host.send(0, &Simulate::Device(bench()));
    host.send(0, &Simulate::Hand(script));
    host.ticks(1);
    let (_, after) = host.states.last().unwrap();
    assert_eq!((after.mode, after.faults), (Mode::Armed, 0));
    assert!((after.position_m[0] - x).abs() < 1e-3);
}

/// A host that stays away is forgotten: at rest, no force, nothing sent; and it may come again.
#[test]
fn a_session_in_which_nothing_comes_is_closed_and_the_console_lets_go() {
    let mut host = Host::new();
    host.ticks(2);
    host.send(0, &Command::Arm);
    host.ticks(3);
    assert_eq!(host.states.last().unwrap().1.mode, Mode::Armed);
    // Three ticks of it were just now, and the next is one more.
    host.silence(EXPIRES_AFTER_US / TICK_US - 4);
    let mut up = Vec::new();
    host.console.tick(Pace::default());
    host.console.drain(&mut up);
    assert!(!up.is_empty(), "not a tick too early");
    up.clear();
    host.console.tick(Pace::default());
    host.console.drain(&mut up);
    assert_eq!(up, [], "the session is over");

    host.states.clear();
    host.hello(79);
    host.ticks(1);
    let (_, state) = host.states[0];
    assert_eq!((state.mode, state.heard_sequence), (Mode::Idle, 0));
}

/// Another host asks while the first one sends, and again when that has been quiet for long enough.
#[test]
fn another_host_gets_the_console_only_when_it_is_free() {
    let mut host = Host::new();
    host.ticks(2);
    host.send(0, &Command::Arm);
    host.ticks(1);
    let mut other = HostLink::new(1000);
    let mut frame = [0; MAX_FRAME];
    let len = other.hello(5, &mut frame).unwrap();
    let ask = |host: &mut Host| {
        host.console.feed(&frame[..len]);
        let mut up = Vec::new();
        host.console.tick(Pace::default());
        host.console.drain(&mut up);
        up
    };
    let answer = ask(&mut host);
    let heard: Vec<_> = answer
        .iter()
        .filter_map(|byte| other.receive(*byte))
        .collect();
    assert_eq!(heard, [HostEvent::Owned]);
    // Nothing changed for the first one, which hears an answer that is not for it.
    let heard: Vec<_> = answer
        .iter()
        .filter_map(|byte| host.link.receive(*byte))
        .collect();
    let [HostEvent::State(state), HostEvent::Report(_)] = &heard[..] else {
        panic!("{heard:?}");
    };
    assert_eq!(state.body().mode, Mode::Armed);

    host.silence(OWNED_FOR_US / TICK_US - 3);
    let mut late = HostLink::new(1000);
    let len = late.hello(6, &mut frame).unwrap();
    host.console.feed(&frame[..len]);
    let mut up = Vec::new();
    host.console.drain(&mut up);
    let heard: Vec<_> = up.iter().filter_map(|byte| late.receive(*byte)).collect();
    assert_eq!(heard, [HostEvent::Owned], "a tick too early");
    host.silence(1);
    let len = late.hello(7, &mut frame).unwrap();
    host.console.feed(&frame[..len]);
    up.clear();
    host.console.drain(&mut up);
    let heard = up.iter().find_map(|byte| late.receive(*byte));
    assert!(matches!(heard, Some(HostEvent::Opened(_))), "{heard:?}");
}

/// What a session sends besides pings is in the states, as the tick applied it.
#[test]
fn the_states_say_what_had_been_heard_and_what_was_read() {
    let mut host = Host::new();
    host.ticks(2);
    assert_eq!(host.states.last().unwrap().1.heard_sequence, 0);
    host.send(0, &Command::Arm);
    host.send(0, &Ping { host_us: 7 });
    host.ticks(1);
    assert_eq!(host.states.last().unwrap().1.heard_sequence, 1);
    assert_eq!(host.pongs.last().unwrap().host_us, 7);
    // A contact, and an order after it.
    let (time_us, state) = *host.states.last().unwrap();
    host.send(time_us, &wall(500.0, state.position_m));
    host.send(0, &Simulate::EmergencyStop(true));
    host.ticks(1);
    let (_, state) = *host.states.last().unwrap();
    assert_eq!(state.heard_sequence, 4);
    assert_eq!(state.inputs, inputs::EMERGENCY_STOP);
    host.send(0, &Simulate::EncoderOffset([5, -6, 7]));
    let before = state.encoder_counts;
    host.ticks(1);
    let (_, state) = *host.states.last().unwrap();
    let moved = [0, 1, 2].map(|k| state.encoder_counts[k] - before[k]);
    assert_eq!(moved, [5, -6, 7]);
}

/// Where a clock runs between ticks the stamps are its.
#[test]
fn a_pong_has_the_times_at_which_the_ping_came_and_it_leaves() {
    let mut host = Host::new();
    host.ticks(3);
    host.console.wait(1250);
    host.send(0, &Ping { host_us: 99 });
    host.console.tick(Pace::default());
    host.console.wait(260);
    let mut up = Vec::new();
    host.console.drain(&mut up);
    let pongs = up.iter().filter_map(|byte| match host.link.receive(*byte) {
        Some(HostEvent::Pong(pong)) => Some(*pong.body()),
        _ => None,
    });
    let expected = Pong {
        host_us: 99,
        received_us: 4250,
        sent_us: 4260,
    };
    assert!(pongs.eq([expected]));
}
