//! Hosts that send nonsense, as valid frames: what guards are for that no honest scene needs.

use super::{Sample, Scene, Solution, Truth};
use crate::fidelity::random::Random;
use sutura_host::step::ToolRows;

/// What it sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Rogue {
    /// A push of 40 N from nowhere, for ever.
    Push,
    /// 40 N this way and that, in every frame.
    Shaker,
    /// Random forces and tangents of any sign.
    Noise,
    /// A push of 40 N by what says that it is stiff: whoever has pressed it has paid for such a force.
    Stiff,
    /// A slope without friction, 20 kN/m hard: an honest scene, but harder than motors follow.
    Slope,
    /// A spring of 500 N/m, with contact rows beside it that the wire lets through and nobody can solve: each two of three
    /// rows go together, all three do not.
    Rows,
}

impl Rogue {
    /// Those that nothing is known of.
    pub const WILD: [Rogue; 3] = [Rogue::Push, Rogue::Shaker, Rogue::Noise];

    /// As tables print it.
    pub fn scene_name(self) -> &'static str {
        match self {
            Rogue::Push => "rogue-push",
            Rogue::Shaker => "rogue-shaker",
            Rogue::Noise => "rogue-noise",
            Rogue::Stiff => "rogue-stiff",
            Rogue::Slope => "rogue-slope",
            Rogue::Rows => "rogue-rows",
        }
    }
}

impl Scene for Rogue {
    fn name(&self) -> &'static str {
        self.scene_name()
    }

    fn origin_m(&self) -> [f64; 3] {
        [0.0; 3]
    }

    fn start(&self, _most_rows: usize, _ahead_s: f64, _period_s: f64) -> Box<dyn Truth> {
        Box::new(Sender {
            what: *self,
            count: 0,
            random: Random::new(5),
        })
    }
}

/// Frames that say that nothing is near, before a wild host begins: what a console is armed inside of comes slowly, whatever it
/// is.
const HONEST: u32 = 1;

struct Sender {
    what: Rogue,
    count: u32,
    random: Random,
}

/// A plane spring \[N/m\] through the origin.
fn spring(k: f64, normal: [f64; 3], sample: &Sample) -> Solution {
    let height: f64 = (0..3)
        .map(|i: usize| normal[i] * sample.position_m[i])
        .sum();
    let mut solution = Solution::nothing(height);
    solution.normal = normal;
    let push_n = k * (-height).max(0.0);
    for (entry, along) in solution.wrench.iter_mut().zip(normal) {
        *entry = push_n * along;
    }
    for (row, along) in solution.tangent.iter_mut().zip(normal) {
        for (entry, other) in row.iter_mut().zip(normal) {
            *entry = -k * along * other;
        }
    }
    solution
}

/// Three rows in balance, each pair of which has a compliance, and all of which have less than none.
fn unsolvable(solution: &Solution) -> ToolRows {
    let mut rows = ToolRows::NONE;
    rows.count = 3;
    rows.id[..3].copy_from_slice(&[1, 2, 3]);
    rows.compliance[..6].copy_from_slice(&[2e-3, -1.8e-3, -1.8e-3, 2e-3, -1.8e-3, 2e-3]);
    for row in 0..3 {
        rows.jacobian[row][2] = 1.0;
        rows.delta_m[row] = solution.gap_m;
        rows.lambda_n[row] = solution.wrench[2] / 3.0;
    }
    rows
}

impl Truth for Sender {
    fn solve(&mut self, sample: &Sample) -> Option<Solution> {
        self.count += 1;
        let is_wild = !matches!(self.what, Rogue::Slope | Rogue::Rows);
        if is_wild && self.count <= HONEST {
            return Some(Solution::nothing(1.0));
        }
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
            Rogue::Stiff => {
                solution.wrench[2] = 40.0;
                solution.tangent[1][1] = -2000.0;
            }
            Rogue::Slope => solution = spring(20e3, [0.8, 0.0, 0.6], sample),
            Rogue::Rows => {
                solution = spring(500.0, [0.0, 0.0, 1.0], sample);
                solution.rows = Some(Box::new(unsolvable(&solution)));
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
