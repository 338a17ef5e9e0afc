//! Bounds of a thread's rows that follow its tensions, brought to where the tensions will be.
//!
//! Entry point: [`ThreadState::foresee`] after each solve. Friction at a passage is bounded by (e^(mu theta) - 1) times the tension
//! before it, which falls where friction rises; a grip bounds the tension at its end, which is friction away from that at the tail.
//! Bounds that are those of the last solve's tensions swing from solve to solve where such a product exceeds 1. Here the thread's own rows
//! are solved with bounds that follow, all other rows as they pushed last: a semismooth Newton method over what sticks and what slides
//! either way (Alart & Curnier 1991). The next solve of all rows begins with bounds that hold for what it will find. In a balance that takes
//! long all portions of a thread are looked at together, with all other rows that act condensed out.

use super::model::ThreadPart;
use super::segments::Segment;
use super::state::{ThreadState, Weakest};
use crate::anchors::{ConstraintState, ConstraintSystem};
use crate::rows::{Condensed, Mode};
use std::ops::Range;
use sutura_factor::Lu;

/// Most rows on lengths of one thread that are looked at together; the bounds of more follow solve by solve.
const MOST_ROWS: usize = 128;
/// Most sets of what sticks and slides that are tried, and after how many of them only the first row that is wrong changes (Murty 1974): a
/// step of Newton's for all may lead round in a circle.
const MOST_SETS: u32 = 64;
const ONE_BY_ONE: u32 = 16;

/// What is nearer to a bound than this part of it counts as at it for what follows when a hand moves on. As the tissue settles under a hand
/// that rests, friction falls back by so little, and is at its bound again within some micrometres: less than an encoder's count.
const REACHED: f64 = 0.03;

/// Scratch for the rows on lengths of one thread.
pub(crate) struct FollowWork {
    matrix: Vec<f64>,
    lu: Lu,
    /// Of each row: the change of its multiplier \[N\], and how it acts.
    change: Vec<f64>,
    modes: Vec<Mode>,
    /// Bounds at the tensions of the last solve \[N\], how they grow with the tension before the row, and that tension.
    bounds: Vec<[f64; 2]>,
    rates: Vec<[f64; 2]>,
    /// Of a row of a passage: the part of its friction in the most tension of the whole; else 0.
    weights: Vec<f64>,
    /// The portion that each row is of.
    portions: Vec<Portion>,
    /// Part of the way to where the last solve has segments at which they are linearised.
    pub part: f64,
    /// All rows on several anchors with the others that act condensed out: which, W \[m/N\] (k x k), delta without their forces \[m\], (k).
    keep: Vec<usize>,
    condensed: Vec<f64>,
    delta_free: Vec<f64>,
}

/// How a multiplier at its bound follows others: it changes by so much less for each newton of theirs.
pub(crate) struct Tie {
    pub row: usize,
    pub to: Range<usize>,
    pub less: f64,
}

/// Rows of one portion of a thread.
#[derive(Clone, Copy)]
struct Portion {
    first: usize,
    /// One after the last.
    end: usize,
    /// Whether the first is that of its whole length.
    is_held: bool,
}

impl Portion {
    fn is_whole(&self, row: usize) -> bool {
        self.is_held && row == self.first
    }
}

/// Which rows' changes a row at one side of its bounds follows, and how much less it is for each newton of theirs.
fn follows<'a>(
    (rates, weights, portions): (&'a [[f64; 2]], &'a [f64], &[Portion]),
    row: usize,
    side: usize,
) -> impl Iterator<Item = (Range<usize>, f64)> + use<'a> {
    let rate = rates[row][side];
    let portion = portions[row];
    // The tension before a passage is the sum of all before it; the whole has a part of each passage's friction.
    let is_whole = portion.is_whole(row);
    let each = if is_whole {
        portion.first + 1..portion.end
    } else {
        row..row + 1
    };
    each.map(move |of| match is_whole {
        true => (of..of + 1, rate * weights[of]),
        false => (portion.first..of, -rate),
    })
}

