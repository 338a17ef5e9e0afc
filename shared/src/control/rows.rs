//! Contact rows: the local contact problem, solved anew at the pose of every tick.
//!
//! Entry points: [`ContactRows::unpack`], [`ContactRows::adopt`] when a frame takes the place of another,
//! [`ContactRows::solve`] every tick. Projected Gauss-Seidel, a contact at a time (Saupin, Duriez and Cotin 2008;
//! Jourdan, Alart and Jean 1998), with a fixed number of sweeps that start from the last tick's multipliers.
//! Rows are scaled by d = W_ii^(-1/2), the tangents of a cone by the largest eigenvalue of their block: then
//! delta~ = d delta and lambda~ = lambda / d are of one unit, and a step of a row needs no division.

use super::laws::Cone;
use crate::math::{Vec3, clamp, dot, max, min};
use crate::wire::ValidRows;
use crate::wire::message::{MAX_ROWS, Row, RowKind};
use crate::wire::validate::MAX_WRENCH;

/// Sweeps of a tick. All in one direction: from multipliers that are a tick old, sweeps to and fro lag ten to a hundred
/// times as far behind on patches of 24 rows, and nonlinear conjugate gradients (Silcowitz, Niebe and Erleben
/// 2010) up to ten times.
const SWEEPS: u32 = 14;
/// Scaled residual above which rows are not solved well enough to be felt: a twentieth of the largest drive.
pub(super) const MAX_RESIDUAL: f32 = 0.05;
/// In place of the residual of rows that no tick has solved yet.
const UNSOLVED: f32 = -1.0;
/// Numbers of a row that are worked on at a time; rows are filled up with zeros.
const LANES: usize = 8;
/// Largest way and turn \[m, rad\] for which rows are solved: twice the reach of any console, and more than any turn.
const MAX_WAY: f32 = 20.0;
/// What a multiplier counts for in the scale of the residual: rounding of f32 over some tens of terms.
const ROUNDING: f32 = 1e-6;

/// Sum of the host's multipliers below which nothing presses \[N\].
const LEAST_N: f32 = 1e-3;
/// Part of the sum of all normal forces' magnitudes that their sum has at least: what embraces the tool has no cone.
const LEAST_PART: f32 = 0.5;

/// What the rows say at a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowsForce {
    /// Change of the wrench since the frame's \[N, N m\], (6): M dx + J' (lambda - lambda of the host). Without
    /// the skew part, which the moment makes.
    pub change: [f32; 6],
    /// How far the multipliers are from solving the rows: the largest violation of a row, scaled, as a part of the
    /// largest drive (penetration without forces). The largest number there is if they could not be solved.
    pub residual: f32,
}

/// A contact: its normal row, and its two tangents if it has friction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Touch {
    id: u32,
    /// Its normal row.
    row: u8,
    /// Coulomb's coefficient between scaled multipliers; 0 without tangents.
    friction: f32,
    /// Largest scaled multiplier of the normal.
    limit: f32,
    /// Direction in which the gap opens, unit vector of J's linear part, (3).
    opens: [f32; 3],
    /// From the middle of the tool's curvature to the tissue \[m\]; 0 of a flat tool.
    reach_m: f32,
}

/// What carries over from one frame's rows to the next.
struct Known {
    touching: u8,
    touches: [Touch; MAX_ROWS],
    lambda: [f32; MAX_ROWS],
    scale: [f32; MAX_ROWS],
    residual: f32,
}

