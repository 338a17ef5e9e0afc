//! A tool that rubs on a plane: friction is felt within Coulomb's cone at the normal force that is felt.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::common::rows::{Contact3, cone, frame as rows_frame};
use crate::rig::{bench, frame, no_contact};
use nalgebra::{Matrix3, Rotation3, Vector3};
use sutura_shared::control::{ContactRows, Control, Fresh, TickInput};
use sutura_shared::device::JOINTS;
use sutura_shared::wire::List;
use sutura_shared::wire::message::{Command, Contact, Rows};

type Vec = Vector3<f64>;

/// Stiffness of a plane along its normal z and across it \[N/m\].
const STIFFNESS_N_PER_M: [f64; 2] = [500.0, 300.0];
/// Force beyond the cone that nobody notices \[N\].
const NOTICED_N: f64 = 0.03;

/// A point on springs that slips.
#[derive(Clone, Copy)]
struct Plane {
    friction: f64,
    anchor_m: Option<[f64; 2]>,
}

/// Force \[N\], and the way along which it slips, if it does.
struct Solved {
    force: Vec,
    slips: Option<Vec>,
}

impl Plane {
    fn go(&mut self, place: &Vec) -> Solved {
        let [normal, along] = STIFFNESS_N_PER_M;
        let push_n = normal * (-place.z).max(0.0);
        if push_n == 0.0 {
            self.anchor_m = None;
            return Solved {
                force: Vec::zeros(),
                slips: None,
            };
        }
        let [x, y] = self.anchor_m.unwrap_or([place.x, place.y]);
        let moved = Vec::new(place.x - x, place.y - y, 0.0);
        let most_m = self.friction * push_n / along;
        let length_m = moved.dot(&moved).sqrt();
        let slips = (length_m > most_m).then(|| moved / length_m);
        let held = slips.map_or(moved, |way| way * most_m);
        self.anchor_m = Some([place.x - held.x, place.y - held.y]);
        Solved {
            force: Vec::new(0.0, 0.0, push_n) - held * along,
            slips,
        }
    }

    /// As a host solves it in a scene that is turned.
    fn frames(&mut self, turn: &Rotation3<f64>, place: &Vec) -> (Contact, Rows) {
        let [normal, along] = STIFFNESS_N_PER_M;
        let Solved { force, slips } = self.go(place);
        let mut tangent = Matrix3::from_diagonal(&Vec::new(-along, -along, -normal));
        if let Some(way) = slips {
            tangent += way * way.transpose() * along;
        }
        let tangent = turn.matrix() * tangent * turn.matrix().transpose();
        let (at, wrench) = (turn * place, turn * force);
        let mut contact = Contact {
            position_m: at.map(|x| x as f32).into(),
            gap_m: place.z.max(0.0) as f32,
            normal: (turn * Vec::z()).map(|x| x as f32).into(),
            horizon_us: 150_000,
            ..no_contact()
        };
        let places = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        for (packed, (i, j)) in [0, 1, 2, 6, 7, 11].into_iter().zip(places) {
            contact.tangent[packed] = tangent[(i, j)] as f32;
        }
        for (to, from) in contact.wrench.iter_mut().zip(wrench.iter()) {
            *to = *from as f32;
        }
        let point = Contact3 {
            normal: normal as f32,
            along: along as f32,
            friction: self.friction as f32,
        };
        let mut rows = cone(1, &point, place.z as f32);
        let mut turned = List::new();
        for (row, axis) in rows.rows.items().iter().zip([2, 0, 1]) {
            let mut row = *row;
            let towards = turn * Vec::ith(axis, 1.0);
            row.jacobian[..3].copy_from_slice(&<[f32; 3]>::from(towards.map(|x| x as f32)));
            if axis != 2 {
                row.lambda_n = force[axis] as f32;
                row.delta_free_m = -(force[axis] / along) as f32;
            }
            turned.push(row);
        }
        rows.rows = turned;
        (contact, rows)
    }
}

/// Presses that come and go, and strokes to and fro aside, of other times.
fn path(time_s: f64) -> Vec {
    let wave = |hz: f64| (hz * time_s * core::f64::consts::TAU).sin();
    let deep_m = 3e-3 + 2.5e-3 * wave(1.7) + 1.5e-3 * wave(4.3);
    Vec::new(
        8e-3 * wave(2.3),
        5e-3 * wave(3.1) * wave(0.9),
        1e-3 - deep_m * (time_s / 0.3).min(1.0),
    )
}

/// Most that is felt across the normal beyond the cone \[N\].
fn beyond(friction: f64, period_ms: u32, phase_ms: u32) -> f64 {
    let turn = Rotation3::from_scaled_axis(Vec::new(0.4, -0.7, 0.2));
    let device = bench();
    let mut control = Control::new(device).unwrap();
    control.command(Command::Arm);
    let mut host = Plane {
        friction,
        anchor_m: None,
    };
    let mut under_way = None;
    let mut most_n = f64::MIN;
    for ms in 1..=3000_u32 {
        let place = path(f64::from(ms) * 1e-3);
        let counted = turn * place;
        let mut encoder_counts = [0; JOINTS];
        for (axis, count) in encoder_counts.iter_mut().enumerate() {
            let counts_per_m = f64::from(device.joints[axis].counts_per_unit);
            *count = (counted[axis] * counts_per_m).floor() as i32;
        }
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts,
            ..TickInput::default()
        };
        let mut fresh = None;
        if ms % period_ms == phase_ms {
            let arrived = under_way.replace((input.now_us, host.frames(&turn, &place)));
            if let Some((time_us, (contact, rows))) = arrived {
                let contact = frame(ms, time_us, contact);
                let rows = ContactRows::unpack(&rows_frame(time_us, rows));
                fresh = Some(Fresh::of(contact, &rows));
            }
        }
        let output = control.tick(&input, fresh.as_ref());
        assert_eq!(output.state.faults, 0);
        let felt = turn.inverse() * Vec::from(output.state.force_n.map(f64::from));
        let across_n = felt.x.hypot(felt.y);
        most_n = most_n.max(across_n - friction * felt.z.max(0.0));
    }
    most_n
}

#[test]
fn friction_on_a_plane_is_felt_within_its_cone() {
    for friction in [0.05, 0.1, 0.5] {
        for period_ms in [1, 5, 17, 50] {
            for phase in 0..3 {
                let most_n = beyond(friction, period_ms, phase * period_ms / 3);
                let what = format!("{friction}, {period_ms} ms, phase {phase}");
                assert!(most_n <= NOTICED_N, "{what}: {most_n} N beyond the cone");
            }
        }
    }
}
