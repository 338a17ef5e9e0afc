//! What a chain's step makes least, and Newton's way there.

use super::{Chain, NONE, Step};
use nalgebra::{Matrix3, Vector3};

impl Chain {
    /// Inertia, gravity, drag, bending and contact of `trial` \[J\]; leaves its contacts in `touch_tried`.
    pub(super) fn potential(&mut self, step: &Step<'_>) -> f64 {
        let mut sum = 0.0;
        for (index, point) in self.points.iter().enumerate() {
            let at = self.trial[index];
            self.touch_tried[index] = (0.0, Vector3::zeros());
            if point.fixed {
                continue;
            }
            let far = (at - self.free[index]).norm_squared();
            let gone = at - self.before[index];
            sum += point.mass
                * (0.5 * step.inertia * far + 0.5 * step.drag * gone.norm_squared()
                    - step.gravity.dot(&gone));
            if let Some((skin, places)) = step.tissue
                && let Some((distance, out)) = skin.distance(places, &at, self.settings.radius_m)
            {
                let depth = self.settings.radius_m - distance;
                self.touch_tried[index] = (depth, out);
                sum += 0.5 * step.stiffness * depth * depth;
            }
        }
        for middle in 1..self.points.len().saturating_sub(1) {
            let (kink, weight, _) = self.kink(&self.trial, middle);
            sum += 0.5 * weight * kink.norm_squared();
        }
        sum
    }

    /// Energy that the step may leave in motion \[J\]: what there was of it, and what bending and gravity gave.
    pub(super) fn energy_left_j(&self, step: &Step<'_>) -> f64 {
        let mut sum = 0.0;
        for (index, point) in self.points.iter().enumerate() {
            let (at, before) = (&self.at[index], &self.before[index]);
            let speed = (self.free[index] - before).norm_squared() * step.inertia;
            sum += point.mass * (0.5 * speed + step.gravity.dot(&(at - before)));
        }
        for middle in 1..self.points.len().saturating_sub(1) {
            let [now, then] = [&self.at, &self.before].map(|at| self.kink(at, middle));
            sum += 0.5 * now.1 * (then.0.norm_squared() - now.0.norm_squared());
        }
        sum.max(0.0)
    }

    /// How much the direction changes at a point, its weight \[N m\] and its three coefficients \[1/m\].
    fn kink(&self, at: &[Vector3<f64>], middle: usize) -> (Vector3<f64>, f64, [f64; 3]) {
        let (a, b) = (self.rest(middle), self.rest(middle + 1));
        let parts = [1.0 / a, -1.0 / a - 1.0 / b, 1.0 / b];
        let kink = at[middle - 1] * parts[0] + at[middle] * parts[1] + at[middle + 1] * parts[2];
        (kink, 2.0 * self.settings.bending_n_m2 / (a + b), parts)
    }

    /// Gradient of the potential at `at` by point, without what holds its lengths; of a fixed point only what
    /// its neighbours and its weight do.
    fn find_gradient(&mut self, step: &Step<'_>) {
        for (index, point) in self.points.iter().enumerate() {
            let mut gradient = -step.gravity * point.mass;
            if !point.fixed {
                let at = self.at[index];
                gradient += (at - self.free[index]) * (point.mass * step.inertia)
                    + (at - self.before[index]) * (point.mass * step.drag);
                let (depth, out) = self.touch[index];
                gradient -= out * (step.stiffness * depth);
            }
            self.gradient[index] = gradient;
        }
        for middle in 1..self.points.len().saturating_sub(1) {
            let (kink, weight, parts) = self.kink(&self.at, middle);
            for (point, part) in (middle - 1..).zip(parts) {
                self.gradient[point] += kink * (weight * part);
            }
        }
    }

