//! How the forces of what tools that rub touch follow them.
//!
//! Entry points: [`Touched::replace`] for the derivative of the balance, [`Touched::load`] for a motion of the tool; of tools
//! that do not rub [`super::Load`] knows. With p the
//! force on the tissue, x the vertex, n the normal, H the Hessian of the distance, s the way by which the tool has run
//! ahead, and a motion `dX` of the tool there that turns by theta: what sticks has `dx = dX`; what slides has `n.dx = n.dX`
//! and keeps `p = lambda (n + mu s/|s|)` while `dn = H (dx - dX) + theta x n` turns both. Unknown is
//! `dp = -(frame) dLambda`, and `dx = W dp`.

use super::{Contact, ToolContacts, TouchingTools};
use nalgebra::{Matrix2, Vector2, Vector3};

/// A slip by less is none \[m\].
const NO_WAY_M: f64 = 1e-10;

/// A contact in a derivative.
pub(crate) struct Touched {
    /// The first of its three rows.
    pub row: usize,
    pub at_m: Vector3<f64>,
    /// Where on the tool its normal row and its others hold it \[m\].
    moves_at_m: Vector3<f64>,
    sticks_at_m: Vector3<f64>,
    pub frame: [Vector3<f64>; 3],
    normal: Vector3<f64>,
    /// On the tissue \[N\].
    pub force_n: Vector3<f64>,
    law: Law,
}

enum Law {
    Sticks,
    Slides(Slide),
}

/// `-dLambda_i - mu s_i dLambda_0 = B (theta x n - h dX) + D m + (B h - D) dx`, across the normal; m is the motion of the place
/// where it sticks.
struct Slide {
    /// mu s/|s|.
    along: Vector2<f64>,
    turns: Matrix2<f64>,
    bends: Matrix2<f64>,
    swings: Matrix2<f64>,
    /// Whether the vertex itself does not move.
    is_wall: bool,
}

impl Slide {
    fn follows(&self) -> Matrix2<f64> {
        if self.is_wall {
            return -self.swings;
        }
        self.turns * self.bends - self.swings
    }
}

