//! Two rods that press on each other: a ball of each, swept along its curve, where the curves are nearest.
//!
//! Entry points: [`Nearest::find`], then [`Press::felt`] for the side that moves. With d from one nearest point to the other, R the sum of
//! radii and k the stiffness of the pair, the force is k (R - D) d/D, the gradient of k (R - D)^2 / 2. Where lines lie along each other
//! no place on them is nearest, and a force would jump from end to end as they turn. So each place is drawn a little to the middle of
//! its rod (Tikhonov 1963): D^2 is the least of |d|^2 + e_1 (a_1 - m_1)^2 + e_2 (a_2 - m_2)^2, which has one place, and that follows the
//! poses without a jump. Friction is a spring of the same stiffness across the normal, whose force a cone bounds: plastic flow,
//! integrated backwards (Simo & Hughes 1998, 1.4).

use super::shape::Rod;
use crate::needle::Curve;
use nalgebra::{Matrix2, Matrix6, Vector2, Vector3, Vector6};

/// What a place at an end of its rod adds to D^2, in squares of R: D is larger there than the distance by half of this part of R.
const EVEN: f64 = 0.002;
/// Steps in which a place on a stretch is looked for, and the part of that at which it is found.
const LOOKS: u32 = 60;
const FOUND: f64 = 1e-15;

/// One of two rods at the place that is nearest to the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Side {
    /// On its curve \[m\], (3).
    pub at: Vector3<f64>,
    /// Unit tangent there, and how that turns along the curve \[1/m\], (3) each.
    along: Vector3<f64>,
    bend: Vector3<f64>,
    /// e of the rod, and whether the place is not one of its ends.
    even: f64,
    is_within: bool,
    radius_m: f64,
}

/// Where two rods are nearest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest {
    pub sides: [Side; 2],
    /// D \[m\].
    pub far_m: f64,
}

/// A place on a rod, the nearest one on another that is straight, and what is least there.
#[derive(Clone, Copy)]
struct Pair {
    alphas: [f64; 2],
    square: f64,
    /// Half of the derivatives of that along the first rod.
    slope: f64,
    curvature: f64,
}

/// A rod, e and the middle.
struct Drawn<'a> {
    curve: &'a Curve,
    front_m: f64,
    even: f64,
}

impl Drawn<'_> {
    fn off(&self, alpha: f64) -> f64 {
        alpha - 0.5 * self.front_m
    }

    /// What is nearest to a place on it, on the straight rod `other`.
    fn pair(&self, alpha: f64, other: &Drawn) -> Pair {
        let (at, along) = (self.curve.at(alpha), self.curve.tangent_at(alpha));
        let line = other.curve.tangent;
        let ahead = line.dot(&(at - other.curve.start));
        let foot = (ahead + other.even * 0.5 * other.front_m) / (1.0 + other.even);
        let beta = foot.clamp(0.0, other.front_m);
        let way = at - other.curve.at(beta);
        let bend = self.curve.inward_at(alpha) * self.curve.curvature_at(alpha);
        let gives = match beta == foot {
            true => line.dot(&along).powi(2) / (1.0 + other.even),
            false => 0.0,
        };
        let drawn = self.even * self.off(alpha).powi(2) + other.even * other.off(beta).powi(2);
        Pair {
            alphas: [alpha, beta],
            square: way.norm_squared() + drawn,
            slope: way.dot(&along) + self.even * self.off(alpha),
            curvature: 1.0 + way.dot(&bend) + self.even - gives,
        }
    }

    /// The nearest place of a stretch to the straight rod `other`.
    fn nearest(&self, [from, to]: [f64; 2], other: &Drawn) -> Pair {
        let (first, last) = (self.pair(from, other), self.pair(to, other));
        if first.slope >= 0.0 {
            return first;
        }
        if last.slope <= 0.0 {
            return last;
        }
        let (mut low, mut high) = (from, to);
        let mut best = self.pair(0.5 * (from + to), other);
        for _ in 0..LOOKS {
            let alpha = best.alphas[0];
            if best.slope > 0.0 {
                high = alpha;
            } else {
                low = alpha;
            }
            let newton = alpha - best.slope / best.curvature;
            let is_good = best.curvature > 0.0 && newton > low && newton < high;
            let next = if is_good { newton } else { 0.5 * (low + high) };
            best = self.pair(next, other);
            if (next - alpha).abs() <= FOUND * self.front_m {
                break;
            }
        }
        best
    }

    fn side(&self, alpha: f64, radius_m: f64) -> Side {
        Side {
            at: self.curve.at(alpha),
            along: self.curve.tangent_at(alpha),
            bend: self.curve.inward_at(alpha) * self.curve.curvature_at(alpha),
            even: self.even,
            is_within: alpha > 0.0 && alpha < self.front_m,
            radius_m,
        }
    }
}

