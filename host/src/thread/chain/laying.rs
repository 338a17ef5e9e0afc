//! Which points a chain has in a step, and how its lengths are held.

use super::{
    APART, ASIDE, Chain, Guide, HELD, LAID_ANEW, LEAST_FREE, MOST_PASSES, NONE, Point, STRAIGHT,
};
use nalgebra::Vector3;

impl Chain {
    pub(super) fn are_sound(&self, guides: &[Guide]) -> bool {
        let within = |guide: &Guide| {
            (0.0..=self.settings.length_m).contains(&guide.along_m)
                && guide.at_m.iter().all(|x| x.abs() <= 1e6)
        };
        let ascending = guides.windows(2).all(|two| two[0].along_m < two[1].along_m);
        guides.len() <= self.settings.most_guides && guides.iter().all(within) && ascending
    }

    /// Distance of two nodes along it \[m\].
    pub fn segment(&self) -> f64 {
        self.settings.length_m / (self.settings.nodes - 1) as f64
    }

    /// Points of nodes and guides in their order, and where they were; nodes next to a guide go with it.
    pub(super) fn lay(&mut self, dt: f64, guides: &[Guide]) {
        let segment = self.segment();
        self.points.clear();
        for list in [&mut self.at, &mut self.before, &mut self.free] {
            list.clear();
        }
        let (mut node, mut guide) = (0, 0);
        while node < self.nodes.len() || guide < guides.len() {
            let along = node as f64 * segment;
            let next = guides.get(guide);
            if let Some(next) = next
                && (node == self.nodes.len() || next.along_m <= along)
            {
                let at = Vector3::from(next.at_m);
                self.push(next.along_m, true, guide, at, at);
                guide += 1;
                continue;
            }
            let near = |guide: Option<&Guide>| {
                guide.is_some_and(|guide| (guide.along_m - along).abs() < APART * segment)
            };
            let last = guide.checked_sub(1).and_then(|guide| guides.get(guide));
            if !(near(next) || near(last)) {
                let at = self.nodes[node];
                self.push(along, false, node, at, at + self.velocities[node] * dt);
            }
            node += 1;
        }
        self.straighten();
        self.number();
    }

    fn push(
        &mut self,
        along: f64,
        is_guide: bool,
        index: usize,
        at: Vector3<f64>,
        free: Vector3<f64>,
    ) {
        self.points.push(Point {
            along,
            is_guide,
            index,
            fixed: is_guide,
            mass: 0.0,
            first: NONE,
            multiplier: NONE,
        });
        self.at.push(at);
        self.before.push(at);
        self.free.push(free);
    }

    /// Between guides that are as far apart as there is of chain, nodes are on the line; so few that their pieces alone say
    /// where they are stay on the arc that the slack leaves. From a line that has become too short the way back to
    /// the lengths leads nowhere: its nodes are given that arc to begin with.
    fn straighten(&mut self) {
        let mut last: Option<usize> = None;
        self.stretched = 0.0;
        for point in 0..self.points.len() {
            if !self.points[point].is_guide {
                continue;
            }
            if let Some(from) = last {
                let length = self.points[point].along - self.points[from].along;
                let (a, b) = (self.at[from], self.at[point]);
                let slack = length - a.metric_distance(&b);
                self.stretched = self.stretched.max(-slack / length);
                let is_straight = slack <= STRAIGHT * length;
                // Of a flat parabola.
                let sag = if is_straight {
                    0.0
                } else {
                    (0.375 * length * slack).sqrt()
                };
                let is_laid = is_straight || point - from - 1 < LEAST_FREE;
                if is_laid || self.bow(from, point) < 0.5 * sag {
                    let down = self.across(&(b - a));
                    for between in from + 1..point {
                        let share = (self.points[between].along - self.points[from].along) / length;
                        let hang = 4.0 * sag * share * (1.0 - share);
                        self.at[between] = a.lerp(&b, share) + down * hang;
                        self.points[between].fixed = is_laid;
                    }
                }
            }
            last = Some(point);
        }
    }