impl FollowWork {
    /// Nothing is kept where no bound follows.
    pub fn new(follows: bool) -> Self {
        let most = if follows { MOST_ROWS } else { 0 };
        Self {
            matrix: vec![0.0; most * most],
            lu: Lu::new(most),
            change: vec![0.0; most],
            modes: Vec::with_capacity(most),
            bounds: Vec::with_capacity(most),
            rates: Vec::with_capacity(most),
            weights: Vec::with_capacity(most),
            portions: Vec::with_capacity(most),
            part: 1.0,
            keep: Vec::with_capacity(most),
            condensed: vec![0.0; most * most],
            delta_free: vec![0.0; most],
        }
    }

    /// For the next [`ThreadState::foresee`]: all other rows push as they did.
    pub fn leave_others(&mut self) {
        self.keep.clear();
    }

    /// For the next [`ThreadState::foresee`]: after a solve of so many rows on one anchor, and on several, what the former answer is counted
    /// in, at the price of one more reduction. Does nothing where there are none on several, or more than [`MOST_ROWS`].
    pub fn condense_others(
        &mut self,
        system: &mut ConstraintSystem,
        grasp: &ConstraintState,
        [single, spread]: [usize; 2],
    ) {
        self.keep.clear();
        if spread == 0 || spread > self.change.len() {
            return;
        }
        self.keep.extend(single..single + spread);
        let mut out = Condensed {
            compliance: &mut self.condensed[..spread * spread],
            delta_free: &mut self.delta_free[..spread],
            jacobian: &mut [],
        };
        if !system.condense(single, None, grasp, (&self.keep, &[]), &mut out) {
            self.keep.clear();
        }
    }

    /// What the bounds of a row are when the tension before it has changed by so much.
    fn bounds(&self, row: usize, more_n: f64) -> [f64; 2] {
        [0, 1].map(|side| self.bounds[row][side] + self.rates[row][side] * more_n)
    }

    /// Whether a row is that of the whole length of a portion.
    fn is_whole(&self, row: usize) -> bool {
        self.portions[row].is_whole(row)
    }

    /// How much the tension before a passage's row changes, or, for the row of the whole, what friction takes of its bound.
    fn more_n(&self, row: usize) -> f64 {
        let Portion { first, end, .. } = self.portions[row];
        if self.is_whole(row) {
            let after = first + 1..end;
            let weighted = self.weights[after.clone()].iter().zip(&self.change[after]);
            return -weighted
                .map(|(weight, change)| weight * change)
                .sum::<f64>();
        }
        self.change[first..row].iter().sum()
    }

    /// Change of all rows with the modes as they are; whether it is one.
    fn solve(&mut self, rows: &LengthRows) -> bool {
        let m = self.modes.len();
        self.matrix[..m * m].fill(0.0);
        for row in 0..m {
            let side = match self.modes[row] {
                Mode::AtLower => 0,
                Mode::AtUpper => 1,
                _ => {
                    for column in 0..m {
                        self.matrix[column * m + row] = rows.relative(row, column);
                    }
                    self.change[row] = -rows.gap_n(row);
                    continue;
                }
            };
            let Self {
                matrix,
                rates,
                weights,
                portions,
                ..
            } = self;
            let bounds = (&rates[..], &weights[..], &portions[..]);
            for (columns, less) in follows(bounds, row, side) {
                columns.for_each(|column| matrix[column * m + row] = less);
            }
            matrix[row * m + row] = 1.0;
            self.change[row] = self.bounds[row][side] - rows.lambda(row);
        }
        self.lu.factor(&mut self.matrix[..m * m], m);
        let factors = &self.matrix[..m * m];
        self.lu.solve(factors, m, &mut self.change[..m], 1);
        self.change[..m].iter().all(|change| change.is_finite())
    }

    /// Finds what sticks and what slides, from the modes on; whether there is such a set.
    fn find(&mut self, rows: &LengthRows) -> bool {
        for set in 0..MOST_SETS {
            if !self.solve(rows) {
                return false;
            }
            if self.look(rows, set < ONE_BY_ONE) {
                return true;
            }
        }
        false
    }

