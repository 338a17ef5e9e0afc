//! A strand between two hands with no tissue between them: a straight spring.
//!
//! Entry points: [`ThreadState::stretch_in_air`] before a balance, [`ThreadState::give_in_air`] at its end. Hands have both ends where
//! they are, so that the tension follows without a solve: EA times the strain, up to what the grips hold and the thread bears. What does
//! not stretch has none: hands that are where they are would have to tear it.

use super::model::{ThreadPart, ThreadTension};
use super::segments::NO_TENSION_N;
use super::state::{ThreadState, Weakest};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// A strand in the air.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Air {
    /// From its tail to its head \[m\].
    pub way: Vector3<f64>,
    /// Tension \[N\], and how it grows with the length \[N/m\]: not at all where it is slack or slips.
    pub tension_n: f64,
    stiffness_n_per_m: f64,
}

impl Air {
    /// Unit vector from its tail to its head; zero if it has no length.
    pub fn along(&self) -> Vector3<f64> {
        self.way.try_normalize(0.0).unwrap_or_else(Vector3::zeros)
    }

    /// d pull on its head / d way, (3 x 3) \[N/m\]: along it as it stretches, across it as a taut string turns.
    pub fn tangent(&self) -> Matrix3<f64> {
        let along = self.along();
        let project = along * along.transpose();
        let taut = self.tension_n / self.way.norm().max(f64::MIN_POSITIVE);
        -(project * self.stiffness_n_per_m + (Matrix3::identity() - project) * taut)
    }
}

impl ThreadState {
    /// Finds the tension of a strand whose ends hands hold, the head's at `head`, if no tissue is between.
    pub fn stretch_in_air(&mut self, part: &ThreadPart, head: Option<Vector3<f64>>) {
        let is_in_air = self.is_used && self.passed.is_empty() && self.is_tail_in_hand();
        let stretches = part.through.axial_stiffness_n.is_finite();
        self.air = head.filter(|_| is_in_air && stretches).map(|head| Air {
            way: head - self.tail.at,
            ..Air::default()
        });
        self.pull_in_air(part);
    }

    /// Its tension, as far as what holds it bears that.
    fn pull_in_air(&mut self, part: &ThreadPart) {
        let material_m = self.head.alpha - self.tail.alpha;
        let (bound_n, _) = self.bears_in_air(part);
        let Some(air) = &mut self.air else {
            return;
        };
        let stiffness = part.through.axial_stiffness_n / material_m.max(f64::MIN_POSITIVE);
        let pull_n = stiffness * (air.way.norm() - material_m).max(0.0);
        let grows = pull_n > 0.0 && pull_n <= bound_n;
        air.tension_n = pull_n.min(bound_n);
        air.stiffness_n_per_m = if grows { stiffness } else { 0.0 };
    }

    /// Most tension with which its grips hold and it does not break \[N\], and what gives way then.
    fn bears_in_air(&self, part: &ThreadPart) -> (f64, Weakest) {
        let tail = (self.holds_n(part, 0), Weakest::Tail);
        let head = (self.holds_n(part, 1), Weakest::Head);
        let thread = (part.strength_n, Weakest::Thread);
        [head, tail].into_iter().fold(
            thread,
            |least, next| if next.0 < least.0 { next } else { least },
        )
    }

    /// A balance is found: what is pulled harder than its grips hold slips through them, of which there is as much as up to the places
    /// `ends` on the thread \[m\], or breaks.
    pub fn give_in_air(&mut self, part: &ThreadPart, ends: [f64; 2]) {
        self.pull_in_air(part);
        let Some(air) = self.air else {
            return;
        };
        let material_m = self.head.alpha - self.tail.alpha;
        let (bound_n, weakest) = self.bears_in_air(part);
        // As much as is stretched to that by its bound.
        let needed_m = air.way.norm() / (1.0 + bound_n / part.through.axial_stiffness_n);
        let pulls = air.tension_n > NO_TENSION_N;
        self.state = match pulls {
            true => ThreadTension::Taut,
            false => ThreadTension::Slack,
        };
        if air.tension_n < bound_n || needed_m <= material_m {
            return;
        }
        if weakest == Weakest::Thread {
            self.tear(self.tail.alpha, air.tension_n);
            self.air = None;
            self.state = ThreadTension::Slack;
        } else {
            self.let_through(weakest, needed_m - material_m, ends);
        }
    }
}