/// The rows of one tool, unpacked; none is the default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactRows {
    /// Console time that was solved for \[us\].
    console_time_us: u64,
    tool: u8,
    /// How many rows there are, and how many contacts.
    count: u8,
    touching: u8,
    touches: [Touch; MAX_ROWS],
    /// M, packed upper triangle by rows \[N/m, N, N m/rad\].
    held: [f32; 21],
    /// Scaled W, symmetric, (24 x 24) \[1\].
    compliance: [[f32; MAX_ROWS]; MAX_ROWS],
    /// Scaled J, (24 x 6) \[N^1/2 m^-1/2, N^1/2 m^1/2\].
    jacobian: [[f32; 6]; MAX_ROWS],
    /// d, (24) \[(N/m)^1/2\].
    scale: [f32; MAX_ROWS],
    /// Scaled: delta at the frame's pose without multipliers, the host's multipliers, \[(N m)^1/2\].
    free: [f32; MAX_ROWS],
    host: [f32; MAX_ROWS],
    /// Scaled: the multipliers of the last tick, and where tangents stick.
    lambda: [f32; MAX_ROWS],
    anchor: [f32; MAX_ROWS],
    /// The host's anchors: how far tangents slipped between the state's pose and the frame's.
    told: [f32; MAX_ROWS],
    /// Friction cone of all of it at the frame's pose; none where nothing rubs.
    cone: Option<Cone>,
    /// What the last solve left; negative before a first one that may start from the host's multipliers.
    residual: f32,
}

/// What is left of a contact's rows: the largest violation, scaled, and how far it slips.
struct Left {
    off: f32,
    slip: Option<[f32; 2]>,
}

impl Default for ContactRows {
    fn default() -> Self {
        ContactRows::NONE
    }
}

impl ContactRows {
    /// No rows.
    pub const NONE: ContactRows = ContactRows {
        console_time_us: 0,
        tool: 0,
        count: 0,
        touching: 0,
        touches: [Touch {
            id: 0,
            row: 0,
            friction: 0.0,
            limit: 0.0,
            opens: [0.0; 3],
            reach_m: 0.0,
        }; MAX_ROWS],
        held: [0.0; 21],
        compliance: [[0.0; MAX_ROWS]; MAX_ROWS],
        jacobian: [[0.0; 6]; MAX_ROWS],
        scale: [0.0; MAX_ROWS],
        free: [0.0; MAX_ROWS],
        host: [0.0; MAX_ROWS],
        lambda: [0.0; MAX_ROWS],
        anchor: [0.0; MAX_ROWS],
        told: [0.0; MAX_ROWS],
        cone: None,
        residual: 0.0,
    };

    /// Unpacks a frame: W full and scaled, multipliers and anchors as the host has them. Costs as much as some
    /// sweeps, and is not for the tick.
    pub fn unpack(frame: &ValidRows) -> ContactRows {
        let mut rows = ContactRows::NONE;
        rows.unpack_from(frame);
        rows
    }

    /// [`unpack`](Self::unpack) in place.
    pub fn unpack_from(&mut self, frame: &ValidRows) {
        *self = ContactRows::NONE;
        let body = frame.body();
        let rows = body.rows.items();
        self.console_time_us = frame.console_time_us();
        self.tool = body.tool;
        self.held = body.held;
        // At most `MAX_ROWS`.
        self.count = rows.len() as u8;
        let mut packed = body.compliance.items().iter();
        for i in 0..rows.len() {
            for (j, entry) in (i..rows.len()).zip(&mut packed) {
                set(&mut self.compliance, i, j, *entry);
                set(&mut self.compliance, j, i, *entry);
            }
        }
        for (index, row) in rows.iter().enumerate() {
            self.name(index, row);
        }
        self.scale_rows(rows);
        self.cone = cone_of(rows);
        if body.curvature_per_m > 0.0 {
            self.bend(rows, body.curvature_per_m);
        }
    }

    /// Enters a row into its contact.
    fn name(&mut self, index: usize, row: &Row) {
        let (id, friction) = match row.kind {
            RowKind::Smooth { id } => (id, 0.0),
            RowKind::Normal { id, friction } => (id, friction),
            RowKind::Tangent { .. } => return,
        };
        let normal = 1.0 / libm::sqrtf(self.coupling(index, index));
        put(&mut self.scale, index, normal);
        let mut touch = Touch {
            id,
            row: index as u8,
            friction: 0.0,
            limit: MAX_WRENCH / normal,
            opens: [0.0; 3],
            reach_m: 0.0,
        };
        if friction > 0.0 {
            let (a, b) = (index + 1, index + 2);
            let mean = 0.5 * (self.coupling(a, a) + self.coupling(b, b));
            let half = 0.5 * (self.coupling(a, a) - self.coupling(b, b));
            let across = self.coupling(a, b);
            let largest = mean + libm::sqrtf(half * half + across * across);
            let tangent = 1.0 / libm::sqrtf(largest);
            put(&mut self.scale, a, tangent);
            put(&mut self.scale, b, tangent);
            touch.friction = friction * (normal / tangent);
        }
        if let Some(place) = self.touches.get_mut(usize::from(self.touching)) {
            *place = touch;
            self.touching += 1;
        }
    }

