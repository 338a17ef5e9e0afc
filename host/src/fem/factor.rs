//! Sparse Cholesky factor of a stiffness matrix, and solves that reuse their buffers.
//!
//! Entry points: [`Factor::new`], [`Factor::refactor`], [`Factor::solve`], [`Factor::solve_columns`].
//! One right-hand side, or few that are sparse, are solved by our own sweeps over the factor's supernodes.

use super::error::TissueError;
use super::held::largest;
use super::pattern::Pattern;
use crate::work;
use std::sync::Arc;
use sutura_factor::{Cholesky, Indefinite, Scratch, Supernodes, SweepScratch};
use sutura_models::memory::{self, Shortage};

/// `L L' = P K P'`. Copies share what depends on the pattern only.
#[derive(Clone, Debug)]
pub(crate) struct Factor {
    symbolic: Arc<Symbolic>,
    /// Packed for sweeps.
    values: Vec<f64>,
}

/// What depends on the pattern only.
#[derive(Debug)]
struct Symbolic {
    cholesky: Cholesky,
    supernodes: Supernodes,
}

/// Why there is no factor.
#[derive(Debug)]
pub(crate) enum NotFactored {
    /// The matrix is not positive definite.
    Indefinite,
    /// It is too large for the memory that is free.
    TooLarge(Shortage),
    /// Nobody waits for it any more.
    Stopped,
}

/// What a factor is for, as far as that takes memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Need {
    /// Copies of its values that there will be.
    pub copies: usize,
    /// What else will be there beside it \[bytes\].
    pub beside_bytes: u64,
}

/// Said of a mesh that is too large.
const FACTOR: &str = "the factor of its stiffness";
/// Memory that is needed first; how much the factor needs is known afterwards.
const ORDER: &str = "the order in which its stiffness is to be factored";

/// So far tissue that is held is moved by forces whose norm is 1, at most, in units of the inverse of its largest stiffness.
const MOST_MOVED: f64 = 1e12;

/// Memory for solves.
pub struct SolveScratch(SweepScratch<1>);

/// Memory for the columns of one vertex, and what they are after a solve.
pub(crate) type ColumnScratch = SweepScratch<3>;

/// Memory for [`Factor::refactor`].
pub(crate) struct RefactorScratch {
    memory: Scratch,
    /// Of the next factor, so that one that fails leaves the last.
    values: Vec<f64>,
    room: Vec<f64>,
}

impl Factor {
    /// Analyses the pattern and factors `values`, (entries of the pattern). What that takes is known from the analysis:
    /// more than is free is refused before it is begun.
    pub fn new(pattern: &Pattern, values: &[f64], need: Need) -> Result<Self, NotFactored> {
        let nodes = pattern.unknowns / 3;
        work::begin("finding an order of elimination", || {
            format!("{nodes} free nodes")
        });
        let cholesky = Cholesky::analyse(pattern.lower())
            .map_err(|_| short(ORDER, 4 * size_of::<usize>() * pattern.entries()))?;
        let supernodes = Supernodes::new(&cholesky).ok_or(NotFactored::Indefinite)?;
        let symbolic = Symbolic {
            cholesky,
            supernodes,
        };
        let entries = symbolic.cholesky.entries();
        let bytes = size_of::<f64>() * entries;
        let all = bytes * need.copies.max(1) + symbolic.cholesky.factor_bytes();
        memory::require(FACTOR, all as u64 + need.beside_bytes)?;
        if work::is_stopped() {
            return Err(NotFactored::Stopped);
        }
        work::begin("factoring the stiffness", || {
            format!(
                "{nodes} free nodes, {:.1} million entries, {:.2} GB",
                1e-6 * entries as f64,
                1e-9 * bytes as f64
            )
        });
        let mut values_of_factor = memory::zeros(FACTOR, entries)?;
        let mut memory = (symbolic.cholesky)
            .try_factor_scratch()
            .map_err(|_| short(FACTOR, all))?;
        symbolic
            .cholesky
            .factor(pattern.lower(), values, &mut values_of_factor, &mut memory)?;
        let room = &mut symbolic.supernodes.panel_room();
        symbolic.supernodes.pack(&mut values_of_factor, room);
        Ok(Self {
            values: values_of_factor,
            symbolic: Arc::new(symbolic),
        })
    }

