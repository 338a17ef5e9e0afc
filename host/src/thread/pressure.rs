//! What a thread presses on tissue where it turns.
//!
//! Entry point: [`ThreadState::pressures_pa`]. A thread that turns by theta over a length s bears on tissue with T theta / s per
//! length, as far as it turns alike everywhere, which friction takes for granted, too; over its thickness that is a pressure.

use super::model::ThreadPart;
use super::state::ThreadState;

impl ThreadState {
    /// Of each passage through tissue, from the tail on, with the larger of the tensions at its ends \[Pa\].
    pub fn pressures_pa<'a>(&'a self, part: &'a ThreadPart) -> impl Iterator<Item = f64> + 'a {
        let thickness_m = part.through.thickness_m;
        let mut before_n = 0.0;
        self.spans
            .iter()
            .enumerate()
            .filter_map(move |(place, span)| {
                before_n = self.tension_before(place, before_n);
                span.passage?;
                let after_n = before_n + span.friction_n;
                let tension_n = before_n.max(after_n).max(0.0);
                let length_m = self.lengths_of(place).max(thickness_m);
                Some(tension_n * span.turn / (length_m * thickness_m))
            })
    }
}