    fn scale_rows(&mut self, rows: &[Row]) {
        for (row, own) in self.compliance.iter_mut().zip(self.scale) {
            for (entry, other) in row.iter_mut().zip(self.scale) {
                *entry *= own * other;
            }
        }
        for (index, row) in rows.iter().enumerate() {
            let scale = at(&self.scale, index);
            let anchor = match row.kind {
                RowKind::Tangent { anchor_m } => anchor_m,
                RowKind::Smooth { .. } | RowKind::Normal { .. } => 0.0,
            };
            put(&mut self.anchor, index, anchor * scale);
            put(&mut self.told, index, anchor * scale);
            put(&mut self.free, index, row.delta_free_m * scale);
            put(&mut self.host, index, row.lambda_n / scale);
            if let Some(jacobian) = self.jacobian.get_mut(index) {
                *jacobian = row.jacobian.map(|entry| entry * scale);
            }
        }
        self.lambda = self.host;
    }

    /// How the tool's curvature opens gaps.
    fn bend(&mut self, rows: &[Row], curvature_per_m: f32) {
        for index in 0..usize::from(self.touching) {
            let Some(mut touch) = self.touches.get(index).copied() else {
                return;
            };
            let row = usize::from(touch.row);
            let Some([x, y, z, ..]) = rows.get(row).map(|row| row.jacobian) else {
                return;
            };
            let square = x * x + y * y + z * z;
            if square > 0.0 {
                let part = 1.0 / libm::sqrtf(square);
                touch.opens = [x * part, y * part, z * part];
                let gap = (at(&self.free, row) + self.by_forces(row)) / at(&self.scale, row);
                touch.reach_m = 1.0 / curvature_per_m + max(gap, 0.0);
            }
            if let Some(place) = self.touches.get_mut(index) {
                *place = touch;
            }
        }
    }