impl Touched {
    /// A contact that presses; nothing where the tool does not rub.
    pub fn new(tools: &TouchingTools, state: &ToolContacts, contact: &Contact) -> Option<Self> {
        let placement = state.placements[contact.tool as usize].as_ref()?;
        let solid = tools.solid(contact.tool as usize, placement);
        let touch = solid.touch(&contact.at_m)?;
        let tool = &tools.each[contact.tool as usize].tool;
        let frame = contact.frame();
        let pressing = contact.lambda_n[0];
        if tool.is_smooth() {
            return None;
        }
        let across = |v: &Vector3<f64>| Vector2::new(frame[1].dot(v), frame[2].dot(v));
        let flat = across(&contact.ahead_m);
        let law = if !contact.slips {
            Law::Sticks
        } else {
            // What has no way is rubbed along the force on it.
            let way = flat.norm().max(NO_WAY_M);
            let along = if way > NO_WAY_M {
                flat
            } else {
                across(&contact.force_n())
            };
            let direction = along.try_normalize(0.0).unwrap_or_default();
            let aside = Vector2::new(-direction.y, direction.x);
            let mu = tool.friction;
            let swing = aside * aside.transpose() * (pressing * mu / way);
            let mut bends = Matrix2::zeros();
            for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                bends[(i, j)] = frame[1 + i].dot(&(touch.curvature * frame[1 + j]));
            }
            let turns = (Matrix2::identity() + direction * direction.transpose() * (mu * mu))
                * pressing
                - swing * contact.normal.dot(&contact.ahead_m);
            Law::Slides(Slide {
                along: direction * mu,
                turns,
                bends,
                swings: swing,
                is_wall: contact.is_wall,
            })
        };
        Some(Self {
            row: contact.row as usize,
            at_m: contact.at_m,
            moves_at_m: contact.at_m,
            sticks_at_m: if contact.is_wall && contact.slips {
                contact.at_m + contact.ahead_m + contact.stretch_m()
            } else {
                contact.at_m + contact.ahead_m
            },
            frame,
            normal: contact.normal,
            force_n: contact.force_n(),
            law,
        })
    }

    /// A point of a needle that lies on a surface which stays while it is solved for: the first of its three rows and their
    /// directions, where it is, the force on the tissue \[N\], the needle's way ahead of the tissue \[m\] where it slips, and
    /// Coulomb's coefficient.
    pub fn lying(
        (row, frame): (usize, [Vector3<f64>; 3]),
        (at_m, on_needle_m): (Vector3<f64>, Vector3<f64>),
        force_n: Vector3<f64>,
        slipped: Option<(Vector3<f64>, f64)>,
    ) -> Self {
        let across = |v: &Vector3<f64>| Vector2::new(frame[1].dot(v), frame[2].dot(v));
        let law = slipped.map_or(Law::Sticks, |(ahead_m, friction)| {
            let flat = across(&ahead_m);
            let way = flat.norm().max(NO_WAY_M);
            let direction = flat.try_normalize(NO_WAY_M);
            let direction = direction
                .or_else(|| across(&force_n).try_normalize(0.0))
                .unwrap_or_default();
            let aside = Vector2::new(-direction.y, direction.x);
            let pressing = -force_n.dot(&frame[0]);
            Law::Slides(Slide {
                along: direction * friction,
                turns: Matrix2::zeros(),
                bends: Matrix2::zeros(),
                swings: aside * aside.transpose() * (pressing * friction / way),
                is_wall: false,
            })
        });
        Self {
            row,
            at_m,
            moves_at_m: on_needle_m,
            sticks_at_m: on_needle_m,
            frame,
            normal: -frame[0],
            force_n,
            law,
        }
    }

    /// Puts the law of what slides in place of its rows of the compliance `w`, in `matrix` (n x n).
    pub fn replace(&self, matrix: &mut [f64], w: &[f64], n: usize) {
        let Law::Slides(slide) = &self.law else {
            return;
        };
        let follows = slide.follows();
        for (column, (own, w)) in matrix
            .chunks_exact_mut(n)
            .zip(w.chunks_exact(n))
            .enumerate()
        {
            let moved = Vector2::new(w[self.row + 1], w[self.row + 2]);
            let law = follows * moved;
            for axis in 0..2 {
                let row = self.row + 1 + axis;
                let force = f64::from(u8::from(column == row));
                let normal = f64::from(u8::from(column == self.row));
                own[row] = force + slide.along[axis] * normal - law[axis];
            }
        }
    }

    /// Whether [`Self::replace`] does anything.
    pub fn slides(&self) -> bool {
        matches!(self.law, Law::Slides(_))
    }

    /// Where something else moves its rows by `-moved`: right-hand sides of its law, in the place of these.
    pub fn follow(&self, moved: &mut [f64]) {
        if let Law::Slides(slide) = &self.law {
            let across = Vector2::new(moved[self.row + 1], moved[self.row + 2]);
            let law = slide.follows() * across * -1.0;
            moved[self.row + 1..self.row + 3].copy_from_slice(law.as_slice());
        }
    }

    /// Right-hand sides of its rows for a motion of its tool, whose grip shifts and turns.
    pub fn load(&self, grip: &Vector3<f64>, shift: &Vector3<f64>, turn: &Vector3<f64>) -> [f64; 3] {
        let motion = |at: &Vector3<f64>| shift + turn.cross(&(at - grip));
        let moved = motion(&self.moves_at_m);
        let normal = -self.frame[0].dot(&moved);
        let across = |v: &Vector3<f64>| Vector2::new(self.frame[1].dot(v), self.frame[2].dot(v));
        match &self.law {
            Law::Sticks => {
                let flat = across(&motion(&self.sticks_at_m));
                [normal, -flat.x, -flat.y]
            }
            Law::Slides(slide) => {
                let turned = across(&turn.cross(&self.normal)) - slide.bends * across(&moved);
                let load = slide.turns * turned + slide.swings * across(&motion(&self.sticks_at_m));
                [normal, -load.x, -load.y]
            }
        }
    }
}
