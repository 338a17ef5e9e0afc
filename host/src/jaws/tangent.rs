//! How the forces of points that jaws hold follow their tool.
//!
//! Entry points: [`Gripped::replace`] for the derivative of the balance, [`Gripped::load`] for a motion of the tool. With f the
//! force on the tissue, x where its point is, (n, a, b) the frame of the pads, and a motion `dX` of the tool at x that turns by
//! theta: what sticks has `dx = dX`. What slides has `n.dx = n.dX`, and keeps `R d` in the plane, d along the way s by which the
//! tool has run ahead: with `ds = dX - dx` there, `df = theta x f + R/|s| (I - d d') ds`. Unknown is `df = -(n a b) dLambda`,
//! and `dx = W df`.

use nalgebra::{Matrix2, Vector2, Vector3};

/// A slip by less is none \[m\].
const NO_WAY_M: f64 = 1e-10;

/// A point of the present rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gripped {
    /// Which jaws, and which of their points.
    pub jaws: usize,
    pub(super) place: usize,
    pub anchor: usize,
    /// The first of its three rows.
    pub row: usize,
    /// Across the pads, along their axis, along the hinge.
    pub frame: [Vector3<f64>; 3],
    /// By how much its rows give way by themselves \[m/N\].
    pub soft: [f64; 3],
    /// At the last balance: where it was \[m\], the force on the tissue \[N\], and how far the tool ran ahead in the pads' plane
    /// \[m\].
    pub at_m: Vector3<f64>,
    pub force_n: Vector3<f64>,
    pub ahead_m: Vector2<f64>,
    pub slips: bool,
}

impl Gripped {
    /// `R/|s| (I - d d')` \[N/m\], of what slips.
    fn swings(&self) -> Option<Matrix2<f64>> {
        if !self.slips {
            return None;
        }
        let flat = Vector2::new(
            self.frame[1].dot(&self.force_n),
            self.frame[2].dot(&self.force_n),
        );
        let d = flat.try_normalize(0.0)?;
        let way = self.ahead_m.norm().max(NO_WAY_M);
        Some((Matrix2::identity() - d * d.transpose()) * (flat.norm() / way))
    }

    /// Puts the law of what slips in place of its rows of the compliance `w`, in `matrix` (n x n).
    pub fn replace(&self, matrix: &mut [f64], w: &[f64], n: usize) {
        let Some(swings) = self.swings() else {
            return;
        };
        let first = self.row + 1;
        let columns = matrix.chunks_exact_mut(n).zip(w.chunks_exact(n));
        for (column, (own, w)) in columns.enumerate() {
            let law = swings * Vector2::new(w[first], w[first + 1]);
            for axis in 0..2 {
                own[first + axis] = f64::from(u8::from(column == first + axis)) + law[axis];
            }
        }
    }

    /// Where something else moves its rows by `-moved`: right-hand sides of its law, in the place of these.
    pub fn follow(&self, moved: &mut [f64]) {
        if let Some(swings) = self.swings() {
            let first = self.row + 1;
            let law = swings * Vector2::new(moved[first], moved[first + 1]);
            moved[first..first + 2].copy_from_slice(law.as_slice());
        }
    }

    /// Right-hand sides of its rows for a motion of its tool, whose grip shifts and turns.
    pub fn load(&self, grip: &Vector3<f64>, shift: &Vector3<f64>, turn: &Vector3<f64>) -> [f64; 3] {
        let moved = shift + turn.cross(&(self.at_m - grip));
        let turned = turn.cross(&self.force_n);
        let mut load = [0.0; 3];
        for (axis, load) in load.iter_mut().enumerate() {
            let along = self.frame[axis];
            *load = -along.dot(&moved) - self.soft[axis] * along.dot(&turned);
        }
        if let Some(swings) = self.swings() {
            let law = swings * Vector2::new(load[1], load[2]);
            for axis in 1..3 {
                load[axis] = law[axis - 1] - self.frame[axis].dot(&turned);
            }
        }
        load
    }
}
