//! The problem as the solvers see it: rows scaled to a unit diagonal, equality rows first.
//!
//! Entry points: [`Scaled::prepare`], then [`Scaled::block`] for parts of the scaled compliance.

use super::{Problem, RowKind};
use std::ops::Range;

/// What a scaled row may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Law {
    /// `low <= lambda <= high`; both zero for a row that nothing can act on.
    Between { low: f64, high: f64 },
    /// A cone's normal; the next two rows are its tangents.
    Normal { friction: f64 },
    /// A cone's tangent, or the second row of a disc.
    Tangent,
    /// A disc's first row; the next one is its second.
    Disc { radius: f64 },
}

impl Law {
    /// Neither bound nor cone.
    pub const FREE: Self = Self::Between {
        low: f64::NEG_INFINITY,
        high: f64::INFINITY,
    };
    /// Holds lambda at zero.
    pub const NONE: Self = Self::Between {
        low: 0.0,
        high: 0.0,
    };

    /// Least and largest lambda~; cones as if they had no friction.
    pub fn bounds(self) -> (f64, f64) {
        match self {
            Self::Between { low, high } => (low, high),
            Self::Normal { .. } => (0.0, f64::INFINITY),
            Self::Tangent | Self::Disc { .. } => (0.0, 0.0),
        }
    }
}

/// Why a problem is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    NotFinite,
    Malformed,
}

/// Scaled rows, by position: `order` leads back to the problem's rows.
#[derive(Debug)]
pub(super) struct Scaled {
    pub n: usize,
    /// Equality rows, which come first.
    pub equalities: usize,
    pub order: Vec<usize>,
    /// Positions whose rows follow each other in the problem, too, equality rows apart from others.
    runs: Vec<Range<usize>>,
    /// d, by position.
    pub scale: Vec<f64>,
    /// delta_free~, by position.
    pub target: Vec<f64>,
    /// `W_ii^(1/2)` by row of the problem, infinite for empty rows: nothing bounds their rounding.
    root: Vec<f64>,
    pub law: Vec<Law>,
    /// Largest drive~.
    pub drive: f64,
    /// Whether some cone can rub.
    pub cones: bool,
}

/// Part by which `|W_ij| <= (W_ii W_jj)^(1/2)` may be broken: columns of K^-1 from a single precision
/// factor do so by up to 3e-4.
const SEMIDEFINITE_SLACK: f64 = 1e-3;

impl Scaled {
    pub fn new(largest: usize) -> Self {
        Self {
            n: 0,
            equalities: 0,
            order: Vec::with_capacity(largest),
            runs: Vec::with_capacity(largest),
            scale: Vec::with_capacity(largest),
            target: Vec::with_capacity(largest),
            root: Vec::with_capacity(largest),
            law: Vec::with_capacity(largest),
            drive: 0.0,
            cones: false,
        }
    }

    /// Checks and scales `problem`; equality rows come first if they are to be eliminated.
    pub fn prepare(&mut self, problem: &Problem, equalities_first: bool) -> Result<(), Fault> {
        let n = problem.rows.len();
        if problem.compliance.len() != n * n || problem.delta_free.len() != n {
            return Err(Fault::Malformed);
        }
        check_kinds(problem)?;
        if !finite(problem.delta_free) {
            return Err(Fault::NotFinite);
        }
        self.n = n;
        self.order.clear();
        let diagonal = |row: usize| problem.compliance[row * (n + 1)];
        let eliminated = |row: usize| {
            equalities_first
                && problem.rows[row].kind == RowKind::Equality
                && diagonal(row) >= f64::MIN_POSITIVE
        };
        self.order.extend((0..n).filter(|&row| eliminated(row)));
        self.equalities = self.order.len();
        self.order.extend((0..n).filter(|&row| !eliminated(row)));
        self.find_runs();

        self.scale.clear();
        self.law.clear();
        self.cones = false;
        while self.scale.len() < n {
            self.push_rows(problem)?;
        }
        self.target.clear();
        self.drive = 0.0;
        for (&row, (&scale, &law)) in self.order.iter().zip(self.scale.iter().zip(&self.law)) {
            let target = problem.delta_free[row] * scale;
            self.target.push(target);
            let drive = match law {
                Law::Disc { radius } => target
                    .hypot(problem.delta_free[row + 1] * scale)
                    .min(radius),
                Law::Between { low: 0.0, high } => (-target).clamp(0.0, high),
                Law::Between { low, high } => target.abs().min(high.max(-low)),
                Law::Normal { .. } => (-target).max(0.0),
                Law::Tangent => 0.0,
            };
            self.drive = self.drive.max(drive);
        }
        if !(finite(&self.target) && finite(&self.scale)) {
            return Err(Fault::NotFinite);
        }
        self.check_compliance(problem)
    }