    /// For a pattern whose values come later: the factor of the identity.
    pub fn of_identity(pattern: &Pattern, need: Need) -> Result<Self, TissueError> {
        let mut values = vec![0.0; pattern.entries()];
        for column in 0..pattern.unknowns {
            // The diagonal comes first in its column of the lower triangle.
            values[pattern.column_start[column]] = 1.0;
        }
        Self::new(pattern, &values, need).map_err(|error| error.of_tissue(0))
    }

    /// As [`Self::new`] for tissue at rest with so many nodes `fixed`, held against rigid motion or
    /// refused.
    pub fn held(
        pattern: &Pattern,
        stiffness: &[f64],
        fixed: usize,
        need: Need,
    ) -> Result<Self, TissueError> {
        let floating = TissueError::Floating { fixed };
        let factor = Self::new(pattern, stiffness, need).map_err(|error| error.of_tissue(fixed))?;
        let mut work = vec![0.0; pattern.unknowns];
        if factor.keeps(stiffness, &mut work, &mut factor.scratch()) {
            Ok(factor)
        } else {
            Err(floating)
        }
    }

    /// Whether the factored `stiffness` keeps tissue where it is. Round-off can hide a rigid motion from the factorisation, but not from a solve:
    /// forces without symmetry, `work` (unknowns), move it by many orders more than the stiffness explains. How far grows as their norm does.
    pub fn keeps(&self, stiffness: &[f64], work: &mut [f64], scratch: &mut SolveScratch) -> bool {
        for (index, value) in work.iter_mut().enumerate() {
            *value = (index as f64).sin();
        }
        self.solve(work, scratch);
        work.iter().all(|u| u.is_finite())
            && largest(work) * largest(stiffness) < MOST_MOVED * (work.len() as f64).sqrt()
    }

    /// As much memory as [`Self::new`] has found once already.
    pub fn refactor_scratch(&self) -> RefactorScratch {
        RefactorScratch {
            memory: self.symbolic.cholesky.factor_scratch(),
            values: vec![0.0; self.values.len()],
            room: self.symbolic.supernodes.panel_room(),
        }
    }

    /// Factors other values on the same pattern. Allocates nothing; on failure the factor is as before.
    pub fn refactor(
        &mut self,
        pattern: &Pattern,
        values: &[f64],
        scratch: &mut RefactorScratch,
    ) -> Result<(), NotFactored> {
        let RefactorScratch {
            memory,
            values: next,
            room,
        } = scratch;
        let Symbolic {
            cholesky,
            supernodes,
        } = &*self.symbolic;
        cholesky.factor(pattern.lower(), values, next, memory)?;
        supernodes.pack(next, room);
        std::mem::swap(&mut self.values, &mut scratch.values);
        Ok(())
    }

    pub fn scratch(&self) -> SolveScratch {
        SolveScratch(self.symbolic.supernodes.scratch())
    }

    /// Solves in place for right-hand sides one after the other in memory, (columns x unknowns).
    pub fn solve(&self, rhs: &mut [f64], scratch: &mut SolveScratch) {
        let Symbolic { supernodes, .. } = &*self.symbolic;
        for rhs in rhs.chunks_exact_mut(supernodes.unknowns().max(1)) {
            supernodes.solve(&self.values, rhs, &mut scratch.0);
        }
    }

    /// Brings into the caches what [`Self::solve`] will read.
    pub fn touch(&self) {
        let read = self.symbolic.supernodes.entries();
        sutura_factor::touch(&self.values[..read]);
    }

    /// What [`Self::solve_columns`] must visit so that these `unknowns` can be read afterwards.
    pub fn needed_for(&self, unknowns: impl Iterator<Item = usize>) -> Vec<u32> {
        self.symbolic.supernodes.needed_for(unknowns)
    }