/// Two rods, of which one at least is straight, and which of them is the other.
struct Rods<'a> {
    rods: [&'a Rod; 2],
    drawn: [Drawn<'a>; 2],
    bent: usize,
}

impl<'a> Rods<'a> {
    fn new(rods: [&'a Rod; 2]) -> Self {
        let sum_m = rods[0].radius_m + rods[1].radius_m;
        let drawn = rods.map(|rod| Drawn {
            curve: &rod.curve,
            front_m: rod.front_m,
            even: EVEN * (2.0 * sum_m / rod.front_m).powi(2),
        });
        let bent = usize::from(rods[1].curve.bends());
        Self { rods, drawn, bent }
    }

    fn sides(&self) -> (&Drawn<'a>, &Drawn<'a>) {
        (&self.drawn[self.bent], &self.drawn[1 - self.bent])
    }

    /// What is nearest on each stretch of the one that may bend.
    fn by_stretch(&self) -> impl Iterator<Item = ([f64; 2], Pair)> {
        let (own, other) = self.sides();
        let stretches = self.rods[self.bent].stretches();
        stretches.map(move |stretch| (stretch, own.nearest(stretch, other)))
    }

    fn at(&self, pair: &Pair) -> Nearest {
        let side = |place: usize| {
            let alpha = pair.alphas[usize::from(place != self.bent)];
            self.drawn[place].side(alpha, self.rods[place].radius_m)
        };
        Nearest {
            sides: [side(0), side(1)],
            far_m: pair.square.sqrt(),
        }
    }
}

impl Nearest {
    /// Of two rods, of which one at least is straight. Of several places that are as near, one: a straight rod over an arc that it
    /// crosses twice is nearest to it at one of these.
    pub fn find(rods: [&Rod; 2]) -> Self {
        let rods = Rods::new(rods);
        let (own, other) = rods.sides();
        let mut best = own.pair(0.0, other);
        for (_, found) in rods.by_stretch() {
            if found.square < best.square {
                best = found;
            }
        }
        rods.at(&best)
    }

    /// Every place where they are nearer than beside it, of which one is where they are nearest.
    pub fn visit(both: [&Rod; 2], mut visit: impl FnMut(&Self)) {
        let rods = Rods::new(both);
        let front_m = rods.sides().0.front_m;
        for ([from, to], found) in rods.by_stretch() {
            let alpha = found.alphas[0];
            // What is nearest at the edge of a stretch is nearer in the next.
            let goes_on = (alpha == from && from > 0.0)
                || (alpha == to && to < front_m && found.slope != 0.0);
            if !goes_on {
                visit(&rods.at(&found));
            }
        }
    }

    /// How deep they are in each other \[m\]; below zero as far as they are apart.
    pub fn depth_m(&self) -> f64 {
        self.radii_m() - self.far_m
    }

    /// Whether they press, or are apart by less than both radii.
    pub fn is_close(&self) -> bool {
        -self.depth_m() < self.radii_m()
    }

    /// Both radii \[m\].
    fn radii_m(&self) -> f64 {
        self.sides[0].radius_m + self.sides[1].radius_m
    }

    /// From the second to the first.
    pub fn way(&self) -> Vector3<f64> {
        self.sides[0].at - self.sides[1].at
    }
}

/// Two rods that press, or would if they were nearer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Press {
    pub near: Nearest,
    pub stiffness_n_per_m: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
    /// Points fixed to the one and to the other, which were at one place but for how the touch was stretched \[m\]; nothing where they did
    /// not press before.
    pub sticks: Option<[Vector3<f64>; 2]>,
}

impl Press {
    fn depth_m(&self) -> f64 {
        self.near.depth_m().max(0.0)
    }

    /// Normal force on the first one \[N\]; none where both curves go through one place, which has no normal.
    fn normal_n(&self) -> Vector3<f64> {
        let far_m = self.near.far_m.max(f64::MIN_POSITIVE);
        self.near.way() * (self.stiffness_n_per_m * self.depth_m() / far_m)
    }

    /// How far the touch is stretched across the normal, of the first one from the second \[m\], and whether that is as far as friction lets
    /// it.
    pub fn stretch_m(&self) -> (Vector3<f64>, bool) {
        let normal = self.near.way().try_normalize(0.0);
        let (Some([one, other]), Some(normal)) = (self.sticks, normal) else {
            return (Vector3::zeros(), false);
        };
        let way = one - other;
        let across = way - normal * normal.dot(&way);
        let most_m = self.friction * self.normal_n().norm() / self.stiffness_n_per_m;
        let long_m = across.norm();
        if long_m > most_m {
            (across * (most_m / long_m), true)
        } else {
            (across, false)
        }
    }

    /// Where they press \[m\].
    pub fn place_m(&self) -> Vector3<f64> {
        let [one, other] = &self.near.sides;
        let part = other.radius_m / (one.radius_m + other.radius_m);
        other.at + self.near.way() * part
    }

    /// Stored in it \[J\].
    pub fn stored_j(&self) -> f64 {
        let (stretch_m, _) = self.stretch_m();
        let square = self.depth_m().powi(2) + stretch_m.norm_squared();
        0.5 * self.stiffness_n_per_m * square
    }

    /// Where one of the two is pressed on \[m\], and what the force on it is per force of the pair: nearly the normal.
    pub fn pushes(&self, own: usize) -> (Vector3<f64>, Vector3<f64>) {
        let way = self.near.way() / self.near.far_m.max(f64::MIN_POSITIVE);
        let sign = if own == 0 { 1.0 } else { -1.0 };
        (self.near.sides[own].at, way * sign)
    }

    /// Force and moment about `grip` on one of the two, and their derivative by left increments of its pose about that, (6) and (6 x 6).
    /// The other one stays. Of two that are apart, the derivative just after they touch.
    pub fn felt(&self, own: usize, grip: &Vector3<f64>) -> (Vector6<f64>, Matrix6<f64>) {
        let sign = if own == 0 { 1.0 } else { -1.0 };
        let (stretch_m, _) = self.stretch_m();
        let force = (self.normal_n() - stretch_m * self.stiffness_n_per_m) * sign;
        let arm = self.place_m() - grip;
        let moment = arm.cross(&force);
        let mut derivative = Matrix6::zeros();
        for pose in 0..6 {
            let unit = |axis: usize| Vector3::ith(axis % 3, 1.0);
            let (shift, turn) = match pose < 3 {
                true => (unit(pose), Vector3::zeros()),
                false => (Vector3::zeros(), unit(pose)),
            };
            let (change, moved) = self.change(own, grip, (&shift, &turn));
            let turned = (moved - shift).cross(&force) + arm.cross(&change);
            derivative
                .fixed_view_mut::<3, 1>(0, pose)
                .copy_from(&change);
            derivative
                .fixed_view_mut::<3, 1>(3, pose)
                .copy_from(&turned);
        }
        let [f, m] = [force, moment];
        (Vector6::new(f.x, f.y, f.z, m.x, m.y, m.z), derivative)
    }

    /// How the force on one of the two and the place where they press follow a motion of it.
    fn change(
        &self,
        own: usize,
        grip: &Vector3<f64>,
        (shift, turn): (&Vector3<f64>, &Vector3<f64>),
    ) -> (Vector3<f64>, Vector3<f64>) {
        let [a, b] = [&self.near.sides[own], &self.near.sides[1 - own]];
        let (way, far_m) = (a.at - b.at, self.near.far_m);
        let Some(normal) = way.try_normalize(0.0) else {
            return (Vector3::zeros(), *shift);
        };
        let moves = |at: &Vector3<f64>| shift + turn.cross(&(at - grip));
        let moved = moves(&a.at);
        let slid = slides([a, b], &way, (&moved, turn));
        let changed = moved + a.along * slid.x - b.along * slid.y;
        let (stiff, depth_m) = (self.stiffness_n_per_m, self.depth_m());
        // What is least changes by the motion alone.
        let farther_m = way.dot(&moved) / far_m;
        let turns = (changed - way * (farther_m / far_m)) * depth_m;
        let pressed = (turns - way * farther_m) * (stiff / far_m);
        let place = b.along * slid.y + changed * (b.radius_m / (a.radius_m + b.radius_m));
        let Some(sticks) = self.sticks else {
            return (pressed, place);
        };
        let off = sticks[own] - sticks[1 - own];
        let across = |way: Vector3<f64>| way - normal * normal.dot(&way);
        let tilt = across(changed) / way.norm();
        let follows =
            across(moves(&sticks[own])) - tilt * normal.dot(&off) - normal * tilt.dot(&off);
        let (stretch_m, slips) = self.stretch_m();
        let rubbed = match (slips, across(off).try_normalize(0.0)) {
            (true, Some(along)) => {
                let more_n = self.friction * normal.dot(&pressed);
                let part = stretch_m.norm() / across(off).norm();
                let aside = follows - along * along.dot(&follows);
                along * more_n + aside * (part * stiff)
            }
            _ => follows * stiff,
        };
        (pressed - rubbed, place)
    }
}

/// How the nearest places slide along both curves as the first rod moves by `moved` where it is nearest and turns by `turn`.
fn slides(
    [a, b]: [&Side; 2],
    way: &Vector3<f64>,
    (moved, turn): (&Vector3<f64>, &Vector3<f64>),
) -> Vector2<f64> {
    let own = 1.0 + a.even + way.dot(&a.bend);
    let other = 1.0 + b.even - way.dot(&b.bend);
    let both = -a.along.dot(&b.along);
    let leads = Vector2::new(
        -moved.dot(&a.along) - way.dot(&turn.cross(&a.along)),
        moved.dot(&b.along),
    );
    match (a.is_within, b.is_within) {
        (true, true) => {
            let inverse = Matrix2::new(own, both, both, other).try_inverse();
            inverse.map_or_else(Vector2::zeros, |inverse| inverse * leads)
        }
        (true, false) => Vector2::new(leads.x / own, 0.0),
        (false, true) => Vector2::new(0.0, leads.y / other),
        (false, false) => Vector2::zeros(),
    }
}