    fn coupling(&self, i: usize, j: usize) -> f32 {
        self.compliance.get(i).map_or(0.0, |row| at(row, j))
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Friction cone of all of it at the frame's pose; none where nothing rubs.
    pub(super) fn cone(&self) -> Option<&Cone> {
        self.cone.as_ref()
    }

    /// Console time that they were solved for \[us\].
    pub fn console_time_us(&self) -> u64 {
        self.console_time_us
    }

    /// Tool that they belong to.
    pub fn tool(&self) -> u8 {
        self.tool
    }

    /// The multipliers as they are now \[N\], in the order of the frame's rows.
    pub fn multipliers_n(&self) -> impl Iterator<Item = f32> {
        let rows = self.lambda.iter().zip(&self.scale);
        rows.take(usize::from(self.count))
            .map(|(lambda, scale)| lambda * scale)
    }

    /// Takes the rows of a new frame and goes on from the present ones, see [`adopt`](Self::adopt); none in the
    /// place of none costs nothing. `farthest` says how far along a direction the grip has come since the state that the frame
    /// was solved for, beyond the frame's pose \[m\].
    pub fn replace(&mut self, fresh: &ContactRows, farthest: impl FnOnce(&Vec3) -> f32) {
        if fresh.is_empty() {
            (self.count, self.touching, self.cone) = (0, 0, None);
            self.held = [0.0; 21];
            return;
        }
        let known = self.known();
        *self = *fresh;
        self.go_on(&known);
        self.slip_to(farthest);
    }

    /// A contact that slips on the way from the state's pose to the frame's, where the grip did not come, has slipped no
    /// farther than the grip came: its force is that of the frame there.
    fn slip_to(&mut self, farthest: impl FnOnce(&Vec3) -> f32) {
        let mut along = Vec3::zeros();
        for touch in self.rubbing() {
            along += self.slide(touch, |rows, row| at(&rows.told, row));
        }
        let square = dot(&along, &along);
        if square <= 0.0 {
            return;
        }
        let along = along * (1.0 / libm::sqrtf(square));
        let way = along * min(farthest(&along), 0.0);
        for index in 0..usize::from(self.touching) {
            let touch = self.touches.get(index).copied().unwrap_or_default();
            if touch.friction <= 0.0 {
                continue;
            }
            let rows = [usize::from(touch.row) + 1, usize::from(touch.row) + 2];
            let slipped = square_of(rows.map(|row| at(&self.told, row)));
            if slipped <= 0.0 {
                continue;
            }
            let moved = rows.map(|row| dot(&self.direction(row), &way));
            // No farther back than it slipped.
            let most = square_of(moved);
            let part = if most > slipped {
                libm::sqrtf(slipped / most)
            } else {
                1.0
            };
            for (row, moved) in rows.into_iter().zip(moved) {
                let anchor = at(&self.anchor, row) + part * moved;
                put(&mut self.anchor, row, anchor);
            }
        }
    }

    /// Contacts with friction.
    fn rubbing(&self) -> impl Iterator<Item = &Touch> {
        let touches = self.touches.iter();
        let touches = touches.take(usize::from(self.touching));
        touches.filter(|touch| touch.friction > 0.0)
    }

    /// Linear part of a row's J, scaled.
    fn direction(&self, row: usize) -> Vec3 {
        let row = self.jacobian.get(row);
        row.map_or_else(Vec3::zeros, |[x, y, z, ..]| Vec3::new(*x, *y, *z))
    }

    /// The way over a contact with friction of which its tangents have the scaled parts `of` \[m\].
    fn slide(&self, touch: &Touch, of: impl Fn(&Self, usize) -> f32) -> Vec3 {
        let first = usize::from(touch.row) + 1;
        let scale = at(&self.scale, first);
        // J of a tangent is its direction times its scale.
        let way = [first, first + 1].map(|row| self.direction(row) * of(self, row));
        (way[0] + way[1]) * (1.0 / (scale * scale))
    }

    /// How far the tool has slid over a contact with friction since the frame's pose \[m\].
    fn slid(&self, touch: &Touch) -> Vec3 {
        self.slide(touch, |rows, row| {
            at(&rows.anchor, row) - at(&rows.told, row)
        })
    }

    /// The same on average by force; none if nothing rubs.
    fn slid_on_average(&self) -> Option<Vec3> {
        let (mut whole, mut sum) = (0.0, Vec3::zeros());
        for touch in self.rubbing() {
            let row = usize::from(touch.row);
            let force = at(&self.lambda, row) * at(&self.scale, row);
            whole += force;
            sum += self.slid(touch) * force;
        }
        (whole > 0.0).then(|| sum * (1.0 / whole))
    }

    /// Goes on from the rows that have been rendered so far: the multipliers of contacts that both know carry
    /// over. Where they stick is what the host says, which knows all slip.
    pub fn adopt(&mut self, old: &ContactRows) {
        self.go_on(&old.known());
    }

    fn known(&self) -> Known {
        Known {
            touching: self.touching,
            touches: self.touches,
            lambda: self.lambda,
            scale: self.scale,
            residual: self.residual,
        }
    }

    fn go_on(&mut self, old: &Known) {
        // Rows that nobody can solve are not believed anew with every frame.
        self.residual = if old.residual <= MAX_RESIDUAL {
            UNSOLVED
        } else {
            old.residual
        };
        let known = || old.touches.iter().take(usize::from(old.touching));
        let mut next = known();
        for touch in self.touches.iter().take(usize::from(self.touching)) {
            let is_same = |other: &&Touch| other.id == touch.id;
            // Most come in the order in which they did.
            let before = next.next().filter(is_same);
            let Some(before) = before.or_else(|| known().find(is_same)) else {
                continue;
            };
            let (to, from) = (usize::from(touch.row), usize::from(before.row));
            let both = touch.friction > 0.0 && before.friction > 0.0;
            for row in 0..if both { 3 } else { 1 } {
                let force = at(&old.lambda, from + row) * at(&old.scale, from + row);
                put(
                    &mut self.lambda,
                    to + row,
                    force / at(&self.scale, to + row),
                );
            }
        }
    }

    /// Scaled delta of a row at a pose without multipliers.
    fn without_forces(&self, row: usize, dx: &[f32; 6]) -> f32 {
        let moved = self.jacobian.get(row).map_or(0.0, |row| dot6(row, dx));
        at(&self.free, row) + moved
    }

    /// What the multipliers add to it. Hundreds of times a tick: a call costs as much as a chunk of the product.
    #[inline(always)]
    fn by_forces(&self, row: usize) -> f32 {
        let width = self.width();
        let row = self.compliance.get(row);
        row.map_or(0.0, |row| product(row, &self.lambda, width))
    }

    /// The same of a row and the next one, which change together: what both are multiplied with is read once.
    #[inline(always)]
    fn by_forces_of_two(&self, row: usize) -> [f32; 2] {
        let width = self.width();
        match self.compliance.get(row..row + 2) {
            Some([first, second]) => products([first, second], &self.lambda, width),
            _ => [0.0; 2],
        }
    }

    /// Chunks of [`LANES`] that hold all rows.
    fn width(&self) -> usize {
        usize::from(self.count).div_ceil(LANES)
    }

    /// Solves the rows at the pose `dx` from the frame's: linear \[m\], then rotation vector \[rad\], world frame,
    /// left increment. Always the same number of sweeps, from the multipliers of the solve before. Tangents whose
    /// force is at its limit drag their anchors along.
    pub fn solve(&mut self, dx: &[f32; 6]) -> RowsForce {
        if !is_small(dx) {
            return RowsForce {
                change: [0.0; 6],
                residual: f32::MAX,
            };
        }
        let mut drive = [0.0; MAX_ROWS];
        for row in 0..usize::from(self.count) {
            let free = self.without_forces(row, dx);
            put(&mut drive, row, free - at(&self.anchor, row));
        }
        self.open(&mut drive, dx);
        if self.residual < 0.0 {
            self.start(&drive);
        }
        for _ in 0..SWEEPS {
            self.sweep(&drive);
        }
        self.residual = self.settle(&drive);
        RowsForce {
            change: self.change(dx),
            residual: self.residual,
        }
    }

    /// How gaps open under a round tool: by the way that it slides over a vertex, which is its own where that does not rub.
    /// A vertex without friction that pressed from the start goes along with those that have some.
    fn open(&self, drive: &mut [f32; MAX_ROWS], dx: &[f32; 6]) {
        if self.touches.iter().all(|touch| touch.reach_m <= 0.0) {
            return;
        }
        let [x, y, z, ..] = *dx;
        let way = Vec3::new(x, y, z);
        let on_average = self.slid_on_average();
        for touch in self.touches.iter().take(usize::from(self.touching)) {
            let row = usize::from(touch.row);
            let slid = match on_average {
                Some(_) if touch.friction > 0.0 => self.slid(touch),
                Some(slid) if at(&self.host, row) > 0.0 => slid,
                _ => way,
            };
            let opened = at(drive, row) + touch.opening(&way, &slid) * at(&self.scale, row);
            put(drive, row, opened);
        }
    }

    /// One pass over all contacts.
    fn sweep(&mut self, drive: &[f32; MAX_ROWS]) {
        for index in 0..usize::from(self.touching) {
            let Some(touch) = self.touches.get(index).copied() else {
                return;
            };
            let row = usize::from(touch.row);
            let aim = at(&self.lambda, row) - (at(drive, row) + self.by_forces(row));
            let normal = clamp(aim, 0.0, touch.limit);
            put(&mut self.lambda, row, normal);
            if touch.friction > 0.0 {
                let forces = self.by_forces_of_two(row + 1);
                let aim = [
                    at(&self.lambda, row + 1) - (at(drive, row + 1) + forces[0]),
                    at(&self.lambda, row + 2) - (at(drive, row + 2) + forces[1]),
                ];
                let [a, b] = disc(aim, touch.friction * normal);
                put(&mut self.lambda, row + 1, a);
                put(&mut self.lambda, row + 2, b);
            }
        }
    }

    /// Multipliers to start from: those of the tick before, or the host's, whichever are nearer to solving the rows. Where the
    /// frame before shared its rows among vertices in another way, its multipliers are those of other shares.
    fn start(&mut self, drive: &[f32; MAX_ROWS]) {
        let carried = self.lambda;
        let off = self.farthest_off(drive);
        self.lambda = self.host;
        if self.farthest_off(drive) >= off {
            self.lambda = carried;
        }
    }

    /// The largest violation of a row, scaled.
    fn farthest_off(&self, drive: &[f32; MAX_ROWS]) -> f32 {
        let touches = self.touches.iter().take(usize::from(self.touching));
        touches.fold(0.0, |worst, touch| max(worst, self.left(touch, drive).off))
    }

    /// What is left of a contact's rows.
    #[inline(always)]
    fn left(&self, touch: &Touch, drive: &[f32; MAX_ROWS]) -> Left {
        let row = usize::from(touch.row);
        let lambda = at(&self.lambda, row);
        let delta = at(drive, row) + self.by_forces(row);
        // A multiplier that only the end of the range keeps from growing solves nothing.
        let mut left = Left {
            off: (lambda - max(lambda - delta, 0.0)).abs(),
            slip: None,
        };
        if touch.friction > 0.0 {
            let forces = self.by_forces_of_two(row + 1);
            let delta = [
                at(drive, row + 1) + forces[0],
                at(drive, row + 2) + forces[1],
            ];
            let force = [at(&self.lambda, row + 1), at(&self.lambda, row + 2)];
            let aim = [force[0] - delta[0], force[1] - delta[1]];
            let held = disc(aim, touch.friction * lambda);
            left.off = max(left.off, (force[0] - held[0]).abs());
            left.off = max(left.off, (force[1] - held[1]).abs());
            left.slip = (held != aim).then_some(delta);
        }
        left
    }

    /// What is left of every row: the residual. Anchors of what slips move to where it sticks now.
    fn settle(&mut self, drive: &[f32; MAX_ROWS]) -> f32 {
        let (mut worst, mut largest, mut strongest) = (0.0, 0.0, 0.0);
        for index in 0..usize::from(self.touching) {
            let Some(touch) = self.touches.get(index).copied() else {
                continue;
            };
            let left = self.left(&touch, drive);
            let row = usize::from(touch.row);
            worst = max(worst, left.off);
            // As deep as without forces now, or at the frame's pose: a contact that has all but opened is no reason
            // for doubt.
            largest = max(largest, max(-at(drive, row), -at(&self.free, row)));
            strongest = max(strongest, at(&self.lambda, row));
            for (row, slip) in (row + 1..).zip(left.slip.into_iter().flatten()) {
                let anchor = at(&self.anchor, row) + slip;
                put(&mut self.anchor, row, anchor);
            }
        }
        let scale = largest + ROUNDING * strongest;
        if worst > 0.0 {
            min(worst / scale, f32::MAX)
        } else {
            0.0
        }
    }

    /// M dx + J' (lambda - lambda of the host).
    fn change(&self, dx: &[f32; 6]) -> [f32; 6] {
        let mut change = symmetric_times(&self.held, dx);
        let rows = self.jacobian.iter().zip(self.lambda.iter().zip(&self.host));
        for (jacobian, (lambda, host)) in rows.take(usize::from(self.count)) {
            let more = lambda - host;
            for (sum, entry) in change.iter_mut().zip(jacobian) {
                *sum += entry * more;
            }
        }
        change
    }
}

impl Touch {
    /// What a round tool's way along the surface adds to the gap, which is not in J \[m\]. A vertex is `reach` from the
    /// tool's middle; moved by d it is `|reach opens + d|`, with the part of d across that it slides.
    #[inline]
    fn opening(&self, way: &Vec3, slid: &Vec3) -> f32 {
        if self.reach_m <= 0.0 {
            return 0.0;
        }
        let [a, b, c] = self.opens;
        let opens = Vec3::new(a, b, c);
        let along = dot(&opens, way);
        let aside = dot(&opens, slid);
        // No farther than it went.
        let across = min(
            dot(slid, slid) - aside * aside,
            dot(way, way) - along * along,
        );
        let across = max(across, 0.0);
        let foot = self.reach_m + along;
        libm::sqrtf(foot * foot + across) - foot
    }
}

/// `aim`, brought back to a disc of this radius.
#[inline]
fn disc(aim: [f32; 2], radius: f32) -> [f32; 2] {
    let [a, b] = aim;
    let square = a * a + b * b;
    if square > radius * radius {
        let part = radius / libm::sqrtf(square);
        [a * part, b * part]
    } else {
        aim
    }
}

fn square_of([a, b]: [f32; 2]) -> f32 {
    a * a + b * b
}

/// Whether rows are solved for such a way; not for NaN.
fn is_small(dx: &[f32; 6]) -> bool {
    dx.iter().all(|way| way.abs() <= MAX_WAY)
}

/// Sum of products over the first `width` chunks.
#[inline]
fn product(a: &[f32; MAX_ROWS], b: &[f32; MAX_ROWS], width: usize) -> f32 {
    let (a, _) = a.as_chunks::<LANES>();
    let (b, _) = b.as_chunks::<LANES>();
    let mut sum = 0.0;
    for (a, b) in a.iter().zip(b).take(width) {
        for (a, b) in a.iter().zip(b) {
            sum += a * b;
        }
    }
    sum
}

/// Two of them with one vector, each in the same order.
#[inline]
fn products(a: [&[f32; MAX_ROWS]; 2], x: &[f32; MAX_ROWS], width: usize) -> [f32; 2] {
    let [first, second] = a.map(|row| row.as_chunks::<LANES>().0);
    let (x, _) = x.as_chunks::<LANES>();
    let mut sums = [0.0; 2];
    for ((first, second), x) in first.iter().zip(second).zip(x).take(width) {
        for ((first, second), x) in first.iter().zip(second).zip(x) {
            sums[0] += first * x;
            sums[1] += second * x;
        }
    }
    sums
}

#[inline]
fn dot6(a: &[f32; 6], b: &[f32; 6]) -> f32 {
    let products = a.iter().zip(b).map(|(a, b)| a * b);
    products.fold(0.0, |sum, product| sum + product)
}

/// Product of a packed symmetric matrix (21) and a vector.
pub(super) fn symmetric_times(packed: &[f32; 21], x: &[f32; 6]) -> [f32; 6] {
    let mut out = [0.0; 6];
    let mut entries = packed.iter();
    for i in 0..6 {
        for (j, entry) in (i..6).zip(&mut entries) {
            out[i] += entry * x[j];
            if j > i {
                out[j] += entry * x[i];
            }
        }
    }
    out
}

#[inline]
fn at(values: &[f32; MAX_ROWS], index: usize) -> f32 {
    values.get(index).copied().unwrap_or(0.0)
}

#[inline]
fn put(values: &mut [f32; MAX_ROWS], index: usize, value: f32) {
    if let Some(place) = values.get_mut(index) {
        *place = value;
    }
}

#[inline]
fn set(matrix: &mut [[f32; MAX_ROWS]; MAX_ROWS], i: usize, j: usize, value: f32) {
    if let Some(row) = matrix.get_mut(i) {
        put(row, j, value);
    }
}
/// Cone of all contacts together by the host's multipliers, or by their number where none presses.
fn cone_of(rows: &[Row]) -> Option<Cone> {
    let sum = |weight: &dyn Fn(&Row) -> f32| {
        let (mut friction, mut size, mut sum) = (0.0, 0.0, Vec3::zeros());
        for row in rows {
            friction = match row.kind {
                RowKind::Normal { friction: own, .. } => max(friction, own),
                RowKind::Smooth { .. } => friction,
                RowKind::Tangent { .. } => continue,
            };
            let [x, y, z, ..] = row.jacobian;
            let weight = weight(row);
            size += weight;
            sum += Vec3::new(x, y, z) * weight;
        }
        (friction, size, sum)
    };
    let by_force = sum(&|row| row.lambda_n);
    let (friction, size, sum) = if by_force.1 > LEAST_N {
        by_force
    } else {
        sum(&|_| 1.0)
    };
    let length = libm::sqrtf(dot(&sum, &sum));
    let is_one = length > LEAST_PART * size && friction > 0.0;
    is_one.then(|| Cone::new(sum * (1.0 / length), friction, size / length))
}
