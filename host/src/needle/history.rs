//! Which faces of the mesh a needle goes through, from its end to its tip.
//!
//! Entry point: [`History`]. Source: Younes 2021, 3.2.1, the history list; it keeps faces where the thesis
//! keeps cells, as its remark on inside-out punctures asks for.
//!
//! Always, for crossings i and i + 1 and a needle of a given length:
//! - alpha(i) <= alpha(i + 1) <= length; below zero is behind the end, where a thread would follow;
//! - the cell that i leads to is the cell that i + 1 comes from, or both are the outside;
//! - weights are not negative and sum to 1.
//!
//! [`History::check`] says so. Only [`History::set_alpha`] and [`History::shift`] with a bad number can
//! break it.

use crate::mesh::{HalfFace, HalfFaces};
use serde::Serialize;

/// One passage through one face of the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Crossing {
    /// Half-face of a cell that exists: of the cell that the tip came from, or of the one that it went
    /// into if it came from outside.
    pub face: HalfFace,
    /// Whether the tip came from outside through it.
    pub enters: bool,
    /// Where on the face: barycentric on `mesh.vertices(face)`. Fixed for the crossing's life.
    pub weights: [f64; 3],
    /// Where on the needle \[m\], from its end.
    pub alpha: f64,
}

impl Crossing {
    /// The cell before it on the way from end to tip; `None` outside.
    pub fn from(&self) -> Option<u32> {
        (!self.enters).then(|| self.face.cell())
    }

    /// The cell after it; `None` outside.
    pub fn to(&self, mesh: &HalfFaces) -> Option<u32> {
        self.ahead(mesh).map(HalfFace::cell)
    }

    /// The same face as a half-face of the cell after it; `None` if that is the outside.
    pub fn ahead(&self, mesh: &HalfFaces) -> Option<HalfFace> {
        if self.enters {
            Some(self.face)
        } else {
            mesh.opposite(self.face)
        }
    }

    /// Whether the needle leaves the tissue through it.
    pub fn leaves(&self, mesh: &HalfFaces) -> bool {
        !self.enters && mesh.opposite(self.face).is_none()
    }
}

/// How a list is not what [`History`] promises; the number is that of the crossing, from the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Broken {
    /// Its face is none of the mesh, or is entered from outside without lying on the boundary.
    Face(usize),
    /// It does not come from the cell that the one before it leads to.
    Chain(usize),
    /// Its alpha is below that of the one before it, beyond the tip, or no number.
    Alpha(usize),
    /// Its weights are negative or do not sum to 1.
    Weights(usize),
}

/// Crossings of one needle, from its end to its tip; nothing is allocated after [`History::new`].
#[derive(Debug, Default, Serialize)]
pub struct History {
    /// Cell before the first crossing; `None` outside.
    before: Option<u32>,
    crossings: Vec<Crossing>,
    most: usize,
}

impl History {
    /// Of a needle outside, with room for `most` crossings.
    pub fn new(most: usize) -> Self {
        Self {
            before: None,
            crossings: Vec::with_capacity(most),
            most,
        }
    }

    /// From end to tip.
    pub fn crossings(&self) -> &[Crossing] {
        &self.crossings
    }

    /// Those of the needle itself, without what lies behind its end.
    pub fn on_needle(&self) -> &[Crossing] {
        &self.crossings[self.behind(0.0)..]
    }

    /// How many crossings there is room for.
    pub fn most(&self) -> usize {
        self.most
    }

    /// The cell before the first crossing; `None` outside.
    pub fn before(&self) -> Option<u32> {
        self.before
    }

    /// The cell that the tip is in; `None` outside.
    pub fn tip_cell(&self, mesh: &HalfFaces) -> Option<u32> {
        self.crossings.last().map_or(self.before, |c| c.to(mesh))
    }

    /// The cell that the end is in; `None` outside.
    pub fn end_cell(&self, mesh: &HalfFaces) -> Option<u32> {
        match self.behind(0.0).checked_sub(1) {
            Some(last) => self.crossings[last].to(mesh),
            None => self.before,
        }
    }