    fn find_runs(&mut self) {
        self.runs.clear();
        for (at, &row) in self.order.iter().enumerate() {
            let goes_on = at != self.equalities && at > 0 && self.order[at - 1] + 1 == row;
            match self.runs.last_mut().filter(|_| goes_on) {
                Some(run) => run.end = at + 1,
                None => self.runs.push(at..at + 1),
            }
        }
    }

    /// Scales the next row, or the next three if it is a normal.
    fn push_rows(&mut self, problem: &Problem) -> Result<(), Fault> {
        let n = self.n;
        let diagonal = |row: usize| problem.compliance[row * (n + 1)];
        let row = self.order[self.scale.len()];
        let empty = diagonal(row) < f64::MIN_POSITIVE;
        let scale = scale_of(diagonal(row))?;
        self.scale.push(scale);
        self.law.push(match problem.rows[row].kind {
            _ if empty => Law::NONE,
            RowKind::Equality => Law::FREE,
            RowKind::Inequality => Law::Between {
                low: 0.0,
                high: f64::INFINITY,
            },
            RowKind::Box { limit_n } => Law::Between {
                low: -limit_n / scale,
                high: limit_n / scale,
            },
            RowKind::Between { least_n, most_n } => Law::Between {
                low: least_n / scale,
                high: most_n / scale,
            },
            // Replaced below.
            RowKind::Normal { .. } | RowKind::Tangent | RowKind::Disc { .. } => Law::NONE,
        });
        if let RowKind::Disc { limit_n } = problem.rows[row].kind {
            return self.push_disc([diagonal(row), diagonal(row + 1)], limit_n);
        }
        let RowKind::Normal { friction } = problem.rows[row].kind else {
            return Ok(());
        };
        let (first, second) = (diagonal(row + 1), diagonal(row + 2));
        let sideways = scale_of(first.max(second))?;
        // A tangent that moves nothing cannot rub, nor can its pair.
        let rubs = friction > 0.0 && !empty && first.min(second) >= f64::MIN_POSITIVE;
        // Negative diagonals are for `scale_of` to find.
        scale_of(first.min(second))?;
        self.scale.extend([sideways, sideways]);
        let normal = self.law.len() - 1;
        if rubs {
            let friction = friction * (scale / sideways);
            if !friction.is_finite() {
                return Err(Fault::NotFinite);
            }
            self.cones = true;
            self.law[normal] = Law::Normal { friction };
            self.law.extend([Law::Tangent, Law::Tangent]);
        } else {
            if !empty {
                self.law[normal] = Law::Between {
                    low: 0.0,
                    high: f64::INFINITY,
                };
            }
            self.law.extend([Law::NONE, Law::NONE]);
        }
        Ok(())
    }

    /// Scales both rows of a disc alike, of which the first is there; one that moves nothing bears nothing.
    fn push_disc(&mut self, diagonals: [f64; 2], limit_n: f64) -> Result<(), Fault> {
        let [first, second] = diagonals;
        scale_of(first.min(second))?;
        let scale = scale_of(first.max(second))?;
        let at = self.law.len() - 1;
        self.scale[at] = scale;
        self.scale.push(scale);
        let acts = limit_n > 0.0 && first.min(second) >= f64::MIN_POSITIVE;
        let radius = limit_n / scale;
        let laws = if !acts {
            [Law::NONE; 2]
        } else if radius == f64::INFINITY {
            [Law::FREE; 2]
        } else {
            self.cones = true;
            [Law::Disc { radius }, Law::Tangent]
        };
        self.law[at] = laws[0];
        self.law.push(laws[1]);
        Ok(())
    }

