//! Host, console and hand in one loop: what the local contact model is for.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{bench, frame, hand, wall};
use sutura_shared::control::{Control, Guards, TickOutput, Tuning};
use sutura_shared::simulated_console::SimulatedBoard;
use sutura_shared::wire::message::{Command, Contact, Mode, Simulate};

/// Stiffer than a console that only holds the last force can be at 100 Hz: with 11 N s/m of damping and
/// 15 ms of delay on average, Gil's bound is b / (T/2 + t_d) = 11 / (0.005 + 0.010) = 730 N/m.
const WALL: f32 = 3000.0;
const HAND: f32 = 1000.0;
/// Where the hand wants to be, behind the wall \[m\].
const TARGET: f32 = -0.012;

/// Console, board, and a host that solves the wall at 100 Hz and delivers one period later.
struct Session {
    control: Control,
    board: SimulatedBoard,
    solved: Option<(u64, Contact)>,
    output: Option<TickOutput>,
    tick: u32,
    render: fn(Contact) -> Contact,
}

impl Session {
    fn new(render: fn(Contact) -> Contact, guards: Guards) -> Self {
        let tuning = Tuning {
            guards,
            ..Tuning::default()
        };
        let mut control = Control::tuned(bench(), tuning).unwrap();
        let mut board = SimulatedBoard::new(&bench());
        let points = [(0.0, [0.0, 0.0, 0.01]), (0.3, [0.0, 0.0, TARGET])];
        let mut script = hand(HAND, 10.0, &points);
        script.start_joint = [0.0, 0.0, 0.01];
        board.simulate(&Simulate::Hand(script), &mut control);
        control.command(Command::Arm);
        Session {
            control,
            board,
            solved: None,
            output: None,
            tick: 0,
            render,
        }
    }

    fn tick(&mut self) -> TickOutput {
        self.tick += 1;
        let mut fresh = None;
        if self.tick.is_multiple_of(10) {
            let delivered = self.solved.take();
            fresh = delivered.map(|(time_us, body)| frame(self.tick, time_us, body));
            self.solved = self.output.map(|output| {
                let body = (self.render)(wall(WALL, output.state.position_m));
                (self.board.now_us(), body)
            });
        }
        let input = self.board.read(false);
        let output = self.control.tick(&input, fresh.map(Into::into).as_ref());
        self.board.write(&output);
        self.output = Some(output);
        output
    }

    /// Lowest and highest grip \[m\] while the hand rests, from 1 s to 2 s.
    fn swing(&mut self) -> (f32, f32) {
        let (mut low, mut high) = (f32::MAX, f32::MIN);
        for tick in 0..2000 {
            let z = self.tick().state.position_m[2];
            if tick >= 1000 {
                low = if z < low { z } else { low };
                high = if z > high { z } else { high };
            }
        }
        (low, high)
    }
}

const WITHOUT_TANK: Guards = Guards {
    tank: false,
    damping: false,
    ..Guards::ALL
};

/// A frame without its tangent: the console holds the force.
fn hold(contact: Contact) -> Contact {
    Contact {
        tangent: [0.0; 21],
        ..contact
    }
}

#[test]
fn with_the_tangent_the_grip_rests_where_springs_and_hand_balance() {
    let mut session = Session::new(|contact| contact, Guards::ALL);
    let (low, high) = session.swing();
    // Two encoder counts.
    assert!(high - low < 25e-6, "{low} {high}");
    // HAND (TARGET - z) = WALL z, to friction of 0.15 N and an encoder count of 12 um.
    let balance = HAND * TARGET / (HAND + WALL);
    let slack = 0.15 / (HAND + WALL) + 13e-6;
    assert!((low - balance).abs() <= slack, "{low} {balance}");
    let output = session.tick();
    assert_eq!(output.state.mode, Mode::Armed);
    assert!((output.state.force_n[2] + WALL * low).abs() < WALL * 13e-6);
    assert!(output.state.applied_age_us >= 10_000);
}

#[test]
fn without_the_tangent_the_same_loop_shakes() {
    let (low, high) = Session::new(hold, WITHOUT_TANK).swing();
    assert!(high - low > 1e-3, "{low} {high}");
}