    /// Brings the modes, `all` or the first that is wrong, to what the change says; whether they are as they were.
    fn look(&mut self, rows: &LengthRows, all: bool) -> bool {
        let m = self.modes.len();
        let mut same = true;
        for row in 0..m {
            let [low, high] = self.bounds(row, self.more_n(row));
            let changes = self.change[..m].iter().enumerate();
            let moved: f64 = changes
                .map(|(column, x)| rows.relative(row, column) * x)
                .sum();
            let drive_n = rows.lambda(row) + self.change[row] - (rows.gap_n(row) + moved);
            let mode = if drive_n >= high {
                Mode::AtUpper
            } else if drive_n <= low {
                Mode::AtLower
            } else {
                Mode::Held
            };
            if mode == self.modes[row] {
                continue;
            }
            (same, self.modes[row]) = (false, mode);
            if !all {
                break;
            }
        }
        same
    }
}

/// The rows on lengths of a thread after a solve: portion by portion that of the whole first, if that is held, then one a passage.
#[derive(Clone, Copy)]
pub(super) struct LengthRows<'a> {
    /// W \[m/N\] of all rows of the set, or of those on several anchors with the others condensed out, (n x n).
    pub compliance: &'a [f64],
    pub n: usize,
    /// Where they begin in W, and among all.
    pub at: usize,
    pub first: usize,
    /// How all were solved, lambda \[N\] and delta \[m\].
    pub modes: &'a [Mode],
    pub lambda_n: &'a [f64],
    pub delta_m: &'a [f64],
}

impl LengthRows<'_> {
    fn compliance(&self, row: usize, column: usize) -> f64 {
        let place = (self.at + column) * self.n + self.at + row;
        self.compliance.get(place).copied().unwrap_or(0.0)
    }

    /// Of one row on another over its own.
    fn relative(&self, row: usize, column: usize) -> f64 {
        let own = self.compliance(row, row);
        if own > 0.0 {
            self.compliance(row, column) / own
        } else {
            f64::from(u8::from(row == column))
        }
    }

    fn lambda(&self, row: usize) -> f64 {
        self.lambda_n.get(self.first + row).copied().unwrap_or(0.0)
    }

    /// delta over the row's own compliance \[N\].
    fn gap_n(&self, row: usize) -> f64 {
        let own = self.compliance(row, row);
        let delta_m = self.delta_m.get(self.first + row).copied().unwrap_or(0.0);
        if own > 0.0 { delta_m / own } else { 0.0 }
    }

    fn mode(&self, row: usize) -> Mode {
        let mode = self.modes.get(self.first + row);
        mode.copied().unwrap_or(Mode::AtLower)
    }
}

impl ThreadState {
    /// Brings the bounds from the tensions of the last solve to those that the next will have with them, as far as the thread's own
    /// rows say, of which the first is the `first`th of the `single` and others.
    pub(super) fn foresee(
        &mut self,
        part: &ThreadPart,
        is_held: bool,
        (single, first): (usize, usize),
        (system, grasp): (&ConstraintSystem, &ConstraintState),
        work: &mut FollowWork,
    ) {
        let all = grasp.lambda().len();
        let condensed = std::mem::take(&mut work.condensed);
        let kept = work.keep.len();
        let (compliance, n, at) = match kept {
            0 => (system.compliance(all), all, single + first),
            _ => (&condensed[..kept * kept], kept, first),
        };
        let mut rows = LengthRows {
            compliance,
            n,
            at,
            first: single + first,
            modes: grasp.modes(),
            lambda_n: grasp.lambda(),
            delta_m: grasp.delta_m(),
        };
        let counts = self
            .portions()
            .map(|portion| self.length_rows(part, is_held, &portion));
        let count: usize = counts.sum();
        if kept > 0 && count <= work.change.len() {
            self.foresee_spans(part, is_held, 0..self.spans.len(), rows, work);
        } else {
            let mut next = 0;
            while next < self.spans.len() {
                let portion = self.portion(next);
                let own = rows;
                let count = self.length_rows(part, is_held, &portion);
                (rows.at, rows.first) = (rows.at + count, rows.first + count);
                next = portion.end;
                let whole = usize::from(self.is_portion_held(&portion, is_held));
                if count > whole && count <= work.change.len() {
                    self.foresee_spans(part, is_held, portion, own, work);
                }
            }
        }
        work.condensed = condensed;
    }