    /// One look at every entry, for a number and for what it may be.
    fn check_compliance(&mut self, problem: &Problem) -> Result<(), Fault> {
        let n = self.n;
        let w = problem.compliance;
        self.root.clear();
        self.root.extend((0..n).map(|row| match w[row * (n + 1)] {
            diagonal if diagonal < f64::MIN_POSITIVE => f64::INFINITY,
            diagonal => diagonal.sqrt(),
        }));
        let allowed = 1.0 + SEMIDEFINITE_SLACK;
        for j in 0..n {
            // Square roots apart: a product of two diagonals may overflow or vanish.
            let own = self.root[j] * allowed;
            let column = &w[j * n..(j + 1) * n];
            let mut sound = true;
            for (entry, root) in column.iter().zip(&self.root) {
                // Not a number is not below anything.
                sound &= entry.abs() <= (own * root).min(f64::MAX);
            }
            if !sound {
                return Err(match finite(w) {
                    true => Fault::Malformed,
                    false => Fault::NotFinite,
                });
            }
        }
        Ok(())
    }

    /// Columns `columns` and rows `rows` (positions) of the scaled compliance, into `out`,
    /// column-major.
    pub fn block(
        &self,
        problem: &Problem,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
    ) {
        for (out, at) in out.chunks_exact_mut(rows.len().max(1)).zip(columns) {
            self.column(problem, at, rows.clone(), out);
        }
    }

    /// As [`Self::block`] for rows and columns `both`, without what is above the diagonal.
    pub fn lower_block(&self, problem: &Problem, both: Range<usize>, out: &mut [f64]) {
        let columns = out.chunks_exact_mut(both.len().max(1)).enumerate();
        for (column, out) in columns.take(both.len()) {
            let at = both.start + column;
            self.column(problem, at, at..both.end, &mut out[column..]);
        }
    }

    /// Rows `rows` of the column at a position, into `out`.
    fn column(&self, problem: &Problem, at: usize, rows: Range<usize>, out: &mut [f64]) {
        let own = self.scale[at];
        let start = self.order[at] * self.n;
        let column = &problem.compliance[start..start + self.n];
        for run in &self.runs {
            let run = run.start.max(rows.start)..run.end.min(rows.end);
            if run.is_empty() {
                continue;
            }
            let row = self.order[run.start];
            let entries = column[row..row + run.len()].iter();
            let out = &mut out[run.start - rows.start..run.end - rows.start];
            for ((out, entry), scale) in out.iter_mut().zip(entries).zip(&self.scale[run]) {
                *out = own * entry * scale;
            }
        }
    }
}

fn finite(numbers: &[f64]) -> bool {
    numbers.iter().fold(true, |all, x| all & x.is_finite())
}

/// `W_ii^(-1/2)`, 1 for an empty row.
fn scale_of(diagonal: f64) -> Result<f64, Fault> {
    if diagonal < 0.0 {
        Err(Fault::Malformed)
    } else if diagonal < f64::MIN_POSITIVE {
        Ok(1.0)
    } else {
        Ok(diagonal.sqrt().recip())
    }
}

/// Limits, frictions, and tangents behind their normals.
pub(super) fn check_kinds(problem: &Problem) -> Result<(), Fault> {
    let mut due = 0;
    for row in problem.rows {
        if (row.kind == RowKind::Tangent) != (due > 0) {
            return Err(Fault::Malformed);
        }
        match row.kind {
            RowKind::Tangent => due -= 1,
            RowKind::Disc { limit_n } if limit_n.is_nan() => return Err(Fault::NotFinite),
            RowKind::Disc { limit_n } if limit_n < 0.0 => return Err(Fault::Malformed),
            RowKind::Disc { .. } => due = 1,
            RowKind::Normal { friction } if friction.is_infinite() || friction.is_nan() => {
                return Err(Fault::NotFinite);
            }
            RowKind::Box { limit_n } if limit_n.is_nan() => return Err(Fault::NotFinite),
            RowKind::Between { least_n, most_n } if least_n.is_nan() || most_n.is_nan() => {
                return Err(Fault::NotFinite);
            }
            RowKind::Normal { friction } if friction < 0.0 => return Err(Fault::Malformed),
            RowKind::Box { limit_n } if limit_n < 0.0 => return Err(Fault::Malformed),
            RowKind::Between { least_n, most_n } if least_n > 0.0 || most_n < 0.0 => {
                return Err(Fault::Malformed);
            }
            RowKind::Normal { .. } => due = 2,
            _ => {}
        }
    }
    if due > 0 {
        Err(Fault::Malformed)
    } else {
        Ok(())
    }
}
