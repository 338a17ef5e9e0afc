//! The assembled console over its bytes: what comes when, and what counts as replaced.

#![allow(clippy::unwrap_used, reason = "a test")]

mod rig;

use rig::{arm, bench, hand, wall};
use sutura_shared::link::{HostEvent, HostLink};
use sutura_shared::simulated_console::{Pace, SimulatedConsole};
use sutura_shared::wire::message::{Command, Mode, Report, Simulate, State};
use sutura_shared::wire::{MAX_FRAME, Message};

struct Host {
    console: SimulatedConsole,
    link: HostLink,
    states: Vec<(u64, State)>,
    reports: Vec<Report>,
}

impl Host {
    fn new() -> Self {
        let mut host = Host {
            console: SimulatedConsole::new(&bench(), 0).unwrap(),
            link: HostLink::new(1000),
            states: Vec::new(),
            reports: Vec::new(),
        };
        let mut frame = [0; MAX_FRAME];
        let len = host.link.hello(1, &mut frame).unwrap();
        host.console.feed(&frame[..len]);
        host
    }

    fn send<M: Message>(&mut self, time_us: u64, body: &M) {
        let mut frame = [0; MAX_FRAME];
        let len = self.link.send(time_us, body, &mut frame).unwrap();
        self.console.feed(&frame[..len]);
    }

    fn tick(&mut self, pace: Pace) {
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
                None => {}
            }
        }
        assert_eq!(self.link.counters().frames_rejected, 0);
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
    let mut frame = [0; MAX_FRAME];
    let len = host.link.hello(78, &mut frame).unwrap();
    host.console.feed(&frame[..len]);
    host.ticks(3);
    let counts: Vec<_> = host
        .reports
        .iter()
        .map(|r| (r.ticks, r.frames_received))
        .collect();
    assert_eq!(counts, [(1, 1), (6, 3)]);
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