    /// How the multipliers of this thread's rows that are at a bound, as all are after a solve and this one's from the `first` on, follow others
    /// as the hands move on. What has slid and rests is at its bound, too: it is taken to go on.
    pub(super) fn tie(
        &self,
        part: &ThreadPart,
        is_held: bool,
        (grasp, first): (&ConstraintState, usize),
        work: &mut FollowWork,
        out: &mut Vec<Tie>,
    ) {
        let portions = self.portions();
        let counts = portions.map(|portion| self.length_rows(part, is_held, &portion));
        let count: usize = counts.sum();
        if count > work.change.len() {
            return;
        }
        self.list_all_bounds(part, is_held, 0..self.spans.len(), work);
        // Where no balance was found there may be more by now than was solved for.
        let own = first..first + work.bounds.len();
        let (Some(lambda), Some(modes)) = (grasp.lambda().get(own.clone()), grasp.modes().get(own))
        else {
            return;
        };
        let bounds = (&work.rates[..], &work.weights[..], &work.portions[..]);
        for (row, [low, high]) in work.bounds.iter().enumerate() {
            let near = REACHED * high.max(-low);
            let side = match modes[row] {
                Mode::AtLower => 0,
                Mode::AtUpper => 1,
                // What is taut begins at its lower bound, and is not slack.
                _ if lambda[row] < low + near && !work.is_whole(row) => 0,
                _ if lambda[row] > high - near => 1,
                _ => continue,
            };
            let row_of = |row: usize| first + row;
            out.extend(follows(bounds, row, side).map(|(to, less)| Tie {
                row: row_of(row),
                to: row_of(to.start)..row_of(to.end),
                less,
            }));
        }
    }

    /// Bounds of the portions that these spans are.
    fn list_all_bounds(
        &self,
        part: &ThreadPart,
        is_held: bool,
        spans: Range<usize>,
        work: &mut FollowWork,
    ) {
        work.bounds.clear();
        work.rates.clear();
        work.weights.clear();
        work.portions.clear();
        let mut next = spans.start;
        while next < spans.end {
            let portion = self.portion(next);
            self.list_bounds(part, &portion, is_held, work);
            next = portion.end;
        }
    }

    /// The same of the portions that these spans are.
    fn foresee_spans(
        &mut self,
        part: &ThreadPart,
        is_held: bool,
        spans: Range<usize>,
        rows: LengthRows,
        work: &mut FollowWork,
    ) {
        self.list_all_bounds(part, is_held, spans.clone(), work);
        work.modes.clear();
        work.modes
            .extend((0..work.bounds.len()).map(|row| rows.mode(row)));
        if !work.find(&rows) {
            return;
        }
        let (mut next, mut row) = (spans.start, 0);
        while next < spans.end {
            let portion = self.portion(next);
            row = self.follow(part, is_held, &portion, row, work);
            next = portion.end;
        }
    }

    /// Bounds as the last solve has them, and how they follow.
    fn list_bounds(
        &self,
        part: &ThreadPart,
        portion: &Range<usize>,
        is_held: bool,
        work: &mut FollowWork,
    ) {
        let FollowWork {
            bounds,
            rates,
            weights,
            portions,
            ..
        } = work;
        let first = bounds.len();
        let rubs = |place: &usize| self.has_friction_row(part, is_held, *place);
        let passages = || {
            let places = portion.clone().filter(rubs);
            places.filter_map(|place| {
                let span = &self.spans[place];
                Some((place, span, span.passage?))
            })
        };
        let mut weakest = None;
        let is_held = self.is_portion_held(portion, is_held);
        if is_held {
            bounds.push([0.0, self.most_n(part, portion)]);
            rates.push([0.0, 1.0]);
            weights.push(0.0);
            let segments = self.segments.iter();
            let mut segments = segments.filter(|segment| portion.contains(&segment.span));
            let tension = |a: &&Segment, b: &&Segment| a.tension_n.total_cmp(&b.tension_n);
            weakest = match self.weakest {
                _ if portion.start > 0 => None,
                Weakest::Tail => None,
                Weakest::Head => segments.next_back(),
                Weakest::Thread => segments.max_by(tension),
            };
        }
        for (place, span, passage) in passages() {
            bounds.push([-passage.lessens_n, span.limit_n]);
            rates.push([-passage.rates[0], passage.rates[1]]);
            weights.push(weakest.map_or(0.0, |segment| segment.beyond(place)));
        }
        let end = bounds.len();
        portions.resize(
            end,
            Portion {
                first,
                end,
                is_held,
            },
        );
    }

