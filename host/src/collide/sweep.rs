//! The first time at which a moving patch passes the origin: conservative advancement on halves of halves.
//!
//! Entry point: [`first_pass`]. A direction along which every corner stays on one side of the origin
//! separates the whole patch from it, for a patch is the hull of its corners and they move on straight
//! lines: so far in time the patch is clear, exactly. The direction tried is that of the patch's closest point,
//! as Mirtich (1996) does for bodies; where it stalls the patch is halved, as Wang et al. (2021) halve
//! boxes. What can be wrong by rounding is bounded from the corners' magnitude and counts as touching.

use super::patch::{Patch, closest};
use nalgebra::Vector3;

/// How near is as good as touching.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margin {
    /// Distance that must not be fallen below \[m\], at least 0. At 0: what touches meets.
    pub separation_m: f64,
    /// What passes by farther than the separation by no more than this may be said to meet, too \[m\], at
    /// least 0. Smaller costs more where things pass close by. Round-off comes on top: some 1e-14 of the size.
    pub tolerance_m: f64,
}

/// What comes of two things that move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// They do not come as near as the separation, for certain.
    Apart,
    /// They meet, or nearly so.
    Meet(Impact),
    /// A coordinate that is not finite or beyond 1e60 m: nothing is known.
    NotFinite,
}

/// Where and when two things meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// Part of the step, 0 to 1. Before it they do not meet, for certain; then they are as near as the
    /// margin says, unless the search was given up.
    pub time: f64,
    /// With these the four nodes' positions add up to the difference between the two points that meet, (4).
    /// A vertex and a face: 1, then minus the weights of its corners. Two edges: weights of the ends of the
    /// first, then minus those of the second.
    pub weights: [f64; 4],
    /// The search was given up for its length: they may be farther apart than the margin.
    pub given_up: bool,
}

/// An answer and what it cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    /// The answer.
    pub verdict: Verdict,
    /// Parts of the patch that were looked at: 1 if the whole was enough.
    pub parts: u32,
}

/// Halvings on top of each other: then a part is as small as round-off, and the search is given up there.
const DEEPEST: usize = 64;
/// Advances of a part before it is halved.
const ADVANCES: u32 = 6;
/// Parts that are looked at before the search is given up: five times what the worst of a million tests took.
const MOST_PARTS: u32 = 4096;
/// Round-off of all that is done with a corner, in units of half a unit in the last place of the largest:
/// one for each halving; a difference, a product with a direction and its sum, a mixture in time, a
/// quotient: below 30.
const ROUND_OFF: f64 = 128.0;
/// Largest coordinate \[m\]: squares of squares stay finite.
const LARGEST_M: f64 = 1e60;

/// When, and where on the patch.
pub(super) struct Pass {
    pub time: f64,
    pub place: [f64; 2],
    pub given_up: bool,
}

pub(super) enum Found {
    Nothing,
    Pass(Pass),
    NotFinite,
}

/// A part of the patch that is clear until `time`.
#[derive(Clone, Copy)]
struct Part<const N: usize> {
    patch: Patch<N>,
    time: f64,
    depth: usize,
}

/// What becomes of a part.
enum Fate<const N: usize> {
    /// It does not pass, or not before what is known already.
    Clear,
    /// It is near at that time.
    Near(f64, [f64; 2]),
    /// Halve it.
    Open(f64, [f64; N]),
}

/// Parts yet to be looked at: of each depth one, of the deepest two.
struct Waiting<const N: usize> {
    parts: [Part<N>; DEEPEST + 2],
    count: usize,
}

impl<const N: usize> Waiting<N> {
    /// Adds a part's halves, the more likely one to be next.
    fn halve(&mut self, part: &Part<N>, time: f64, weights: &[f64; N]) {
        let [likely, other] = part.patch.halves(weights);
        for patch in [other, likely] {
            self.parts[self.count] = Part {
                patch,
                time,
                depth: part.depth + 1,
            };
            self.count += 1;
        }
    }

    fn next(&mut self) -> Option<Part<N>> {
        self.count = self.count.checked_sub(1)?;
        Some(self.parts[self.count])
    }
}

struct Search {
    separation_m: f64,
    near_m: f64,
    /// Round-off of a corner by axis \[m\], (3).
    round_off_m: Vector3<f64>,
    /// Time until which passes matter.
    until: f64,
}

