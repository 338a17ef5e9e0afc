//! Small round bodies: the force turns with the normal and follows the depth against it, however far a hand goes between two frames.

#![allow(clippy::unwrap_used, reason = "a test")]

use crate::rig::{bench, frame, no_contact};
use nalgebra::{Matrix3, Rotation3, Vector3};
use sutura_shared::control::{Control, TickInput};
use sutura_shared::device::JOINTS;
use sutura_shared::wire::message::{Command, Contact};

type Vec = Vector3<f64>;

const RADIUS_M: f64 = 5e-3;
const STIFFNESS_N_PER_M: f64 = 500.0;
const SPEED_M_PER_S: f64 = 0.08;
/// How deep the grip goes \[m\].
const DEEP_M: f64 = 2e-3;

/// A ball, or a cylinder along y.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Body {
    Ball,
    Cylinder,
}

impl Body {
    /// The part of a place that is seen from the centre.
    fn seen(self, place: &Vec) -> Vec {
        match self {
            Body::Ball => *place,
            Body::Cylinder => Vec::new(place.x, 0.0, place.z),
        }
    }

    fn force(self, place: &Vec) -> Vec {
        let seen = self.seen(place);
        let deep_m = (RADIUS_M - length(&seen)).max(0.0);
        unit(&seen) * (STIFFNESS_N_PER_M * deep_m)
    }

    /// As a host solves it in a scene that is turned.
    fn solved(self, turn: &Rotation3<f64>, place: &Vec) -> Contact {
        let (seen, force) = (self.seen(place), self.force(place));
        let normal = unit(&seen);
        let round = match self {
            Body::Ball => Matrix3::identity() - normal * normal.transpose(),
            Body::Cylinder => {
                let along = normal.cross(&Vec::y());
                along * along.transpose()
            }
        };
        let steep = if force == Vec::zeros() {
            Matrix3::zeros()
        } else {
            round * (length(&force) / length(&seen))
        };
        let tangent = steep - normal * normal.transpose() * STIFFNESS_N_PER_M;
        let tangent = turn.matrix() * tangent * turn.matrix().transpose();
        let (place, force) = (turn * place, turn * force);
        let mut contact = Contact {
            position_m: place.map(|x| x as f32).into(),
            gap_m: (length(&seen) - RADIUS_M).max(0.0) as f32,
            normal: (turn * normal).map(|x| x as f32).into(),
            horizon_us: 150_000,
            ..no_contact()
        };
        let places = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
        for (packed, (i, j)) in [0, 1, 2, 6, 7, 11].into_iter().zip(places) {
            contact.tangent[packed] = tangent[(i, j)] as f32;
        }
        for (wrench, force) in contact.wrench.iter_mut().zip(force.iter()) {
            *wrench = *force as f32;
        }
        contact
    }
}

fn length(v: &Vec) -> f64 {
    v.dot(v).sqrt()
}

fn unit(v: &Vec) -> Vec {
    v / length(v)
}

/// Straight over the body, again and again, and around it.
fn over(time_s: f64) -> Vec {
    let half_m = 1.6 * RADIUS_M;
    let way_m = (SPEED_M_PER_S * time_s).rem_euclid(4.0 * half_m);
    let x = half_m - (way_m - 2.0 * half_m).abs();
    Vec::new(x, 0.3 * x, RADIUS_M - DEEP_M)
}

fn around(time_s: f64) -> Vec {
    let down_m = f64::min(time_s * SPEED_M_PER_S, 2.0 * DEEP_M);
    let away_m = RADIUS_M + DEEP_M - down_m;
    let angle = SPEED_M_PER_S * (time_s - 0.2).max(0.0) / (RADIUS_M - DEEP_M);
    Vec::new(away_m * angle.sin(), 0.0, away_m * angle.cos())
}

/// RMS error and largest error of the command in the next tick but one, in parts of the largest true force.
fn errors(body: Body, path: fn(f64) -> Vec, period_ms: u32, phase_ms: u32) -> (f64, f64) {
    let turn = Rotation3::from_scaled_axis(Vec::new(0.4, -0.7, 0.2));
    let device = bench();
    let mut control = Control::new(device).unwrap();
    control.command(Command::Arm);
    let (mut under_way, mut felt) = (None, std::vec::Vec::new());
    let mut before_m = path(0.0);
    let mut normal = Vec::z();
    for ms in 1..=2000_u32 {
        let place_m = path(f64::from(ms) * 1e-3);
        let (velocity, _) = ((place_m - before_m) * 1e3, before_m = place_m);
        let mut encoder_counts = [0; JOINTS];
        let counted = turn * place_m;
        for (axis, count) in encoder_counts.iter_mut().enumerate() {
            *count = (counted[axis] * f64::from(device.joints[axis].counts_per_unit)) as i32;
        }
        let input = TickInput {
            now_us: u64::from(ms) * 1000,
            encoder_counts,
            ..TickInput::default()
        };
        let mut fresh = None;
        if ms % period_ms == phase_ms {
            let arrived = under_way.take();
            fresh = arrived.map(|(time_us, body)| frame(ms, time_us, body).into());
            // Solved for where the grip will be across the normal.
            let across = velocity - normal * normal.dot(&velocity);
            let ahead_m = place_m + across * (1.5e-3 * f64::from(period_ms));
            normal = unit(&body.seen(&ahead_m));
            under_way = Some((input.now_us, body.solved(&turn, &ahead_m)));
        }
        let output = control.tick(&input, fresh.as_ref());
        assert_eq!(output.state.faults, 0);
        let force = turn.inverse() * Vec::from(output.state.force_n.map(f64::from));
        felt.push((force, body.force(&place_m)));
    }
    let largest = felt
        .iter()
        .map(|(_, truth)| length(truth))
        .fold(0.0, f64::max);
    let settled = felt.len() / 4;
    let off = felt.windows(3).skip(settled).map(|ticks| {
        let truth = (ticks[1].1 + ticks[2].1) * 0.5;
        length(&(ticks[0].0 - truth)) / largest
    });
    let off: std::vec::Vec<f64> = off.collect();
    let squares: f64 = off.iter().map(|off| off * off).sum();
    let peak = off.iter().copied().fold(0.0, f64::max);
    ((squares / off.len() as f64).sqrt(), peak)
}

/// Errors at the worst of five phases of the host.
fn worst(body: Body, path: fn(f64) -> Vec, period_ms: u32) -> (f64, f64) {
    let phases = (0..5).map(|phase| errors(body, path, period_ms, phase * period_ms / 5));
    phases.fold((0.0, 0.0), |worst, found| {
        (f64::max(worst.0, found.0), f64::max(worst.1, found.1))
    })
}

#[test]
fn a_small_body_is_felt_round_at_60_hz() {
    for body in [Body::Cylinder, Body::Ball] {
        for path in [over as fn(f64) -> Vec, around] {
            let (rms, peak) = worst(body, path, 17);
            assert!(rms < 0.025 && peak < 0.06, "{body:?}: {rms} {peak}");
        }
    }
}

#[test]
fn a_small_body_is_felt_round_at_20_hz() {
    for body in [Body::Cylinder, Body::Ball] {
        for path in [over as fn(f64) -> Vec, around] {
            let (rms, peak) = worst(body, path, 50);
            assert!(rms < 0.025 && peak < 0.06, "{body:?}: {rms} {peak}");
        }
    }
}