    /// How far points between two guides are from the line at most.
    fn bow(&self, from: usize, to: usize) -> f64 {
        let a = self.at[from];
        let along = (self.at[to] - a)
            .try_normalize(0.0)
            .unwrap_or_else(Vector3::z);
        let off = |at: &Vector3<f64>| ((at - a) - along * along.dot(&(at - a))).norm();
        self.at[from + 1..to].iter().map(off).fold(0.0, f64::max)
    }

    /// Unit vector across a line, to the side it is to bow to, or downwards, as far as that is possible.
    fn across(&self, line: &Vector3<f64>) -> Vector3<f64> {
        let along = line.try_normalize(0.0).unwrap_or_else(Vector3::z);
        let gravity = Vector3::from(self.settings.gravity_m_per_s2);
        off(&along, &self.aside)
            .or_else(|| off(&along, &gravity))
            .unwrap_or_else(|| {
                let axis = Vector3::ith(along.iamin(), 1.0);
                (axis - along * along.dot(&axis)).normalize()
            })
    }

    /// How far a loose end that is laid along a unit vector leaves that, over the square of the way along it \[1/m\]: downwards, or to
    /// some side where that is the way it stands; nowhere without gravity.
    pub(super) fn falls(&self, loose: &Vector3<f64>) -> Vector3<f64> {
        let gravity = Vector3::from(self.settings.gravity_m_per_s2);
        if gravity.norm() > 0.0 {
            self.across(loose) * (ASIDE / self.settings.length_m)
        } else {
            Vector3::zeros()
        }
    }

    /// Masses, and places of unknowns: those of a point, then the multiplier of the piece before it.
    fn number(&mut self) {
        let mut unknowns = 0;
        for point in 0..self.points.len() {
            let along = |point: Option<usize>| {
                point
                    .and_then(|point| self.points.get(point))
                    .map(|point| point.along)
            };
            let here = self.points[point].along;
            let after = along(Some(point + 1)).unwrap_or(self.settings.length_m.max(here));
            let before = along(point.checked_sub(1));
            let mut reach = 0.5 * (after - before.unwrap_or(0.0));
            if before.is_none() {
                reach += 0.5 * here;
            }
            if point + 1 == self.points.len() {
                reach += 0.5 * (after - here);
            }
            let (fixed, alone) = (
                self.points[point].fixed,
                point == 0 || self.points[point - 1].fixed && self.points[point].fixed,
            );
            let at = &mut self.points[point];
            at.mass = reach * self.settings.kg_per_m;
            if !fixed {
                at.first = unknowns;
                unknowns += 3;
            }
            if !alone {
                at.multiplier = unknowns;
                unknowns += 1;
            }
        }
        let count = self.points.len();
        self.rhs.clear();
        self.rhs.resize(unknowns, 0.0);
        self.tension.resize(count, 0.0);
        self.touch.resize(count, (0.0, Vector3::zeros()));
        self.touch_tried.resize(count, (0.0, Vector3::zeros()));
        self.gradient.resize(count, Vector3::zeros());
    }

    /// Length of the piece before a point, as it should be.
    pub(super) fn rest(&self, point: usize) -> f64 {
        self.points[point].along - self.points[point - 1].along
    }

    /// Brings `trial` back to its lengths, moving points as little as their masses allow.
    pub(super) fn come_back(&mut self) {
        if self.worst() > LAID_ANEW {
            self.lay_anew();
        }
        for _ in 0..MOST_PASSES {
            if self.worst() <= HELD {
                return;
            }
            self.project();
        }
    }

    /// Largest error of a length of `trial`, of its own.
    pub(super) fn worst(&self) -> f64 {
        let pieces = (1..self.points.len()).filter(|point| self.points[*point].multiplier != NONE);
        pieces
            .map(|point| {
                let length = self.trial[point].metric_distance(&self.trial[point - 1]);
                (length / self.rest(point) - 1.0).abs()
            })
            .fold(0.0, f64::max)
    }