    /// Adds a crossing at the tip, not behind the last one; `false` if there is no room.
    pub fn push(&mut self, mut crossing: Crossing) -> bool {
        let room = self.crossings.len() < self.most;
        if room {
            if let Some(last) = self.crossings.last() {
                crossing.alpha = crossing.alpha.max(last.alpha);
            }
            self.crossings.push(crossing);
        }
        room
    }

    /// Adds a crossing at the end, not beyond the first one; `false` if there is no room.
    pub fn push_front(&mut self, mut crossing: Crossing) -> bool {
        let room = self.crossings.len() < self.most;
        if room {
            if let Some(first) = self.crossings.first() {
                crossing.alpha = crossing.alpha.min(first.alpha);
            }
            self.before = crossing.from();
            self.crossings.insert(0, crossing);
        }
        room
    }

    /// Takes the crossing next to the tip away.
    pub fn pop(&mut self) -> Option<Crossing> {
        self.crossings.pop()
    }

    /// Takes away what the tip has been withdrawn from; says how many crossings.
    pub fn pop_beyond(&mut self, length: f64) -> usize {
        let had = self.crossings.len();
        while self.crossings.last().is_some_and(|c| c.alpha > length) {
            self.crossings.pop();
        }
        had - self.crossings.len()
    }

    /// Forgets crossings with a smaller alpha: 0 for a needle without a thread. Says how many.
    pub fn drop_behind(&mut self, mesh: &HalfFaces, alpha: f64) -> usize {
        let count = self.behind(alpha);
        if let Some(last) = self.crossings[..count].last() {
            self.before = last.to(mesh);
        }
        self.crossings.drain(..count);
        count
    }

    /// Moves a crossing along the needle; the caller keeps their order.
    pub fn set_alpha(&mut self, crossing: usize, alpha: f64) {
        if let Some(crossing) = self.crossings.get_mut(crossing) {
            crossing.alpha = alpha;
        }
    }

    /// Adds to every alpha \[m\].
    pub fn shift(&mut self, by: f64) {
        for crossing in &mut self.crossings {
            crossing.alpha += by;
        }
    }

    /// As of a way that begins in the cell `before`, or outside, with `last` as its only crossing.
    pub fn restart(&mut self, before: Option<u32>, last: Option<Crossing>) {
        self.before = before;
        self.crossings.clear();
        self.crossings.extend(last);
    }

    /// As of a needle outside.
    pub fn clear(&mut self) {
        self.before = None;
        self.crossings.clear();
    }

    /// Looks at everything that the list promises.
    ///
    /// # Errors
    /// The first promise that is broken.
    pub fn check(&self, mesh: &HalfFaces, length: f64) -> Result<(), Broken> {
        let (mut cell, mut alpha) = (self.before, f64::NEG_INFINITY);
        for (place, crossing) in self.crossings.iter().enumerate() {
            let known = (crossing.face.cell() as usize) < mesh.cells().len();
            if !known || (crossing.enters && mesh.opposite(crossing.face).is_some()) {
                return Err(Broken::Face(place));
            }
            if crossing.from() != cell {
                return Err(Broken::Chain(place));
            }
            if !(alpha <= crossing.alpha && crossing.alpha <= length) {
                return Err(Broken::Alpha(place));
            }
            let sum: f64 = crossing.weights.iter().sum();
            // Rounding of three products; not a number fails.
            let sound = (sum - 1.0).abs() <= 1e-14 && crossing.weights.iter().all(|w| *w >= 0.0);
            if !sound {
                return Err(Broken::Weights(place));
            }
            (cell, alpha) = (crossing.to(mesh), crossing.alpha);
        }
        Ok(())
    }

    /// How many crossings have a smaller alpha.
    fn behind(&self, alpha: f64) -> usize {
        self.crossings.partition_point(|c| c.alpha < alpha)
    }
}

/// With the same room, so that a copy does not allocate later either.
impl Clone for History {
    fn clone(&self) -> Self {
        let mut copy = Self::new(self.most);
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, source: &Self) {
        self.before = source.before;
        self.most = source.most;
        self.crossings.clear();
        self.crossings.reserve_exact(source.most);
        self.crossings.extend_from_slice(&source.crossings);
    }
}