    /// Takes over the bounds of a portion that hold with the change found, from a row on; the row after its last.
    fn follow(
        &mut self,
        part: &ThreadPart,
        is_held: bool,
        portion: &Range<usize>,
        mut row: usize,
        work: &FollowWork,
    ) -> usize {
        if self.is_portion_held(portion, is_held) {
            if portion.start == 0 {
                let [_, most_n] = work.bounds(row, work.more_n(row));
                self.bound_n = most_n.max(0.0);
            }
            row += 1;
        }
        for place in portion.clone() {
            if !self.has_friction_row(part, is_held, place) {
                continue;
            }
            let [low, high] = work.bounds(row, work.more_n(row));
            let span = &mut self.spans[place];
            span.limit_n = high.max(0.0);
            if let Some(passage) = &mut span.passage {
                passage.lessens_n = (-low).max(0.0);
            }
            row += 1;
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hardly any tension before two passages, of which the first multiplies it by 80 and slides, and the second sticks: all rows that are
    /// wrong changed at once lead through three sets, none of which is right, in a circle.
    #[test]
    fn sets_that_lead_in_a_circle_are_left() {
        let compliance = [
            0.013145156745403872,
            0.012466232057577574,
            0.008909281324535072,
            0.012466232057577574,
            0.01227351294772904,
            0.009002175559938215,
            0.008909281324535072,
            0.009002175559938215,
            0.00894989502448199,
        ];
        let rows = LengthRows {
            compliance: &compliance,
            n: 3,
            at: 0,
            first: 0,
            modes: &[Mode::AtLower, Mode::Held, Mode::Held],
            lambda_n: &[0.0, 0.012102588055501094, 0.10298834797193213],
            delta_m: &[1.8030334393525726e-6 * compliance[0], 0.0, 0.0],
        };
        let grown = [79.57937284885837, 82.62490591407557];
        let mut work = FollowWork::new(true);
        work.bounds.extend([
            [0.0, 20.0],
            [0.0, 0.0],
            [-0.011957863371829264, 0.9999751994025927],
        ]);
        work.rates.push([0.0, 1.0]);
        work.rates
            .extend(grown.map(|grown| [-grown / (1.0 + grown), grown]));
        work.weights.extend([0.0; 3]);
        work.portions.resize(
            3,
            Portion {
                first: 0,
                end: 3,
                is_held: true,
            },
        );
        work.modes.extend(rows.modes);
        assert!(work.find(&rows));
        assert_eq!(work.modes, [Mode::Held, Mode::AtUpper, Mode::Held]);
        let [tension_n, friction_n, second_n] =
            [0, 1, 2].map(|row| rows.lambda(row) + work.change[row]);
        assert!(tension_n > 0.0, "{tension_n} N");
        assert!(
            (friction_n / (grown[0] * tension_n) - 1.0).abs() < 1e-9,
            "{friction_n} N"
        );
        assert!(
            second_n < grown[1] * (tension_n + friction_n),
            "{second_n} N"
        );
        // What sticks or is taut has moved by nothing.
        for row in [0, 2] {
            let moved: f64 = (0..3)
                .map(|of| rows.compliance(row, of) * work.change[of])
                .sum();
            assert!(
                (moved + rows.delta_m[row]).abs() < 1e-15,
                "{row}: {moved} m"
            );
        }
    }
}