    /// The step to where the linearised balance is, left in `rhs`, and the tensions there: the potential's slope along
    /// it and how far a point moves at most. `None` if there is none.
    pub(super) fn newton(&mut self, step: &Step<'_>, firm: f64) -> Option<(f64, f64)> {
        self.find_gradient(step);
        self.band.clear(self.rhs.len());
        for index in 0..self.points.len() {
            let point = self.points[index];
            if point.fixed {
                continue;
            }
            let (depth, out) = self.touch[index];
            let mut block =
                Matrix3::from_diagonal_element(point.mass * (step.inertia + step.drag) + firm);
            if depth > 0.0 {
                block += out * out.transpose() * step.stiffness;
            }
            self.add(index, index, &block);
            for axis in 0..3 {
                self.rhs[point.first + axis] = -self.gradient[index][axis];
            }
        }
        for middle in 1..self.points.len().saturating_sub(1) {
            let (_, weight, parts) = self.kink(&self.at, middle);
            for (a, first) in (middle - 1..).zip(parts) {
                for (b, second) in (middle - 1..=a).zip(parts) {
                    let block = Matrix3::from_diagonal_element(weight * first * second);
                    self.add(a, b, &block);
                }
            }
        }
        for index in 1..self.points.len() {
            let multiplier = self.points[index].multiplier;
            if multiplier == NONE {
                continue;
            }
            let way = self.at[index] - self.at[index - 1];
            let length = way.norm();
            let direction = way / length;
            // A string under tension resists being turned; under pressure only bending holds it.
            let turned = (Matrix3::identity() - direction * direction.transpose())
                * (self.tension[index].max(0.0) / length);
            self.add(index, index, &turned);
            self.add(index - 1, index - 1, &turned);
            self.add(index, index - 1, &-turned);
            for (point, sign) in [(index - 1, -1.0), (index, 1.0)] {
                let first = self.points[point].first;
                if first != NONE {
                    for axis in 0..3 {
                        let value = sign * direction[axis];
                        self.band.add(multiplier, first + axis, value);
                        self.band.add(first + axis, multiplier, value);
                    }
                }
            }
            self.rhs[multiplier] = self.rest(index) - length;
        }
        if !self.band.factor() {
            return None;
        }
        self.band.solve(&mut self.rhs);
        if !self.rhs.iter().all(|x| x.is_finite()) {
            return None;
        }
        let (mut slope, mut farthest) = (0.0, 0.0f64);
        for (index, point) in self.points.iter().enumerate() {
            self.tension[index] = match point.multiplier {
                NONE => 0.0,
                multiplier => self.rhs[multiplier],
            };
            if !point.fixed {
                let moved = self.moved(index);
                slope += moved.dot(&self.gradient[index]);
                farthest = farthest.max(moved.norm());
            }
        }
        Some((slope, farthest))
    }

    /// Adds a block between two points, the later one first.
    fn add(&mut self, a: usize, b: usize, block: &Matrix3<f64>) {
        let (a, b) = (self.points[a].first, self.points[b].first);
        if a == NONE || b == NONE {
            return;
        }
        for row in 0..3 {
            for column in 0..3 {
                self.band.add(a + row, b + column, block[(row, column)]);
            }
        }
    }

    fn moved(&self, index: usize) -> Vector3<f64> {
        match self.points[index].first {
            NONE => Vector3::zeros(),
            first => Vector3::new(self.rhs[first], self.rhs[first + 1], self.rhs[first + 2]),
        }
    }

    /// `at` and a share of the step.
    pub(super) fn go(&mut self, share: f64) {
        for index in 0..self.points.len() {
            self.trial[index] = self.at[index] + self.moved(index) * share;
        }
    }

    /// The share of the step by which no point goes farther than the chain is long, or, near tissue, than would take it
    /// through unseen.
    pub(super) fn clear_share(&self, step: &Step<'_>, farthest: f64) -> f64 {
        let mut most = 0.5 * self.settings.length_m;
        if let Some((skin, _)) = step.tissue
            && farthest > skin.reach_m()
        {
            let met = (0..self.points.len())
                .any(|index| skin.may_meet(&self.at[index], &(self.at[index] + self.moved(index))));
            if met {
                most = most.min(skin.reach_m());
            }
        }
        (most / farthest).min(1.0)
    }

    /// What the chain pulls guides with: gradient and tensions at `at`.
    #[cfg(test)]
    pub(super) fn find_pulls(&mut self, step: &Step<'_>, guides: usize) {
        self.find_gradient(step);
        self.pulls.clear();
        self.pulls.resize(guides, Vector3::zeros());
        for index in 0..self.points.len() {
            let point = self.points[index];
            if !point.is_guide {
                continue;
            }
            let mut pull = -self.gradient[index];
            for (other, tension) in [
                (index.checked_sub(1), self.tension.get(index)),
                (Some(index + 1), self.tension.get(index + 1)),
            ] {
                if let (Some(other), Some(tension)) = (other, tension)
                    && let Some(there) = self.at.get(other)
                    && let Some(way) = (there - self.at[index]).try_normalize(0.0)
                {
                    pull += way * *tension;
                }
            }
            self.pulls[point.index] = pull;
        }
    }
}