impl PartialEq for History {
    fn eq(&self, other: &Self) -> bool {
        self.before == other.before && self.crossings == other.crossings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three cells in a row: 0 to 2 by the faces that they share.
    fn row() -> HalfFaces {
        let cells = vec![[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]];
        HalfFaces::new(6, cells).expect("a row of cells")
    }

    /// Into cell 0, through the others, and out of cell 2.
    fn through(mesh: &HalfFaces) -> History {
        let face = |cell, corner| mesh.half_face(cell, corner).expect("a face");
        let faces = [
            (face(0, 3), true),
            (face(0, 0), false),
            (face(1, 0), false),
            (face(2, 0), false),
        ];
        let mut history = History::new(4);
        for (place, (face, enters)) in faces.into_iter().enumerate() {
            assert!(history.push(Crossing {
                face,
                enters,
                weights: [0.25, 0.75, 0.0],
                alpha: 0.125 * place as f64,
            }));
        }
        history
    }

    #[test]
    fn cells_are_those_between_the_crossings() {
        let mesh = row();
        let mut history = through(&mesh);
        assert_eq!(history.check(&mesh, 0.375), Ok(()));
        assert!(history.crossings()[3].leaves(&mesh) && !history.crossings()[2].leaves(&mesh));
        assert!(
            !history.push(history.crossings()[0]),
            "there is room for four"
        );
        history.shift(-0.2);
        assert_eq!(history.end_cell(&mesh), Some(1));
        assert_eq!(history.on_needle().len(), 2);
        assert_eq!(history.pop_beyond(0.1), 1);
        assert_eq!(history.tip_cell(&mesh), Some(2));
        assert_eq!(history.drop_behind(&mesh, 0.0), 2);
        assert_eq!((history.before(), history.crossings().len()), (Some(1), 1));
        assert_eq!(history.check(&mesh, 0.375), Ok(()));
        assert!(history.pop().is_some());
        assert_eq!(
            (history.tip_cell(&mesh), history.end_cell(&mesh)),
            (Some(1), Some(1))
        );
    }

    #[test]
    fn what_comes_later_is_not_put_before() {
        let mesh = row();
        let mut history = through(&mesh);
        let last = history.pop().expect("four");
        assert!(history.push(Crossing { alpha: 0.2, ..last }));
        assert_eq!(history.crossings()[3].alpha, history.crossings()[2].alpha);
    }

    #[test]
    fn every_promise_is_looked_at() {
        let mesh = row();
        let broken = |spoil: fn(&mut Vec<Crossing>)| {
            let mut history = through(&mesh);
            spoil(&mut history.crossings);
            history
                .check(&mesh, 0.375)
                .expect_err("something is broken")
        };
        let inner = |all: &mut Vec<Crossing>| all[0].face = all[1].face;
        assert_eq!(broken(inner), Broken::Face(0));
        assert_eq!(broken(|all| all[2].enters = true), Broken::Face(2));
        assert_eq!(broken(|all| all.swap(1, 2)), Broken::Chain(1));
        assert_eq!(broken(|all| all[1].alpha = -0.1), Broken::Alpha(1));
        assert_eq!(broken(|all| all[3].alpha = 0.38), Broken::Alpha(3));
        assert_eq!(broken(|all| all[0].alpha = f64::NAN), Broken::Alpha(0));
        assert_eq!(
            broken(|all| all[2].weights = [0.5, 0.6, -0.1]),
            Broken::Weights(2)
        );
        assert_eq!(broken(|all| all[2].weights[0] += 1e-12), Broken::Weights(2));
        assert_eq!(
            broken(|all| all[2].weights[0] = f64::NAN),
            Broken::Weights(2)
        );
        assert_eq!(
            HalfFaces::new(4, vec![[0, 1, 2, 3]]).map(|one| through(&mesh).check(&one, 0.375)),
            Ok(Err(Broken::Face(2)))
        );
    }
}
