//! What is drawn away after each bite: by a hand of the scene first, then by the console.
//!
//! Entry point: [`Drawn::new`].

use super::stitch::{REST_S, Sewing, Stop};
use super::turn::{Vec3, along};
use std::ops::Range;

/// How long the needle is drawn away after a bite, and held there \[s\].
pub const AWAY_S: f64 = 1.2;
pub const STAY_S: f64 = 0.9;
/// Of the hand that draws first.
pub const DRAWS: u8 = 4;

/// Where a hand is that does not turn.
pub fn stop(time_s: f64, position_m: Vec3) -> Stop {
    Stop {
        time_s,
        position_m,
        rotation_deg: [0.0; 3],
    }
}

/// Hands that draw the needle away between bites.
#[derive(Default)]
pub struct Drawn {
    /// Of the hand that draws first, and of the console.
    pub hand: Vec<Stop>,
    pub console: Vec<(f64, Vec3)>,
    /// Who holds the needle from when on \[s\]: tool 1 goes round with it, 2 carries it.
    pub holds: Vec<(f64, u8)>,
    /// When each bite's needle is drawn away \[s\], before it stays there.
    pub there_s: Vec<f64>,
    pub ends_s: f64,
}

impl Drawn {
    /// Of a needle that is drawn by [`Sewing::pulls`]; the console draws after some bites, and goes by 12 points at most.
    pub fn new(sewing: &Sewing, console: Range<usize>) -> Self {
        let script = sewing.script();
        let mut all = Self::default();
        let puller = |index: usize| if console.contains(&index) { 0 } else { DRAWS };
        let mut drawn = 0;
        for (time_s, hand) in script.holds {
            let tool = [1, 2, puller(drawn)][hand];
            drawn += usize::from(hand == 2);
            all.holds.push((time_s, tool));
        }
        for (index, (bite, sewn_s)) in sewing.bites.iter().zip(script.ends_s).enumerate() {
            let (from_s, at) = (sewn_s + 2.0 * REST_S, sewing.end_after(bite));
            let there_s = from_s + AWAY_S;
            let far = along(at, 1.0, sewing.pulls[index]);
            all.ends_s = there_s + STAY_S;
            all.there_s.push(there_s);
            let given_s = all.ends_s + 2.0 * REST_S;
            for (time_s, at) in [(sewn_s, at), (from_s, at), (there_s, far), (given_s, far)] {
                if console.contains(&index) {
                    all.console.push((time_s, at));
                } else {
                    all.hand.push(stop(time_s, at));
                }
            }
        }
        all
    }
}
