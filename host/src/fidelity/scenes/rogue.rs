//! Hosts that send nonsense, as valid frames: what guards are for that no honest scene needs.

use super::{Sample, Scene, Solution, Truth};
use crate::fidelity::random::Random;

/// What it sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Rogue {
    /// A push of 40 N from nowhere, for ever.
    Push,
    /// 40 N this way and that, in every frame.
    Shaker,
    /// Random forces and tangents of any sign.
    Noise,
}

impl Rogue {
    /// All of them.
    pub const ALL: [Rogue; 3] = [Rogue::Push, Rogue::Shaker, Rogue::Noise];
}

impl Scene for Rogue {
    fn name(&self) -> &'static str {
        match self {
            Rogue::Push => "rogue-push",
            Rogue::Shaker => "rogue-shaker",
            Rogue::Noise => "rogue-noise",
        }
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0; 3]
    }

    fn start(&self, _most_rows: usize, _ahead_s: f64) -> Box<dyn Truth> {
        Box::new(Sender {
            what: *self,
            count: 0,
            random: Random::new(5),
        })
    }
}

struct Sender {
    what: Rogue,
    count: u32,
    random: Random,
}

impl Truth for Sender {
    fn solve(&mut self, _sample: &Sample) -> Option<Solution> {
        self.count += 1;
        let mut solution = Solution::nothing(0.0);
        match self.what {
            Rogue::Push => solution.wrench[2] = 40.0,
            Rogue::Shaker => {
                let sign = if self.count.is_multiple_of(2) {
                    1.0
                } else {
                    -1.0
                };
                solution.wrench[2] = 40.0 * sign;
                solution.normal[2] = sign;
            }
            Rogue::Noise => {
                let mut draw = |size: f64| size * (2.0 * self.random.unit() - 1.0);
                solution.wrench = [draw(40.0), draw(40.0), draw(40.0), 0.0, 0.0, 0.0];
                for entry in solution.tangent.iter_mut().flatten() {
                    *entry = draw(2e4);
                }
            }
        }
        Some(solution)
    }
}
