//! Threads that hang, in the course of a session: moved on at fixed beats of the console's time, whoever looks and how often.
//!
//! Entry points: [`Beats`], [`Hanging::beat`], [`Hanging::seen`]. A beat is the first state of each tenth of a second. What is seen between
//! two is that of the last beat moved on by what has passed since, and forgotten: the shape at an instant follows from the states of
//! the beats and from the state of that instant alone.

use super::free::FreeThreads;
use crate::model::Model;
use crate::step::State;

/// Console time between two beats \[us\].
const BEAT_US: u64 = 100_000;
/// After more than this without a beat they begin anew \[us\].
const LOST_US: u64 = 1_000_000;
/// Steps of one beat in which threads that begin come to rest.
const SETTLING: u32 = 20;
/// Of what hangs in a scene that names none \[m/s^2\], (3): z is up, as at the console.
const GRAVITY_M_PER_S2: [f64; 3] = [0.0, 0.0, -9.81];

/// Tells which of a session's states are beats.
#[derive(Clone, Copy, Debug, Default)]
pub struct Beats {
    beat: Option<u64>,
}

impl Beats {
    /// Of the next state, at this console time \[us\].
    pub fn is_due(&mut self, now_us: u64) -> bool {
        let now = Some(now_us / BEAT_US);
        let before = std::mem::replace(&mut self.beat, now);
        before != now
    }
}

/// A model's threads in the course of a session.
#[derive(Clone, Debug)]
pub struct Hanging {
    threads: FreeThreads,
    /// Of an instant after the last beat.
    shown: FreeThreads,
    /// When the last beat was, if there was one \[us\].
    at_us: Option<u64>,
}

impl Hanging {
    /// Before the first beat; `None` of a model without a thread.
    pub fn new(model: &Model) -> Option<Self> {
        let gravity_m_per_s2 = model.gravity_m_per_s2.unwrap_or(GRAVITY_M_PER_S2);
        let threads = FreeThreads::new(model, gravity_m_per_s2)?;
        Some(Self {
            shown: threads.clone(),
            threads,
            at_us: None,
        })
    }

    /// The next beat begins anew: beats before it are missing.
    pub fn begin(&mut self) {
        self.at_us = None;
    }

    /// Moves on to a beat at this console time \[us\], with nodes at `nodes_m` (n x 3). Threads that begin, and all of them where time
    /// has gone back or leapt, begin straight and come to rest at once. Allocates.
    pub fn beat(&mut self, now_us: u64, model: &Model, state: &State, nodes_m: &[[f64; 3]]) {
        let passed_us = self.at_us.and_then(|at_us| now_us.checked_sub(at_us));
        self.at_us = Some(now_us);
        match passed_us.filter(|passed_us| *passed_us <= LOST_US) {
            Some(0) => {}
            Some(passed_us) => {
                self.threads
                    .step(1e-6 * passed_us as f64, model, state, nodes_m);
            }
            None => {
                self.threads.forget();
                for _ in 0..SETTLING {
                    self.threads
                        .step(1e-6 * BEAT_US as f64, model, state, nodes_m);
                }
            }
        }
    }

    /// The threads at an instant after the last beat and before the next one, at this console time \[us\]; `None` before the first beat. Allocates.
    pub fn seen(
        &mut self,
        now_us: u64,
        model: &Model,
        state: &State,
        nodes_m: &[[f64; 3]],
    ) -> Option<&FreeThreads> {
        let passed_us = now_us.checked_sub(self.at_us?)?;
        if passed_us == 0 {
            return Some(&self.threads);
        }
        self.shown.lie_as(&self.threads);
        self.shown
            .step(1e-6 * passed_us as f64, model, state, nodes_m);
        Some(&self.shown)
    }
}
