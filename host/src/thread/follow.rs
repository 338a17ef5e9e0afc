//! Bounds of a thread's rows that follow its tensions, brought to where the tensions will be.
//!
//! Entry point: [`ThreadState::foresee`] after each solve. Friction at a passage is bounded by (e^(mu theta) - 1) times the tension
//! before it, which falls where friction rises; a grip bounds the tension at its end, which is friction away from that at the tail.
//! Bounds that are those of the last solve's tensions swing from solve to solve where such a product exceeds 1. Here the thread's own rows
//! are solved with bounds that follow, all other rows as they pushed last: a semismooth Newton method over what sticks and what slides
//! either way (Alart & Curnier 1991). The next solve of all rows begins with bounds that hold for what it will find.

use super::model::ThreadPart;
use super::segments::Segment;
use super::state::{ThreadState, Weakest};
use crate::rows::Mode;
use std::ops::Range;
use sutura_factor::Lu;

/// Most rows on lengths of one thread that are looked at together; the bounds of more follow solve by solve.
const MOST_ROWS: usize = 128;
/// Most sets of what sticks and slides that are tried.
const MOST_SETS: u32 = 32;

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
    /// Of the whole length's most tension: its part in the friction of each passage.
    weights: Vec<f64>,
    /// Part of the way to where the last solve has segments at which they are linearised.
    pub part: f64,
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
            part: 1.0,
        }
    }

    /// What the bounds of a row are when the tension before it has changed by so much.
    fn bounds(&self, row: usize, more_n: f64) -> [f64; 2] {
        [0, 1].map(|side| self.bounds[row][side] + self.rates[row][side] * more_n)
    }

    /// How much the tension before a passage's row changes, or, for the row of the whole, what friction takes of its bound.
    fn more_n(&self, begin: usize, row: usize) -> f64 {
        if row < begin {
            let weighted = self.weights.iter().zip(&self.change[begin..]);
            return -weighted
                .map(|(weight, change)| weight * change)
                .sum::<f64>();
        }
        self.change[..row].iter().sum()
    }

    /// Change of all rows with the modes as they are; whether it is one.
    fn solve(&mut self, rows: &LengthRows, begin: usize) -> bool {
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
            let rate = self.rates[row][side];
            if row < begin {
                for (column, weight) in (begin..m).zip(&self.weights) {
                    self.matrix[column * m + row] = rate * weight;
                }
            } else {
                (0..row).for_each(|column| self.matrix[column * m + row] = -rate);
            }
            self.matrix[row * m + row] = 1.0;
            self.change[row] = self.bounds[row][side] - rows.lambda(row);
        }
        self.lu.factor(&mut self.matrix[..m * m], m);
        let factors = &self.matrix[..m * m];
        self.lu.solve(factors, m, &mut self.change[..m], 1);
        self.change[..m].iter().all(|change| change.is_finite())
    }

    /// Brings the modes to what the change says; whether they are as they were.
    fn look(&mut self, rows: &LengthRows, begin: usize) -> bool {
        let m = self.modes.len();
        let mut same = true;
        for row in 0..m {
            let [low, high] = self.bounds(row, self.more_n(begin, row));
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
            same &= mode == self.modes[row];
            self.modes[row] = mode;
        }
        same
    }
}

/// The rows on lengths of a thread after a solve: that of the whole first, if the thread is held, then one a passage.
#[derive(Clone, Copy)]
pub(super) struct LengthRows<'a> {
    /// W \[m/N\] of all rows of the set, (n x n).
    pub compliance: &'a [f64],
    pub n: usize,
    /// Where they begin among all.
    pub first: usize,
    /// How all were solved, lambda \[N\] and delta \[m\].
    pub modes: &'a [Mode],
    pub lambda_n: &'a [f64],
    pub delta_m: &'a [f64],
}

impl LengthRows<'_> {
    fn compliance(&self, row: usize, column: usize) -> f64 {
        let place = (self.first + column) * self.n + self.first + row;
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
    /// rows say.
    pub(super) fn foresee(
        &mut self,
        part: &ThreadPart,
        is_held: bool,
        rows: LengthRows,
        work: &mut FollowWork,
    ) {
        let (mut next, mut first) = (0, rows.first);
        while next < self.spans.len() {
            let portion = self.portion(next);
            let own = LengthRows { first, ..rows };
            let count = self.length_rows(part, is_held, &portion);
            (first, next) = (first + count, portion.end);
            let is_held = self.is_portion_held(&portion, is_held);
            if count > usize::from(is_held) && count <= work.change.len() {
                self.foresee_portion(part, &portion, is_held, own, work);
            }
        }
    }

    /// The same of a portion between hands.
    fn foresee_portion(
        &mut self,
        part: &ThreadPart,
        portion: &Range<usize>,
        is_held: bool,
        rows: LengthRows,
        work: &mut FollowWork,
    ) {
        let begin = usize::from(is_held);
        self.list_bounds(part, portion, is_held, work);
        work.modes.clear();
        work.modes
            .extend((0..work.bounds.len()).map(|row| rows.mode(row)));
        for _ in 0..MOST_SETS {
            if !work.solve(&rows, begin) {
                return;
            }
            if work.look(&rows, begin) {
                self.follow(portion, is_held, work);
                return;
            }
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
            ..
        } = work;
        bounds.clear();
        rates.clear();
        weights.clear();
        let passages = || {
            let places = portion.clone();
            places.filter_map(|place| {
                let span = &self.spans[place];
                Some((place, span, span.passage?))
            })
        };
        if is_held {
            bounds.push([0.0, self.most_n(part, portion)]);
            rates.push([0.0, 1.0]);
            let segments = self.segments.iter();
            let mut segments = segments.filter(|segment| portion.contains(&segment.span));
            let tension = |a: &&Segment, b: &&Segment| a.tension_n.total_cmp(&b.tension_n);
            let weakest = match self.weakest {
                _ if portion.start > 0 => None,
                Weakest::Tail => None,
                Weakest::Head => segments.next_back(),
                Weakest::Thread => segments.max_by(tension),
            };
            let weight = |place: usize| weakest.map_or(0.0, |segment| segment.beyond(place));
            weights.extend(passages().map(|(place, ..)| weight(place)));
        }
        for (_, span, passage) in passages() {
            bounds.push([-passage.lessens_n, span.limit_n]);
            rates.push([-passage.rates[0], passage.rates[1]]);
        }
    }

    /// Takes over the bounds that hold with the change found.
    fn follow(&mut self, portion: &Range<usize>, is_held: bool, work: &FollowWork) {
        let begin = usize::from(is_held);
        if is_held && portion.start == 0 {
            let [_, most_n] = work.bounds(0, work.more_n(begin, 0));
            self.bound_n = most_n.max(0.0);
        }
        let spans = self.spans[portion.clone()].iter_mut();
        let passages = spans.filter(|span| span.passage.is_some());
        for (row, span) in (begin..work.modes.len()).zip(passages) {
            let [low, high] = work.bounds(row, work.more_n(begin, row));
            span.limit_n = high.max(0.0);
            if let Some(passage) = &mut span.passage {
                passage.lessens_n = (-low).max(0.0);
            }
        }
    }
}