    /// One of Newton's steps towards the lengths: `J M^-1 J' lambda = c`, tridiagonal.
    fn project(&mut self) {
        let free = |point: &Point| if point.fixed { 0.0 } else { 1.0 / point.mass };
        let way = |at: &[Vector3<f64>], point: usize| {
            let way = at[point] - at[point - 1];
            let length = way.norm();
            if length > 0.0 {
                (way / length, length)
            } else {
                (Vector3::z(), 0.0)
            }
        };
        self.lengths.clear();
        self.lengths.push([0.0; 3]);
        for point in 1..self.points.len() {
            let (direction, length) = way(&self.trial, point);
            let (a, b) = (free(&self.points[point - 1]), free(&self.points[point]));
            let mut row = [(a + b) * (1.0 + 1e-13), 0.0, length - self.rest(point)];
            if a + b == 0.0 {
                row = [1.0, 0.0, 0.0];
            } else if point > 1 {
                row[1] = -a * way(&self.trial, point - 1).0.dot(&direction);
            }
            // Forward elimination.
            let last = self.lengths[point - 1];
            if last[0] != 0.0 {
                let factor = row[1] / last[0];
                row[0] -= factor * row[1];
                row[2] -= factor * last[2];
            }
            self.lengths.push(row);
        }
        let mut lambda = 0.0;
        let mut coupling = 0.0;
        for point in (1..self.points.len()).rev() {
            let row = self.lengths[point];
            lambda = if row[0].abs() > 0.0 {
                (row[2] - coupling * lambda) / row[0]
            } else {
                0.0
            };
            coupling = row[1];
            self.lengths[point][2] = lambda;
        }
        // All directions are of before, so that each is taken before its ends move.
        let mut last = Vector3::zeros();
        for point in 1..=self.points.len() {
            let next = if point < self.points.len() {
                way(&self.trial, point).0 * self.lengths[point][2]
            } else {
                Vector3::zeros()
            };
            let moved = (next - last) * free(&self.points[point - 1]);
            self.trial[point - 1] += moved;
            last = next;
        }
    }

    /// Forward from each guide and back from the next (FABRIK, Aristidou & Lasenby 2011): converges from anywhere,
    /// slowly near the end.
    fn lay_anew(&mut self) {
        for _ in 0..MOST_PASSES {
            for point in 1..self.points.len() {
                if !self.points[point].fixed {
                    self.reach(point, point - 1, self.rest(point));
                }
            }
            for point in (1..self.points.len()).rev() {
                if !self.points[point - 1].fixed {
                    self.reach(point - 1, point, self.rest(point));
                }
            }
            if self.worst() < 0.1 * LAID_ANEW {
                return;
            }
        }
    }

    /// Puts a point of `trial` at its distance from another.
    fn reach(&mut self, point: usize, from: usize, length: f64) {
        let way = self.trial[point] - self.trial[from];
        let way = way.try_normalize(1e-9 * length).unwrap_or_else(Vector3::z);
        self.trial[point] = self.trial[from] + way * length;
    }

    /// Nodes and their velocities from the points, with no more than `most_j` of kinetic energy; those that went with a
    /// guide lie between their neighbours.
    pub(super) fn take_over(&mut self, dt: f64, most_j: f64) {
        if self.points.len() < 2 || !self.at.iter().all(|at| at.iter().all(|x| x.is_finite())) {
            return;
        }
        let moved = self.at.iter().zip(&self.before).zip(&self.points);
        let kinetic: f64 = moved
            .map(|((at, before), point)| 0.5 * point.mass * (at - before).norm_squared())
            .sum::<f64>()
            / (dt * dt);
        let slowed = if kinetic > most_j {
            (most_j / kinetic).sqrt()
        } else {
            1.0
        };
        let segment = self.segment();
        let mut after = 1;
        for node in 0..self.nodes.len() {
            let along = node as f64 * segment;
            while after + 1 < self.points.len() && self.points[after].along < along {
                after += 1;
            }
            let (a, b) = (&self.points[after - 1], &self.points[after]);
            let share = (along - a.along) / (b.along - a.along);
            let at = if share == 1.0 {
                self.at[after]
            } else {
                self.at[after - 1].lerp(&self.at[after], share)
            };
            self.velocities[node] = (at - self.nodes[node]) * (slowed / dt);
            self.nodes[node] = at;
        }
    }
}

/// Unit vector to a side, across a unit vector, if there is one.
fn off(along: &Vector3<f64>, side: &Vector3<f64>) -> Option<Vector3<f64>> {
    let across = side - along * along.dot(side);
    across.try_normalize(1e-6 * side.norm())
}
