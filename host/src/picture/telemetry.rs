//! Ticks and solves in columns, as plots take them.
//!
//! Entry points: [`encode_ticks`], [`encode_solves`].

use super::bytes::Message;
use super::describe::statuses;
use super::message::as_gap;
use crate::recording::SolveSample;
use crate::step::Stages;
use sutura_shared::wire::message::State;

/// A control tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickRow {
    /// Session time \[s\].
    pub time_s: f64,
    /// What the console said.
    pub state: State,
}

/// A solve.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveRow {
    /// Session time of the state that was solved for \[s\].
    pub time_s: f64,
    /// What is recorded of it.
    pub sample: SolveSample,
}

/// What all solves of a session have in common.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SolvesOf {
    /// Number of the session.
    pub session: u32,
    /// Needles of the scene.
    pub needles: usize,
    /// Threads of the scene.
    pub threads: usize,
}

/// Writes a block of ticks.
pub fn encode_ticks(session: u32, rows: &[TickRow], out: &mut Vec<u8>) {
    let mut message = Message::begin(out, 3, 0, |header| {
        header.u32(session);
        header.u32(rows.len() as u32);
        header.u32(0);
    });
    let each = || rows.iter().map(|row| &row.state);
    message.section(1, |to| rows.iter().for_each(|row| to.f64(row.time_s)));
    message.section(2, |to| each().for_each(|state| to.u32(state.tick)));
    let vectors: [fn(&State) -> [f32; 3]; 3] = [
        |state| state.position_m,
        |state| state.velocity_m_per_s,
        |state| state.force_n,
    ];
    for (tag, vector) in (3..).zip(vectors) {
        message.section(tag, |to| {
            each().flat_map(vector).for_each(|value| to.f32(value));
        });
    }
    message.section(6, |to| {
        each().for_each(|state| to.u32(state.contact_age_us))
    });
    message.section(7, |to| {
        each().for_each(|state| to.u32(state.applied_age_us))
    });
    message.section(8, |to| each().for_each(|state| to.u8(state.mode as u8)));
    message.section(9, |to| each().for_each(|state| to.u8(state.inputs)));
    message.section(10, |to| each().for_each(|state| to.u16(state.faults)));
}

/// Writes a block of solves. Stages are left out where none of them says any.
pub fn encode_solves(of: SolvesOf, rows: &[SolveRow], out: &mut Vec<u8>) {
    let stages = Stages::default().named().len();
    let mut message = Message::begin(out, 4, 0, |header| {
        header.u32(of.session);
        header.u32(rows.len() as u32);
        header.u32(stages as u32);
    });
    let each = || rows.iter().map(|row| &row.sample);
    message.section(1, |to| rows.iter().for_each(|row| to.f64(row.time_s)));
    message.section(2, |to| {
        for sample in each() {
            let place = statuses().iter().position(|word| *word == sample.status);
            to.u8(place.map_or(u8::MAX, |place| place as u8));
        }
    });
    message.section(3, |to| to.f32s(each().map(|sample| sample.step_us)));
    if each().any(|sample| !sample.stages_us.is_empty()) {
        message.section(4, |to| {
            for stage in 0..stages {
                to.f32s(
                    each().map(|sample| sample.stages_us.get(stage).copied().unwrap_or(f64::NAN)),
                );
            }
        });
    }
    message.section(5, |to| each().for_each(|sample| to.u32(sample.rows)));
    message.section(6, |to| {
        each().for_each(|sample| to.f32(as_gap(sample.gap_m.unwrap_or(f64::INFINITY))));
    });
    message.section(7, |to| {
        each().for_each(|sample| to.f32s(sample.wrench.unwrap_or([f64::NAN; 6])));
    });
    message.section(8, |to| each().for_each(|sample| to.u32(sample.iterations)));
    message.section(9, |to| to.f32s(each().map(|sample| sample.energy_j)));
    let at = |values: &[f64], place: usize| values.get(place).copied().unwrap_or(f64::NAN);
    if of.needles > 0 {
        message.section(10, |to| {
            for needle in 0..of.needles {
                to.f32s(each().map(|sample| at(&sample.axial_n, needle)));
            }
        });
    }
    if of.threads > 0 {
        message.section(11, |to| {
            for thread in 0..of.threads {
                for end in 0..2 {
                    to.f32s(each().map(|sample| at(&sample.tension_n, 2 * thread + end)));
                }
            }
        });
    }
}