    pub fn column_scratch(&self) -> ColumnScratch {
        self.symbolic.supernodes.scratch()
    }

    /// Columns of K^-1, one scratch for each three `unknowns`. The bits of one do not depend on its
    /// company.
    pub fn solve_columns(
        &self,
        unknowns: &[[usize; 3]],
        needed: &[u32],
        scratch: &mut [ColumnScratch],
    ) {
        let supernodes = &self.symbolic.supernodes;
        supernodes.solve_columns(&self.values, unknowns, needed, scratch);
    }

    /// One unknown in the three columns of a scratch.
    pub fn read_column(&self, scratch: &ColumnScratch, unknown: usize) -> [f64; 3] {
        self.symbolic.supernodes.read(scratch, unknown)
    }

    /// Non-zeros of the factor, padding included.
    pub fn len(&self) -> usize {
        self.values.len()
    }
}

impl NotFactored {
    /// The same of tissue with so many nodes fixed.
    fn of_tissue(self, fixed: usize) -> TissueError {
        match self {
            NotFactored::Indefinite => TissueError::Floating { fixed },
            NotFactored::TooLarge(shortage) => shortage.into(),
            NotFactored::Stopped => TissueError::Stopped,
        }
    }
}

impl From<Indefinite> for NotFactored {
    fn from(_: Indefinite) -> Self {
        NotFactored::Indefinite
    }
}

impl From<Shortage> for NotFactored {
    fn from(shortage: Shortage) -> Self {
        NotFactored::TooLarge(shortage)
    }
}

/// The allocator had no such piece.
fn short(what: &'static str, bytes: usize) -> NotFactored {
    NotFactored::TooLarge(Shortage {
        what,
        needed_bytes: bytes as u64,
        available_bytes: memory::available_bytes().unwrap_or_default(),
    })
}

#[cfg(test)]
mod tests {
    use crate::fem::{Factored, LinearTissue, Material, Materials, TissueError};
    use crate::mesh::slab;
    use sutura_factor::{Cholesky, Lower, Supernodes};

    /// What is needed beside the factor counts before anything of it is computed.
    #[test]
    fn more_than_the_free_memory_is_refused_with_both_figures() {
        let mesh = slab([0.06, 0.05, 0.03], [6, 5, 4]).expect("a slab");
        let soft = Material {
            youngs_modulus_pa: 1e4,
            poisson_ratio: 0.45,
        };
        let bottom: Vec<u32> = (0..42).collect();
        let beside = |bytes| LinearTissue::beside(&mesh, &Materials::from(soft), &bottom, bytes);
        assert!(beside(0).is_ok());
        if sutura_models::memory::available_bytes().is_none() {
            return;
        }
        let most = u64::MAX / 2;
        match beside(most) {
            Err(TissueError::TooLarge(shortage)) => {
                assert!(shortage.needed_bytes > most, "{shortage:?}");
                assert!(shortage.available_bytes < most, "{shortage:?}");
            }
            other => panic!("{other:?}"),
        }
    }

    fn tissue() -> LinearTissue {
        let mesh = slab([0.06, 0.05, 0.03], [6, 5, 4]).expect("a slab");
        let soft = Material {
            youngs_modulus_pa: 1e4,
            poisson_ratio: 0.45,
        };
        let bottom: Vec<u32> = (0..42).collect();
        LinearTissue::new(&mesh, soft, &bottom).expect("tissue")
    }

    const SIDE: usize = 17;
    const N: usize = SIDE * SIDE;

