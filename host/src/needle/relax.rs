//! How far along a curve slides go from one solve to the next, so that they come to rest.
//!
//! Entry point: [`Relaxation`]. A point that slides along a curve turns the directions of the forces across it: pressed by F on tissue
//! of compliance C, a curvature k takes it by k F C of its last change to the other side, or on. Where that is near 1 the places swing
//! for long, and beyond it for ever. A part of the change is taken that would end it if all places went alike, as the last two changes
//! have it (Irons & Tuck 1969, Aitken's rule for vectors).

/// Least part of a change that is taken.
const LEAST: f64 = 0.05;

/// Changes of all places on a curve in the last solve and before.
#[derive(Clone, Debug)]
pub(super) struct Relaxation {
    part: f64,
    last_m: Vec<f64>,
    now_m: Vec<f64>,
}

impl Relaxation {
    /// For so many places.
    pub fn new(most: usize) -> Self {
        Self {
            part: 1.0,
            last_m: Vec::with_capacity(most),
            now_m: Vec::with_capacity(most),
        }
    }

    /// Forgets what was.
    pub fn begin(&mut self) {
        self.part = 1.0;
        self.last_m.clear();
        self.now_m.clear();
    }

    /// Takes the change of the next place \[m\].
    pub fn take(&mut self, change_m: f64) {
        self.now_m.push(change_m);
    }

    /// Which part of all the changes that were taken is to be made.
    pub fn part(&mut self) -> f64 {
        let (now, last) = (&self.now_m, &self.last_m);
        if now.len() == last.len() {
            let pairs = || now.iter().zip(last);
            let grown: f64 = pairs().map(|(now, last)| (now - last).powi(2)).sum();
            let along: f64 = pairs().map(|(now, last)| last * (now - last)).sum();
            if grown > 0.0 {
                self.part = (-self.part * along / grown).clamp(LEAST, 1.0);
            }
        } else {
            self.part = 1.0;
        }
        std::mem::swap(&mut self.last_m, &mut self.now_m);
        self.now_m.clear();
        self.part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places of which each change brings about so much of the next one: how many it takes until all changes are below 1e-9.
    fn changes(grows: [f64; 2]) -> Option<usize> {
        let mut relaxation = Relaxation::new(2);
        let mut off_m = [1e-3, -2e-3];
        for count in 1..=64 {
            let change_m = [0, 1].map(|place| (grows[place] - 1.0) * off_m[place]);
            if change_m.iter().all(|change| change.abs() < 1e-12) {
                return Some(count);
            }
            change_m.iter().for_each(|change| relaxation.take(*change));
            let part = relaxation.part();
            for place in [0, 1] {
                off_m[place] += part * change_m[place];
            }
        }
        None
    }

    #[test]
    fn what_swings_comes_to_rest() {
        // Without it 0.9^n, and 3^n.
        for swings in [-0.1, -0.5, -0.9, -3.0] {
            let count = changes([swings; 2]);
            assert!(count.is_some_and(|count| count <= 5), "{swings}: {count:?}");
        }
        let count = changes([-0.9, -0.2]);
        assert!(count.is_some_and(|count| count <= 24), "{count:?}");
        // What goes on the same way is let be.
        let count = changes([0.3; 2]);
        assert!(count.is_some_and(|count| count <= 20), "{count:?}");
    }

    #[test]
    fn another_number_of_places_begins_anew() {
        let mut relaxation = Relaxation::new(2);
        relaxation.take(1.0);
        assert_eq!(relaxation.part(), 1.0);
        relaxation.take(-1.0);
        assert_eq!(relaxation.part(), 0.5);
        relaxation.take(1.0);
        relaxation.take(1.0);
        assert_eq!(relaxation.part(), 1.0);
    }
}