/// The first pass within the step, and how many parts were looked at.
pub(super) fn first_pass<const N: usize>(whole: Patch<N>, margin: &Margin) -> (Found, u32) {
    let corners = || whole.start.iter().chain(&whole.end);
    let margins = [margin.separation_m, margin.tolerance_m];
    // No comparison holds for what is not a number.
    let known = corners().flatten().all(|x| x.abs() <= LARGEST_M)
        && margins.iter().all(|x| (0.0..=LARGEST_M).contains(x));
    if !known {
        return (Found::NotFinite, 0);
    }
    let largest = corners().fold(Vector3::zeros(), |most: Vector3<f64>, corner| {
        most.sup(&corner.abs())
    });
    let round_off_m = largest * (ROUND_OFF * 0.5 * f64::EPSILON);
    let mut search = Search {
        separation_m: margin.separation_m,
        near_m: margin.separation_m + margin.tolerance_m + 2.0 * round_off_m.norm(),
        round_off_m,
        until: 1.0,
    };
    let whole = Part {
        patch: whole,
        time: 0.0,
        depth: 0,
    };
    match search.follow(&whole) {
        Fate::Clear => (Found::Nothing, 1),
        Fate::Near(time, place) => (
            Found::Pass(Pass {
                time,
                place,
                given_up: false,
            }),
            1,
        ),
        Fate::Open(time, weights) => search.halve(whole, time, &weights),
    }
}

impl Search {
    /// Follows halves of halves, the more likely one first, for the first pass of them all.
    fn halve<const N: usize>(
        &mut self,
        whole: Part<N>,
        time: f64,
        weights: &[f64; N],
    ) -> (Found, u32) {
        let mut waiting = Waiting {
            parts: [whole; DEEPEST + 2],
            count: 0,
        };
        waiting.halve(&whole, time, weights);
        let mut found: Option<Pass> = None;
        let mut parts = 1;
        while let Some(part) = waiting.next() {
            if found.is_some() && part.time >= self.until {
                continue;
            }
            if parts >= MOST_PARTS {
                // Whatever is left may pass from now on.
                let first = waiting.parts[..waiting.count]
                    .iter()
                    .fold(
                        &part,
                        |first, part| {
                            if part.time < first.time { part } else { first }
                        },
                    );
                found = Some(Pass {
                    time: first.time,
                    place: first.patch.place_of(&[1.0 / N as f64; N]),
                    given_up: true,
                });
                break;
            }
            parts += 1;
            let (time, place, given_up) = match self.follow(&part) {
                Fate::Clear => continue,
                Fate::Near(time, place) => (time, place, false),
                Fate::Open(time, weights) if part.depth < DEEPEST => {
                    waiting.halve(&part, time, &weights);
                    continue;
                }
                Fate::Open(time, weights) => (time, part.patch.place_of(&weights), true),
            };
            if found.is_none() || time < self.until {
                self.until = time;
                found = Some(Pass {
                    time,
                    place,
                    given_up,
                });
            }
        }
        (found.map_or(Found::Nothing, Found::Pass), parts)
    }

    /// Advances a part as long as that goes well.
    fn follow<const N: usize>(&self, part: &Part<N>) -> Fate<N> {
        let mut time = part.time;
        let mut weights = [0.0; N];
        for _ in 0..ADVANCES {
            let closest = closest(&part.patch.at(time));
            if closest.point.norm() <= self.near_m {
                return Fate::Near(time, part.patch.place_of(&closest.weights));
            }
            weights = closest.weights;
            // Nearly the same direction, but where the patch is near it is the more exact one.
            let normal = closest.normal.map(|normal| {
                let side = normal.dot(&closest.point);
                if side < 0.0 { -normal } else { normal }
            });
            let advanced = [Some(closest.point), normal]
                .into_iter()
                .flatten()
                .filter_map(|direction| self.clear_until(&part.patch, time, &direction))
                .fold(None, |most: Option<f64>, until| {
                    Some(most.map_or(until, |most| most.max(until)))
                });
            let Some(until) = advanced else {
                return Fate::Open(time, weights);
            };
            if until > self.until {
                return Fate::Clear;
            }
            time = until;
        }
        Fate::Open(time, weights)
    }

    /// How long from `time` on every corner stays ahead along `direction`, by more than the separation and
    /// what rounding may hide; infinity for ever. `None` if one is not even ahead at `time`.
    fn clear_until<const N: usize>(
        &self,
        patch: &Patch<N>,
        time: f64,
        direction: &Vector3<f64>,
    ) -> Option<f64> {
        let direction = direction / direction.amax();
        // One that has no length gives numbers that are none, which are ahead of nothing.
        let hidden = direction.abs().dot(&self.round_off_m) + f64::MIN_POSITIVE;
        let least = self.separation_m * direction.norm() * (1.0 + 1e-12) + hidden;
        let mut until = f64::INFINITY;
        for (start, end) in patch.start.iter().zip(&patch.end) {
            let (start, end) = (direction.dot(start), direction.dot(end));
            let ahead = start + time * (end - start);
            if ahead.partial_cmp(&least) != Some(std::cmp::Ordering::Greater) {
                return None;
            }
            if end < start {
                until = until.min((start - least) / (start - end));
            }
        }
        Some(until.max(time))
    }
}