    /// Springs between neighbours on a grid, diagonals included, whose factor has supernodes of one to some twenty columns: its
    /// lower triangle.
    fn grid() -> (Vec<usize>, Vec<usize>, Vec<f64>) {
        let (mut start, mut row, mut values) = (vec![0], Vec::new(), Vec::new());
        for column in 0..N {
            let (x, y) = (column % SIDE, column / SIDE);
            let stiffness = |other: usize| 1.0 + ((column * 31 + other * 17) % 7) as f64;
            row.push(column);
            values.push(80.0);
            let right = (x + 1 < SIDE).then_some(column + 1);
            let down = (y + 1 < SIDE).then_some(column + SIDE);
            let left = down.filter(|_| x > 0).map(|down| down - 1);
            let across = right.and(down).map(|down| down + 1);
            for other in [right, left, down, across].into_iter().flatten() {
                row.push(other);
                values.push(-stiffness(other));
            }
            start.push(row.len());
        }
        (start, row, values)
    }

    /// Our sweeps on packed values against faer's solve on its own, for all unknowns and for groups of them.
    #[test]
    fn sweeps_agree_with_faer() {
        let (column_start, row, values) = grid();
        let pattern = Lower {
            column_start: &column_start,
            row: &row,
        };
        let cholesky = Cholesky::analyse(pattern).expect("memory");
        let mut factor = vec![0.0; cholesky.entries()];
        let mut memory = cholesky.factor_scratch();
        let factored = cholesky.factor(pattern, &values, &mut factor, &mut memory);
        factored.expect("positive definite");
        let mut expected = vec![0.0; N * N];
        expected
            .iter_mut()
            .step_by(N + 1)
            .for_each(|one| *one = 1.0);
        cholesky.solve(&factor, &mut expected, &mut cholesky.solve_scratch(N));

        let supernodes = Supernodes::new(&cholesky).expect("supernodes");
        assert!(supernodes.entries() < factor.len(), "nothing is left out");
        supernodes.pack(&mut factor, &mut supernodes.panel_room());
        factor.truncate(supernodes.entries());

        let near = |found: f64, expected: f64| (found - expected).abs() < 1e-15;
        let mut scratch = supernodes.scratch();
        for (unknown, expected) in expected.chunks_exact(N).enumerate() {
            let mut found = [0.0; N];
            found[unknown] = 1.0;
            supernodes.solve(&factor, &mut found, &mut scratch);
            let agrees = found.iter().zip(expected).all(|(x, y)| near(*x, *y));
            assert!(agrees, "{unknown}");
        }
        let groups: Vec<[usize; 3]> = (0..5).map(|k| [50 * k, 50 * k + 1, 50 * k + 40]).collect();
        let mut columns: Vec<_> = groups.iter().map(|_| supernodes.scratch()).collect();
        let read = [0, 7, N / 3, N - 1];
        let needed = supernodes.needed_for(read.into_iter());
        supernodes.solve_columns(&factor, &groups, &needed, &mut columns);
        for (group, scratch) in groups.iter().zip(&columns) {
            for unknown in read {
                let found = supernodes.read(scratch, unknown);
                for (column, found) in group.iter().zip(found) {
                    assert!(near(found, expected[column * N + unknown]));
                }
            }
        }
    }

    /// Alone, in company, read in few places or everywhere: the same bits.
    #[test]
    fn a_columns_bits_do_not_depend_on_its_company() {
        let tissue = tissue();
        let factor = tissue.factor();
        let n = tissue.unknowns();
        let groups: Vec<[usize; 3]> = (0..8).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let everywhere = factor.needed_for(0..n);
        let few = factor.needed_for([5, n / 2].into_iter());
        assert!(few.len() < everywhere.len(), "nothing is left out");
        let mut together: Vec<_> = (0..8).map(|_| factor.column_scratch()).collect();
        factor.solve_columns(&groups, &everywhere, &mut together);
        let mut alone = [factor.column_scratch()];
        for (group, together) in groups.iter().zip(&together) {
            factor.solve_columns(&[*group], &few, &mut alone);
            for unknown in [5, n / 2] {
                let (a, b) = (
                    factor.read_column(&alone[0], unknown),
                    factor.read_column(together, unknown),
                );
                assert_eq!(a.map(f64::to_bits), b.map(f64::to_bits));
            }
        }
    }
}
